"""How an autopilot flies waypoints and a circle: the model that the waypoints of a transition are laid out with.

The aircraft steers to the straight line from the last waypoint to the next, then to the circle::

    curvature = g sin(error of course + asin(e / l)),   g = 4 pi zeta / (P v),   l = zeta P v / pi

with e the distance from the line, v the ground speed, P and zeta the period and damping of the loop. That is
ArduPlane's L1 law (NAVL1_PERIOD, NAVL1_DAMPING), and PX4's NPFG law (NPFG_PERIOD, NPFG_DAMPING) near the line. On
the circle its curvature is added. The roll follows with a lag, bank and roll rate are limited. A leg ends
``switch_s`` of flight before its waypoint, or where the waypoint is passed abreast. Where the first leg is no line,
the aircraft steers for the first waypoint itself until it is that near to it.

A line has no curvature to feed forward, so a string of waypoints round a curve is flown outside of it, by
l asin(1 / (g R)) in a steady turn: 25 m at R = 65 m, 15 m/s with ArduPlane's defaults.

Source: Park, Deyst, How, "A new nonlinear guidance logic for trajectory tracking", AIAA 2004-4900, with the gains of
ArduPilot's libraries/AP_L1_Control/AP_L1_Control.cpp.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import GRAVITY_M_S2, Wind
from sidelong.mission.geometry.wind import STILL_AIR

_STEP_S = 0.25
_LINE_INTERCEPT = math.sin(math.pi / 4)  # a line is met at 45 degrees at most

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class LineTracking:
    """One autopilot's guidance on one aircraft. The defaults are ArduPlane's at 15 m/s."""

    airspeed_m_s: float = 15.0
    wind: Wind = STILL_AIR
    period_s: float = 17.0
    damping: float = 0.75
    switch_s: float = 1.7
    first_s: float = 0.7
    first_is_line: bool = True
    roll_lag_s: float = 0.5
    bank_max_rad: float = math.radians(45.0)
    roll_rate_max_rad_s: float = math.radians(60.0)

    @property
    def switch_m(self) -> float:
        """How far before a waypoint its leg ends: the acceptance radius."""
        return self.switch_s * self.airspeed_m_s

    @property
    def first_m(self) -> float:
        """How far along the planned line the first waypoint lies."""
        return self.first_s * self.airspeed_m_s

    def gain_per_m(self, ground_speed_m_s: float) -> float:
        """Return g, the curvature for one radian of course error, 1/m.

        Args:
            ground_speed_m_s: Ground speed, m/s.
        """
        return 4.0 * math.pi * self.damping / (self.period_s * ground_speed_m_s)

    def look_ahead_m(self, ground_speed_m_s: float) -> float:
        """Return l, the cross-track distance that counts as one radian, m.

        Args:
            ground_speed_m_s: Ground speed, m/s.
        """
        return self.damping * self.period_s * ground_speed_m_s / math.pi

    def fly(
        self,
        start: Point,
        course_rad: float,
        curvature_per_m: float,
        waypoints: Sequence[Point],
        circle: Circle,
        duration_s: float,
    ) -> FloatArray:
        """Return the path that the autopilot flies through waypoints to a circle.

        Args:
            start: Start (east, north), m.
            course_rad: Course, clockwise from north, rad.
            curvature_per_m: Curvature at the start, 1/m, positive to the right.
            waypoints: Waypoints (east, north), m.
            circle: The circle at the end.
            duration_s: Duration of the prediction, s.

        Returns:
            Rows of (time s, east m, north m), (n, 3).
        """
        at, leg = start, 0
        previous: Point | None = start if self.first_is_line else None
        rows = []
        for step in range(math.ceil(duration_s / _STEP_S) + 1):
            rows.append((step * _STEP_S, *at))
            speed_m_s = self._ground_speed_m_s(course_rad)
            while leg < len(waypoints) and self.is_done(at, previous, waypoints[leg]):
                previous, leg = waypoints[leg], leg + 1
            goal = circle if leg == len(waypoints) else waypoints[leg]
            wanted_per_m = self.wanted_per_m(at, course_rad, speed_m_s, previous, goal)
            tightest_per_m = GRAVITY_M_S2 * math.tan(self.bank_max_rad) / speed_m_s**2
            wanted_per_m = max(-tightest_per_m, min(tightest_per_m, wanted_per_m))
            ramp_per_m = GRAVITY_M_S2 * self.roll_rate_max_rad_s / speed_m_s**2 * _STEP_S
            change_per_m = (wanted_per_m - curvature_per_m) * (1.0 - math.exp(-_STEP_S / self.roll_lag_s))
            change_per_m = max(-ramp_per_m, min(ramp_per_m, change_per_m))
            turned_rad = (curvature_per_m + change_per_m / 2.0) * speed_m_s * _STEP_S
            middle_rad = course_rad + turned_rad / 2.0
            at = (
                at[0] + speed_m_s * _STEP_S * math.sin(middle_rad),
                at[1] + speed_m_s * _STEP_S * math.cos(middle_rad),
            )
            course_rad += turned_rad
            curvature_per_m += change_per_m
        return np.array(rows)

    def wanted_per_m(
        self, at: Point, course_rad: float, speed_m_s: float, previous: Point | None, goal: Point | Circle
    ) -> float:
        """Return the curvature that the guidance asks for, without limits.

        Args:
            at: where the aircraft is, (east, north) in metres.
            course_rad: its course over the ground.
            speed_m_s: its ground speed.
            previous: where the leg begins; None: the goal itself is steered for.
            goal: the waypoint at the end of the leg, or the circle to fly.
        """
        if isinstance(goal, Circle):
            return self._to_circle(at, course_rad, goal, speed_m_s)
        if previous is None:
            return self._pursue(_bearing_rad(at, goal) - course_rad, speed_m_s)
        return self._to_line(at, course_rad, previous, goal, speed_m_s)

    def _ground_speed_m_s(self, course_rad: float) -> float:
        sine, cosine = math.sin(course_rad), math.cos(course_rad)
        along_m_s = self.wind.east_m_s * sine + self.wind.north_m_s * cosine
        across_m_s = self.wind.east_m_s * cosine - self.wind.north_m_s * sine
        return max(along_m_s + math.sqrt(max(self.airspeed_m_s**2 - across_m_s**2, 0.0)), 1.0)

    def is_done(self, at: Point, previous: Point | None, waypoint: Point) -> bool:
        """Return whether a leg ends here: near its waypoint, or abreast of it.

        Args:
            at: Position (east, north), m.
            previous: The waypoint before; None on the first leg.
            waypoint: The waypoint of the leg.
        """
        if math.dist(at, waypoint) <= self.switch_m:
            return True
        if previous is None:
            return False
        ahead_m = (waypoint[0] - previous[0]) * (at[0] - waypoint[0]) + (waypoint[1] - previous[1]) * (
            at[1] - waypoint[1]
        )
        return ahead_m >= 0.0

    def _to_line(self, at: Point, course_rad: float, begin: Point, end: Point, speed_m_s: float) -> float:
        line_rad = _bearing_rad(begin, end)
        right_m = (at[0] - end[0]) * math.cos(line_rad) - (at[1] - end[1]) * math.sin(line_rad)
        offset = max(-_LINE_INTERCEPT, min(_LINE_INTERCEPT, right_m / self.look_ahead_m(speed_m_s)))
        return self._pursue(line_rad - math.asin(offset) - course_rad, speed_m_s)

    def _to_circle(self, at: Point, course_rad: float, circle: Circle, speed_m_s: float) -> float:
        east_m, north_m = at[0] - circle.east_m, at[1] - circle.north_m
        distance_m = math.hypot(east_m, north_m)
        turn = 1.0 if circle.clockwise else -1.0
        outside_m = distance_m - circle.radius_m
        error_rad = math.remainder(circle.course_at(*at) - course_rad, math.tau)
        hold_per_m = turn * math.cos(error_rad) ** 2 / max(circle.radius_m / 2.0, distance_m) + self.gain_per_m(
            speed_m_s
        ) * (math.sin(error_rad) + turn * outside_m / self.look_ahead_m(speed_m_s))
        if outside_m <= 0.0:
            return hold_per_m
        # Far outside, the law for the circle would turn too early: steer for its centre until it turns less.
        centre_per_m = self._pursue(math.atan2(-east_m, -north_m) - course_rad, speed_m_s)
        return centre_per_m if turn * centre_per_m < turn * hold_per_m else hold_per_m

    def _pursue(self, error_rad: float, speed_m_s: float) -> float:
        error_rad = math.remainder(error_rad, math.tau)
        return self.gain_per_m(speed_m_s) * math.sin(max(-math.pi / 2, min(math.pi / 2, error_rad)))


def _bearing_rad(begin: Point, end: Point) -> float:
    return math.atan2(end[0] - begin[0], end[1] - begin[1])
