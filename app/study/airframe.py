"""The kinematic aircraft of the studies: coordinated turns over the ground, with limits on bank and roll rate."""

from __future__ import annotations

import math

from mission.core.plan import AircraftState
from mission.core.requirement import GRAVITY_M_S2, Wind
from mission.geometry.wind import ground_speed_m_s


class KinematicAircraft:
    """Flies commanded curvatures over the ground at constant airspeed, as far as bank and roll rate allow."""

    def __init__(
        self,
        start: AircraftState,
        airspeed_m_s: float,
        bank_max_rad: float,
        roll_rate_max_rad_s: float,
        wind: Wind,
        lag_s: float = 0.0,
    ) -> None:
        """lag_s: time constant of the bank towards its command, within the roll rate; 0: the roll rate alone."""
        self._airspeed_m_s, self._wind = airspeed_m_s, wind
        self._bank_max_rad, self._roll_rate_max_rad_s = bank_max_rad, roll_rate_max_rad_s
        self._lag_s = lag_s
        self.state = start
        self.bank_rad = math.atan(start.ground_speed_m_s**2 * start.curvature_per_m / GRAVITY_M_S2)

    def step(self, curvature_per_m: float, step_s: float) -> AircraftState:
        """Roll towards the commanded curvature, fly on for a step and return the new state."""
        before = self.state
        wanted_rad = math.atan(before.ground_speed_m_s**2 * curvature_per_m / GRAVITY_M_S2)
        wanted_rad = min(max(wanted_rad, -self._bank_max_rad), self._bank_max_rad)
        reach_rad = self._roll_rate_max_rad_s * step_s
        answered = 1.0 if self._lag_s <= 0.0 else -math.expm1(-step_s / self._lag_s)
        self.bank_rad += min(max(answered * (wanted_rad - self.bank_rad), -reach_rad), reach_rad)
        speed_m_s = before.ground_speed_m_s
        flown_per_m = GRAVITY_M_S2 * math.tan(self.bank_rad) / speed_m_s**2
        turned_rad = flown_per_m * speed_m_s * step_s
        middle_rad = before.course_rad + 0.5 * turned_rad
        course_rad = math.remainder(before.course_rad + turned_rad, 2.0 * math.pi)
        windy = self._wind.speed_m_s > 0.0
        self.state = AircraftState(
            before.time_s + step_s,
            before.east_m + speed_m_s * step_s * math.sin(middle_rad),
            before.north_m + speed_m_s * step_s * math.cos(middle_rad),
            course_rad,
            ground_speed_m_s(course_rad, self._airspeed_m_s, self._wind) if windy else self._airspeed_m_s,
            flown_per_m,
        )
        return self.state
