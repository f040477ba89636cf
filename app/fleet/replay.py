"""Replay of a fleet's coordinator through its own journal: the same events must give the same output."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, get_args

from sidelong.app.records.journal import encode
from sidelong.mission.fleet.coordinator import FleetCoordinator
from sidelong.mission.fleet.events import FleetCommand, FleetEvent


@dataclass(frozen=True, slots=True)
class FleetDifference:
    """The first output of a replay that differs from the flight."""

    event: FleetEvent
    flown: FleetCommand | None
    replayed: FleetCommand | None

    def __str__(self) -> str:
        return f"after {self.event}\n  flown:    {self.flown}\n  replayed: {self.replayed}"


def compare_coordination(coordinator: FleetCoordinator, records: Iterable[Any]) -> tuple[int, FleetDifference | None]:
    """Step the coordinator through its journal; return how many commands were compared, and the first difference."""
    commands = get_args(FleetCommand)
    compared, cause, expected = 0, None, deque[FleetCommand]()
    for record in records:
        if isinstance(record, commands):
            replayed = expected.popleft() if expected else None
            compared += 1
            if cause is not None and (replayed is None or encode(replayed) != encode(record)):
                return compared, FleetDifference(cause, record, replayed)
            continue
        if expected and cause is not None:
            return compared, FleetDifference(cause, None, expected[0])
        cause = record
        expected.extend(coordinator.step(record))
    return compared, None  # a flight that was cut off may lack the last commands: those are not held against it
