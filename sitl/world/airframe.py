"""A fixed wing as a point mass that turns by banking."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.sitl.world.turbulence import Turbulence

GRAVITY_M_S2 = 9.80665
# How fast the air carries an aircraft along: times of speed over gravity ahead, to the right and up. A tenth for a
# wing with a lift of 0.5 and a slope of 5 per radian, more for the side force, most for the drag of a lift over 10.
_CARRIED = (5.0, 1.25, 0.1)
_CALM_BELOW_M = 10.0  # the ground holds up air that moves up or down
_STABILISED_S = 0.01  # a gimbal's error for a rotation of the aircraft: 0.1 degrees at 10 degrees/s
_HIT_M = 1.0  # a beam that is less off still meets the target


def true_over_equivalent_airspeed(altitude_m: float) -> float:
    """Return the ratio of true to equivalent airspeed in the standard troposphere."""
    return float((1.0 - 2.25577e-5 * altitude_m) ** -2.128)


@dataclass(frozen=True, slots=True)
class WindVector:
    """The air's motion over the ground (where it blows *to*)."""

    east_m_s: float = 0.0
    north_m_s: float = 0.0

    @staticmethod
    def blowing_from(speed_m_s: float, from_rad: float) -> WindVector:
        """Return the wind from a direction, rad clockwise from north."""
        return WindVector(-speed_m_s * math.sin(from_rad), -speed_m_s * math.cos(from_rad))


@dataclass(frozen=True, slots=True)
class AirframeParameters:
    """What the airframe can do. turn_efficiency: turn achieved over the turn a coordinated bank would give."""

    roll_time_constant_s: float = 0.4
    roll_rate_max_rad_s: float = math.radians(70.0)
    climb_max_m_s: float = 6.0
    sink_max_m_s: float = 4.0
    climb_time_constant_s: float = 1.0
    acceleration_max_m_s2: float = 3.0
    run_acceleration_m_s2: float = 6.0
    turn_efficiency: float = 1.0


class SimulatedAirframe:
    """State and motion. airspeed_m_s is true airspeed; heading_rad is where the nose points, without sideslip."""

    def __init__(
        self, build: AirframeParameters, wind: WindVector, heading_rad: float = 0.0, home_altitude_m: float = 0.0
    ) -> None:
        self._home_altitude_m, self._ratio_at_m, self._ratio = home_altitude_m, math.nan, 1.0
        self.build = build
        self.wind = wind
        self.east_m = self.north_m = self.height_m = self.ground_m = 0.0
        self.heading_rad = heading_rad
        self.airspeed_m_s = self.climb_m_s = 0.0
        self.velocity_east_m_s = self.velocity_north_m_s = 0.0
        self.roll_rad = self.roll_rate_rad_s = self.yaw_rate_rad_s = 0.0
        self.flying = False
        self.turbulence: Turbulence | None = None
        self._carried_m_s = (0.0, 0.0, 0.0)  # by gusts: ahead, to the right and up
        self._off_rad = self._off_rad_s = (0.0, 0.0)  # pitch and yaw by gusts, which the autopilot takes out again

    @property
    def true_airspeed_ratio(self) -> float:
        """True over equivalent airspeed at the aircraft's height."""
        if self.height_m != self._ratio_at_m:  # each step asks for it, and only a climb changes it
            self._ratio_at_m = self.height_m
            self._ratio = true_over_equivalent_airspeed(self._home_altitude_m + self.height_m)
        return self._ratio

    @property
    def ground_speed_m_s(self) -> float:
        return math.hypot(self.velocity_east_m_s, self.velocity_north_m_s)

    @property
    def course_rad(self) -> float:
        """The direction of motion over the ground; the heading of the nose at zero ground speed."""
        if self.velocity_east_m_s == 0.0 and self.velocity_north_m_s == 0.0:
            return self.heading_rad
        return math.atan2(self.velocity_east_m_s, self.velocity_north_m_s)

    @property
    def pitch_rad(self) -> float:
        """Climb angle and the short-period motion of gusts, positive up; 0 on the ground."""
        if not self.flying:
            return 0.0
        return math.asin(max(-1.0, min(1.0, self.climb_m_s / self.airspeed_m_s))) + self._off_rad[0]

    @property
    def yaw_rad(self) -> float:
        """Where the nose points, with the sideslip of gusts."""
        return self.heading_rad + self._off_rad[1]

    @property
    def body_rates_rad_s(self) -> tuple[float, float, float]:
        """Rates about the body's axes (forward, right, down)."""
        (pitch_rad_s, off_rad_s), yaw_rad_s = self._off_rad_s, self.yaw_rate_rad_s
        sine, cosine = math.sin(self.roll_rad), math.cos(self.roll_rad)
        return self.roll_rate_rad_s, yaw_rad_s * sine + pitch_rad_s, yaw_rad_s * cosine + off_rad_s

    @property
    def measured_airspeed_m_s(self) -> float:
        """Airspeed with the gusts along the path that the airframe does not follow."""
        gust_m_s = self._carried_m_s[0] - self.turbulence.velocity_m_s[0] if self.turbulence and self.flying else 0.0
        return self.airspeed_m_s + gust_m_s

    def gimbal_error_rad(self, bearing_rad: float) -> tuple[float, float]:
        """Return by how much a gimbal that looks there is off to the right and up: its stabilisation lags."""
        if self.turbulence is None or not self.flying:
            return 0.0, 0.0
        aside_rad, (pitch_rad_s, off_rad_s) = bearing_rad - self.heading_rad, self._off_rad_s
        rise_rad_s = pitch_rad_s * math.cos(aside_rad) - self.roll_rate_rad_s * math.sin(aside_rad)
        return _STABILISED_S * off_rad_s, _STABILISED_S * rise_rad_s

    def pointed_m(self, to_m: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return where a gimbal that is to look along ``to_m`` (east, north, up) points, and its laser measures.

        A beam that misses the target meets the ground, which is level there.
        """
        if self.turbulence is None or not self.flying:
            return to_m
        bearing_rad, elevation_rad = math.atan2(to_m[0], to_m[1]), math.atan2(to_m[2], math.hypot(*to_m[:2]))
        aside_rad, rise_rad = self.gimbal_error_rad(bearing_rad)
        if (aside_rad, rise_rad) == (0.0, 0.0):
            return to_m
        range_m, bearing_rad, elevation_rad = math.hypot(*to_m), bearing_rad + aside_rad, elevation_rad + rise_rad
        if abs(rise_rad) * range_m > _HIT_M and elevation_rad < 0.0:
            range_m = to_m[2] / math.sin(elevation_rad)
        level_m = range_m * math.cos(elevation_rad)
        return level_m * math.sin(bearing_rad), level_m * math.cos(bearing_rad), range_m * math.sin(elevation_rad)

    def _blow(self, turbulence: Turbulence, dt_s: float) -> float:
        """Let a gust carry and turn the aircraft for a step; return its roll rate."""
        turbulence.step(dt_s, self.airspeed_m_s, self.height_m)
        before_m_s = self._carried_m_s[2]
        ahead, right, up = (
            carried + (gust - carried) * -math.expm1(-dt_s * GRAVITY_M_S2 / (times * self.airspeed_m_s))
            for carried, gust, times in zip(self._carried_m_s, turbulence.velocity_m_s, _CARRIED, strict=True)
        )
        self._carried_m_s = ahead, right, up
        # The autopilot takes a climb out again, as any other.
        self.climb_m_s += (up - before_m_s) * min(1.0, (self.height_m - self.ground_m) / _CALM_BELOW_M)
        roll_rad_s, *rates_rad_s = turbulence.rates_rad_s
        kept, before = math.exp(-dt_s / self.build.roll_time_constant_s), self._off_rad
        pitch_rad, yaw_rad = (off * kept + rate * dt_s for off, rate in zip(before, rates_rad_s, strict=True))
        self._off_rad = pitch_rad, yaw_rad
        self._off_rad_s = (pitch_rad - before[0]) / dt_s, (yaw_rad - before[1]) / dt_s
        return roll_rad_s

    def fly(self, dt_s: float, roll_rad: float, airspeed_m_s: float, climb_m_s: float) -> None:
        """Step with commanded roll, true airspeed and climb rate; touches the ground at ``ground_m``."""
        build = self.build
        # Comparisons in place of min() and max(): a study makes ten steps for each second.
        rate_rad_s, limit_rad_s = (roll_rad - self.roll_rad) / build.roll_time_constant_s, build.roll_rate_max_rad_s
        if not -limit_rad_s <= rate_rad_s <= limit_rad_s:
            rate_rad_s = math.copysign(limit_rad_s, rate_rad_s)
        if self.turbulence is not None:
            rate_rad_s += self._blow(self.turbulence, dt_s)
        self.roll_rate_rad_s = rate_rad_s
        self.roll_rad += rate_rad_s * dt_s
        least_m_s, most_m_s = -build.sink_max_m_s, build.climb_max_m_s
        climb_m_s = least_m_s if climb_m_s < least_m_s else most_m_s if climb_m_s > most_m_s else climb_m_s
        self.climb_m_s += (climb_m_s - self.climb_m_s) * dt_s / build.climb_time_constant_s
        gain_m_s, step_m_s = (airspeed_m_s - self.airspeed_m_s) * dt_s, build.acceleration_max_m_s2 * dt_s
        if not -step_m_s <= gain_m_s <= step_m_s:
            gain_m_s = math.copysign(step_m_s, gain_m_s)
        self.airspeed_m_s += gain_m_s
        lateral_m_s2 = build.turn_efficiency * GRAVITY_M_S2 * math.tan(self.roll_rad)
        self.yaw_rate_rad_s = yaw_rate_rad_s = lateral_m_s2 / self.airspeed_m_s
        # The middle of the turn made in this step keeps a circle closed.
        middle_rad = self.heading_rad + 0.5 * yaw_rate_rad_s * dt_s
        self.heading_rad = (self.heading_rad + yaw_rate_rad_s * dt_s) % math.tau
        level_m2_s2 = self.airspeed_m_s**2 - self.climb_m_s**2
        level_m_s = math.sqrt(level_m2_s2) if level_m2_s2 > 1.0 else 1.0
        sine, cosine = math.sin(middle_rad), math.cos(middle_rad)
        east_m_s, north_m_s = level_m_s * sine + self.wind.east_m_s, level_m_s * cosine + self.wind.north_m_s
        if self.turbulence is not None:
            ahead_m_s, right_m_s, _ = self._carried_m_s
            east_m_s += ahead_m_s * sine + right_m_s * cosine
            north_m_s += ahead_m_s * cosine - right_m_s * sine
        self.velocity_east_m_s, self.velocity_north_m_s = east_m_s, north_m_s
        self.east_m += east_m_s * dt_s
        self.north_m += north_m_s * dt_s
        self.height_m += self.climb_m_s * dt_s
        if self.height_m <= self.ground_m:
            self.flying = False
            self.height_m = self.ground_m
            self.climb_m_s = self.roll_rad = self.roll_rate_rad_s = self.yaw_rate_rad_s = 0.0
            self._carried_m_s, self._off_rad, self._off_rad_s = (0.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0)

    def roll_on_ground(self, dt_s: float, lift_off_m_s: float | None) -> None:
        """Run along the nose: up to the airspeed of lift-off, or (None) down to a stop."""
        speed_m_s = self.ground_speed_m_s
        step_m_s = self.build.run_acceleration_m_s2 * dt_s
        speed_m_s = max(0.0, speed_m_s - step_m_s) if lift_off_m_s is None else speed_m_s + step_m_s
        self.velocity_east_m_s = speed_m_s * math.sin(self.heading_rad)
        self.velocity_north_m_s = speed_m_s * math.cos(self.heading_rad)
        self.east_m += self.velocity_east_m_s * dt_s
        self.north_m += self.velocity_north_m_s * dt_s
        if lift_off_m_s is None:
            self.airspeed_m_s = speed_m_s
            return
        through_air_east_m_s = self.velocity_east_m_s - self.wind.east_m_s
        through_air_north_m_s = self.velocity_north_m_s - self.wind.north_m_s
        self.airspeed_m_s = math.hypot(through_air_east_m_s, through_air_north_m_s)
        if speed_m_s > 0.5 * lift_off_m_s and self.airspeed_m_s >= lift_off_m_s:
            self.heading_rad = math.atan2(through_air_east_m_s, through_air_north_m_s) % math.tau
            self.flying = True


@dataclass(frozen=True, slots=True)
class LocalPosition:
    """Height is above home."""

    east_m: float
    north_m: float
    height_m: float

    @staticmethod
    def of(craft: SimulatedAirframe) -> LocalPosition:
        return LocalPosition(craft.east_m, craft.north_m, craft.height_m)

    @property
    def ground_m(self) -> tuple[float, float]:
        return self.east_m, self.north_m

    def distance_m(self, craft: SimulatedAirframe) -> float:
        return math.hypot(self.east_m - craft.east_m, self.north_m - craft.north_m)

    def bearing_rad(self, other: LocalPosition) -> float:
        """Return the bearing of another position, clockwise from north."""
        return math.atan2(other.east_m - self.east_m, other.north_m - self.north_m)


def quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> tuple[float, float, float, float]:
    """Return (w, x, y, z) of yaw, then pitch, then roll."""
    cr, sr = math.cos(roll_rad / 2), math.sin(roll_rad / 2)
    cp, sp = math.cos(pitch_rad / 2), math.sin(pitch_rad / 2)
    cy, sy = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
