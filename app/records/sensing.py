"""Input of a flight's filter: events that pass the plausibility check, and the sightings that they complete."""

from __future__ import annotations

from typing import get_args

from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.sensing.readings import AttitudeReading, Reading
from sidelong.estimators.sensing.sighting import SightingOutcome
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.control.controller import StandoffController, StandoffSettings
from sidelong.mission.core.events import ClockTick, Event, LinkReported, ModeReported, NavigationReported
from sidelong.mission.core.fleet import FleetAdvice
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind

_INPUTS = frozenset((*get_args(Reading), NavigationReported, ModeReported, ClockTick, LinkReported, FleetAdvice))
# A control step that never takes control plans nothing: it needs neither of them.
_SETTINGS = StandoffSettings(Requirement(0.0, 1.0, Side.LEFT, 0.0), Aircraft(1.0, 1.0))


class _NoPlanner:
    def decide(
        self, aircraft: AircraftState, _target: TargetEstimate, _present: Plan, _wind: Wind, _latency_s: float
    ) -> Decision:
        return Decision(aircraft.time_s, None, "")


class Sensing:
    """Steps a flight's inputs as its control step did; attitude: the latest accepted one."""

    def __init__(self, tracker: Tracker) -> None:
        self.attitude: AttitudeReading | None = None
        self.tracker = tracker
        self._controller = StandoffController(_SETTINGS, tracker, lambda _aircraft, _requirement: _NoPlanner())

    def take(self, event: Event) -> tuple[Event | None, tuple[SightingOutcome, ...]]:
        """Return the accepted event, None if it is rejected, and the sightings that it completed."""
        if type(event) not in _INPUTS:
            return event, ()
        self._controller.step(event)
        admitted = self._controller.admitted
        if isinstance(admitted, AttitudeReading):
            self.attitude = admitted
        return admitted, self._controller.sighted

    @property
    def unknown(self) -> str:
        """Why it is not known how well the target is watched; empty while it is known."""
        return self._controller.snapshot().unknown
