"""Steering along a field of courses around a moving target.

Source: Frew, Lawrence, Morris, Journal of Guidance, Control, and Dynamics 31(2), 2008: the rate of the field's course
along the present path, and a correction in proportion to the course error.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState

_AHEAD_S = 0.2  # over which the rate of the field's course is taken


@dataclass(frozen=True, slots=True)
class CourseField(ABC):
    """A field that leads onto a circle around the target.

    Attributes:
        clockwise: Direction, seen from above.
        course_gain_per_s: Turn rate for each radian off the field's course, 1/s.
    """

    radius_m: float
    clockwise: bool
    course_gain_per_s: float

    @abstractmethod
    def _course_rad(self, x_m: float, y_m: float, speed_m_s: float, target: TargetEstimate) -> float:
        """Return the field's course at a place relative to the target (east, north), rad."""

    def curvature_per_m(self, aircraft: AircraftState, target: TargetEstimate) -> float:
        """Return the curvature to fly now, 1/m: the field's own turn, and a correction towards its course."""
        speed_m_s, course_rad = aircraft.ground_speed_m_s, aircraft.course_rad
        x_m, y_m = aircraft.east_m - target.east_m, aircraft.north_m - target.north_m
        now_rad = self._course_rad(x_m, y_m, speed_m_s, target)
        ahead_x_m = x_m + _AHEAD_S * (speed_m_s * math.sin(course_rad) - target.velocity_east_m_s)
        ahead_y_m = y_m + _AHEAD_S * (speed_m_s * math.cos(course_rad) - target.velocity_north_m_s)
        ahead_rad = self._course_rad(ahead_x_m, ahead_y_m, speed_m_s, target)
        turn_rad_s = math.remainder(ahead_rad - now_rad, 2.0 * math.pi) / _AHEAD_S
        off_rad = math.remainder(now_rad - course_rad, 2.0 * math.pi)
        return (turn_rad_s + self.course_gain_per_s * off_rad) / speed_m_s
