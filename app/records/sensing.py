"""Input of a flight's filter: events that pass the plausibility check, and the sightings that they complete."""

from __future__ import annotations

from sidelong.estimators.sensing.readings import AttitudeReading, PositionReading, Reading
from sidelong.estimators.sensing.sighting import SightingOutcome
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.control.plausibility import Plausibility
from sidelong.mission.core.events import Event


class Sensing:
    """Goes through a flight's events as its control step did. attitude: the latest accepted one; tracker: fed so."""

    def __init__(self, tracker: Tracker) -> None:
        self.attitude: AttitudeReading | None = None
        self.tracker, self._door = tracker, Plausibility()

    def take(self, event: Event) -> tuple[Event | None, tuple[SightingOutcome, ...]]:
        """Return the accepted event, None if it is rejected, and the sightings that it completed."""
        admitted, _ = self._door.admit(event)
        if isinstance(admitted, AttitudeReading):
            self.attitude = admitted
        if not isinstance(admitted, Reading):
            return admitted, ()
        if isinstance(admitted, PositionReading) and not self._door.place_is_known:
            return admitted, ()
        return admitted, self.tracker.add(admitted)
