"""The way to the first circle, or back to one after the target was lost: turn, straight, turn.

::

         .--.
        ( c1 )------- straight, on the course common to both circles ------.
         '--'                                                            ( c2 )

Curvature steps between the three parts; the autopilot's roll lag rounds them. That is good enough far from the
target, where an approach is used; next to the target the planners fly continuous curvature.

Source: Dubins, "On curves of minimal length with a constraint on average curvature", American Journal of Mathematics
79(3), 1957.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement

# Below this speed a course is noise, and the aircraft's present side serves instead.
_MIN_SPEED_FOR_COURSE_M_S = 0.5
_SAMPLE_M, _SAMPLES_MAX = 5.0, 1000  # of one part


def approach(aircraft: AircraftState, target: TargetEstimate, airframe: Aircraft, requirement: Requirement) -> Plan:
    """Return the shortest way to a circle in mid-band on the required side that keeps range_min_m to the target.

    If no way keeps it (the aircraft is already inside), the way whose least range is greatest is returned. The
    target is taken to move on at its present velocity until the aircraft arrives.
    """
    arrival_s = 0.0
    plan = _plan_to(aircraft, target, airframe, requirement, arrival_s)
    for _ in range(2):  # where the target will be depends on how long the way is
        assert plan.transition is not None
        arrival_s = plan.transition.length_m / airframe.airspeed_m_s
        plan = _plan_to(aircraft, target, airframe, requirement, arrival_s)
    return plan


def _plan_to(
    aircraft: AircraftState, target: TargetEstimate, airframe: Aircraft, requirement: Requirement, arrival_s: float
) -> Plan:
    circle = _circle_next_to(aircraft, target, airframe, requirement, arrival_s)
    best: tuple[tuple[float, float], Path] | None = None
    for first_turn in (1.0, -1.0):
        path = turn_straight_turn(aircraft, circle, first_turn * airframe.radius_m)
        if path is None:
            continue
        shortfall_m = max(0.0, requirement.range_min_m - least_range_m(path, target, airframe.airspeed_m_s))
        rank = (shortfall_m, path.length_m)
        if best is None or rank < best[0]:
            best = (rank, path)
    if best is None:  # the wanted circle overlaps both turning circles: join it from where we are
        return Plan(circle, _join(aircraft, circle), aircraft.time_s)
    return Plan(circle, best[1], aircraft.time_s)


def _circle_next_to(
    aircraft: AircraftState, target: TargetEstimate, airframe: Aircraft, requirement: Requirement, arrival_s: float
) -> Circle:
    target_east_m = target.east_m + target.velocity_east_m_s * arrival_s
    target_north_m = target.north_m + target.velocity_north_m_s * arrival_s
    if target.speed_m_s >= _MIN_SPEED_FOR_COURSE_M_S:
        side_rad = target.course_rad + requirement.side.normal_turn_rad
    else:
        side_rad = math.atan2(aircraft.east_m - target_east_m, aircraft.north_m - target_north_m)
    middle_m = 0.5 * (requirement.range_min_m + requirement.range_max_m)
    stand_off_m = max(middle_m, requirement.range_min_m + airframe.radius_m)
    return Circle(
        target_east_m + stand_off_m * math.sin(side_rad),
        target_north_m + stand_off_m * math.cos(side_rad),
        airframe.radius_m,
        requirement.side.clockwise,
    )


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

    Args:
        first_radius_m: Radius of the first turn, m; positive to the right.
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
    """Return a line of one curvature.

    Args:
        aircraft: Where it begins.
        curvature_per_m: Its curvature, 1/m; positive to the right.
    """
    return _sampled(aircraft, ((max(length_m, 1.0), curvature_per_m),))


def joined(first: Path, second: Path) -> Path:
    """Return two paths as one; the second begins where the first ends."""
    arc_m = np.concatenate((first.arc_m, first.length_m + second.arc_m[1:]))
    names = "east_m", "north_m", "course_rad", "curvature_per_m"
    return Path(arc_m, *(np.concatenate((getattr(first, name), getattr(second, name)[1:])) for name in names))


def _join(aircraft: AircraftState, circle: Circle) -> Path:
    """Return a straight to where the aircraft's course meets the wanted circle best; the autopilot captures it."""
    return _sampled(aircraft, ((circle.radius_m, 0.0), (_SAMPLE_M, circle.curvature_per_m)))


def _sampled(start: AircraftState, parts: tuple[tuple[float, float], ...]) -> Path:
    """Return the line of constant-curvature parts (length_m, curvature_per_m) from ``start``."""
    pieces = [_even(length_m) for length_m, _ in parts if length_m > 0.0]
    step_m = np.concatenate(pieces)
    bends_per_m = [curvature_per_m for length_m, curvature_per_m in parts if length_m > 0.0]
    curvature_per_m = np.repeat(bends_per_m, [len(piece) for piece in pieces])
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


def _even(length_m: float) -> npt.NDArray[np.float64]:
    """Return the lengths of the steps of a part: a bounded number, however long it is."""
    steps = min(max(1, math.ceil(length_m / _SAMPLE_M)), _SAMPLES_MAX)
    return np.full(steps, length_m / steps)
