"""PX4's way to a line and to a circle: a nonlinear path follower with the path's own curvature fed forward.

After T. Stastny, R. Siegwart, "On Flying Backwards: Preventing Run-away of Small, Low-speed, Fixed-wing UAVs in
Strong Winds", IROS 2019: the bearing blends from straight at the path (far away) to along it (on it).
"""

from __future__ import annotations

import math

from sidelong.sitl.world.airframe import Airframe


class PathFollower:
    """Lateral acceleration towards a line or a circle."""

    def __init__(self, period_s: float = 10.0, damping: float = 0.7071) -> None:
        self.period_s = period_s
        self.damping = damping

    def towards_line(self, craft: Airframe, start_m: tuple[float, float], end_m: tuple[float, float]) -> float:
        """Return the acceleration that joins and follows the endless line through start and end (east, north)."""
        tangent_rad = math.atan2(end_m[0] - start_m[0], end_m[1] - start_m[1])
        right_m = (craft.east_m - end_m[0]) * math.cos(tangent_rad) - (craft.north_m - end_m[1]) * math.sin(
            tangent_rad
        )
        return self._follow(craft, tangent_rad, right_m, curvature_per_m=0.0)

    def towards_circle(
        self, craft: Airframe, centre_m: tuple[float, float], radius_m: float, clockwise: bool
    ) -> float:
        """Return the acceleration that joins and follows the circle."""
        east_m, north_m = craft.east_m - centre_m[0], craft.north_m - centre_m[1]
        distance_m = math.hypot(east_m, north_m)
        outward_rad = math.atan2(east_m, north_m) if distance_m > 0.1 else craft.course_rad
        turn = 1.0 if clockwise else -1.0
        tangent_rad = outward_rad + turn * math.pi / 2
        return self._follow(craft, tangent_rad, -turn * (distance_m - radius_m), turn / max(1.0, distance_m))

    def _follow(self, craft: Airframe, tangent_rad: float, right_m: float, curvature_per_m: float) -> float:
        """right_m: how far the craft is to the right of the path."""
        speed_m_s = max(1.0, craft.ground_speed_m_s)
        bound_m = speed_m_s * self.period_s * self.damping
        closeness = 1.0 - min(1.0, abs(right_m) / bound_m)
        look_ahead_rad = math.pi / 2 * closeness**2  # 90 degrees: along the path
        lean_rad = math.pi / 2 - look_ahead_rad
        heading_rad, turn_ratio = self._heading_for(craft, tangent_rad - math.copysign(lean_rad, right_m))
        error_rad = math.remainder(heading_rad - craft.heading_rad, math.tau)
        gain_per_s = 4.0 * math.pi * self.damping / self.period_s
        correction = math.copysign(1.0, error_rad) if abs(error_rad) > math.pi / 2 else math.sin(error_rad)
        on_path_rad_s = curvature_per_m * speed_m_s * math.sin(look_ahead_rad) ** 2
        return craft.airspeed_m_s * (gain_per_s * correction + turn_ratio * on_path_rad_s)

    @staticmethod
    def _heading_for(craft: Airframe, course_rad: float) -> tuple[float, float]:
        """Return the heading that makes good the course in this wind, and d(heading) / d(course)."""
        wind, airspeed_m_s = craft.wind, craft.airspeed_m_s
        sine, cosine = math.sin(course_rad), math.cos(course_rad)
        cross_m_s = wind.east_m_s * cosine - wind.north_m_s * sine  # wind to the right of the course
        along_m_s = wind.east_m_s * sine + wind.north_m_s * cosine
        drift_rad = math.asin(max(-0.95, min(0.95, cross_m_s / airspeed_m_s)))
        return course_rad - drift_rad, 1.0 + along_m_s / (airspeed_m_s * math.cos(drift_rad))
