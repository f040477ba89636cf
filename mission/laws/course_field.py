"""Steering along a field of courses around a moving target.

Source: Frew, Lawrence, Morris, Journal of Guidance, Control, and Dynamics 31(2), 2008: the rate of the field's course
along the present path, and a correction in proportion to the course error.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState

_AHEAD_S = 0.2  # over which the rate of the field's course is taken

CourseAt = Callable[[float, float], float]
"""Course of the field, rad, at a place relative to the target (east, north), m."""


def curvature_per_m(course_at: CourseAt, gain_per_s: float, aircraft: AircraftState, target: TargetEstimate) -> float:
    """Return the curvature to fly now, 1/m.

    Args:
        course_at: Course of the field at a place relative to the target.
        gain_per_s: Turn rate for each radian off the field's course.
        aircraft: State of the aircraft.
        target: Estimate of the target.
    """
    speed_m_s, course_rad = aircraft.ground_speed_m_s, aircraft.course_rad
    x_m, y_m = aircraft.east_m - target.east_m, aircraft.north_m - target.north_m
    now_rad = course_at(x_m, y_m)
    ahead_rad = course_at(
        x_m + _AHEAD_S * (speed_m_s * math.sin(course_rad) - target.velocity_east_m_s),
        y_m + _AHEAD_S * (speed_m_s * math.cos(course_rad) - target.velocity_north_m_s),
    )
    turn_rad_s = math.remainder(ahead_rad - now_rad, 2.0 * math.pi) / _AHEAD_S
    off_rad = math.remainder(now_rad - course_rad, 2.0 * math.pi)
    return (turn_rad_s + gain_per_s * off_rad) / speed_m_s
