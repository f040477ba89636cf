"""What the vehicle reports of itself: mode, whether it flies, home, firmware release."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Mapping, Sequence
from typing import Any

from sidelong.app.autopilots.autopilot import Release, release_in
from sidelong.app.link.message import Message
from sidelong.app.link.quality import LinkReport
from sidelong.app.link.telemetry import ARMED_FLAG, FAILSAFE_STATES, mode_name
from sidelong.app.link.vehicle import Vehicle, VehicleMessages
from sidelong.mission.control.present import VehicleStatus
from sidelong.mission.exchange.dialect import Home

_FLYING_HEIGHT_M = 25.0
_ANSWER_S, _TRIES, _WARNED_S = 0.8, 3, 10.0
_REQUEST_MESSAGE, _HOME_POSITION_ID, _AUTOPILOT_VERSION_ID, _GIMBAL_MANAGER_INFORMATION_ID = 512, 242, 148, 280
_GIMBAL_MANAGER_INFORMATION = "GIMBAL_MANAGER_INFORMATION"
_FAILSAFE_TEXT = re.compile("failsafe|lost|loss|low|breach|fence", re.IGNORECASE)
_INFINITE_YAW = 2048  # GIMBAL_MANAGER_CAP_FLAGS


def failsafe_of(vehicle: VehicleMessages) -> str:
    """Return why the autopilot is in a failsafe, by its own texts; '' if it is in none."""
    heartbeat = vehicle.latest.get("HEARTBEAT")
    if heartbeat is None or int(heartbeat.fields["system_status"]) not in FAILSAFE_STATES:
        return ""
    return ", ".join(vehicle.texts.matching(_FAILSAFE_TEXT, heartbeat.received_s - _WARNED_S)) or "no reason is given"


def mode_of(vehicle: Vehicle) -> str:
    heartbeat, current = vehicle.latest["HEARTBEAT"], vehicle.latest.get("CURRENT_MODE")
    newer = current if current is not None and current.received_s > heartbeat.received_s else heartbeat
    fields = heartbeat.fields
    return mode_name(int(fields["autopilot"]), int(fields["base_mode"]), int(newer.fields["custom_mode"]))


def is_flying(vehicle: Vehicle) -> bool:
    """Return whether the vehicle is armed and well above its home."""
    armed = int(vehicle.latest["HEARTBEAT"].fields["base_mode"]) & ARMED_FLAG
    position = vehicle.latest.get("GLOBAL_POSITION_INT")
    return bool(armed) and position is not None and position.fields["relative_alt"] * 1e-3 > _FLYING_HEIGHT_M


async def home_of(vehicle: Vehicle) -> Home | None:
    """Return the vehicle's home, requesting it if it was not reported yet."""
    message = await _requested(vehicle, "HOME_POSITION", _HOME_POSITION_ID)
    if message is None:
        return None
    fields = message.fields
    return Home(fields["latitude"] * 1e-7, fields["longitude"] * 1e-7, fields["altitude"] * 1e-3)


async def release_of(vehicle: Vehicle) -> Release | None:
    message = await _requested(vehicle, "AUTOPILOT_VERSION", _AUTOPILOT_VERSION_ID)
    return None if message is None else release_in(message.fields)


async def request_pan_limits(vehicle: Vehicle) -> None:
    """Request how far the gimbal turns off the nose, unless its gimbal manager has reported that."""
    # Any component may be the manager: https://mavlink.io/en/services/gimbal_v2.html#discovery-of-gimbal-manager
    await _requested(vehicle, _GIMBAL_MANAGER_INFORMATION, _GIMBAL_MANAGER_INFORMATION_ID, target_component=0)


def reported_pan_limits_rad(vehicle: Vehicle) -> tuple[float, float] | None:
    """Return the gimbal's least and greatest yaw off the nose; None if there is no limit or none was reported."""
    message = vehicle.latest.get(_GIMBAL_MANAGER_INFORMATION)
    if message is None or int(message.fields["cap_flags"]) & _INFINITE_YAW:
        return None
    least_rad, most_rad = float(message.fields["yaw_min"]), float(message.fields["yaw_max"])
    return (least_rad, most_rad) if least_rad < most_rad else None


async def _requested(vehicle: Vehicle, name: str, message_id: int, **address: int) -> Message | None:
    """Return a message that is requested of the autopilot, or of another address."""
    request: dict[str, Any] = address | {"command": _REQUEST_MESSAGE, "confirmation": 0, "param1": float(message_id)}
    request |= {f"param{i}": 0.0 for i in range(2, 8)}
    for _ in range(_TRIES):
        if name in vehicle.latest:
            break
        waiting = asyncio.ensure_future(vehicle.received(name, vehicle.answer_s(_ANSWER_S)))
        await vehicle.transmit("COMMAND_LONG", request)
        await waiting
    return vehicle.latest.get(name)


_FIXES = ("no GPS", "no fix", "2D", "3D", "DGPS", "RTK float", "RTK fixed", "static", "PPP")  # GPS_FIX_TYPE
_GOOD_FROM, _MIN_SATELLITES = 3, 6
_UNKNOWN_SATELLITES, _UNKNOWN_MV = 255, 65535


def vehicle_status(latest: Mapping[str, Message], links: Sequence[LinkReport]) -> VehicleStatus:
    """Return the status by the autopilot's latest messages and the links' present measures."""
    power, fix = latest.get("SYS_STATUS"), latest.get("GPS_RAW_INT")
    percent = mv = amps = gps = good = None
    if power is not None:
        percent, mv = int(power.fields["battery_remaining"]), int(power.fields["voltage_battery"])
        amps = int(power.fields["current_battery"]) * 1e-2
    battery = latest.get("BATTERY_STATUS")
    if (percent is None or percent < 0) and battery is not None:
        percent = int(battery.fields["battery_remaining"])
    if fix is not None:
        kind, satellites = int(fix.fields["fix_type"]), int(fix.fields["satellites_visible"])
        known = satellites != _UNKNOWN_SATELLITES
        gps = _FIXES[kind] if kind < len(_FIXES) else f"fix type {kind}"
        gps += f", {satellites} satellites" if known else ""
        good = kind >= _GOOD_FROM and (not known or satellites >= _MIN_SATELLITES)
    used = next((link.measured for link in links if link.in_use), None)
    return VehicleStatus(
        percent if percent is not None and percent >= 0 else None,
        None if mv in (None, 0, _UNKNOWN_MV) else mv * 1e-3,
        gps,
        good,
        None if used is None or used.loss is None else round(100.0 * (1.0 - used.loss)),
        None if used is None else used.round_trip_s,
        battery_a=amps if amps is not None and amps > 0.0 else None,
    )
