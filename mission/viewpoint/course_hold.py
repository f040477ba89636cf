"""The course of a target that stops: held while it stands, and taken from before the stop was noticed.

A slowing estimate turns about at random before its speed falls below the threshold, so the course that counts is
the one of some seconds earlier.
"""

from __future__ import annotations

import math
from collections import deque

from estimators.estimate import TargetEstimate

_STOPPED_BELOW_M_S = 0.9
_MOVING_ABOVE_M_S = 1.0
_SIGMAS = 2.0  # a speed below so many of its standard deviations is no motion either
_BEFORE_STOP_S = 3.0


class CourseHold:
    """The course to watch from: the target's while it moves; None until it has moved."""

    def __init__(self) -> None:
        self.course_rad: float | None = None
        self.standing = True
        self._recent: deque[tuple[float, float]] = deque()  # (time, course) while moving

    def update(self, target: TargetEstimate) -> float | None:
        """Take an estimate, in the order of time, and return the course to watch from."""
        threshold_m_s = max(
            _MOVING_ABOVE_M_S if self.standing else _STOPPED_BELOW_M_S, _SIGMAS * velocity_sigma_m_s(target)
        )
        if target.speed_m_s >= threshold_m_s:
            self.standing = False
            self.course_rad = target.course_rad
            self._recent.append((target.time_s, target.course_rad))
            while len(self._recent) > 1 and self._recent[1][0] <= target.time_s - _BEFORE_STOP_S:
                self._recent.popleft()
        elif not self.standing:
            self.standing = True
            self.course_rad = self._recent[0][1]
            self._recent.clear()
        return self.course_rad


def velocity_sigma_m_s(target: TargetEstimate) -> float:
    """Return one standard deviation of the velocity on its worse axis."""
    return math.sqrt(max(float(target.covariance[2, 2]), float(target.covariance[3, 3]), 0.0))


def course_sigma_rad(target: TargetEstimate) -> float:
    """Return one standard deviation of a moving target's course: the velocity's across it, over the speed."""
    east, north = math.cos(target.course_rad), -math.sin(target.course_rad)
    p = target.covariance[2:, 2:]
    variance = float(east * east * p[0, 0] + 2.0 * east * north * p[0, 1] + north * north * p[1, 1])
    return math.sqrt(max(variance, 0.0)) / max(target.speed_m_s, _STOPPED_BELOW_M_S)
