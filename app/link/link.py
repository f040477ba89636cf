"""The whole boundary to an autopilot: messages in and out, and the mission, as one small Protocol."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

from app.link.message import Message


class UploadResult(StrEnum):
    """What an upload came to. After TIMEOUT the vehicle may hold the old mission, the new one or a mixture."""

    ACCEPTED = "accepted"
    DENIED = "denied"
    TIMEOUT = "timeout"


@dataclass(frozen=True, slots=True)
class RawItem:
    """One mission item exactly as MISSION_ITEM_INT carries it (param NaN: unused)."""

    command: int
    frame: int
    param1: float
    param2: float
    param3: float
    param4: float
    x: int
    y: int
    z: float
    autocontinue: int = 1


class Link(Protocol):
    """A connection to one vehicle. Every call ends within its own bound, whatever the other side does."""

    system_id: int

    def messages(self) -> AsyncIterator[Message]:
        """Yield what the vehicle and its components say, in order of arrival, until the link is closed."""
        ...

    async def send(self, name: str, fields: Mapping[str, Any]) -> None:
        """Send one message. Raises LinkError when it cannot be sent."""
        ...

    async def upload(self, items: Sequence[RawItem], current: int, timeout_s: float) -> UploadResult:
        """Replace the vehicle's mission; ``current`` is the index marked as current."""
        ...

    async def download(self, timeout_s: float) -> tuple[RawItem, ...] | None:
        """Return the vehicle's mission, or None when it did not arrive in time."""
        ...

    async def parameter(self, name: str, timeout_s: float = 4.0) -> float | None:
        """Return a parameter's value, or None where the vehicle has none of that name."""
        ...

    async def set_parameter(self, name: str, value: float, timeout_s: float = 4.0) -> bool:
        """Set a parameter and tell whether the vehicle took it."""
        ...

    async def close(self) -> None:
        """End everything; safe to call more than once."""
        ...


class LinkError(Exception):
    """The link could not do what was asked; the text says what and why."""
