"""Which messages the mission needs, and how often; answers to the autopilot's questions about the ground."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sidelong.app.config import LinkSection
from sidelong.app.link.message import Message
from sidelong.app.link.raw_links import UNREAD
from sidelong.app.link.vehicle import LinkError, Vehicle
from sidelong.app.terrain.elevation_data import ElevationData, Posts
from sidelong.mission.control.present import Present
from sidelong.mission.core.events import HealthChanged
from sidelong.mission.core.inputs import Input, InputState


class OneTask:
    """Runs a task; while it runs, no other one begins."""

    def __init__(self) -> None:
        self._task: asyncio.Task[None] | None = None

    @property
    def is_running(self) -> bool:
        return self._task is not None and not self._task.done()

    def begin(self, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Start the work, unless work is running."""
        if not self.is_running:
            self._task = asyncio.create_task(work())

    def stop(self) -> None:
        if self._task is not None:
            self._task.cancel()


async def announcing(work: Coroutine[Any, Any, None], what: str, note: Callable[[str], object]) -> None:
    """Do work that the flight can go on without: an error of it is announced."""
    try:
        await work
    except Exception as error:
        note(f"{what}: internal error, {error!r}; the flight goes on without it")


_SLOW_BAUD = 57_600
_AGAIN_S = 10.0
_SLOWED_SHARE, _SLOWED_EVERY_S = 0.5, 30.0
RATES_HZ = {1: 1.0, 2: 1.0, 24: 2.0, 30: 20.0, 33: 10.0, 42: 5.0, 87: 2.0, 168: 1.0, 193: 2.0, 230: 2.0}
RATES_HZ |= {231: 1.0, 360: 2.0, 436: 10.0}
"""SYS_STATUS, SYSTEM_TIME, GPS_RAW_INT, ATTITUDE, GLOBAL_POSITION_INT, MISSION_CURRENT, POSITION_TARGET_GLOBAL_INT,
WIND, EKF_STATUS_REPORT, ESTIMATOR_STATUS, WIND_COV, ORBIT_EXECUTION_STATUS, CURRENT_MODE."""
FEW_HZ = RATES_HZ | {1: 0.2, 2: 0.2, 24: 1.0, 30: 8.0, 33: 5.0, 42: 3.0, 87: 1.0, 168: 0.5, 193: 1.0}
FEW_HZ |= {230: 1.0, 231: 0.5, 436: 4.0}
TERRAIN_HZ = {133: 1.0, 136: 0.5}
"""TERRAIN_REQUEST, TERRAIN_REPORT."""
UNUSED_HZ = dict.fromkeys((*sorted(UNREAD), 65, 147, 245, 380, 410), 0.0)
"""What a slow radio need not carry: the last ones are RC_CHANNELS, BATTERY_STATUS, EXTENDED_SYS_STATE,
TIME_ESTIMATE_TO_TARGET and EVENT."""


def is_slow(urls: Sequence[str]) -> bool:
    """Return whether one of the links is a serial line of 57,600 baud or less."""
    bauds = [re.fullmatch(r"serial\w*://.*:(\d+)", url) for url in urls]
    return any(baud is not None and int(baud[1]) <= _SLOW_BAUD for baud in bauds)


def wants_few(link: LinkSection) -> bool:
    """Return whether to request only the messages that the mission needs."""
    return is_slow(link.connections) if link.few_messages is None else link.few_messages


async def ask_for_streams(vehicle: Vehicle, few: bool = False, terrain: bool = False) -> None:
    """Request the messages that the mission needs; default rates are 1 Hz on ArduPlane.

    few: request the minimum rates and switch all other messages off, for a ground station on the same link, too.
    """
    if few:
        await vehicle.set_rates(UNUSED_HZ, rounds=1)
    await vehicle.set_rates((FEW_HZ if few else RATES_HZ) | (TERRAIN_HZ if terrain else {}))
    if few:
        await vehicle.set_rates(UNUSED_HZ, rounds=1)  # some may have been lost


@dataclass(eq=False)
class StreamKeeper:
    """Requests the streams again while one is silent, and when another ground station has slowed one down."""

    _request: Callable[[], Awaitable[None]]
    _note: Callable[[str], object]
    _stale: set[Input] = field(default_factory=set)
    _requesting: OneTask = field(default_factory=OneTask)
    _best_hz: dict[Input, float] = field(default_factory=dict)
    _look_s: float = -math.inf

    def health_changed(self, change: HealthChanged) -> None:
        """Request again for as long as an input of the autopilot is stale."""
        if change.input not in (Input.POSITION, Input.ATTITUDE, Input.HEARTBEAT):
            return
        if change.state is InputState.STALE:
            self._stale.add(change.input)
        else:
            self._stale.discard(change.input)
        self._requesting.begin(self._keep_requesting)

    def show(self, snapshot: Present) -> None:
        """Request positions and attitudes again when their rate has dropped."""
        if abs(snapshot.time_s - self._look_s) < _SLOWED_EVERY_S:
            return
        self._look_s = snapshot.time_s
        for health in snapshot.health:
            rate_hz = health.rate_hz
            if health.input not in (Input.POSITION, Input.ATTITUDE) or not rate_hz > 0.0:
                continue
            best_hz = self._best_hz[health.input] = max(rate_hz, self._best_hz.get(health.input, 0.0))
            if rate_hz < _SLOWED_SHARE * best_hz and health.state is InputState.OK:
                sends = f"the autopilot sends its {health.input} {rate_hz:.1f} times a second"
                self._note(f"{sends}, before it was {best_hz:.1f}: requesting the rate again")
                self._requesting.begin(self._keep_requesting)

    def stop(self) -> None:
        self._requesting.stop()

    async def _keep_requesting(self) -> None:
        await self._request()
        while self._stale:
            await asyncio.sleep(_AGAIN_S)
            if self._stale:
                await self._request()


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
    steps_deg = step_deg, step_deg / math.cos(math.radians(latitude_deg))
    heights = data.read(Posts(latitude_deg, longitude_deg, *steps_deg, _UP * _POSTS, _ACROSS * _POSTS))
    for bit in range(_UP * _ACROSS):
        if not mask >> bit & 1:
            continue
        row, column = _POSTS * (bit // _ACROSS), _POSTS * (bit % _ACROSS)
        square = heights[row : row + _POSTS, column : column + _POSTS]
        if np.isnan(square).any():
            continue
        place = {"lat": int(request["lat"]), "lon": int(request["lon"])}
        yield place | {
            "grid_spacing": spacing_m,
            "gridbit": bit,
            "data": np.rint(square).astype(int).ravel().tolist(),
        }
