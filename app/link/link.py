"""The whole boundary to an autopilot: messages in and out, and parameters, as one small Protocol."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from typing import Any, Protocol

from sidelong.app.errors import FlightError
from sidelong.app.link.message import Message
from sidelong.app.link.quality import LinkReport


class Link(Protocol):
    """A connection to one vehicle. Every call ends within its own bound, whatever the other side does."""

    system_id: int
    own_id: tuple[int, int]  # system and component id of this end

    def messages(self) -> AsyncIterator[Message]:
        """Yield the messages of the vehicle and its components, in order of arrival, until the link is closed."""

    async def send(self, name: str, fields: Mapping[str, Any]) -> None:
        """Send one message. Raises LinkError when it cannot be sent."""

    async def parameter(self, name: str) -> float | None:
        """Return a parameter's value, or None where the vehicle has none of that name."""

    async def set_parameter(self, name: str, value: float) -> bool:
        """Set a parameter; return whether the vehicle accepted it."""

    def reports(self) -> tuple[LinkReport, ...]:
        """Return how each way to the vehicle has been since the beginning."""

    def recent(self) -> tuple[LinkReport, ...]:
        """Return how each way to the vehicle is now."""

    async def close(self) -> None:
        """End everything; safe to call more than once."""


class LinkError(FlightError):
    """A link operation failed; the message names the operation and the reason."""
