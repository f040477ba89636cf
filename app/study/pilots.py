"""Calling and timing planners."""

from __future__ import annotations

from collections.abc import Callable
from time import thread_time
from typing import TypeVar

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState

LAW_PERIOD_S = 0.2
DECISION_PERIOD_S = 1.0
TIMED_EVERY = 32

T = TypeVar("T")
GuidanceLaw = Callable[[AircraftState, TargetEstimate], float]


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
