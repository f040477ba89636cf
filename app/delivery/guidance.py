"""How plans reach the autopilot: as mission items, or as one command for each circle."""

from __future__ import annotations

from typing import Protocol

from app.link.message import Message
from mission.core.events import UploadPlan


class SwapError(Exception):
    """A plan could not be brought to the autopilot, which flies on as before; the text says why."""


class PlanBackend(Protocol):
    """One way of flying plans. At any moment, whatever fails, the vehicle is left on a circle that needs no one."""

    @property
    def mode(self) -> str:
        """The flight mode, by name, in which it flies."""
        ...

    async def prepare(self, command: UploadPlan) -> None:
        """Make the plan ready without flying it. Raises SwapError."""
        ...

    async def depart(self, number: int) -> None:
        """Fly plan ``number`` from now on. Raises SwapError."""
        ...

    def foreign(self, message: Message) -> str | None:
        """Return what a message tells about somebody else who commands the vehicle; None if nothing."""
        ...

    def stop(self) -> None:
        """Send nothing any more, at once."""
        ...
