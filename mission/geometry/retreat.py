"""Plans that keep away from a target that is not seen. Source: docs/health.md#the-target-is-not-seen."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement
from sidelong.mission.geometry.approach import least_range_m, turn_straight_turn

LEAVE_S = 10.0
"""The aircraft needs this time to leave a circle."""
HOLD_S = 40.0
"""A new circle has to stay clear for this time, so that the aircraft does not move all the time."""
_BEARINGS = 16
_RINGS = (1.0, 0.85, 0.7, 0.6, 0.5)


@dataclass(frozen=True, slots=True)
class Reach:
    """The disk in which an unseen target is: it grows about the position where it was last seen.

    Attributes:
        east_m: Where the target was last seen.
        north_m: The same, north.
        radius_m: Of the disk now.
        speed_m_s: How fast the disk grows.
    """

    east_m: float
    north_m: float
    radius_m: float
    speed_m_s: float

    def clearance_m(self, plan: Plan, airspeed_m_s: float, hold_s: float = HOLD_S, from_m: float = 0.0) -> float:
        """Return the least distance between what is left of a plan and the disk, which grows in that time.

        Args:
            plan: The plan; its circle is flown for ``hold_s`` after the transition.
            airspeed_m_s: Of the aircraft.
            hold_s: Time on the circle, s.
            from_m: Where on the plan the aircraft is.
        """
        circle, path, left_m, path_m = plan.circle, plan.transition, 0.0, math.inf
        if path is not None and from_m < path.length_m:
            ahead = path.arc_m >= from_m
            left_m = path.length_m - from_m
            away_m = np.hypot(path.east_m[ahead] - self.east_m, path.north_m[ahead] - self.north_m)
            path_grown_m = self.speed_m_s * (path.arc_m[ahead] - from_m) / airspeed_m_s
            path_m = float((away_m - path_grown_m).min()) - self.radius_m
        centre_m = math.hypot(circle.east_m - self.east_m, circle.north_m - self.north_m)
        grown_m = self.speed_m_s * (left_m / airspeed_m_s + hold_s)
        return min(path_m, abs(centre_m - circle.radius_m) - self.radius_m - grown_m)

    def after(self, seconds: float) -> Reach:
        """Return the disk some seconds later."""
        return replace(self, radius_m=self.radius_m + self.speed_m_s * seconds)


def retreats(start: AircraftState, reach: Reach, clockwise: bool, airframe: Aircraft, keep_m: float) -> list[Plan]:
    """Return plans to circles away from the disk, the best first.

    The best is the nearest circle that keeps ``keep_m`` from the disk, on the way and for some time on the circle:
    the laser does not reach far. Where none does, the best keeps most.

    Args:
        start: The aircraft at the departure.
        reach: Where the target can be at the departure.
        clockwise: Sense of flight of the circles.
        airframe: Gives the radius and the airspeed.
        keep_m: Distance to keep from the disk.
    """
    radius_m, airspeed_m_s = airframe.radius_m, airframe.airspeed_m_s
    farthest_m = keep_m + reach.radius_m + radius_m + reach.speed_m_s * HOLD_S
    # The disk grows on the way, which leads at most half round it.
    farthest_m /= max(1.0 - math.pi * reach.speed_m_s / airspeed_m_s, 0.5)
    plans = []
    for ring_m in (share * farthest_m for share in _RINGS):
        for bearing_rad in np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False).tolist():
            east_m = reach.east_m + ring_m * math.sin(bearing_rad)
            north_m = reach.north_m + ring_m * math.cos(bearing_rad)
            circle = Circle(east_m, north_m, radius_m, clockwise)
            for turn in (radius_m, -radius_m):
                path = turn_straight_turn(start, circle, turn)
                if path is not None:
                    plans.append(Plan(circle, path, start.time_s))

    def rank(plan: Plan) -> tuple[float, float, float]:
        lacks_m = max(keep_m - reach.clearance_m(plan, airspeed_m_s), 0.0)
        circle = plan.circle
        away_m = math.hypot(circle.east_m - reach.east_m, circle.north_m - reach.north_m)
        return lacks_m, round(away_m), plan.transition_m

    return sorted(plans, key=rank)


_ESCAPE_BEARINGS, _ESCAPE_RINGS = 24, 3
_ABEAM = 0.5  # cosine of the angle from abeam of the target within which a circle is on a side


def escapes(
    start: AircraftState, target: TargetEstimate | None, present: Circle, airframe: Aircraft, requirement: Requirement
) -> Iterator[Plan]:
    """Yield plans to other circles, the nearest on the required side first.

    With a target the circles lie in the range band about it, and no path comes nearer to it than range_min_m.

    Args:
        start: The aircraft at the departure.
        target: The estimate of the target; None while there is none: circles about the present one are returned.
        present: The circle that is flown.
        airframe: Gives the radius and the airspeed.
        requirement: Gives band and side.
    """

    def keeps_range(path: Path) -> bool:
        return target is None or least_range_m(path, target, airframe.airspeed_m_s) >= requirement.range_min_m

    for circle in _circles(target, present, airframe, requirement):
        paths = (turn_straight_turn(start, circle, turn * airframe.radius_m) for turn in (1.0, -1.0))
        clear = [path for path in paths if path is not None and keeps_range(path)]
        if clear:
            yield Plan(circle, min(clear, key=lambda path: path.length_m), start.time_s)


def _circles(
    target: TargetEstimate | None, present: Circle, airframe: Aircraft, requirement: Requirement
) -> list[Circle]:
    radius_m = airframe.radius_m
    if target is None:
        middle_m, rings_m = (present.east_m, present.north_m), np.array([4.0, 6.0, 8.0]) * radius_m
        side_rad = 0.0
    else:
        middle_m = target.east_m, target.north_m
        limits_m = requirement.range_min_m + radius_m, requirement.range_max_m - radius_m
        rings_m = np.linspace(*limits_m, _ESCAPE_RINGS + 2)[1:-1]  # the target moves: not at the limits themselves
        side_rad = target.course_rad + requirement.side.normal_turn_rad

    def rank(circle: Circle) -> tuple[bool, float]:
        bearing_rad = math.atan2(circle.east_m - middle_m[0], circle.north_m - middle_m[1])
        off_side = target is not None and math.cos(bearing_rad - side_rad) < _ABEAM
        return off_side, math.hypot(circle.east_m - present.east_m, circle.north_m - present.north_m)

    bearings_rad = np.arange(_ESCAPE_BEARINGS) * 2.0 * math.pi / _ESCAPE_BEARINGS
    circles = [
        Circle(
            middle_m[0] + ring_m * math.sin(bearing_rad),
            middle_m[1] + ring_m * math.cos(bearing_rad),
            radius_m,
            present.clockwise if target is None else requirement.side.clockwise,
        )
        for ring_m in rings_m.tolist()
        for bearing_rad in bearings_rad.tolist()
    ]
    return sorted(circles, key=rank)
