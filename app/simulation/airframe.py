"""The kinematic aircraft of the studies: coordinated turns over the ground, with limits on bank and roll rate."""

from __future__ import annotations

import math
from collections.abc import Callable

from sidelong.app.simulation.airframe_kernel import Airframe, Body, stepped
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import GRAVITY_M_S2, Wind

# In Python: for one step, to hand its tuples over to compiled code and back takes longer than the step.
_stepped: Callable[[Body, Airframe, float, float], Body] = stepped.py_func  # type: ignore[attr-defined]


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
        self.airspeed_m_s = airspeed_m_s
        self._limits = (airspeed_m_s, bank_max_rad, roll_rate_max_rad_s)
        self._lag_s, self._wind = lag_s, wind
        s = start
        bank_rad = math.atan(s.ground_speed_m_s**2 * s.curvature_per_m / GRAVITY_M_S2)
        self.body = Body(s.time_s, s.east_m, s.north_m, s.course_rad, s.ground_speed_m_s, s.curvature_per_m, bank_rad)
        """Where it is, as the loops see it."""

    def frame(self, step_s: float) -> Airframe:
        """Return the airframe as the loops see it, for steps of this length."""
        answer = 1.0 if self._lag_s <= 0.0 else -math.expm1(-step_s / self._lag_s)
        return Airframe(*self._limits, answer, self._wind.east_m_s, self._wind.north_m_s)

    @property
    def state(self) -> AircraftState:
        """Where it is, as planners see it."""
        return AircraftState(*self.body[:-1])

    def step(self, curvature_per_m: float, step_s: float) -> None:
        """Roll towards the commanded curvature and fly on for a step."""
        self.body = _stepped(self.body, self.frame(step_s), curvature_per_m, step_s)
