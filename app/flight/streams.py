"""Which messages the mission lives on, and how often: all that is needed, or what a slow radio can carry."""

from __future__ import annotations

import re
from collections.abc import Sequence

from sidelong.app.link.vehicle import Vehicle

_SLOW_BAUD = 57_600
_RATES_HZ = {
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
    436: 20.0,
}
"""SYS_STATUS, SYSTEM_TIME, GPS_RAW_INT, ATTITUDE, GLOBAL_POSITION_INT, MISSION_CURRENT, POSITION_TARGET_GLOBAL_INT,
WIND, EKF_STATUS_REPORT, ESTIMATOR_STATUS, WIND_COV, ORBIT_EXECUTION_STATUS, CURRENT_MODE."""
_FEW_HZ = _RATES_HZ | {1: 0.2, 2: 0.2, 24: 1.0, 30: 8.0, 33: 5.0, 42: 3.0, 87: 1.0, 168: 0.5, 193: 1.0}
_FEW_HZ |= {230: 1.0, 231: 0.5, 436: 4.0}
_TERRAIN_HZ = {133: 1.0, 136: 0.5}
"""TERRAIN_REQUEST, TERRAIN_REPORT."""
_UNUSED_HZ = dict.fromkeys(
    (27, 29, 31, 32, 36, 62, 65, 74, 83, 105, 116, 125, 129, 137, 141, 147, 163, 241, 245, 331, 380, 410), 0.0
)
"""What autopilots send unasked and nothing here reads: raw sensors, servos, RC, VFR_HUD, quaternions, targets."""


def is_slow(urls: Sequence[str]) -> bool:
    """Tell whether one of the links is a serial line of 57,600 baud or less."""
    bauds = [re.fullmatch(r"serial\w*://.*:(\d+)", url) for url in urls]
    return any(baud is not None and int(baud[1]) <= _SLOW_BAUD for baud in bauds)


async def ask_for_streams(vehicle: Vehicle, few: bool = False, terrain: bool = False) -> None:
    """Ask for the messages that the mission lives on; default rates are 1 Hz on ArduPlane.

    terrain: also for what it wants to know of the ground. few: at the least rates that it can live on, and nothing
    else: a ground station on the same link sees less, too.
    """
    if few:
        await vehicle.set_rates(_UNUSED_HZ, rounds=1)
    await vehicle.set_rates((_FEW_HZ if few else _RATES_HZ) | (_TERRAIN_HZ if terrain else {}))
    if few:
        await vehicle.set_rates(_UNUSED_HZ, rounds=1)  # some may have been lost
