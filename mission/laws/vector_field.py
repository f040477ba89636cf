"""Lyapunov guidance vector field: circling a moving target at a stand-off radius, for comparison.

Source: Frew, Lawrence, Morris, "Coordinated standoff tracking of moving targets using Lyapunov guidance vector
fields", Journal of Guidance, Control, and Dynamics 31(2), 2008; the same field is in Lawrence (2003) and Chen et al.
(2009).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.laws.course_field import CourseField


@dataclass(frozen=True, slots=True)
class VectorField(CourseField):
    """The Lyapunov vector field."""

    def _course_rad(self, x_m: float, y_m: float, speed_m_s: float, target: TargetEstimate) -> float:
        """Return the course whose velocity relative to the target points along the field there."""
        velocity_east, velocity_north = target.velocity_east_m_s, target.velocity_north_m_s
        range_m = max(math.hypot(x_m, y_m), 1e-3)
        radial = range_m**2 - self.radius_m**2
        tangential = 2.0 * range_m * self.radius_m * (1.0 if self.clockwise else -1.0)
        length = range_m * (range_m**2 + self.radius_m**2)
        field_x, field_y = (-x_m * radial + y_m * tangential) / length, (-y_m * radial - x_m * tangential) / length
        # |target velocity + s * field| = speed, s > 0: always solvable for a slower target.
        along = velocity_east * field_x + velocity_north * field_y
        excess = speed_m_s**2 - velocity_east**2 - velocity_north**2
        relative_m_s = -along + math.sqrt(max(along**2 + excess, 0.0))
        return math.atan2(velocity_east + relative_m_s * field_x, velocity_north + relative_m_s * field_y)
