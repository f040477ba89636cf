"""Answers the autopilot's questions about the ground, where we have elevation data."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sidelong.app.flight.one_task import OneTask
from sidelong.app.link.message import Message
from sidelong.app.link.vehicle import LinkError, Vehicle
from sidelong.app.terrain.elevation_data import ElevationData
from sidelong.app.terrain.raster import Posts

_ACROSS, _UP, _POSTS = 8, 7, 4
# ArduPilot's own conversion, in which both sides have to name the same places.
_METRES_PER_DEG = 111_318.84502145034
_SPACING_MIN_M, _SPACING_MAX_M = 5, 1000


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


def answers(request: Mapping[str, Any], data: ElevationData) -> Iterator[dict[str, Any]]:
    """Yield the fields of the TERRAIN_DATA that answer a TERRAIN_REQUEST; squares with a void are not answered.

    A request that names no place on earth, or no spacing to speak of, is not answered at all.
    """
    latitude_deg, longitude_deg = float(request["lat"]) * 1e-7, float(request["lon"]) * 1e-7
    spacing_m, mask = int(request["grid_spacing"]), int(request["mask"])
    if not (
        abs(latitude_deg) < 89.0 and abs(longitude_deg) <= 180.0 and _SPACING_MIN_M <= spacing_m <= _SPACING_MAX_M
    ):
        return
    step_deg = spacing_m / _METRES_PER_DEG
    posts = Posts(
        latitude_deg,
        longitude_deg,
        step_deg,
        step_deg / math.cos(math.radians(latitude_deg)),
        _UP * _POSTS,
        _ACROSS * _POSTS,
    )
    heights = data.read(posts)
    for bit in range(_UP * _ACROSS):
        if not mask >> bit & 1:
            continue
        row, column = _POSTS * (bit // _ACROSS), _POSTS * (bit % _ACROSS)
        square = heights[row : row + _POSTS, column : column + _POSTS]
        if np.isnan(square).any():
            continue
        yield {
            "lat": int(request["lat"]),
            "lon": int(request["lon"]),
            "grid_spacing": spacing_m,
            "gridbit": bit,
            "data": np.rint(square).astype(int).ravel().tolist(),
        }
