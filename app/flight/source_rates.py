"""How often the sources of the target speak, and which of them are used, by the rules of the estimators in words."""

from __future__ import annotations

import asyncio
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sidelong.app.assembly import tracker_settings
from sidelong.app.config import Config, SharingSection
from sidelong.app.flight.outputs import open_beacon
from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT, Telemetry
from sidelong.app.link.vehicle import Vehicle
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import (
    BEACON_MESSAGES,
    GimbalReading,
    RangeReading,
    Source,
    TargetFixReading,
)
from sidelong.estimators.tracking.sources import Rank, SourceSelector, range_rank, sight_rank

_ANYWHERE = LocalPlane(0.0, 0.0)  # before the flight has one, a beacon is only counted


@dataclass(frozen=True, slots=True)
class SourceRate:
    """How often a range or gimbal source speaks.

    Attributes:
        kind: range, gimbal or target.
        source: Who sends.
        rate_hz: Messages per second of the vehicle's clock.
        fault: Why none of them holds a reading, '' if they do.
    """

    kind: str
    source: Source
    rate_hz: float
    fault: str = ""

    def __str__(self) -> str:
        return self._spoken + (f", but {self.fault}" if self.fault else "")

    @property
    def _spoken(self) -> str:
        if self.source.message in BEACON_MESSAGES:
            return f"{self.source.message} of a beacon at {self.rate_hz:.1f} Hz"
        where = f"component {self.source.component_id} id {self.source.sensor_id}"
        if self.kind == "range":
            where += f" orientation {self.source.orientation}"
        return f"{self.source.message} of {where} at {self.rate_hz:.1f} Hz"


class SourceRates:
    """Listens to a vehicle until ``close``."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        vehicle.listeners.append(self._count)
        self.begin()

    def begin(self) -> None:
        """Discard the messages received so far."""
        self._telemetry = Telemetry(self._vehicle.system_id)
        self._counts: Counter[tuple[str, Source]] = Counter()
        self._begun_s = math.inf  # of this computer's clock
        self._first_s = math.inf  # of the vehicle's

    def close(self) -> None:
        """Listen no more."""
        self._vehicle.listeners.remove(self._count)

    async def received(self, wall_s: float, sharing: SharingSection) -> tuple[SourceRate, ...]:
        """Return the rates, on the vehicle's clock, after listening for ``wall_s`` in total; then restart the count.

        Raises InputError if the beacon's address is in use or not local.
        """
        contacts: list[Callable[[Message], object]] = []
        beacon = await open_beacon(
            sharing, _ANYWHERE, lambda: self._telemetry.now_s, self._count_fix, listeners=contacts
        )
        self._vehicle.listeners += contacts
        listened_s = time.time() - self._begun_s if beacon is None else 0.0
        try:
            await asyncio.sleep(wall_s - min(max(listened_s, 0.0), wall_s))
        finally:
            for contact in contacts:
                self._vehicle.listeners.remove(contact)
            if beacon is not None:
                beacon.stop()
                await asyncio.sleep(0)  # its port is free again once the loop has turned
        # A simulation may run faster than the clock on the wall.
        by_vehicle_s, by_wall_s = self._telemetry.now_s - self._first_s, time.time() - self._begun_s
        duration_s = next((s for s in (by_vehicle_s, by_wall_s) if 0.0 < s < math.inf), wall_s)
        counts = {(*received, ""): number for received, number in self._counts.items()}
        counts |= {key: number for key, number in self._telemetry.unusable.items() if key[:2] not in self._counts}
        rates = tuple(
            SourceRate(kind, source, number / duration_s, fault)
            for (kind, source, fault), number in sorted(counts.items(), key=lambda item: (item[0][0], -item[1]))
        )
        self.begin()
        return rates

    def _count(self, message: Message) -> None:
        event = self._telemetry.event(message)
        self._begun_s = min(self._begun_s, message.received_s)
        if self._first_s == math.inf and self._telemetry.now_s > -math.inf:
            self._first_s = self._telemetry.now_s
        if isinstance(event, RangeReading):
            self._counts["range", event.source] += 1
        elif isinstance(event, GimbalReading):
            self._counts["gimbal", event.source] += 1
        elif isinstance(event, TargetFixReading):
            self._count_fix(event)

    def _count_fix(self, reading: TargetFixReading) -> None:
        self._counts["target", reading.source] += 1


def why_unused(config: Config, kind: str, source: Source) -> str:
    """Return why a source of a kind (range, gimbal, target) is never used, and what would use it; '' if it may be."""
    if kind == "target":
        return ""
    settings = tracker_settings(config.sensors, config.planner.lost_after_s)
    rank, choice = (range_rank, settings.range_source) if kind == "range" else (sight_rank, settings.gimbal_source)
    return SourceSelector(rank, choice).why_never(source, f"sensors.{kind}_component")


def describe_use(config: Config, kind: str, received: Sequence[Source]) -> dict[Source, str]:
    """Return what becomes of each source of a kind: range, gimbal, or target (a camera's own tracker)."""
    settings = tracker_settings(config.sensors, config.planner.lost_after_s)
    if kind == "target":
        return {
            source: "used: the target's own"
            if source.message in BEACON_MESSAGES
            else "used while no laser is received"
            for source in received
        }
    rank: Rank = range_rank if kind == "range" else sight_rank
    choice = settings.range_source if kind == "range" else settings.gimbal_source
    key = f"sensors.{kind}_component"
    if choice is not None:
        return {
            source: f"not used: {why}" if (why := why_unused(config, kind, source)) else f"used: {key} names it"
            for source in received
        }
    ranks = {source: own for source in received if (own := rank(source)) is not None}
    best = min(ranks.values(), default=None)
    first = [source for source, own in ranks.items() if own == best]
    return {
        source: f"not used: {why}" if (why := why_unused(config, kind, source)) else _words(source, key, ranks, first)
        for source in received
    }


def _words(source: Source, key: str, ranks: dict[Source, int], first: Sequence[Source]) -> str:
    if source in first:
        if len(first) > 1:
            return f"used if it is received first; select one with {key}"
        return "used: " + ("the only one" if len(ranks) == 1 else "the payload's own, before what repeats it")
    repeats = source.component_id == AUTOPILOT_COMPONENT
    why = "the autopilot only repeats it" if repeats else "it is not fixed to a gimbal"
    return f"stands by for when the other falls silent: {why}"
