"""How PX4 flies legs and circles with a fixed wing: a nonlinear path follower with the path's curvature fed forward.

After T. Stastny, R. Siegwart, "On Flying Backwards: Preventing Run-away of Small, Low-speed, Fixed-wing UAVs in
Strong Winds", IROS 2019: the bearing blends from straight at the path (far away) to along it (on it).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.sitl.protocol.parameters import Parameters
from sidelong.sitl.world.airframe import GRAVITY_M_S2, LocalPosition, SimulatedAirframe


class PathFollower:
    """Lateral acceleration towards a line or a circle."""

    def __init__(self, period_s: float = 10.0, damping: float = 0.7071) -> None:
        self.period_s = period_s
        self.damping = damping

    def towards_line(
        self, craft: SimulatedAirframe, start_m: tuple[float, float], end_m: tuple[float, float]
    ) -> float:
        """Return the acceleration that joins and follows the endless line through start and end (east, north)."""
        tangent_rad = math.atan2(end_m[0] - start_m[0], end_m[1] - start_m[1])
        right_m = (craft.east_m - end_m[0]) * math.cos(tangent_rad) - (craft.north_m - end_m[1]) * math.sin(
            tangent_rad
        )
        return self._follow(craft, tangent_rad, right_m, curvature_per_m=0.0)

    def towards_circle(
        self, craft: SimulatedAirframe, centre_m: tuple[float, float], radius_m: float, clockwise: bool
    ) -> float:
        """Return the acceleration that joins and follows the circle."""
        east_m, north_m = craft.east_m - centre_m[0], craft.north_m - centre_m[1]
        distance_m = math.hypot(east_m, north_m)
        outward_rad = math.atan2(east_m, north_m) if distance_m > 0.1 else craft.course_rad
        turn = 1.0 if clockwise else -1.0
        tangent_rad = outward_rad + turn * math.pi / 2
        return self._follow(craft, tangent_rad, -turn * (distance_m - radius_m), turn / max(1.0, distance_m))

    def _follow(self, craft: SimulatedAirframe, tangent_rad: float, right_m: float, curvature_per_m: float) -> float:
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
    def _heading_for(craft: SimulatedAirframe, course_rad: float) -> tuple[float, float]:
        """Return the heading that makes good the course in this wind, and d(heading) / d(course)."""
        wind, airspeed_m_s = craft.wind, craft.airspeed_m_s
        sine, cosine = math.sin(course_rad), math.cos(course_rad)
        cross_m_s = wind.east_m_s * cosine - wind.north_m_s * sine  # wind to the right of the course
        along_m_s = wind.east_m_s * sine + wind.north_m_s * cosine
        drift_rad = math.asin(max(-0.95, min(0.95, cross_m_s / airspeed_m_s)))
        return course_rad - drift_rad, 1.0 + along_m_s / (airspeed_m_s * math.cos(drift_rad))


@dataclass(frozen=True, slots=True)
class LoiterGoal:
    centre: LocalPosition
    radius_m: float
    clockwise: bool


class Px4Navigator:
    """Where to, from where, and the lateral acceleration that leads there."""

    def __init__(self, craft: SimulatedAirframe, parameters: Parameters) -> None:
        self._craft = craft
        self._parameters = parameters
        self.follower = PathFollower()
        self.goal = LocalPosition(0.0, 0.0, 0.0)
        self._origin: LocalPosition | None = (
            None  # of the leg; None: it is flown to straight from wherever the aircraft is
        )
        self.circle: LoiterGoal | None = None
        self._inside_since_s: float | None = None

    def go_to(self, goal: LocalPosition, *, from_here: bool) -> None:
        """Make ``goal`` the end of the leg that begins where the last one ended, or of no leg at all."""
        self._origin = None if from_here else self.goal
        self.goal, self.circle, self._inside_since_s = goal, None, None

    def fly_around(self, centre: LocalPosition, signed_radius_m: float = math.nan) -> None:
        """Circle: positive clockwise; 0 or no number for the parameter's radius."""
        if not math.isfinite(signed_radius_m) or signed_radius_m == 0.0:
            signed_radius_m = self._parameters["NAV_LOITER_RAD"]
        self.goal, self._inside_since_s = centre, None
        self.circle = LoiterGoal(centre, abs(signed_radius_m), signed_radius_m > 0.0)

    def stop(self) -> None:
        self.circle = None

    def at_height(self) -> bool:
        return abs(self._craft.height_m - self.goal.height_m) < self._parameters["NAV_FW_ALT_RAD"]

    def fly_leg(self) -> tuple[bool, float]:
        """Return whether the waypoint is reached, and the lateral acceleration; waits there for its height.

        An item's own acceptance radius is not heeded. One that no leg leads to is not passed but orbited.
        """
        if self.circle is not None:
            return self.at_height(), self.fly_circle()
        lateral_m_s2 = self.fly_line()
        if self.goal.distance_m(self._craft) > self._parameters["NAV_ACC_RAD"] and not self._beyond_goal():
            return False, lateral_m_s2
        if not self.at_height():
            self.fly_around(self.goal)
            return False, lateral_m_s2
        return True, lateral_m_s2

    def fly_line(self) -> float:
        if not self._craft.flying:
            return 0.0
        self._tune()
        origin = self._origin or LocalPosition.of(self._craft)
        return self.follower.towards_line(self._craft, origin.ground_m, self.goal.ground_m)

    def fly_circle(self) -> float:
        """Return the lateral acceleration, 0 on the ground and without a circle."""
        circle = self.circle
        if circle is None or not self._craft.flying:
            return 0.0
        self._tune()
        # A circle tighter than the roll limit allows is silently flown wider.
        limit_m_s2 = GRAVITY_M_S2 * math.tan(math.radians(self._parameters.within("FW_R_LIM", 5.0, 80.0)))
        radius_m = max(circle.radius_m, self._craft.airspeed_m_s**2 / limit_m_s2)
        return self.follower.towards_circle(self._craft, circle.centre.ground_m, radius_m, circle.clockwise)

    def inside_for_s(self, now_s: float) -> float | None:
        """Return how long the circle has been flown, None while it is not yet reached."""
        circle = self.circle
        if circle is None:
            return None
        if self._inside_since_s is None:
            if circle.centre.distance_m(self._craft) > circle.radius_m + self._parameters["NAV_ACC_RAD"]:
                return None
            self._inside_since_s = now_s
        return now_s - self._inside_since_s

    def _beyond_goal(self) -> bool:
        """Whether the line through the goal, square to the leg, is passed."""
        if self._origin is None:
            return False
        course_rad = self._origin.bearing_rad(self.goal)
        east_m, north_m = self._craft.east_m - self.goal.east_m, self._craft.north_m - self.goal.north_m
        return east_m * math.sin(course_rad) + north_m * math.cos(course_rad) > 0.0

    def _tune(self) -> None:
        self.follower.period_s = self._parameters.within("NPFG_PERIOD", 1.0, 100.0)
        self.follower.damping = self._parameters.within("NPFG_DAMPING", 0.1, 2.0)
