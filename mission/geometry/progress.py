"""How far along its plan an aircraft is, and where the plan leads from there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mission.core.path import FloatArray, Path
from mission.core.plan import AircraftState, Plan

# Metres that count as much as one radian of course when the fitting point of a line that crosses itself is sought.
_COURSE_WEIGHT_M = 50.0
# Further off its line than this, or on another course, an aircraft is not following its plan.
_OFF_TRACK_M, _OFF_TRACK_RAD = 40.0, math.radians(40.0)


@dataclass(frozen=True, slots=True)
class LinePoint:
    """A point of a flown line: place, course and curvature there."""

    east_m: float
    north_m: float
    course_rad: float
    curvature_per_m: float


def nearest_arc_m(plan: Plan, aircraft: AircraftState) -> float:
    """Return the arc length of the plan's point that fits the aircraft's place and course best.

    Arc 0 is the start of the transition; the circle follows, and there the arc stays within one lap. For a plan
    that is only a circle, arc 0 is the aircraft's own place on it.
    """
    path, circle = plan.transition, plan.circle
    if path is None:
        return 0.0
    off_m = np.hypot(path.east_m - aircraft.east_m, path.north_m - aircraft.north_m)
    off_rad = (path.course_rad - aircraft.course_rad + math.pi) % (2.0 * math.pi) - math.pi
    misfit_m = off_m + _COURSE_WEIGHT_M * np.abs(off_rad)
    best = int(np.argmin(misfit_m))
    lap_rad = circle.course_at(aircraft.east_m, aircraft.north_m)
    off_circle_m = math.hypot(aircraft.east_m - circle.east_m, aircraft.north_m - circle.north_m) - circle.radius_m
    off_circle_rad = math.remainder(lap_rad - aircraft.course_rad, 2.0 * math.pi)
    if best == off_m.size - 1 or abs(off_circle_m) + _COURSE_WEIGHT_M * abs(off_circle_rad) < misfit_m[best]:
        past_rad = lap_rad - float(path.course_rad[-1])
        return path.length_m + circle.radius_m * ((past_rad if circle.clockwise else -past_rad) % (2.0 * math.pi))
    course_rad = float(path.course_rad[best])
    east_m, north_m = aircraft.east_m - float(path.east_m[best]), aircraft.north_m - float(path.north_m[best])
    ahead_m = east_m * math.sin(course_rad) + north_m * math.cos(course_rad)
    return float(np.clip(path.arc_m[best] + ahead_m, 0.0, path.length_m))


def point_at(plan: Plan, arc_m: float, aircraft: AircraftState) -> LinePoint:
    """Return the plan's point at an arc counted as :func:`nearest_arc_m` counts it for that aircraft."""
    path, circle = plan.transition, plan.circle
    if path is not None and arc_m <= path.length_m:
        return _path_point(path, arc_m)
    if path is None:
        start_rad, flown_m = circle.course_at(aircraft.east_m, aircraft.north_m), arc_m
    else:
        start_rad, flown_m = float(path.course_rad[-1]), arc_m - path.length_m
    course_rad = start_rad + circle.curvature_per_m * flown_m
    return LinePoint(*circle.position_at_course(course_rad), course_rad, circle.curvature_per_m)


def line_at(plan: Plan, arc_m: FloatArray, aircraft: AircraftState) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (east, north, course) along the plan at many arcs (k,): :func:`point_at` to some centimetres."""
    path, circle = plan.transition, plan.circle
    sense_per_m = circle.curvature_per_m
    if path is None:
        course_rad = circle.course_at(aircraft.east_m, aircraft.north_m) + sense_per_m * arc_m
    else:
        course_rad = float(path.course_rad[-1]) + sense_per_m * (arc_m - path.length_m)
    east_m = circle.east_m - np.cos(course_rad) / sense_per_m
    north_m = circle.north_m + np.sin(course_rad) / sense_per_m
    if path is not None:
        flying = arc_m < path.length_m
        on_path = [np.interp(arc_m, path.arc_m, a) for a in (path.east_m, path.north_m, path.course_rad)]
        east_m, north_m, course_rad = (
            np.where(flying, a, b) for a, b in zip(on_path, (east_m, north_m, course_rad), strict=True)
        )
    return east_m, north_m, course_rad


def off_track(
    aircraft: AircraftState,
    point: LinePoint,
    cross_track_m: float = _OFF_TRACK_M,
    course_error_rad: float = _OFF_TRACK_RAD,
) -> bool:
    """Tell whether an aircraft is too far from the point of its plan that fits best to be following it."""
    off_m = math.hypot(aircraft.east_m - point.east_m, aircraft.north_m - point.north_m)
    off_rad = math.remainder(aircraft.course_rad - point.course_rad, 2.0 * math.pi)
    return off_m > cross_track_m or abs(off_rad) > course_error_rad


def dead_reckoned(aircraft: AircraftState, duration_s: float, curvature_max_per_m: float) -> LinePoint:
    """Return where the aircraft is after ``duration_s`` on its present curvature, limited to that of a plan."""
    curvature_per_m = min(max(aircraft.curvature_per_m, -curvature_max_per_m), curvature_max_per_m)
    flown_m = aircraft.ground_speed_m_s * duration_s
    return _arc_point(
        LinePoint(aircraft.east_m, aircraft.north_m, aircraft.course_rad, curvature_per_m), 0.0, flown_m
    )


def _path_point(path: Path, arc_m: float) -> LinePoint:
    index = int(np.clip(np.searchsorted(path.arc_m, arc_m, side="right") - 1, 0, path.arc_m.size - 2))
    before = LinePoint(*(float(a[index]) for a in (path.east_m, path.north_m, path.course_rad, path.curvature_per_m)))
    sharpness_per_m2 = float(path.curvature_per_m[index + 1] - path.curvature_per_m[index]) / float(
        path.arc_m[index + 1] - path.arc_m[index]
    )
    return _arc_point(before, sharpness_per_m2, arc_m - float(path.arc_m[index]))


def _arc_point(start: LinePoint, sharpness_per_m2: float, flown_m: float) -> LinePoint:
    """Return the point further on where curvature changes linearly: exact in course, Simpson's rule in place."""
    middle_rad = start.course_rad + (start.curvature_per_m + 0.25 * sharpness_per_m2 * flown_m) * 0.5 * flown_m
    end_rad = start.course_rad + (start.curvature_per_m + 0.5 * sharpness_per_m2 * flown_m) * flown_m
    sixth_m = flown_m / 6.0
    return LinePoint(
        start.east_m + sixth_m * (math.sin(start.course_rad) + 4.0 * math.sin(middle_rad) + math.sin(end_rad)),
        start.north_m + sixth_m * (math.cos(start.course_rad) + 4.0 * math.cos(middle_rad) + math.cos(end_rad)),
        end_rad,
        start.curvature_per_m + sharpness_per_m2 * flown_m,
    )
