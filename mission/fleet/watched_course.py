"""The course that defines the sides for a whole fleet. Source: docs/explanation/planners.md#watch-course."""

from __future__ import annotations

import math

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Requirement
from sidelong.mission.viewpoint.course_hold import CourseHold
from sidelong.mission.viewpoint.side_policy import SidePolicy
from sidelong.mission.viewpoint.viewpoint_kernel import MADE_GOOD


class WatchedCourse:
    """Follows one target from its first sighting on.

    course_rad: the one made good over the requirement's horizon. While the way is still short, the present one, held
    while the target stands; before it has moved, one by which the first aircraft is on the required side; None until
    there is an aircraft.
    """

    def __init__(self, requirement: Requirement) -> None:
        self._normal_turn_rad = requirement.side.normal_turn_rad
        self._policy = SidePolicy(requirement, 0.0, requirement.course_horizon_s)
        self._hold = CourseHold()
        self._presumed_rad: float | None = None
        self.course_rad: float | None = None

    def update(self, target: TargetEstimate, first: AircraftState | None) -> None:
        """Take an estimate, in the order of time. first: the aircraft that began to watch first, None before.

        Args:
            target: Estimate of the target.
            first: State of the first aircraft that watched; None before.
        """
        self._policy.viewpoint(target.east_m, target.north_m, target)
        if first is not None and self._presumed_rad is None:
            away_rad = math.atan2(first.east_m - target.east_m, first.north_m - target.north_m)
            self._presumed_rad = away_rad - self._normal_turn_rad
        held_rad, made_good_rad = self._hold.update(target), float(self._policy.memory[MADE_GOOD])
        if not math.isnan(made_good_rad):
            self.course_rad = made_good_rad
        else:
            self.course_rad = self._presumed_rad if held_rad is None else held_rad
