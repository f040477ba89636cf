"""Sends what the core wants sent, one message after the other; a message that cannot be sent counts as lost."""

from __future__ import annotations

import asyncio

from sidelong.app.link.link import LinkError
from sidelong.app.link.vehicle import Vehicle
from sidelong.mission.exchange.outbox import SendMessage


class CommandExecutor:
    """One vehicle's hands. ``run`` must be running."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._waiting: asyncio.Queue[SendMessage] = asyncio.Queue()
        self._sending = False

    @property
    def is_busy(self) -> bool:
        """Whether something waits to be sent."""
        return self._sending or not self._waiting.empty()

    def send(self, message: SendMessage) -> None:
        """Send a message after those that wait already."""
        self._waiting.put_nowait(message)

    def drop(self) -> None:
        """Send nothing of what still waits."""
        while not self._waiting.empty():
            self._waiting.get_nowait()

    async def run(self) -> None:
        """Send until cancelled."""
        while True:
            self._sending = False
            message = await self._waiting.get()
            self._sending = True
            try:
                await self._vehicle.transmit(message.name, message.fields)
            except LinkError:
                continue  # the core repeats unanswered messages
