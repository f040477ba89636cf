"""Readings in, estimate out."""

from __future__ import annotations

from dataclasses import replace

from estimators.biases import Calibration
from estimators.estimate import TargetEstimate
from estimators.pairing import Pairing
from estimators.pose import PoseHistory
from estimators.readings import (
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Reading,
    Source,
    TargetFixReading,
)
from estimators.settings import SourceChoice, TrackerSettings
from estimators.sighting import AnySighting, SightingOutcome
from estimators.sources import SourceSelector
from estimators.track import Track

__all__ = ["SourceChoice", "Tracker", "TrackerSettings"]


class Tracker:
    """Pose history, source selection, pairing and track behind one door. Time comes from the readings.

    A reading may come late or out of order by a few seconds.
    """

    def __init__(self, settings: TrackerSettings) -> None:
        self._settings = settings
        self._poses = PoseHistory()
        self._pairing = Pairing(settings, self._poses)
        self._ranges = SourceSelector(settings.range_source)
        self._gimbals = SourceSelector(settings.gimbal_source)
        self._track = Track(settings)
        self.sightings = 0
        self.rejected = 0

    def add(self, reading: Reading) -> tuple[SightingOutcome, ...]:
        """Take a reading in. Returns the sightings that it completed, each with what became of it."""
        match reading:
            case PositionReading() | AttitudeReading():
                self._poses.add(reading)
            case GimbalReading():
                if not self._gimbals.accepts(reading.source, reading.time_s):
                    return ()
                self._pairing.add_gimbal(replace(reading, time_s=reading.time_s - self._settings.latency_s))
            case RangeReading():
                if not self._ranges.accepts(reading.source, reading.time_s):
                    return ()
                self._pairing.add_range(replace(reading, time_s=reading.time_s - self._settings.latency_s))
            case TargetFixReading():
                return ()
        if not self._pairing.waiting:
            return ()
        return tuple(self._take(sighting) for sighting in self._pairing.completed())

    def _take(self, sighting: AnySighting) -> SightingOutcome:
        outcome = self._track.add(sighting)
        self.sightings += 1
        self.rejected += not outcome.accepted
        return outcome

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Return the target predicted to ``now_s``; None before the first sighting."""
        return self._track.estimate(now_s)

    @property
    def range_source(self) -> Source | None:
        return self._ranges.chosen

    @property
    def gimbal_source(self) -> Source | None:
        return self._gimbals.chosen

    @property
    def calibration(self) -> Calibration:
        return self._track.calibration
