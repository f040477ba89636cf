"""Where an aircraft is that flies a plan exactly."""

from __future__ import annotations

import math

import numpy as np

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.progress import STILL_AIR, ground_speed_m_s, path_times_s
from sidelong.mission.paper.planner import LapClock


class PlanTrack:
    """The flight along a plan at constant airspeed in steady wind, from ``start`` on.

    A plan with a transition is joined at the transition's start, at ``plan.departure_s``; until then ``before``
    is flown. A plan without one is joined at the point of its circle nearest to ``start``.
    """

    def __init__(
        self,
        plan: Plan,
        start: AircraftState,
        airspeed_m_s: float,
        wind: Wind = STILL_AIR,
        before: PlanTrack | None = None,
    ) -> None:
        self._airspeed_m_s, self._wind = airspeed_m_s, wind
        self._transition: Path | None = plan.transition
        self._circle: Circle = plan.circle
        self._before = before
        self._clock = LapClock(plan.circle, airspeed_m_s, wind)
        if plan.transition is None:
            self.departure_s = self.arrival_s = start.time_s
            joined_rad = plan.circle.course_at(start.east_m, start.north_m)
        else:
            self.departure_s = max(plan.departure_s, start.time_s)
            self._times_s = path_times_s(plan.transition, airspeed_m_s, wind)
            self.arrival_s = self.departure_s + float(self._times_s[-1])
            joined_rad = float(plan.transition.course_rad[-1])
        self._turn_sign = 1.0 if plan.circle.clockwise else -1.0
        self._joined_clock_s = self._clock.time_s(self._turn_sign * joined_rad)

    def state_at(self, time_s: float) -> AircraftState:
        """Return the state at a time; before the departure that of ``before``, or of the transition's start."""
        if time_s < self.departure_s and self._before is not None:
            return self._before.state_at(time_s)
        if time_s < self.arrival_s and self._transition is not None:
            return self._on_transition(self._transition, time_s)
        turn_rad = self._clock.turn_rad(self._joined_clock_s + time_s - self.arrival_s)
        course_rad = self._turn_sign * turn_rad
        east_m, north_m = self._circle.position_at_course(course_rad)
        return self._state(time_s, east_m, north_m, course_rad, self._circle.curvature_per_m)

    def _on_transition(self, path: Path, time_s: float) -> AircraftState:
        arc_m = float(np.interp(time_s - self.departure_s, self._times_s, path.arc_m))
        return self._state(
            time_s,
            *(
                float(np.interp(arc_m, path.arc_m, along))
                for along in (path.east_m, path.north_m, path.course_rad, path.curvature_per_m)
            ),
        )

    def _state(
        self, time_s: float, east_m: float, north_m: float, course_rad: float, curvature_per_m: float
    ) -> AircraftState:
        wrapped_rad = math.remainder(course_rad, 2.0 * math.pi)
        speed_m_s = ground_speed_m_s(wrapped_rad, self._airspeed_m_s, self._wind)
        return AircraftState(time_s, east_m, north_m, wrapped_rad, speed_m_s, curvature_per_m)
