"""The stand-off orbit of occlusion-aware tracking: a circle that moves with the target, for comparison.

The source inscribes the circle in the volume from which nothing hides the target. On open ground that volume is
limited by the range alone, so the radius does not change; the rate of the radius is left out here.

Source: Hague, Wolek, "Occlusion-Aware Ground Target Tracking by a Dubins Vehicle using Visibility Volumes", arXiv
2506.03400, 2025: the steering controller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.laws.course_field import CourseField


@dataclass(frozen=True, slots=True)
class StandoffOrbit(CourseField):
    """The field of a circle that moves with the target.

    Attributes:
        approach_per_m: How sharply the circle is approached, 1/m.
    """

    approach_per_m: float

    def _course_rad(self, x_m: float, y_m: float, speed_m_s: float, target: TargetEstimate) -> float:
        """Return the course along which the distance from the circle decreases at the field's rate."""
        velocity_east, velocity_north = target.velocity_east_m_s, target.velocity_north_m_s
        range_m = max(math.hypot(x_m, y_m), 1e-3)
        out_e, out_n = x_m / range_m, y_m / range_m
        spare_m_s = max(speed_m_s - math.hypot(velocity_east, velocity_north), 0.0)
        inward_m_s = spare_m_s * 2.0 / math.pi * math.atan(self.approach_per_m * (range_m - self.radius_m))
        radial_m_s = velocity_east * out_e + velocity_north * out_n - inward_m_s
        around_m_s = math.sqrt(max(speed_m_s**2 - radial_m_s**2, 0.0)) * (1.0 if self.clockwise else -1.0)
        return math.atan2(radial_m_s * out_e + around_m_s * out_n, radial_m_s * out_n - around_m_s * out_e)
