"""Where the service stands, for people and programs."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any


class State(StrEnum):
    """What the service does now."""

    WAITING = "waiting"  # for a vehicle, its payload or what the checks miss
    READY = "ready"
    WATCHING = "watching"
    YIELDED = "yielded"
    FAULT = "fault"  # the last watch failed; a request to watch tries again


@dataclass(frozen=True, slots=True)
class Status:
    """What ``sidelong status`` shows.

    Attributes:
        state: What the service does now.
        reason: Why, in words; '' where there is nothing to add.
        vehicle: The vehicle that is connected, '' if none is.
        run: The folder of the present watch, or of the last one; '' before the first.
        watches: How many watches have begun since the service started.
        disk_mb: What all run folders take, MB.
        records: Why records of the present or last watch are incomplete, '' if they are not.
    """

    state: State
    reason: str = ""
    vehicle: str = ""
    run: str = ""
    watches: int = 0
    disk_mb: float = 0.0
    records: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)

    def __str__(self) -> str:
        return f"{self.state}: {self.reason}" if self.reason else str(self.state)
