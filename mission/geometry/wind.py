"""Flight over the ground in a steady wind: speeds, times and radii.

Source: wind triangle, Beard and McLain, *Small Unmanned Aircraft*, 2012, chapter 2.
"""

from __future__ import annotations

import math

import numpy as np

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray, Path
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry import line_kernel

STILL_AIR = Wind()

_CIRCLE_STEPS = 720


class WindError(ValueError):
    """The wind is too strong for what is to be flown."""


def ground_speeds_m_s(course_rad: FloatArray, airspeed_m_s: float, wind: Wind) -> FloatArray:
    """Return the ground speed on each course: the long side of the wind triangle.

    Args:
        course_rad: Courses over the ground, rad, any shape.

    Raises:
        WindError: A course cannot be held, or only by drifting backwards along it.
    """
    speed_m_s = np.empty(course_rad.size)
    course = np.ascontiguousarray(course_rad, np.float64).ravel()
    line_kernel.ground_speeds_m_s(course, airspeed_m_s, wind.east_m_s, wind.north_m_s, speed_m_s)
    if not np.all(speed_m_s > 0.0):
        raise WindError(f"a wind of {wind.speed_m_s:.1f} m/s is too strong for an airspeed of {airspeed_m_s:.1f} m/s")
    return speed_m_s.reshape(course_rad.shape)


def ground_speed_m_s(course_rad: float, airspeed_m_s: float, wind: Wind) -> float:
    """Return the ground speed on one course.

    Raises:
        WindError: The course cannot be held, or only by drifting backwards along it.
    """
    return float(ground_speeds_m_s(np.asarray(course_rad), airspeed_m_s, wind))


def path_times_s(path: Path, airspeed_m_s: float, wind: Wind) -> FloatArray:
    """Return the time of flight from the start of the path to each of its samples, shape (n,)."""
    slowness_s_m = 1.0 / ground_speeds_m_s(path.course_rad, airspeed_m_s, wind)
    steps_s = np.diff(path.arc_m) * (slowness_s_m[1:] + slowness_s_m[:-1]) / 2.0
    return np.concatenate(([0.0], np.cumsum(steps_s)))


def _lap_times_s(radius_m: float, airspeed_m_s: float, wind: Wind) -> FloatArray:
    """Return the time at which a clockwise lap begun northwards is flown on each of 721 courses from 0 to 2 pi."""
    course_rad = np.linspace(0.0, 2.0 * math.pi, _CIRCLE_STEPS + 1)
    slowness_s_m = 1.0 / ground_speeds_m_s(course_rad, airspeed_m_s, wind)
    steps_s = (slowness_s_m[1:] + slowness_s_m[:-1]) / 2.0 * (2.0 * math.pi * radius_m / _CIRCLE_STEPS)
    return np.concatenate(([0.0], np.cumsum(steps_s)))


class LapClock:
    """Time against turn on one circle in steady wind; the turn grows in the direction of flight, from north.

    A lap takes longer than in still air, by about 3 w^2 / 4 v^2 of it.
    """

    def __init__(self, circle: Circle, airspeed_m_s: float, wind: Wind) -> None:
        # A counter-clockwise lap is a clockwise one seen in the mirror that keeps north.
        mirrored = wind if circle.clockwise else Wind(-wind.east_m_s, wind.north_m_s)
        self._times_s = _lap_times_s(circle.radius_m, airspeed_m_s, mirrored)
        self._turns_rad = np.linspace(0.0, 2.0 * math.pi, self._times_s.size)
        self.lap_s = float(self._times_s[-1])

    def time_s(self, turn_rad: float) -> float:
        """Return the time at a turn counted from north, any number of laps."""
        laps, within_rad = divmod(turn_rad, 2.0 * math.pi)
        return laps * self.lap_s + float(np.interp(within_rad, self._turns_rad, self._times_s))

    def turn_rad(self, time_s: float) -> float:
        """Return the turn from north at a time: the inverse of :meth:`time_s`."""
        laps, within_s = divmod(time_s, self.lap_s)
        return laps * 2.0 * math.pi + float(np.interp(within_s, self._times_s, self._turns_rad))
