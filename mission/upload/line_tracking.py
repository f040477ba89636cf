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
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.line_kernel import Air, LinePoint
from sidelong.mission.geometry.progress import STILL_AIR, circling_of
from sidelong.mission.upload import line_tracking_kernel as kernel

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
        """Return g, the curvature for one radian of course error, 1/m."""
        return 4.0 * math.pi * self.damping / (self.period_s * ground_speed_m_s)

    def look_ahead_m(self, ground_speed_m_s: float) -> float:
        """Return l, the cross-track distance that counts as one radian, m."""
        return self.damping * self.period_s * ground_speed_m_s / math.pi

    def fly(
        self, start: LinePoint, waypoints: Sequence[Point] | FloatArray, circle: Circle, duration_s: float
    ) -> FloatArray:
        """Return rows (n, 3) of time s, east m and north m: what the autopilot flies by way of waypoints."""
        law = self.gain_per_m(1.0), self.look_ahead_m(1.0), self.switch_m, self.first_is_line, self.roll_lag_s
        air = Air(self.airspeed_m_s, self.wind.east_m_s, self.wind.north_m_s)
        guidance = kernel.Guidance(*law, self.bank_max_rad, self.roll_rate_max_rad_s, air)
        places = np.asarray(waypoints, float).reshape(-1, 2)
        return kernel.flown(start, places, circling_of(circle), guidance, duration_s)
