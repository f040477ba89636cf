"""The courses of a target: the course made good, which defines its sides, and the present course.

The course made good is the direction in which the target moved over a horizon. A jump of the estimated position is a
correction, not a motion of the target. The motion while an estimate coasts is assumed; once the target is seen again,
it has moved straight from where it was last seen.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import numpy.typing as npt

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.path import FloatArray
from sidelong.mission.viewpoint.course_hold import CourseHold
from sidelong.mission.viewpoint.viewpoint_kernel import MIN_WAY_M

Pair = tuple[float, float]

_GAP_MAX_S = 5.0  # the motion between two samples further apart is unknown and counts as none
_SEEN_S, _SETTLES_S = 1.5, 3.0  # the greatest age of a sighting; how long an estimate settles after it has coasted
_JUMP_M = 5.0  # what a turn of the target does not explain


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
    """Both courses of a target whose estimates arrive one by one; at horizon_s 0 both are the present one.

    Attributes:
        made_good_rad: the course made good, None until the target has moved.
        present_rad: the present course, None until the target has moved.
    """

    def __init__(self, standing_m_s: float) -> None:
        self._standing_m_s = standing_m_s
        self.made_good_rad: float | None = None
        self.present_rad: float | None = None
        self._window: deque[tuple[float, float, float]] = deque()  # time, place east and north
        self._velocity_m_s = 0.0, 0.0
        self._seen: tuple[float, Pair] | None = None  # when and where the target was seen last
        self._settled_s = -math.inf
        self._hold = CourseHold()

    def take(self, time_s: float, velocity_m_s: Pair, horizon_s: float) -> None:
        """Take the target's velocity, east and north, at a time not before the last one."""
        self._take_place(time_s, self._expected_m(time_s, velocity_m_s), velocity_m_s, horizon_s)

    def take_estimate(self, time_s: float, estimate: TargetEstimate, horizon_s: float) -> None:
        """Take the newest estimate at a time not before the last one."""
        place_m = estimate.position_m(time_s)
        velocity_m_s = estimate.velocity_east_m_s, estimate.velocity_north_m_s
        if time_s - estimate.last_sighting_s <= _SEEN_S:
            if self._seen is not None and time_s - self._seen[0] > _SEEN_S:
                self._straighten(*self._seen, time_s, place_m)
                self._settled_s = time_s + _SETTLES_S
            self._seen = time_s, place_m
        if time_s >= self._settled_s:
            self._follow_jump(self._expected_m(time_s, velocity_m_s), place_m)
        self._hold.update(estimate)
        self._take_place(time_s, place_m, velocity_m_s, horizon_s, self._hold.least_way_m(estimate))

    def _take_place(
        self, time_s: float, place_m: Pair, velocity_m_s: Pair, horizon_s: float, least_way_m: float = MIN_WAY_M
    ) -> None:
        self._velocity_m_s = velocity_m_s
        if math.hypot(*velocity_m_s) >= self._standing_m_s:
            self.present_rad = math.atan2(*velocity_m_s)
        self._window.append((time_s, *place_m))
        while len(self._window) > 1 and self._window[1][0] <= time_s - horizon_s + 1e-9:
            self._window.popleft()
        if horizon_s == 0.0:
            self.made_good_rad = self.present_rad
            return
        _, east_m, north_m = self._window[0]
        if math.dist(place_m, (east_m, north_m)) > least_way_m:
            self.made_good_rad = math.atan2(place_m[0] - east_m, place_m[1] - north_m)

    def _expected_m(self, time_s: float, velocity_m_s: Pair) -> Pair:
        """Return where the last place and the velocities lead."""
        if not self._window:
            return 0.0, 0.0
        last_s, *last_m = self._window[-1]
        step_s = time_s - last_s if time_s - last_s <= _GAP_MAX_S else 0.0
        east_m, north_m = (
            place_m + 0.5 * step_s * (before + now)
            for place_m, before, now in zip(last_m, self._velocity_m_s, velocity_m_s, strict=True)
        )
        return east_m, north_m

    def _follow_jump(self, expected_m: Pair, place_m: Pair) -> None:
        """Let the places before a jump jump along."""
        if self._window and math.dist(expected_m, place_m) > _JUMP_M:
            east_m, north_m = place_m[0] - expected_m[0], place_m[1] - expected_m[1]
            self._window = deque((one_s, x_m + east_m, y_m + north_m) for one_s, x_m, y_m in self._window)

    def _straighten(self, seen_s: float, seen_m: Pair, now_s: float, now_m: Pair) -> None:
        """Put the places of a time without sightings on the line from the last seen one to the present one."""
        for k, (one_s, *_) in enumerate(self._window):
            if one_s > seen_s:
                share = (one_s - seen_s) / (now_s - seen_s)
                east_m, north_m = (
                    then_m + share * (here_m - then_m) for then_m, here_m in zip(seen_m, now_m, strict=True)
                )
                self._window[k] = one_s, east_m, north_m
