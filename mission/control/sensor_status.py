"""The latest reports of the vehicle and its payload, for the operator. Source: docs/health.md#inputs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from sidelong.estimators.filters.biases import Delays
from sidelong.estimators.sensing.readings import (
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Reading,
)
from sidelong.estimators.sensing.sighting import SightingOutcome
from sidelong.estimators.tracking.tracker import Tracker


@dataclass(slots=True)
class SensorStatus:
    """range_s and gimbal_s: time of the latest reading of the laser and the gimbal in use, -inf before the first.

    nis: normalised innovation squared of the latest sighting that was compared, NaN before the first.
    delays: of the payload's stamps, as far as they are estimated.
    """

    bank_rad: float = 0.0
    heading_rad: float = math.nan
    height_m: float = math.nan
    range_s: float = -math.inf
    gimbal_s: float = -math.inf
    nis: float = math.nan
    sightings: int = 0
    rejected: int = 0
    connected: bool = True
    delays: Delays | None = None

    def copy(self) -> SensorStatus:
        """Return what it is now."""
        return replace(self)

    def note(self, reading: Reading, outcomes: Iterable[SightingOutcome], tracker: Tracker) -> None:
        """Process a reading after the tracker."""
        match reading:
            case PositionReading():
                self.height_m, self.delays = reading.height_m, tracker.delays
            case AttitudeReading():
                self.bank_rad, self.heading_rad = reading.roll_rad, reading.yaw_rad
            case RangeReading() if reading.source == tracker.ranges.chosen:
                self.range_s = max(self.range_s, reading.time_s)
            case GimbalReading() if reading.source == tracker.gimbals.chosen:
                self.gimbal_s = max(self.gimbal_s, reading.time_s)
        for outcome in outcomes:
            self.sightings += 1
            self.rejected += not outcome.accepted
            if math.isfinite(outcome.nis):
                self.nis = outcome.nis
