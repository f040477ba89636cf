"""What the vehicle last said of itself, asked by those who bring plans to it and by those who check it."""

from __future__ import annotations

import asyncio

from sidelong.app.link.modes import ARMED_FLAG, mode_name
from sidelong.app.link.vehicle import Vehicle
from sidelong.mission.exchange.dialect import Home

_FLYING_HEIGHT_M = 25.0
_ANSWER_S, _TRIES = 0.8, 3
_REQUEST_MESSAGE, _HOME_POSITION_ID = 512, 242
_ASK_FOR_HOME = {"command": _REQUEST_MESSAGE, "confirmation": 0, "param1": float(_HOME_POSITION_ID)}
_ASK_FOR_HOME |= {f"param{i}": 0.0 for i in range(2, 8)}


def mode_of(vehicle: Vehicle) -> str:
    """Return the flight mode by name, as the vehicle told it last: in a heartbeat, or at once where it can."""
    heartbeat, told = vehicle.latest["HEARTBEAT"], vehicle.latest.get("CURRENT_MODE")
    newer = told if told is not None and told.received_s > heartbeat.received_s else heartbeat
    fields = heartbeat.fields
    return mode_name(int(fields["autopilot"]), int(fields["base_mode"]), int(newer.fields["custom_mode"]))


def is_flying(vehicle: Vehicle) -> bool:
    """Tell whether the vehicle is armed and well above its home."""
    armed = int(vehicle.latest["HEARTBEAT"].fields["base_mode"]) & ARMED_FLAG
    position = vehicle.latest.get("GLOBAL_POSITION_INT")
    return bool(armed) and position is not None and position.fields["relative_alt"] * 1e-3 > _FLYING_HEIGHT_M


async def home_of(vehicle: Vehicle) -> Home | None:
    """Return the vehicle's home, asking for it if it has not been told."""
    for _ in range(_TRIES):
        if "HOME_POSITION" in vehicle.latest:
            break
        waiting = asyncio.ensure_future(vehicle.heard("HOME_POSITION", vehicle.answer_s(_ANSWER_S)))
        await vehicle.tell("COMMAND_LONG", _ASK_FOR_HOME)
        await waiting
    if "HOME_POSITION" not in vehicle.latest:
        return None
    fields = vehicle.latest["HOME_POSITION"].fields
    return Home(fields["latitude"] * 1e-7, fields["longitude"] * 1e-7, fields["altitude"] * 1e-3)
