"""How ArduPlane flies legs and circles: what its waypoint and loiter code does with the L1 law."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.sitl.arduplane.guidance import L1Guidance
from sidelong.sitl.protocol.parameters import Parameters
from sidelong.sitl.world.airframe import Airframe, true_over_equivalent_airspeed
from sidelong.sitl.world.place import Place

_LINE_RADII = 3.0  # a circle further away than this many radii is approached along the leg to its centre
_RIGHT_ANGLE_RAD = math.pi / 2


@dataclass(slots=True)
class Loiter:
    """Progress on a circle. reached_s: when it was captured, or its centre passed."""

    clockwise: bool
    reached_s: float | None = None
    turned_rad: float = 0.0
    last_bearing_rad: float | None = None


class ArduPlaneNavigator:
    """Where to, from where, and the lateral acceleration that leads there."""

    def __init__(self, craft: Airframe, parameters: Parameters, home_altitude_m: float) -> None:
        self._craft = craft
        self._parameters = parameters
        self._home_altitude_m = home_altitude_m
        self.guidance = L1Guidance()
        self.goal = self._origin = Place(0.0, 0.0, 0.0)
        self.loiter = Loiter(clockwise=True)
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

    def go_to(self, goal: Place, then: Place | None, clockwise: bool) -> None:
        """Make ``goal`` the end of the next leg; ``then`` is what follows it in the mission."""
        if self._track_next:
            self._origin, self._on_track = self.goal, True
        else:
            self._origin, self._on_track, self._track_next = Place.of(self._craft), False, True
        self.goal = goal
        if self._behind_goal():
            self._origin = Place.of(self._craft)
        self.loiter = Loiter(clockwise)
        self._turn_ahead_rad = _RIGHT_ANGLE_RAD
        if then is not None:
            course_rad, next_rad = self._origin.bearing_rad(goal), goal.bearing_rad(then)
            self._turn_ahead_rad = abs(math.remainder(next_rad - course_rad, math.tau))

    def circle(self, centre: Place, clockwise: bool) -> None:
        """Head straight for a circle, without a line to follow."""
        self._origin, self.goal, self._on_track = Place.of(self._craft), centre, False
        self.loiter = Loiter(clockwise)

    def fly_leg(self, acceptance_m: float, dt_s: float) -> tuple[str | None, float]:
        """Return the word for how the leg ended (None: it has not) and the lateral acceleration.

        acceptance_m 0: by WP_RADIUS, in proportion to the turn that follows, or past the finish line.
        """
        lateral_m_s2 = self.fly_line(dt_s)
        if acceptance_m <= 0.0:
            reach_m = min(self._parameters["WP_RADIUS"] * self._thin_air_factor, self.guidance.length_m)
            acceptance_m = reach_m * min(1.0, self._turn_ahead_rad / _RIGHT_ANGLE_RAD)
        if self.goal.distance_m(self._craft) <= acceptance_m:
            return "Reached", lateral_m_s2
        return "Passed" if self._behind_goal() else None, lateral_m_s2

    def fly_line(self, dt_s: float) -> float:
        self._tune()
        origin = self._origin if self._on_track else Place.of(self._craft)
        return self.guidance.towards_line(self._craft, origin.ground_m, self.goal.ground_m, dt_s)

    def fly_circle(self, radius_m: float, now_s: float, dt_s: float, by_line: bool) -> float:
        """by_line: a far circle is approached along its leg."""
        loiter = self.loiter
        radius_m *= self._thin_air_factor
        far = by_line and self._on_track and self.goal.distance_m(self._craft) > _LINE_RADII * radius_m
        if far and loiter.reached_s is None:
            return self.fly_line(dt_s)
        self._tune()
        lateral_m_s2 = self.guidance.towards_circle(self._craft, self.goal.ground_m, radius_m, loiter.clockwise)
        if loiter.reached_s is None and (self.guidance.on_circle or self._behind_goal()):
            loiter.reached_s = now_s
        if self.guidance.on_circle or loiter.last_bearing_rad is not None:
            bearing_rad = Place.of(self._craft).bearing_rad(self.goal)
            if loiter.last_bearing_rad is not None:
                step_rad = math.remainder(bearing_rad - loiter.last_bearing_rad, math.tau)
                loiter.turned_rad += step_rad if loiter.clockwise else -step_rad
            loiter.last_bearing_rad = bearing_rad
        return lateral_m_s2

    def _tune(self) -> None:
        self.guidance.period_s = self._parameters.within("NAVL1_PERIOD", 1.0, 60.0)
        self.guidance.damping = self._parameters.within("NAVL1_DAMPING", 0.1, 2.0)
        self.guidance.integral_gain = self._parameters["NAVL1_XTRACK_I"]

    def _behind_goal(self) -> bool:
        """Whether the finish line, square to the leg through its end, is passed."""
        leg_east_m, leg_north_m = self.goal.east_m - self._origin.east_m, self.goal.north_m - self._origin.north_m
        east_m, north_m = self._craft.east_m - self.goal.east_m, self._craft.north_m - self.goal.north_m
        return leg_east_m * east_m + leg_north_m * north_m >= 0.0
