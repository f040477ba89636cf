"""Guidance laws that steer along a field of courses around a moving target.

Source: Frew, Lawrence, Morris, Journal of Guidance, Control, and Dynamics 31(2), 2008: the rate of the field's course
along the present path, and a correction in proportion to the course error.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState

_AHEAD_S = 0.2  # over which the rate of the field's course is taken


@dataclass(frozen=True, slots=True)
class CourseField(ABC):
    """A field that leads onto a circle around the target; course_gain_per_s: turn rate for each radian off it."""

    radius_m: float
    clockwise: bool
    course_gain_per_s: float

    @abstractmethod
    def _course_rad(self, x_m: float, y_m: float, speed_m_s: float, target: TargetEstimate) -> float:
        """Return the field's course at a place relative to the target (east, north), rad."""

    def curvature_per_m(self, aircraft: AircraftState, target: TargetEstimate) -> float:
        """Return the curvature to fly now, 1/m: the field's own turn, and a correction towards its course."""
        speed_m_s, course_rad = aircraft.ground_speed_m_s, aircraft.course_rad
        x_m, y_m = aircraft.east_m - target.east_m, aircraft.north_m - target.north_m
        now_rad = self._course_rad(x_m, y_m, speed_m_s, target)
        ahead_x_m = x_m + _AHEAD_S * (speed_m_s * math.sin(course_rad) - target.velocity_east_m_s)
        ahead_y_m = y_m + _AHEAD_S * (speed_m_s * math.cos(course_rad) - target.velocity_north_m_s)
        ahead_rad = self._course_rad(ahead_x_m, ahead_y_m, speed_m_s, target)
        turn_rad_s = math.remainder(ahead_rad - now_rad, 2.0 * math.pi) / _AHEAD_S
        off_rad = math.remainder(now_rad - course_rad, 2.0 * math.pi)
        return (turn_rad_s + self.course_gain_per_s * off_rad) / speed_m_s


@dataclass(frozen=True, slots=True)
class VectorField(CourseField):
    """Lyapunov guidance vector field: circling a moving target at a stand-off radius, for comparison.

    Source: Frew, Lawrence, Morris, "Coordinated standoff tracking of moving targets using Lyapunov guidance vector
    fields", Journal of Guidance, Control, and Dynamics 31(2), 2008; the same field is in Lawrence (2003) and Chen et
    al. (2009).
    """

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


@dataclass(frozen=True, slots=True)
class StandoffOrbit(CourseField):
    """The stand-off orbit of occlusion-aware tracking: a circle that moves with the target, for comparison.

    The source inscribes the circle in the volume from which nothing hides the target. On open ground that volume is
    limited by the range alone, so the radius does not change; the rate of the radius is left out here.

    Source: Hague, Wolek, "Occlusion-Aware Ground Target Tracking by a Dubins Vehicle using Visibility Volumes", arXiv
    2506.03400, 2025: the steering controller. approach_per_m: how sharply the circle is approached.
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


# The radius and gain of the laws of one aircraft; the gains of the phase settle it within about a lap.
_RADIUS_M, _GAIN_PER_S = 350.0, 0.25
_SPEED_GAIN_PER_S, _SPEED_SHARE = 0.05, 0.2
_RADIUS_GAIN, _RADIUS_SHARE = 0.3, 0.3


def phased(
    aircraft: Sequence[AircraftState],
    target: TargetEstimate,
    *,
    clockwise: bool,
    airspeed_m_s: float,
    constant_speed: bool,
) -> list[tuple[float, float]]:
    """Return the curvature, 1/m, and the airspeed, m/s, to fly for each aircraft; speeds change by a fifth at most.

    constant_speed: the circular formation in place of the phased field.
    """
    orders = []
    for state, behind_rad in zip(aircraft, behind(aircraft, target, clockwise), strict=True):
        radius_m, speed_m_s = _RADIUS_M, airspeed_m_s
        if constant_speed:
            radius_m *= 1.0 - min(max(_RADIUS_GAIN * behind_rad, -_RADIUS_SHARE), _RADIUS_SHARE)
        else:
            share = _SPEED_GAIN_PER_S * behind_rad * radius_m / airspeed_m_s
            speed_m_s *= 1.0 + min(max(share, -_SPEED_SHARE), _SPEED_SHARE)
        orders.append((VectorField(radius_m, clockwise, _GAIN_PER_S).curvature_per_m(state, target), speed_m_s))
    return orders


def behind(aircraft: Sequence[AircraftState], target: TargetEstimate, clockwise: bool) -> list[float]:
    """Return by how much each aircraft is behind the middle between those before and after it on the circle, rad.

    The aircraft keep their order; a single one is never behind.
    """
    n, sense = len(aircraft), 1.0 if clockwise else -1.0
    phase_rad = [sense * math.atan2(own.east_m - target.east_m, own.north_m - target.north_m) for own in aircraft]
    order = sorted(range(n), key=lambda k: phase_rad[k] % math.tau)
    behind_rad = [0.0] * n
    for place, k in enumerate(order):
        before, after = order[place - 1], order[(place + 1) % n]
        if before != k:
            gap_back_rad = (phase_rad[k] - phase_rad[before]) % math.tau
            gap_ahead_rad = (phase_rad[after] - phase_rad[k]) % math.tau
            behind_rad[k] = 0.5 * (gap_ahead_rad - gap_back_rad)
    return behind_rad
