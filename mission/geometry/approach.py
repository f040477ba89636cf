"""The way to the first circle, or to another one that keeps away from the target: turn, straight, turn.

::

         .--.
        ( c1 )------- straight, on the course common to both circles ------.
         '--'                                                            ( c2 )

Curvature steps between the three parts; the autopilot's roll lag rounds them. That is good enough far from the
target, where an approach is used; next to the target the planners fly continuous curvature.

Source: Dubins, "On curves of minimal length with a constraint on average curvature", American Journal of Mathematics
79(3), 1957; docs/health.md#the-target-is-not-seen, #ways-out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement
from sidelong.mission.geometry.progress import dead_reckoned

# Below this speed a course is noise, and the aircraft's present side serves instead.
_MIN_SPEED_FOR_COURSE_M_S = 0.5
_SAMPLE_M, _SAMPLES_MAX = 5.0, 1000  # of one part


def approach(aircraft: AircraftState, target: TargetEstimate, airframe: Aircraft, requirement: Requirement) -> Plan:
    """Return the shortest way to a circle in mid-band on the required side that keeps range_min_m to the target.

    If no way keeps it (the aircraft is already inside), the way whose least range is greatest is returned. The
    target is taken to move on at its present velocity until the aircraft arrives.
    """
    arrival_s = 0.0
    for _ in range(3):  # where the target will be depends on how long the way is
        plan = _plan_to(aircraft, target, airframe, requirement, arrival_s)
        arrival_s = plan.transition_m / airframe.airspeed_m_s
    return plan


def _plan_to(
    aircraft: AircraftState, target: TargetEstimate, airframe: Aircraft, requirement: Requirement, arrival_s: float
) -> Plan:
    east_m = target.east_m + target.velocity_east_m_s * arrival_s
    north_m = target.north_m + target.velocity_north_m_s * arrival_s
    if target.speed_m_s >= _MIN_SPEED_FOR_COURSE_M_S:
        side_rad = target.course_rad + requirement.side.normal_turn_rad
    else:
        side_rad = math.atan2(aircraft.east_m - east_m, aircraft.north_m - north_m)
    middle_m = 0.5 * (requirement.range_min_m + requirement.range_max_m)
    stand_off_m = max(middle_m, requirement.range_min_m + airframe.radius_m)
    (circle,) = _circles_about(
        (east_m, north_m), [stand_off_m], [side_rad], airframe.radius_m, requirement.side.clockwise
    )

    def rank(path: Path) -> tuple[float, float]:
        nearest_m = least_range_m(path, target, airframe.airspeed_m_s)
        return max(0.0, requirement.range_min_m - nearest_m), path.length_m

    candidates = (turn_straight_turn(aircraft, circle, turn * airframe.radius_m) for turn in (1.0, -1.0))
    paths = [path for path in candidates if path is not None]
    # A wanted circle that overlaps both turning circles is joined by a straight to where the aircraft's course meets
    # it best; the autopilot captures it.
    straight = (circle.radius_m, 0.0), (_SAMPLE_M, circle.curvature_per_m)
    path = min(paths, key=rank) if paths else _sampled(aircraft, straight)
    return Plan(circle, path, aircraft.time_s)


def _circles_about(
    middle_m: tuple[float, float], rings_m: list[float], bearings_rad: list[float], radius_m: float, clockwise: bool
) -> list[Circle]:
    """Return circles with their centres on rings about a place (east, north)."""
    places = [(ring_m, bearing_rad) for ring_m in rings_m for bearing_rad in bearings_rad]
    east_m, north_m = middle_m
    return [Circle(east_m + r * math.sin(b), north_m + r * math.cos(b), radius_m, clockwise) for r, b in places]


def least_range_m(path: Path, target: TargetEstimate, airspeed_m_s: float) -> float:
    """Return the least distance between an aircraft on a path and a target that keeps its velocity, m."""
    time_s = path.arc_m / airspeed_m_s
    range_m = np.hypot(
        path.east_m - target.east_m - target.velocity_east_m_s * time_s,
        path.north_m - target.north_m - target.velocity_north_m_s * time_s,
    )
    return float(range_m.min())


def turn_straight_turn(aircraft: AircraftState, circle: Circle, first_radius_m: float) -> Path | None:
    """Return the line from the aircraft to ``circle``: a turn (positive radius: right), a straight, and the entry.

    None where the two circles overlap so far that they have no common tangent of this kind.
    """
    radius_m = abs(first_radius_m)
    first = Circle.tangent_to(
        aircraft.east_m, aircraft.north_m, aircraft.course_rad, radius_m, clockwise=first_radius_m > 0
    )
    east_m, north_m = circle.east_m - first.east_m, circle.north_m - first.north_m
    distance_m = math.hypot(east_m, north_m)
    second_radius_m = circle.radius_m if circle.clockwise else -circle.radius_m
    difference_m = second_radius_m - first_radius_m
    if distance_m <= abs(difference_m) + 1e-6:
        return None
    # On course h both circles lie at their signed radius to the right of the straight, so
    # distance * sin(bearing - h) = difference of the signed radii.
    course_rad = math.atan2(east_m, north_m) - math.asin(difference_m / distance_m)
    turn_sign = math.copysign(1.0, first_radius_m)
    turn_rad = turn_sign * ((course_rad - aircraft.course_rad) * turn_sign % (2.0 * math.pi))
    if abs(turn_rad) > 2.0 * math.pi - 1e-6:
        turn_rad = 0.0
    straight_m = math.sqrt(distance_m**2 - difference_m**2)
    return _sampled(
        aircraft,
        ((abs(turn_rad) * radius_m, 1.0 / first_radius_m), (straight_m, 0.0), (_SAMPLE_M, circle.curvature_per_m)),
    )


def arc(aircraft: AircraftState, length_m: float, curvature_per_m: float) -> Path:
    """Return a line of one curvature, positive to the right, from the aircraft."""
    return _sampled(aircraft, ((max(length_m, 1.0), curvature_per_m),))


def joined(first: Path, second: Path) -> Path:
    """Return two paths as one; the second begins where the first ends."""
    arc_m = np.concatenate((first.arc_m, first.length_m + second.arc_m[1:]))
    names = "east_m", "north_m", "course_rad", "curvature_per_m"
    return Path(arc_m, *(np.concatenate((getattr(first, name), getattr(second, name)[1:])) for name in names))


def _sampled(start: AircraftState, parts: tuple[tuple[float, float], ...]) -> Path:
    """Return the line of constant-curvature parts (length_m, curvature_per_m) from ``start``."""
    flown = [(length_m, per_m) for length_m, per_m in parts if length_m > 0.0]
    counts = [min(max(1, math.ceil(length_m / _SAMPLE_M)), _SAMPLES_MAX) for length_m, _ in flown]
    step_m = np.repeat([length_m / count for (length_m, _), count in zip(flown, counts, strict=True)], counts)
    curvature_per_m = np.repeat([per_m for _, per_m in flown], counts)
    turned_rad = curvature_per_m * step_m
    course_rad = start.course_rad + np.concatenate(([0.0], np.cumsum(turned_rad)))
    # The chord of an arc points along its middle course and is shorter by sinc.
    chord_m = step_m * np.sinc(turned_rad / (2.0 * math.pi))
    middle_rad = course_rad[:-1] + 0.5 * turned_rad
    return Path(
        np.concatenate(([0.0], np.cumsum(step_m))),
        start.east_m + np.concatenate(([0.0], np.cumsum(chord_m * np.sin(middle_rad)))),
        start.north_m + np.concatenate(([0.0], np.cumsum(chord_m * np.cos(middle_rad)))),
        course_rad,
        np.concatenate(([parts[0][1]], curvature_per_m)),
    )


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

    speed_m_s: how fast it grows. velocity_m_s: how its middle moves (east, north).
    """

    east_m: float
    north_m: float
    radius_m: float
    speed_m_s: float
    velocity_m_s: tuple[float, float] = (0.0, 0.0)

    @staticmethod
    def seen(target: TargetEstimate, speed_max_m_s: float) -> Reach:
        """Return the disk of a target in sight: 2 sigma of its position, which grows since the target may turn."""
        sigma_m = math.sqrt(max(target.covariance[0, 0], target.covariance[1, 1]))
        velocity_m_s = target.velocity_east_m_s, target.velocity_north_m_s
        return Reach(target.east_m, target.north_m, 2.0 * sigma_m, _TURN_SHARE * speed_max_m_s, velocity_m_s)

    def clearance_m(self, plan: Plan, airspeed_m_s: float, hold_s: float = HOLD_S, from_m: float = 0.0) -> float:
        """Return the least distance between what is left of a plan and the disk, which grows in that time.

        The aircraft is ``from_m`` along the plan; its circle is flown for ``hold_s`` after the transition.
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
        grown_m = self.radius_m + self.speed_m_s * (left_s + hold_s)
        for later in (self.after(left_s), self.after(left_s + hold_s)):
            centre_m = math.hypot(circle.east_m - later.east_m, circle.north_m - later.north_m)
            path_m = min(path_m, abs(centre_m - circle.radius_m) - grown_m)
        return path_m

    def holds(self, east_m: float, north_m: float, beyond_m: float) -> bool:
        """Return whether a place is in the disk, or at most so far beyond it."""
        return math.hypot(east_m - self.east_m, north_m - self.north_m) <= self.radius_m + beyond_m

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

    The best is the nearest circle that keeps ``keep_m`` from the disk, and from others, on the way and for some time
    on the circle: the laser does not reach far. Where none does, the best keeps most. start, reach: at the departure.
    """
    radius_m, airspeed_m_s = airframe.radius_m, airframe.airspeed_m_s
    farthest_m = keep_m + reach.radius_m + radius_m + reach.speed_m_s * HOLD_S
    # The disk grows on the way, which leads at most half round it.
    farthest_m /= max(1.0 - math.pi * reach.speed_m_s / airspeed_m_s, 0.5)
    bearings_rad = np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False).tolist()
    rings_m, middle_m = [share * farthest_m for share in _RINGS], (reach.east_m, reach.north_m)
    circles = _circles_about(middle_m, rings_m, bearings_rad, radius_m, clockwise)
    plans = [plan for circle in circles for plan in paths_to(circle, start, airframe)]

    def rank(plan: Plan) -> tuple[float, float, float]:
        clear_m = min(disk.clearance_m(plan, airspeed_m_s) for disk in (reach, *others))
        away_m = math.hypot(plan.circle.east_m - reach.east_m, plan.circle.north_m - reach.north_m)
        return max(keep_m - clear_m, 0.0), round(away_m), plan.transition_m

    return sorted(plans, key=rank)


_ORBIT_S = 30.0  # for which a circle around the disk is kept


def orbits(start: AircraftState, reach: Reach, airframe: Aircraft, keep_m: float) -> list[Plan]:
    """Return plans to circles around the disk, in either sense, the shorter way first: they see it from all around.

    Each keeps ``keep_m`` from the disk on the way and for some time on the circle. start, reach: at the departure.
    """
    airspeed_m_s, plans = airframe.airspeed_m_s, []
    for clockwise in (True, False):
        arrival_s, plan = 0.0, None
        for _ in range(3):  # the disk grows and moves on the way
            middle, later = reach.after(arrival_s + 0.5 * _ORBIT_S), reach.after(arrival_s + _ORBIT_S)
            radius_m = keep_m + later.radius_m + 0.5 * math.hypot(*reach.velocity_m_s) * _ORBIT_S
            circle = Circle(middle.east_m, middle.north_m, radius_m, clockwise)
            ways = paths_to(circle, start, airframe) or _from_within(circle, start, airframe)
            plan = min(ways, key=lambda way: way.transition_m, default=None)
            if plan is None:
                break
            arrival_s = 1.05 * plan.transition_m / airspeed_m_s
        if plan is not None and reach.clearance_m(plan, airspeed_m_s, LEAVE_S) >= keep_m:
            plans.append(plan)
    return sorted(plans, key=lambda plan: plan.transition_m)


def _from_within(circle: Circle, start: AircraftState, airframe: Aircraft) -> list[Plan]:
    """Return plans to a wide circle around the aircraft, by a tight circle that touches it from within."""
    sense, radius_m, plans = (1.0 if circle.clockwise else -1.0), airframe.radius_m, []
    bearings_rad = np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False).tolist()
    tight = _circles_about(
        (circle.east_m, circle.north_m), [circle.radius_m - radius_m], bearings_rad, radius_m, circle.clockwise
    )
    for one, bearing_rad in zip(tight, bearings_rad, strict=True):
        for plan in paths_to(one, start, airframe):
            path = plan.transition
            assert path is not None
            turn_rad = (sense * (bearing_rad - path.course_rad[-1]) + 0.5 * math.pi) % (2.0 * math.pi)
            per_m = sense / radius_m
            end = path.east_m[-1], path.north_m[-1], path.course_rad[-1], start.ground_speed_m_s, per_m
            onto = arc(AircraftState(start.time_s, *end), turn_rad * radius_m, per_m)
            plans.append(Plan(circle, joined(path, onto), start.time_s))
    return plans


_ESCAPE_BEARINGS, _ESCAPE_RINGS = 24, 3
_ABEAM = 0.5  # cosine of the angle from abeam of the target within which a circle is on a side


def paths_to(circle: Circle, start: AircraftState, airframe: Aircraft) -> list[Plan]:
    """Return plans to a circle by a first turn to either side, the shorter one first; none if it is too near.

    Each begins with the way on which the aircraft rolls into its turn. start: the aircraft at the departure.
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

    The circles lie in the range band about the target, without one about the present circle. start: the aircraft at
    the departure.
    """
    radius_m, side_rad, clockwise = airframe.radius_m, 0.0, present.clockwise
    middle_m, rings_m = (present.east_m, present.north_m), np.array([4.0, 6.0, 8.0]) * radius_m
    if target is not None:
        middle_m, clockwise = (target.east_m, target.north_m), requirement.side.clockwise
        limits_m = requirement.range_min_m + radius_m, requirement.range_max_m - radius_m
        rings_m = np.linspace(*limits_m, _ESCAPE_RINGS + 2)[1:-1]  # the target moves: not at the limits themselves
        side_rad = target.course_rad + requirement.side.normal_turn_rad

    def rank(circle: Circle) -> tuple[bool, float]:
        bearing_rad = math.atan2(circle.east_m - middle_m[0], circle.north_m - middle_m[1])
        off_side = target is not None and math.cos(bearing_rad - side_rad) < _ABEAM
        return off_side, math.hypot(circle.east_m - present.east_m, circle.north_m - present.north_m)

    bearings_rad = np.arange(_ESCAPE_BEARINGS) * 2.0 * math.pi / _ESCAPE_BEARINGS
    circles = _circles_about(middle_m, rings_m.tolist(), bearings_rad.tolist(), radius_m, clockwise)
    for circle in sorted(circles, key=rank):
        yield from paths_to(circle, start, airframe)
