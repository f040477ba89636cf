"""Nonlinear lateral guidance round a moving target, for comparison: the paper's reference 26.

The path is a circle round the target that moves with it, so velocity is taken relative to the target.

Source: Park, Deyst, How, "Performance and Lyapunov stability of a nonlinear path-following guidance method", Journal
of Guidance, Control, and Dynamics 30(6), 2007.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState


@dataclass(frozen=True, slots=True)
class LateralGuidance:
    """radius_m: of the circle round the target. look_ahead_m: L1, the distance to the point that is steered for."""

    radius_m: float
    clockwise: bool
    look_ahead_m: float

    def curvature_per_m(self, aircraft: AircraftState, target: TargetEstimate) -> float:
        """Return the curvature to fly now: lateral acceleration 2 V^2 sin(eta) / L1, over V^2 of the ground."""
        velocity_east = aircraft.ground_speed_m_s * math.sin(aircraft.course_rad) - target.velocity_east_m_s
        velocity_north = aircraft.ground_speed_m_s * math.cos(aircraft.course_rad) - target.velocity_north_m_s
        to_target_east, to_target_north = target.east_m - aircraft.east_m, target.north_m - aircraft.north_m
        range_m = max(math.hypot(to_target_east, to_target_north), 1e-3)
        # A point of the circle at distance L1 is seen at this angle off the target, by the law of cosines; too far
        # from the circle for one, the nearest (or, inside, the opposite) point of it is steered for.
        cosine = (range_m**2 + self.look_ahead_m**2 - self.radius_m**2) / (2.0 * range_m * self.look_ahead_m)
        off_target_rad = math.acos(min(max(cosine, -1.0), 1.0))
        bearing_rad = math.atan2(to_target_east, to_target_north)
        steer_rad = bearing_rad + (-off_target_rad if self.clockwise else off_target_rad)
        eta_rad = math.remainder(steer_rad - math.atan2(velocity_east, velocity_north), 2.0 * math.pi)
        # Beyond a right angle the law would ask for less turn again.
        sine = math.sin(min(max(eta_rad, -math.pi / 2), math.pi / 2))
        relative_m2_s2 = velocity_east**2 + velocity_north**2
        return 2.0 * relative_m2_s2 * sine / self.look_ahead_m / aircraft.ground_speed_m_s**2
