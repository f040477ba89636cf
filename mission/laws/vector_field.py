"""Lyapunov guidance vector field: circling a moving target at a stand-off radius, for comparison.

Source: Frew, Lawrence, Morris, "Coordinated standoff tracking of moving targets using Lyapunov guidance vector
fields", Journal of Guidance, Control, and Dynamics 31(2), 2008; the same field is in Lawrence (2003) and Chen et al.
(2009).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.laws.course_field import curvature_per_m


@dataclass(frozen=True, slots=True)
class VectorField:
    """radius_m: the stand-off. course_gain_per_s: turn rate for each radian off the field's course."""

    radius_m: float
    clockwise: bool
    course_gain_per_s: float

    def curvature_per_m(self, aircraft: AircraftState, target: TargetEstimate) -> float:
        """Return the curvature to fly now: the field's own turn, and a correction towards its course.

        Args:
            aircraft: State of the aircraft.
            target: Estimate of the target.
        """

        def course_at(x_m: float, y_m: float) -> float:
            return self._course_rad(x_m, y_m, aircraft.ground_speed_m_s, target)

        return curvature_per_m(course_at, self.course_gain_per_s, aircraft, target)

    def _course_rad(self, x: float, y: float, speed_m_s: float, target: TargetEstimate) -> float:
        """Return the course whose velocity relative to the target points along the field there."""
        velocity_east, velocity_north = target.velocity_east_m_s, target.velocity_north_m_s
        range_m = max(math.hypot(x, y), 1e-3)
        radial = range_m**2 - self.radius_m**2
        tangential = 2.0 * range_m * self.radius_m * (1.0 if self.clockwise else -1.0)
        length = range_m * (range_m**2 + self.radius_m**2)
        field_x, field_y = (-x * radial + y * tangential) / length, (-y * radial - x * tangential) / length
        # |target velocity + s * field| = speed, s > 0: always solvable for a slower target.
        along = velocity_east * field_x + velocity_north * field_y
        excess = speed_m_s**2 - velocity_east**2 - velocity_north**2
        relative_m_s = -along + math.sqrt(max(along**2 + excess, 0.0))
        return math.atan2(velocity_east + relative_m_s * field_x, velocity_north + relative_m_s * field_y)
