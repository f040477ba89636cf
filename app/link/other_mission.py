"""Reads the mission of another vehicle on the links: the way points that an ally is about to follow."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT
from sidelong.app.link.vehicle import Vehicle

_HEARTBEAT_S, _ANSWER_S, _TRIES = 5.0, 1.0, 6
_NAMES = frozenset({"HEARTBEAT", "MISSION_COUNT", "MISSION_ITEM_INT"})
_WAY_POINTS = frozenset(
    {
        int(mavlink.MAV_CMD_NAV_WAYPOINT),
        int(mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT),
        int(mavlink.MAV_CMD_NAV_LOITER_UNLIM),
        int(mavlink.MAV_CMD_NAV_LOITER_TIME),
    }
)
_FOREVER = -1
_ITEMS_MAX = 5000


@dataclass(frozen=True, slots=True)
class OtherMission:
    """Way points (latitude, longitude) in degrees; lap: its last item jumps back to the first way point, forever."""

    points_deg: list[tuple[float, float]]
    lap: bool


async def read_mission(vehicle: Vehicle, system_id: int, answer_s: float = _ANSWER_S) -> OtherMission:
    """Read the mission of another vehicle that is received on the links of this one.

    Args:
        vehicle: The vehicle whose links are used; its ``run`` must be running.
        system_id: MAVLink system id of the other one.
        answer_s: How long to wait for each answer, s.

    Raises:
        LookupError: It is not received, does not answer, or has fewer than two way points; says so in words.
        LinkError: A message cannot be sent.
    """
    received: asyncio.Queue[Message] = asyncio.Queue()

    def on_message(message: Message) -> None:
        if (message.system_id, message.component_id) == (system_id, AUTOPILOT_COMPONENT) and message.name in _NAMES:
            received.put_nowait(message)

    vehicle.bystanders.append(on_message)
    try:
        return await _read(vehicle, system_id, received, answer_s)
    finally:
        vehicle.bystanders.remove(on_message)


async def _read(vehicle: Vehicle, system_id: int, received: asyncio.Queue[Message], answer_s: float) -> OtherMission:
    address = {
        "target_system": system_id,
        "target_component": AUTOPILOT_COMPONENT,
        "mission_type": int(mavlink.MAV_MISSION_TYPE_MISSION),
    }

    async def asked(request: str, answer: str, **fields: int) -> Message:
        def answers(message: Message) -> bool:
            got = message.fields
            addressee = got.get("target_system"), got.get("target_component")
            same = all(got.get(name) == value for name, value in fields.items())
            return message.name == answer and addressee == vehicle.link.own_id and same

        for _ in range(_TRIES):
            await vehicle.link.send(request, address | fields)
            message = await _next(received, answers, answer_s)
            if message is not None:
                return message
        raise LookupError(f"system {system_id} does not answer {request}")

    heartbeat = await _next(received, lambda message: message.name == "HEARTBEAT", max(_HEARTBEAT_S, answer_s))
    if heartbeat is None:
        raise LookupError(f"system {system_id} is not received")
    count = min(int((await asked("MISSION_REQUEST_LIST", "MISSION_COUNT")).fields["count"]), _ITEMS_MAX)
    items = [(await asked("MISSION_REQUEST_INT", "MISSION_ITEM_INT", seq=seq)).fields for seq in range(count)]
    await vehicle.link.send("MISSION_ACK", address | {"type": int(mavlink.MAV_MISSION_ACCEPTED)})
    has_home = heartbeat.fields["autopilot"] == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    try:
        return mission_of(items[has_home:])
    except LookupError as error:
        raise LookupError(f"the mission of system {system_id} {error}") from error


def mission_of(items: Sequence[Mapping[str, Any]]) -> OtherMission:
    """Return the mission of MISSION_ITEM_INT messages, without a home item. Raises LookupError."""
    ways = [item for item in items if item["command"] in _WAY_POINTS and (item["x"] or item["y"])]
    if len(ways) < 2:
        raise LookupError(f"contains {len(ways)} way points; a route needs two")
    last = items[-1]
    jumps = last["command"] == mavlink.MAV_CMD_DO_JUMP and last["param2"] == _FOREVER
    lap = bool(jumps and last["param1"] is not None and last["param1"] <= ways[0]["seq"])
    return OtherMission([(way["x"] * 1e-7, way["y"] * 1e-7) for way in ways], lap)


async def _next(
    received: asyncio.Queue[Message], wanted: Callable[[Message], bool], timeout_s: float
) -> Message | None:
    try:
        async with asyncio.timeout(timeout_s):
            while True:
                message = await received.get()
                if wanted(message):
                    return message
    except TimeoutError:
        return None
