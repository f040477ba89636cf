"""How ArduPlane flies legs and circles: what its waypoint and loiter code does with the L1 law.

S. Park, J. Deyst, J. P. How, "A New Nonlinear Guidance Logic for Trajectory Tracking", AIAA 2004-4900, with a PD term
on circles. Neither branch for circles has an integral, so an airframe that turns less than its bank promises flies a
larger circle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.sitl.protocol.parameters import Parameters
from sidelong.sitl.world.airframe import LocalPosition, SimulatedAirframe, true_over_equivalent_airspeed

_CAPTURE_MAX = math.sin(math.pi / 4)  # a line is met at 45 degrees at most
_INTEGRAL_MAX_RAD = 0.1
_PASSED_S = 3.0
_RIGHT_ANGLE_RAD = math.pi / 2
NAVIGATION_PERIOD_S = 0.1


class L1Guidance:
    """Lateral acceleration towards a line or a circle, and what was computed on the way, for telemetry."""

    def __init__(self, period_s: float = 17.0, damping: float = 0.75, integral_gain: float = 0.02) -> None:
        self.period_s = period_s
        self.damping = damping
        self.integral_gain = integral_gain
        self.length_m = self.cross_track_m = self.nav_bearing_rad = self._bearing_integral_rad = 0.0
        self.on_circle = False

    def towards_line(
        self, craft: SimulatedAirframe, start_m: tuple[float, float], end_m: tuple[float, float], dt_s: float
    ) -> float:
        """Return the acceleration that joins and follows the line from start to end (east, north)."""
        self.on_circle = False
        speed_m_s, course_rad = max(0.1, craft.ground_speed_m_s), craft.course_rad
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
        self, craft: SimulatedAirframe, centre_m: tuple[float, float], radius_m: float, clockwise: bool
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
        sine = math.sin(angle_rad) if abs(angle_rad) < _RIGHT_ANGLE_RAD else math.copysign(1.0, angle_rad)
        return 4.0 * self.damping**2 * speed_m_s**2 / self.length_m * sine


_LINE_RADII = 3.0  # a circle further away than this many radii is approached along the leg to its centre


@dataclass(slots=True)
class Loiter:
    """Progress on a circle. reached_s: when it was captured, or its centre passed."""

    clockwise: bool
    reached_s: float | None = None
    turned_rad: float = 0.0
    last_bearing_rad: float | None = None


class ArduPlaneNavigator:
    """Where to, from where, and the lateral acceleration that leads there."""

    def __init__(self, craft: SimulatedAirframe, parameters: Parameters, home_altitude_m: float) -> None:
        self._craft = craft
        self._parameters = parameters
        self._home_altitude_m = home_altitude_m
        self.guidance = L1Guidance()
        self.goal = self._origin = LocalPosition(0.0, 0.0, 0.0)
        self.loiter = Loiter(clockwise=True)
        self._tuned_at = -1  # changes of parameters when the guidance was tuned
        self._on_track = False  # the line from the origin is to be followed, not just its end reached
        self._track_next = False
        self._turn_ahead_rad = _RIGHT_ANGLE_RAD

    @property
    def _thin_air_factor(self) -> float:
        """ArduPlane widens radii in thin air, so that the bank stays that of sea level."""
        return true_over_equivalent_airspeed(self._home_altitude_m + self._craft.height_m) ** 2

    def start_over(self) -> None:
        """Let the next leg begin here, untracked, as after a takeoff or a change of mode."""
        self._track_next = False

    def go_to(self, goal: LocalPosition, then: LocalPosition | None, clockwise: bool) -> None:
        """Make ``goal`` the end of the next leg; ``then`` is what follows it in the mission."""
        if self._track_next:
            self._origin, self._on_track = self.goal, True
        else:
            self._origin, self._on_track, self._track_next = LocalPosition.of(self._craft), False, True
        self.goal = goal
        if self._behind_goal():
            self._origin = LocalPosition.of(self._craft)
        self.loiter = Loiter(clockwise)
        self._turn_ahead_rad = _RIGHT_ANGLE_RAD
        if then is not None:
            course_rad, next_rad = self._origin.bearing_rad(goal), goal.bearing_rad(then)
            self._turn_ahead_rad = abs(math.remainder(next_rad - course_rad, math.tau))

    def circle(self, centre: LocalPosition, clockwise: bool) -> None:
        """Head straight for a circle, without a line to follow."""
        self._origin, self.goal, self._on_track = LocalPosition.of(self._craft), centre, False
        self.loiter = Loiter(clockwise)

    def fly_leg(self, acceptance_m: float) -> tuple[str | None, float]:
        """Return the word for how the leg ended (None: it has not) and the lateral acceleration.

        acceptance_m 0: by WP_RADIUS, in proportion to the turn that follows, or past the finish line.
        """
        lateral_m_s2 = self.fly_line()
        if acceptance_m <= 0.0:
            reach_m = min(self._parameters["WP_RADIUS"] * self._thin_air_factor, self.guidance.length_m)
            acceptance_m = reach_m * min(1.0, self._turn_ahead_rad / _RIGHT_ANGLE_RAD)
        if self.goal.distance_m(self._craft) <= acceptance_m:
            return "Reached", lateral_m_s2
        return "Passed" if self._behind_goal() else None, lateral_m_s2

    def fly_line(self) -> float:
        if self._tuned_at != self._parameters.changes:
            self._tune()
        craft, goal = self._craft, self.goal
        start_m = self._origin.ground_m if self._on_track else (craft.east_m, craft.north_m)
        return self.guidance.towards_line(craft, start_m, goal.ground_m, NAVIGATION_PERIOD_S)

    def fly_circle(self, radius_m: float, now_s: float, by_line: bool) -> float:
        """by_line: a far circle is approached along its leg."""
        loiter, craft, goal, guidance = self.loiter, self._craft, self.goal, self.guidance
        radius_m *= self._thin_air_factor
        approaches = by_line and self._on_track and loiter.reached_s is None
        if approaches and goal.distance_m(craft) > _LINE_RADII * radius_m:
            return self.fly_line()
        if self._tuned_at != self._parameters.changes:
            self._tune()
        lateral_m_s2 = guidance.towards_circle(craft, goal.ground_m, radius_m, loiter.clockwise)
        if loiter.reached_s is None and (guidance.on_circle or self._behind_goal()):
            loiter.reached_s = now_s
        if guidance.on_circle or loiter.last_bearing_rad is not None:
            bearing_rad = math.atan2(goal.east_m - craft.east_m, goal.north_m - craft.north_m)
            if loiter.last_bearing_rad is not None:
                step_rad = math.remainder(bearing_rad - loiter.last_bearing_rad, math.tau)
                loiter.turned_rad += step_rad if loiter.clockwise else -step_rad
            loiter.last_bearing_rad = bearing_rad
        return lateral_m_s2

    def _tune(self) -> None:
        self._tuned_at = self._parameters.changes
        self.guidance.period_s = self._parameters.within("NAVL1_PERIOD", 1.0, 60.0)
        self.guidance.damping = self._parameters.within("NAVL1_DAMPING", 0.1, 2.0)
        self.guidance.integral_gain = self._parameters["NAVL1_XTRACK_I"]

    def _behind_goal(self) -> bool:
        """Whether the finish line, square to the leg through its end, is passed."""
        leg_east_m, leg_north_m = self.goal.east_m - self._origin.east_m, self.goal.north_m - self._origin.north_m
        east_m, north_m = self._craft.east_m - self.goal.east_m, self._craft.north_m - self.goal.north_m
        return leg_east_m * east_m + leg_north_m * north_m >= 0.0
