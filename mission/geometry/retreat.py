"""Ways out: plans to another circle, or back to the present one, that keep away from the target.

Source: docs/health.md#the-target-is-not-seen; docs/health.md#ways-out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement
from sidelong.mission.geometry.approach import arc, joined, turn_straight_turn
from sidelong.mission.geometry.progress import dead_reckoned

LEAVE_S = 10.0
"""The aircraft needs this time to leave a circle."""
HOLD_S = 40.0
"""A new circle has to stay clear for this time, so that the aircraft does not move all the time."""
_BEARINGS = 16
_RINGS = (1.0, 0.85, 0.7, 0.6, 0.5)
_TURN_SHARE = 0.3  # of its highest speed, by which a seen target may leave its course in some seconds


@dataclass(frozen=True, slots=True)
class Reach:
    """The disk in which the target is: it grows about the position where it was last seen, or moves with its track.

    Attributes:
        east_m: Where the target was last seen.
        north_m: The same, north.
        radius_m: Of the disk now.
        speed_m_s: How fast the disk grows.
        velocity_m_s: How its middle moves, east and north.
    """

    east_m: float
    north_m: float
    radius_m: float
    speed_m_s: float
    velocity_m_s: tuple[float, float] = (0.0, 0.0)

    @staticmethod
    def seen(target: TargetEstimate, speed_max_m_s: float) -> Reach:
        """Return the disk of a target that is seen, as its estimate has it and as it may turn.

        Args:
            target: The estimate.
            speed_max_m_s: The target's highest speed.
        """
        sigma_m = math.sqrt(max(target.covariance[0, 0], target.covariance[1, 1]))
        velocity_m_s = target.velocity_east_m_s, target.velocity_north_m_s
        return Reach(target.east_m, target.north_m, 2.0 * sigma_m, _TURN_SHARE * speed_max_m_s, velocity_m_s)

    def clearance_m(self, plan: Plan, airspeed_m_s: float, hold_s: float = HOLD_S, from_m: float = 0.0) -> float:
        """Return the least distance between what is left of a plan and the disk, which grows in that time.

        Args:
            plan: The plan; its circle is flown for ``hold_s`` after the transition.
            airspeed_m_s: Of the aircraft.
            hold_s: Time on the circle, s.
            from_m: Where on the plan the aircraft is.
        """
        circle, path, left_s, path_m = plan.circle, plan.transition, 0.0, math.inf
        east_m_s, north_m_s = self.velocity_m_s
        if path is not None and from_m < path.length_m:
            ahead = path.arc_m >= from_m
            after_s = (path.arc_m[ahead] - from_m) / airspeed_m_s
            left_s = float(after_s[-1])
            east_m = path.east_m[ahead] - self.east_m - east_m_s * after_s
            north_m = path.north_m[ahead] - self.north_m - north_m_s * after_s
            path_m = float((np.hypot(east_m, north_m) - self.speed_m_s * after_s).min()) - self.radius_m
        circle_m = math.inf
        for after in {left_s, left_s + hold_s}:
            later = self.after(after)
            centre_m = math.hypot(circle.east_m - later.east_m, circle.north_m - later.north_m)
            grown_m = self.radius_m + self.speed_m_s * (left_s + hold_s)
            circle_m = min(circle_m, abs(centre_m - circle.radius_m) - grown_m)
        return min(path_m, circle_m)

    def after(self, seconds: float) -> Reach:
        """Return the disk some seconds later."""
        east_m, north_m = (speed_m_s * seconds for speed_m_s in self.velocity_m_s)
        radius_m = self.radius_m + self.speed_m_s * seconds
        return replace(self, east_m=self.east_m + east_m, north_m=self.north_m + north_m, radius_m=radius_m)


def retreats(
    start: AircraftState,
    reach: Reach,
    clockwise: bool,
    airframe: Aircraft,
    keep_m: float,
    others: Sequence[Reach] = (),
) -> list[Plan]:
    """Return plans to circles away from the disk, the best first.

    The best is the nearest circle that keeps ``keep_m`` from the disk, on the way and for some time on the circle:
    the laser does not reach far. Where none does, the best keeps most.

    Args:
        start: The aircraft at the departure.
        reach: Where the target can be at the departure.
        clockwise: Sense of flight of the circles.
        airframe: Gives the radius and the airspeed.
        keep_m: Distance to keep from the disk.
        others: Disks to keep as far from.
    """
    radius_m, airspeed_m_s = airframe.radius_m, airframe.airspeed_m_s
    farthest_m = keep_m + reach.radius_m + radius_m + reach.speed_m_s * HOLD_S
    # The disk grows on the way, which leads at most half round it.
    farthest_m /= max(1.0 - math.pi * reach.speed_m_s / airspeed_m_s, 0.5)
    plans: list[Plan] = []
    for ring_m in (share * farthest_m for share in _RINGS):
        for bearing_rad in np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False).tolist():
            east_m = reach.east_m + ring_m * math.sin(bearing_rad)
            north_m = reach.north_m + ring_m * math.cos(bearing_rad)
            plans += paths_to(Circle(east_m, north_m, radius_m, clockwise), start, airframe)

    def rank(plan: Plan) -> tuple[float, float, float]:
        clear_m = min(one.clearance_m(plan, airspeed_m_s) for one in (reach, *others))
        lacks_m = max(keep_m - clear_m, 0.0)
        circle = plan.circle
        away_m = math.hypot(circle.east_m - reach.east_m, circle.north_m - reach.north_m)
        return lacks_m, round(away_m), plan.transition_m

    return sorted(plans, key=rank)


_ESCAPE_BEARINGS, _ESCAPE_RINGS = 24, 3
_ABEAM = 0.5  # cosine of the angle from abeam of the target within which a circle is on a side


def paths_to(circle: Circle, start: AircraftState, airframe: Aircraft) -> list[Plan]:
    """Return plans to a circle by a first turn to either side, the shorter one first; none if it is too near.

    Each begins with the way on which the aircraft rolls into its turn.

    Args:
        start: The aircraft at the departure.
        airframe: Gives the radius of the turn and the roll rate.
    """
    plans = []
    for turn_m in (airframe.radius_m, -airframe.radius_m):
        per_m = 0.5 * (start.curvature_per_m + 1.0 / turn_m)
        roll_s = airframe.roll_s(1.0 / turn_m, start.curvature_per_m)
        rolled = dead_reckoned(replace(start, curvature_per_m=per_m), roll_s)
        path = turn_straight_turn(rolled, circle, turn_m)
        if path is not None:
            plans.append(Plan(circle, joined(arc(start, roll_s * start.ground_speed_m_s, per_m), path), start.time_s))
    return sorted(plans, key=lambda plan: plan.transition_m)


def escapes(
    start: AircraftState, target: TargetEstimate | None, present: Circle, airframe: Aircraft, requirement: Requirement
) -> Iterator[Plan]:
    """Yield plans to other circles, the nearest on the required side first.

    With a target the circles lie in the range band about it.

    Args:
        start: The aircraft at the departure.
        target: The estimate of the target; None while there is none: circles about the present one are returned.
        present: The circle that is flown.
        airframe: Gives the radius and the airspeed.
        requirement: Gives band and side.
    """
    for circle in _circles(target, present, airframe, requirement):
        yield from paths_to(circle, start, airframe)


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
