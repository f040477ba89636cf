"""How far along its plan an aircraft is, where it leads, and when in a steady wind.

Source: docs/explanation/planners.md#transitions; wind triangle, Beard and McLain, *Small Unmanned Aircraft*, 2012,
chapter 2.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray, Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry import line_kernel
from sidelong.mission.geometry.line_kernel import OFF_TRACK_M, OFF_TRACK_RAD, Circling, LinePoint

_NO_LINE = np.empty((5, 0))


def circling_of(circle: Circle) -> Circling:
    """Return a circle as the compiled functions take it."""
    return Circling(circle.east_m, circle.north_m, circle.radius_m if circle.clockwise else -circle.radius_m)


def line_of(plan: Plan) -> tuple[FloatArray, Circling]:
    """Return a plan's transition (5, n) and circle as the compiled functions take them."""
    return _NO_LINE if plan.transition is None else _rows_of(plan.transition), circling_of(plan.circle)


@lru_cache(maxsize=8)  # each decision and position asks for those of the same few plans
def _rows_of(path: Path) -> FloatArray:
    return np.array((path.arc_m, path.east_m, path.north_m, path.course_rad, path.curvature_per_m))


def end_circle(path: Path, radius_m: float) -> Circle:
    """Return the circle that continues a path with the sign of its last curvature."""
    east_m, north_m, course_rad = (float(row[-1]) for row in (path.east_m, path.north_m, path.course_rad))
    return Circle.tangent_to(east_m, north_m, course_rad, radius_m, clockwise=bool(path.curvature_per_m[-1] > 0.0))


def nearest_arc_m(plan: Plan, aircraft: AircraftState) -> float:
    """Return the arc length of the plan's point that fits the aircraft's place and course best.

    Arc 0 is the start of the transition; the circle follows, and there the arc stays within one lap. For a plan
    that is only a circle, arc 0 is the aircraft's own place on it.
    """
    return line_kernel.nearest_arc_m(*line_of(plan), aircraft.east_m, aircraft.north_m, aircraft.course_rad)


def point_at(plan: Plan, arc_m: float, aircraft: AircraftState) -> LinePoint:
    """Return the plan's point at an arc counted as :func:`nearest_arc_m` counts it for that aircraft."""
    return line_kernel.point_at(*line_of(plan), arc_m, aircraft.east_m, aircraft.north_m)


def off_track(
    aircraft: AircraftState,
    point: LinePoint,
    cross_track_m: float = OFF_TRACK_M,
    course_error_rad: float = OFF_TRACK_RAD,
) -> bool:
    """Return whether an aircraft is too far from the nearest point of its plan to be following it."""
    off_m = math.hypot(aircraft.east_m - point.east_m, aircraft.north_m - point.north_m)
    off_rad = math.remainder(aircraft.course_rad - point.course_rad, 2.0 * math.pi)
    return off_m > cross_track_m or abs(off_rad) > course_error_rad


def dead_reckoned(aircraft: AircraftState, duration_s: float, curvature_max_per_m: float = math.inf) -> AircraftState:
    """Return where the aircraft is after ``duration_s`` on its present curvature, limited to that of a plan.

    There is no wind.
    """
    curvature_per_m = min(max(aircraft.curvature_per_m, -curvature_max_per_m), curvature_max_per_m)
    step_m = aircraft.ground_speed_m_s * duration_s
    turned_rad = curvature_per_m * step_m
    circle_sinc = math.sin(0.5 * turned_rad) / (0.5 * turned_rad) if abs(turned_rad) > 1e-9 else 1.0
    middle_rad = aircraft.course_rad + 0.5 * turned_rad
    return replace(
        aircraft,
        time_s=aircraft.time_s + duration_s,
        east_m=aircraft.east_m + step_m * circle_sinc * math.sin(middle_rad),
        north_m=aircraft.north_m + step_m * circle_sinc * math.cos(middle_rad),
        course_rad=aircraft.course_rad + turned_rad,
        curvature_per_m=curvature_per_m,
    )


STILL_AIR = Wind()


class WindError(ValueError):
    """The wind is too strong for what is to be flown."""


def ground_speeds_m_s(course_rad: FloatArray, airspeed_m_s: float, wind: Wind) -> FloatArray:
    """Return the ground speed on each course (of any shape): the long side of the wind triangle.

    Raises:
        WindError: A course cannot be held, or only by drifting backwards along it.
    """
    speed_m_s = np.empty(course_rad.size)
    course = np.ascontiguousarray(course_rad, np.float64).ravel()
    line_kernel.speeds_m_s(course, line_kernel.Air(airspeed_m_s, wind.east_m_s, wind.north_m_s), speed_m_s)
    if not np.all(speed_m_s > 0.0):
        raise WindError(f"a wind of {wind.speed_m_s:.1f} m/s is too strong for an airspeed of {airspeed_m_s:.1f} m/s")
    return speed_m_s.reshape(course_rad.shape)


def ground_speed_m_s(course_rad: float, airspeed_m_s: float, wind: Wind) -> float:
    """Return the ground speed on one course.

    Raises:
        WindError: The course cannot be held, or only by drifting backwards along it.
    """
    return float(ground_speeds_m_s(np.asarray(course_rad), airspeed_m_s, wind))


def flight_times_s(arc_m: FloatArray, course_rad: FloatArray, airspeed_m_s: float, wind: Wind) -> FloatArray:
    """Return the time of flight from the first of ascending arcs (n,) to each, flown on these courses, shape (n,)."""
    slowness_s_m = 1.0 / ground_speeds_m_s(course_rad, airspeed_m_s, wind)
    steps_s = np.diff(arc_m) * (slowness_s_m[1:] + slowness_s_m[:-1]) / 2.0
    return np.concatenate(([0.0], np.cumsum(steps_s)))


def path_times_s(path: Path, airspeed_m_s: float, wind: Wind) -> FloatArray:
    """Return the time of flight from the start of the path to each of its samples, shape (n,)."""
    return flight_times_s(path.arc_m, path.course_rad, airspeed_m_s, wind)
