"""Answers the autopilot's questions about the ground, where we have elevation data."""

from __future__ import annotations

import asyncio

from sidelong.app.flight.one_task import OneTask
from sidelong.app.link.link import LinkError
from sidelong.app.link.message import Message
from sidelong.app.link.vehicle import Vehicle
from sidelong.app.terrain.elevation_data import ElevationData
from sidelong.app.terrain.terrain_data import answers


class TerrainServer:
    """Answers TERRAIN_REQUEST with TERRAIN_DATA, one request at a time: the autopilot repeats unanswered requests."""

    def __init__(self, vehicle: Vehicle, data: ElevationData) -> None:
        self._vehicle, self._data = vehicle, data
        self._answering = OneTask()
        vehicle.listeners.append(self._received)

    def stop(self) -> None:
        """Answer no more."""
        self._vehicle.listeners.remove(self._received)
        self._answering.stop()

    def _received(self, message: Message) -> None:
        if message.name == "TERRAIN_REQUEST":
            self._answering.begin(lambda: self._answer(message))

    async def _answer(self, request: Message) -> None:
        # Reading tiles is for a thread: the loop waits for no disk.
        found = await asyncio.to_thread(lambda: list(answers(request.fields, self._data)))
        for fields in found:
            try:
                await self._vehicle.link.send("TERRAIN_DATA", fields)
            except LinkError:
                return
