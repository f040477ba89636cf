"""Who steers in a run: a planner whose plans are followed, or a guidance law that steers by itself."""

from __future__ import annotations

from collections.abc import Callable
from time import thread_time
from typing import Protocol, TypeVar

from estimators.estimate import TargetEstimate
from mission.core.circle import Circle
from mission.core.plan import AircraftState, Plan, Planner
from mission.core.requirement import Wind
from mission.geometry._line_kernel import following_per_m
from mission.geometry.progress import line_of

LAW_PERIOD_S = 0.2
DECISION_PERIOD_S = 1.0
TIMED_EVERY = 8

T = TypeVar("T")
GuidanceLaw = Callable[[AircraftState, TargetEstimate], float]
EstimateAt = Callable[[float], TargetEstimate | None]


class StopWatch:
    """Times one call in ``every``: asking for the processor's time may itself cost as much as a decision."""

    def __init__(self, every: int = TIMED_EVERY) -> None:
        self.taken_s: list[float] = []
        self._every, self._calls = every, 0

    def __call__(self, decide: Callable[[], T]) -> T:
        self._calls += 1
        if (self._calls - 1) % self._every != 0:
            return decide()
        begun_s = thread_time()
        decision = decide()
        self.taken_s.append(thread_time() - begun_s)
        return decision


class Pilot(Protocol):
    """Steers one aircraft through one run. changed_s: when it took up each plan; stopwatch times its decisions."""

    changed_s: list[float]
    stopwatch: StopWatch

    def curvature_per_m(self, aircraft: AircraftState, estimate_at: EstimateAt) -> float:
        """Return the curvature to fly now."""
        ...


class LawPilot:
    """Flies a guidance law; circles as it began until there is an estimate."""

    def __init__(self, law: GuidanceLaw) -> None:
        self._law = law
        self.changed_s: list[float] = []
        self.stopwatch = StopWatch()
        self._command_per_m: float | None = None
        self._next_s = 0.0

    def curvature_per_m(self, aircraft: AircraftState, estimate_at: EstimateAt) -> float:
        """See :class:`Pilot`."""
        if aircraft.time_s >= self._next_s - 1e-6:
            self._next_s = aircraft.time_s + LAW_PERIOD_S
            estimate = estimate_at(aircraft.time_s)
            if estimate is not None:
                self._command_per_m = self.stopwatch(lambda: self._law(aircraft, estimate))
        return aircraft.curvature_per_m if self._command_per_m is None else self._command_per_m


class PlanFollower:
    """Follows ``plan``, and ``coming`` from its departure on. changed_s: when each was departed to."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.coming: Plan | None = None
        self.changed_s: list[float] = []

    def curvature_per_m(self, aircraft: AircraftState) -> float:
        """Return the curvature to fly now."""
        if self.coming is not None and aircraft.time_s >= self.coming.departure_s - 1e-6:
            self.plan, self.coming = self.coming, None
            self.changed_s.append(aircraft.time_s)
        return following_per_m(*line_of(self.plan), aircraft.east_m, aircraft.north_m, aircraft.course_rad)


class PlanPilot:
    """Follows a planner's plans: what the autopilot and the control loop do in flight."""

    def __init__(self, planner: Planner, circle: Circle, wind: Wind, latency_s: float) -> None:
        self._planner, self._wind, self._latency_s = planner, wind, latency_s
        self._follower = PlanFollower(Plan(circle))
        self.changed_s = self._follower.changed_s
        self.stopwatch = StopWatch()
        self._next_s = 0.0

    def curvature_per_m(self, aircraft: AircraftState, estimate_at: EstimateAt) -> float:
        """See :class:`Pilot`."""
        follower = self._follower
        if follower.coming is None and aircraft.time_s >= self._next_s - 1e-6:
            self._next_s = aircraft.time_s + DECISION_PERIOD_S
            estimate = estimate_at(aircraft.time_s)
            if estimate is not None:
                follower.coming = self.stopwatch(
                    lambda: self._planner.decide(aircraft, estimate, follower.plan, self._wind, self._latency_s)
                ).plan
        return follower.curvature_per_m(aircraft)
