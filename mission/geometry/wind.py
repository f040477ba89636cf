"""Flight over the ground in a steady wind: speeds, times and radii.

Source: wind triangle, Beard and McLain, *Small Unmanned Aircraft*, 2012, chapter 2.
"""

from __future__ import annotations

import numpy as np

from sidelong.mission.core.path import FloatArray, Path
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry import line_kernel

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
