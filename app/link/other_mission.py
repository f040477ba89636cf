"""Reads what vehicles store: the mission that an ally on the links is about to follow, and the own fences."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT
from sidelong.app.link.vehicle import Vehicle
from sidelong.estimators.frames import LocalPlane

_HEARTBEAT_S, _ANSWER_S, _TRIES = 5.0, 1.0, 6
_NAMES = frozenset({"HEARTBEAT", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK"})
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
_VERTICES = {  # and whether the aircraft stays inside
    int(mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION): True,
    int(mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION): False,
}
_CIRCLES = {
    int(mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION): True,
    int(mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION): False,
}
_CIRCLE_CORNERS = 64  # within 0.13 % of the radius

Outline = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class OtherMission:
    """Way points (latitude, longitude) in degrees; lap: its last item jumps back to the first way point, forever."""

    points_deg: list[tuple[float, float]]
    lap: bool


async def read_mission(vehicle: Vehicle, system_id: int, answer_s: float = _ANSWER_S) -> OtherMission:
    """Read the mission of another vehicle (by its system id) that is received on the links of this one.

    Raises LookupError if it is not received, does not answer, or has fewer than two way points, LinkError if a
    message cannot be sent.
    """
    with _received(vehicle, system_id) as received:
        wait_s = max(_HEARTBEAT_S, answer_s)
        heartbeat = await _next(received, lambda message: message.name == "HEARTBEAT", wait_s)
    if heartbeat is None:
        raise LookupError(f"system {system_id} is not received")
    items = await read_items(vehicle, system_id, mavlink.MAV_MISSION_TYPE_MISSION, answer_s)
    has_home = heartbeat.fields["autopilot"] == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    try:
        return mission_of(items[has_home:])
    except LookupError as error:
        raise LookupError(f"the mission of system {system_id} {error}") from error


async def read_items(
    vehicle: Vehicle, system_id: int, mission_type: int, answer_s: float = _ANSWER_S
) -> list[Mapping[str, Any]]:
    """Return the fields of a vehicle's items of a MAV_MISSION_TYPE; none where it does not know the type.

    Raises LookupError if it does not answer, LinkError if a message cannot be sent.
    """
    address = {"target_system": system_id, "target_component": AUTOPILOT_COMPONENT, "mission_type": mission_type}
    with _received(vehicle, system_id) as received:

        async def asked(request: str, answers: tuple[str, ...], **fields: int) -> Message:
            def is_answer(message: Message) -> bool:
                got = message.fields
                addressee = got.get("target_system"), got.get("target_component")
                same = all(got.get(name) == value for name, value in fields.items())
                of_type = (got.get("mission_type") or 0) == mission_type
                return message.name in answers and addressee == vehicle.link.own_id and same and of_type

            for _ in range(_TRIES):
                await vehicle.link.send(request, address | fields)
                message = await _next(received, is_answer, answer_s)
                if message is not None:
                    return message
            raise LookupError(f"system {system_id} does not answer {request}")

        counted = await asked("MISSION_REQUEST_LIST", ("MISSION_COUNT", "MISSION_ACK"))
        if counted.name == "MISSION_ACK":
            if counted.fields["type"] == mavlink.MAV_MISSION_UNSUPPORTED:
                return []
            raise LookupError(f"system {system_id} refuses MISSION_REQUEST_LIST ({counted.fields['type']})")
        count = min(int(counted.fields["count"]), _ITEMS_MAX)
        items = [(await asked("MISSION_REQUEST_INT", ("MISSION_ITEM_INT",), seq=seq)).fields for seq in range(count)]
        await vehicle.link.send("MISSION_ACK", address | {"type": int(mavlink.MAV_MISSION_ACCEPTED)})
    return items


@contextlib.contextmanager
def _received(vehicle: Vehicle, system_id: int) -> Iterator[asyncio.Queue[Message]]:
    """Collect the messages of a vehicle's autopilot that concern its missions."""
    received: asyncio.Queue[Message] = asyncio.Queue()

    def on_message(message: Message) -> None:
        if (message.system_id, message.component_id) == (system_id, AUTOPILOT_COMPONENT) and message.name in _NAMES:
            received.put_nowait(message)

    vehicle.bystanders.append(on_message)
    try:
        yield received
    finally:
        with contextlib.suppress(ValueError):  # a flight that ends takes its listeners with it
            vehicle.bystanders.remove(on_message)


@dataclass(frozen=True, slots=True)
class VehicleFences:
    """What a vehicle stores of MAV_MISSION_TYPE_FENCE and RALLY; corners (latitude, longitude) in degrees.

    A circle is a polygon: that of an inclusion is inside it, that of an exclusion around it.
    """

    inclusion: tuple[Outline, ...] = ()
    exclusion: tuple[Outline, ...] = ()
    rally: Outline = ()

    def __str__(self) -> str:
        kinds = ("inclusion fence", self.inclusion), ("exclusion fence", self.exclusion), ("rally point", self.rally)
        counts = (f"{len(found)} {kind}{'s' * (len(found) > 1)}" for kind, found in kinds if found)
        return " and ".join(counts) or "no fence and no rally point"


async def read_fences(vehicle: Vehicle, answer_s: float = _ANSWER_S) -> VehicleFences:
    """Read fences and rally points of a vehicle. Raises LookupError and LinkError as ``read_items``."""
    types = mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY
    fences, rally = [await read_items(vehicle, vehicle.system_id, one, answer_s) for one in types]
    return fences_of(fences, rally)


def fences_of(fences: Sequence[Mapping[str, Any]], rally: Sequence[Mapping[str, Any]] = ()) -> VehicleFences:
    """Return the fences and rally points of MISSION_ITEM_INT messages. Raises LookupError for a polygon cut short."""
    outlines: dict[bool, list[Outline]] = {True: [], False: []}
    items = iter(fences)
    for item in items:
        command, size = item["command"], item["param1"]
        if command in _CIRCLES:
            outlines[_CIRCLES[command]].append(_circle(_corner(item), size, _CIRCLES[command]))
        elif command in _VERTICES:
            corners = [item, *itertools.islice(items, max(int(size) - 1, 0))]
            if len(corners) < size or any(one["command"] != command for one in corners):
                raise LookupError(f"the vehicle's fence has a polygon with fewer than its {size:g} corners")
            outlines[_VERTICES[command]].append(tuple(map(_corner, corners)))
    return VehicleFences(tuple(outlines[True]), tuple(outlines[False]), tuple(map(_corner, rally)))


def _corner(item: Mapping[str, Any]) -> tuple[float, float]:
    return item["x"] * 1e-7, item["y"] * 1e-7


def _circle(centre_deg: tuple[float, float], radius_m: float, inside: bool) -> Outline:
    plane, half_rad = LocalPlane(*centre_deg), math.pi / _CIRCLE_CORNERS
    corner_m = radius_m if inside else radius_m / math.cos(half_rad)
    angles_rad = (2.0 * half_rad * number for number in range(_CIRCLE_CORNERS))
    return tuple(
        plane.latitude_longitude_deg(corner_m * math.sin(angle_rad), corner_m * math.cos(angle_rad))
        for angle_rad in angles_rad
    )


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
