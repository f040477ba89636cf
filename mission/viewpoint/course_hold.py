"""The course of a target that stops: held while it stands, and taken from before the stop was noticed.

A slowing estimate turns about at random before its speed falls below the threshold, so the course that counts is
the one of some seconds earlier.

Source: docs/explanation/planners.md#watch-course.
"""

from __future__ import annotations

import math

import numpy as np

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.viewpoint import viewpoint_kernel as kernel
from sidelong.mission.viewpoint.viewpoint_kernel import STANDING, Estimates, Known


def known(target: TargetEstimate) -> Known:
    """Return an estimate as the loops see it."""
    return Known(
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
        self._memory = kernel.fresh_memory(1.0)

    def update(self, target: TargetEstimate) -> float | None:
        """Process an estimate.

        Args:
            target: Estimate of the target, in order of time.

        Returns:
            Course to watch from, rad; None until the target has moved.
        """
        course_rad = kernel.held_course_rad(known(target), self._memory)
        return None if math.isnan(course_rad) else course_rad

    def least_way_m(self, target: TargetEstimate) -> float:
        """Return the least way that has a course made good, m.

        Args:
            target: The estimate that was processed last.
        """
        return float(kernel.least_way_m(known(target), self._memory))

    @property
    def standing(self) -> bool:
        """Whether the target stands."""
        return bool(self._memory[STANDING] > 0.0)
