"""The courses of a target: its course held while it stands, its course made good, and its present course.

A slowing estimate turns about at random before its speed falls below the threshold, so the course that is held is
the one of some seconds earlier. The course made good, which defines the sides, is the direction in which the target
moved over a horizon. A jump of the estimated position is a correction, not a motion of the target.

Source: docs/explanation/planners.md#watch-course.
"""

from __future__ import annotations

import math

import numpy as np

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.path import FloatArray
from sidelong.mission.viewpoint import viewpoint_kernel as kernel
from sidelong.mission.viewpoint.viewpoint_kernel import Estimates, TargetState

STANDING_M_S = 0.3
"""Below this speed a target keeps its present course: the direction of its velocity is noise."""


def known(target: TargetEstimate) -> TargetState:
    """Return an estimate as the loops see it."""
    return TargetState(
        target.time_s,
        target.east_m,
        target.north_m,
        target.velocity_east_m_s,
        target.velocity_north_m_s,
        np.ascontiguousarray(target.covariance, np.float64),
    )


def estimates_of(target: TargetEstimate) -> Estimates:
    """Return an estimate as the loops see it, with that of the last sighting."""
    now = known(target)
    return Estimates(now, now if target.as_seen is None else known(target.as_seen))


class CourseHold:
    """The course to watch from: the target's while it moves; None until it has moved."""

    def __init__(self) -> None:
        self._memories = kernel.fresh_memory(1.0)

    def update(self, target: TargetEstimate) -> float | None:
        """Process an estimate; return the course to watch from, rad, None until the target has moved."""
        now = known(target)
        course_rad, _ = kernel.courses_of(Estimates(now, now), 0.0, self._memories)
        return None if math.isnan(course_rad) else course_rad

    @property
    def standing(self) -> bool:
        """Whether the target stands."""
        return bool(self._memories[0].standing)


class TargetCourse:
    """Both courses of a target, as the planner takes them; with a horizon of 0 both are the present one.

    Attributes:
        made_good_rad: The course made good; None until the target has moved far enough.
        present_rad: The present course; None until the target has moved.
    """

    def __init__(self) -> None:
        self.made_good_rad: float | None = None
        self.present_rad: float | None = None
        self._memories = kernel.fresh_memory(1.0)

    def update(self, target: TargetEstimate, horizon_s: float) -> None:
        """Process an estimate."""
        if math.hypot(target.velocity_east_m_s, target.velocity_north_m_s) >= STANDING_M_S:
            self.present_rad = math.atan2(target.velocity_east_m_s, target.velocity_north_m_s)
        _, made_good_rad = kernel.courses_of(estimates_of(target), horizon_s, self._memories)
        if horizon_s == 0.0:
            self.made_good_rad = self.present_rad
        elif not math.isnan(made_good_rad):
            self.made_good_rad = made_good_rad


def courses_made_good_rad(
    time_s: FloatArray,
    place_m: FloatArray,
    velocity_m_s: FloatArray,
    horizon_s: FloatArray,
    gap_max_s: float = math.inf,
) -> FloatArray:
    """Return the courses made good of exactly known motion, held while the target moves less than ``MIN_WAY_M``.

    Args:
        time_s: Times of the samples, ascending, shape (n,).
        place_m: East and north of the target, shape (n, 2).
        velocity_m_s: East and north velocity, shape (n, 2): what it does not explain of a way is a correction.
        horizon_s: Time over which each course is taken, shape (n,).
        gap_max_s: The motion between two samples further apart is unknown and counts as none.

    Returns:
        Clockwise from north, shape (n,); NaN until the target has moved far enough.
    """
    time_s, place_m, velocity_m_s, horizon_s = (
        np.ascontiguousarray(values, np.float64) for values in (time_s, place_m, velocity_m_s, horizon_s)
    )
    return kernel.courses_made_good(time_s, place_m, velocity_m_s, horizon_s, gap_max_s, kernel.fresh_memory(1.0))
