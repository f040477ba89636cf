"""ArduPlane's way to a line and to a circle: the L1 law of Park, Deyst and How, with a PD term on circles.

S. Park, J. Deyst, J. P. How, "A New Nonlinear Guidance Logic for Trajectory Tracking", AIAA 2004-4900. Neither
branch for circles has an integral, so an airframe that turns less than its bank promises flies a larger circle.
"""

from __future__ import annotations

import math

from sidelong.sitl.world.airframe import Airframe

_CAPTURE_MAX = math.sin(math.pi / 4)  # a line is met at 45 degrees at most
_INTEGRAL_MAX_RAD = 0.1
_PASSED_S = 3.0


class L1Guidance:
    """Lateral acceleration towards a line or a circle, and what was computed on the way, for telemetry."""

    def __init__(self, period_s: float = 17.0, damping: float = 0.75, integral_gain: float = 0.02) -> None:
        self.period_s = period_s
        self.damping = damping
        self.integral_gain = integral_gain
        self.length_m = self.cross_track_m = self.nav_bearing_rad = self._bearing_integral_rad = 0.0
        self.on_circle = False

    def towards_line(
        self, craft: Airframe, start_m: tuple[float, float], end_m: tuple[float, float], dt_s: float
    ) -> float:
        """Return the acceleration that joins and follows the line from start to end (east, north)."""
        self.on_circle = False
        speed_m_s = max(0.1, craft.ground_speed_m_s)
        course_rad = craft.course_rad
        self.length_m = self.damping * self.period_s * speed_m_s / math.pi
        line_east_m, line_north_m = end_m[0] - start_m[0], end_m[1] - start_m[1]
        line_m = math.hypot(line_east_m, line_north_m)
        if line_m < 1e-6:
            line_east_m, line_north_m = end_m[0] - craft.east_m, end_m[1] - craft.north_m
        line_rad = math.atan2(line_east_m, line_north_m)
        from_start_m = (craft.east_m - start_m[0], craft.north_m - start_m[1])
        sine, cosine = math.sin(line_rad), math.cos(line_rad)
        along_m = from_start_m[0] * sine + from_start_m[1] * cosine
        self.cross_track_m = from_start_m[0] * cosine - from_start_m[1] * sine  # positive right of the line
        start_distance_m = math.hypot(*from_start_m)
        if start_distance_m > self.length_m and along_m < -_CAPTURE_MAX * start_distance_m:
            aim_rad = math.atan2(-from_start_m[0], -from_start_m[1])
        elif along_m > line_m + _PASSED_S * speed_m_s:
            aim_rad = math.atan2(end_m[0] - craft.east_m, end_m[1] - craft.north_m)
        else:
            offset = max(-_CAPTURE_MAX, min(_CAPTURE_MAX, self.cross_track_m / self.length_m))
            turn_in_rad = math.asin(offset)
            if abs(turn_in_rad) < math.radians(5.0):
                integral_rad = self._bearing_integral_rad + turn_in_rad * self.integral_gain * dt_s
                self._bearing_integral_rad = max(-_INTEGRAL_MAX_RAD, min(_INTEGRAL_MAX_RAD, integral_rad))
            aim_rad = line_rad - turn_in_rad - self._bearing_integral_rad
        self.nav_bearing_rad = aim_rad
        return self._pursue(aim_rad - course_rad, speed_m_s)

    def towards_circle(
        self, craft: Airframe, centre_m: tuple[float, float], radius_m: float, clockwise: bool
    ) -> float:
        """Return the acceleration that captures the circle and then holds it."""
        speed_m_s = max(1.0, craft.ground_speed_m_s)
        self.length_m = self.damping * self.period_s * speed_m_s / math.pi
        east_m, north_m = craft.east_m - centre_m[0], craft.north_m - centre_m[1]
        distance_m = max(0.1, math.hypot(east_m, north_m))
        out_east, out_north = east_m / distance_m, north_m / distance_m
        outward_m_s = craft.velocity_east_m_s * out_east + craft.velocity_north_m_s * out_north
        rightward_m_s = craft.velocity_east_m_s * out_north - craft.velocity_north_m_s * out_east
        turn = 1.0 if clockwise else -1.0
        tangential_m_s = turn * rightward_m_s  # positive the right way round
        natural_rad_s = math.tau / self.period_s
        self.cross_track_m = distance_m - radius_m
        self.nav_bearing_rad = math.atan2(-east_m, -north_m)
        capture_m_s2 = self._pursue(self.nav_bearing_rad - craft.course_rad, speed_m_s)
        hold_m_s2 = natural_rad_s**2 * self.cross_track_m + 2.0 * self.damping * natural_rad_s * outward_m_s
        if outward_m_s > 0.0 and tangential_m_s < 0.0:  # the wrong way round: do not turn further outward
            hold_m_s2 = max(0.0, hold_m_s2)
        circle_m_s2 = turn * (hold_m_s2 + tangential_m_s**2 / max(0.5 * radius_m, distance_m))
        self.on_circle = not (self.cross_track_m > 0.0 and turn * capture_m_s2 < turn * circle_m_s2)
        return circle_m_s2 if self.on_circle else capture_m_s2

    def _pursue(self, angle_rad: float, speed_m_s: float) -> float:
        angle_rad = math.remainder(angle_rad, math.tau)
        angle_rad = max(-math.pi / 2, min(math.pi / 2, angle_rad))
        return 4.0 * self.damping**2 * speed_m_s**2 / self.length_m * math.sin(angle_rad)
