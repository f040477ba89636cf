"""Which messages the mission lives on, and how often: all that is needed, or what a slow radio can carry."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable, Sequence

from sidelong.app.config import LinkSection
from sidelong.app.flight.one_task import OneTask
from sidelong.app.link.raw_links import UNREAD
from sidelong.app.link.vehicle import Vehicle
from sidelong.mission.control.snapshot import Snapshot
from sidelong.mission.core.events import HealthChanged
from sidelong.mission.core.inputs import Input, InputState

_SLOW_BAUD = 57_600
_AGAIN_S = 10.0
_SLOWED_SHARE, _SLOWED_EVERY_S = 0.5, 30.0
RATES_HZ = {
    1: 1.0,
    2: 1.0,
    24: 2.0,
    30: 20.0,
    33: 10.0,
    42: 5.0,
    87: 2.0,
    168: 1.0,
    193: 2.0,
    230: 2.0,
    231: 1.0,
    360: 2.0,
    436: 10.0,
}
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

    terrain: request terrain messages too. few: request the minimum rates and switch all other messages off; a ground
    station on the same link then receives fewer messages, too.
    """
    if few:
        await vehicle.set_rates(UNUSED_HZ, rounds=1)
    await vehicle.set_rates((FEW_HZ if few else RATES_HZ) | (TERRAIN_HZ if terrain else {}))
    if few:
        await vehicle.set_rates(UNUSED_HZ, rounds=1)  # some may have been lost


class StreamKeeper:
    """Requests the streams again while one is silent, and when another ground station has slowed one down.

    It observes the rates in the snapshots.

    Args:
        request: requests all streams.
        note: reports a sentence to the operator.
    """

    def __init__(self, request: Callable[[], Awaitable[None]], note: Callable[[str], object]) -> None:
        self._request, self._note = request, note
        self._stale: set[Input] = set()
        self._requesting = OneTask()
        self._best_hz: dict[Input, float] = {}
        self._look_s = float("-inf")

    def health_changed(self, change: HealthChanged) -> None:
        """Request again for as long as an input of the autopilot is stale."""
        if change.input not in (Input.POSITION, Input.ATTITUDE, Input.HEARTBEAT):
            return
        if change.state is InputState.STALE:
            self._stale.add(change.input)
        else:
            self._stale.discard(change.input)
        self._requesting.begin(self._keep_requesting)

    def show(self, snapshot: Snapshot) -> None:
        """Look at the rates from time to time."""
        if abs(snapshot.time_s - self._look_s) < _SLOWED_EVERY_S:
            return
        self._look_s = snapshot.time_s
        for one in snapshot.health:
            if one.input not in (Input.POSITION, Input.ATTITUDE) or not one.rate_hz > 0.0:
                continue
            best_hz = self._best_hz[one.input] = max(one.rate_hz, self._best_hz.get(one.input, 0.0))
            if one.rate_hz < _SLOWED_SHARE * best_hz and one.state is InputState.OK:
                self._note(
                    f"the autopilot sends its {one.input} {one.rate_hz:.1f} times a second, before it was "
                    f"{best_hz:.1f}: requesting the rate again"
                )
                self._requesting.begin(self._keep_requesting)

    def stop(self) -> None:
        """Request nothing more."""
        self._requesting.stop()

    async def _keep_requesting(self) -> None:
        await self._request()
        while self._stale:
            await asyncio.sleep(_AGAIN_S)
            if self._stale:
                await self._request()
