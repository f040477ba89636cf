"""The courses of a target: the course made good, which defines its sides, and the present course.

The course made good is the direction in which the target moved over a horizon. Its motion is the integral of its
velocity, not a difference of positions: when an estimate that coasted re-acquires the target, its position jumps, and
the jump is a correction of the estimate, not a motion of the target.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Pair = tuple[float, float]

MIN_WAY_M = 10.0  # a target that moved less keeps its last course made good
_GAP_MAX_S = 5.0  # the motion between two samples further apart is unknown and counts as none


def made_good_rad(time_s: FloatArray, velocity_m_s: FloatArray, horizon_s: float | FloatArray) -> FloatArray:
    """Return the courses made good, held while the target moves less than ``MIN_WAY_M`` within the horizon.

    Args:
        time_s: times of the samples, ascending, shape (n,).
        velocity_m_s: east and north velocity of the target, shape (n, 2).
        horizon_s: time over which the course is taken, more than 0; one value or shape (n,).

    Returns:
        Clockwise from north, shape (n,); NaN until the target has moved far enough.
    """
    east_m, north_m = _way_m(time_s, velocity_m_s, horizon_s)
    return _held(np.arctan2(east_m, north_m), np.hypot(east_m, north_m) > MIN_WAY_M)


def present_rad(velocity_m_s: FloatArray, standing_m_s: float) -> FloatArray:
    """Return the present courses, held while the target is slower than ``standing_m_s``.

    Args:
        velocity_m_s: east and north velocity of the target, shape (n, 2).
        standing_m_s: below this speed the direction of the velocity is noise.

    Returns:
        Clockwise from north, shape (n,); NaN until the target has moved.
    """
    east_m_s, north_m_s = velocity_m_s.T
    return _held(np.arctan2(east_m_s, north_m_s), np.hypot(east_m_s, north_m_s) >= standing_m_s)


def _way_m(time_s: FloatArray, velocity_m_s: FloatArray, horizon_s: float | FloatArray) -> FloatArray:
    """Return how far the target moved within the horizon, east and north, shape (2, n)."""
    step_s = np.diff(time_s, prepend=time_s[:1])
    step_s[step_s > _GAP_MAX_S] = 0.0
    before_m_s = np.concatenate([velocity_m_s[:1], velocity_m_s[:-1]])
    travelled_m = np.cumsum(0.5 * (velocity_m_s + before_m_s) * step_s[:, None], axis=0)
    since = np.maximum(np.searchsorted(time_s, time_s - horizon_s + 1e-9, side="right") - 1, 0)
    return np.asarray((travelled_m - travelled_m[since]).T)


def _held(course_rad: FloatArray, known: npt.NDArray[np.bool_]) -> FloatArray:
    """Return each course that is known, else the last known one, NaN before the first."""
    last = np.maximum.accumulate(np.where(known, np.arange(known.size), -1))
    return np.where(last < 0, math.nan, course_rad[last])


class TargetCourse:
    """Both courses of a target whose estimates arrive one by one.

    Attributes:
        made_good_rad: the course made good, None until the target has moved.
        present_rad: the present course, None until the target has moved.
    """

    def __init__(self, standing_m_s: float) -> None:
        self._standing_m_s = standing_m_s
        self.made_good_rad: float | None = None
        self.present_rad: float | None = None
        self._window: deque[tuple[float, float, float]] = deque()  # time, velocity east and north

    def take(self, time_s: float, velocity_m_s: Pair, horizon_s: float) -> None:
        """Take the target's velocity at a time.

        Args:
            time_s: not before the last one.
            velocity_m_s: (east, north).
            horizon_s: time over which the course made good is taken; at 0 it is the present course.
        """
        if math.hypot(*velocity_m_s) >= self._standing_m_s:
            self.present_rad = math.atan2(*velocity_m_s)
        if horizon_s == 0.0:
            self.made_good_rad = self.present_rad
            return
        self._window.append((time_s, *velocity_m_s))
        while len(self._window) > 1 and self._window[1][0] <= time_s - horizon_s:
            self._window.popleft()
        window = np.array(self._window)
        east_m, north_m = _way_m(window[:, 0], window[:, 1:], horizon_s)[:, -1].tolist()
        if math.hypot(east_m, north_m) > MIN_WAY_M:
            self.made_good_rad = math.atan2(east_m, north_m)
