"""What vehicles store: the mission of an ally on the links, the own fences, and parameters, changed for a flight."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import struct
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.autopilots.autopilot import Autopilot, ParameterTable, Release, RequiredParameter
from sidelong.app.autopilots.registry import autopilot_by_mav_autopilot
from sidelong.app.errors import InputError
from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT
from sidelong.app.link.vehicle import Vehicle
from sidelong.estimators.frames import LocalPlane

_HEARTBEAT_S, _ANSWER_S, _TRIES = 5.0, 1.0, 6
_NAMES = frozenset({"HEARTBEAT", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK"})
_WAY_POINTS = {
    *(int(mavlink.MAV_CMD_NAV_WAYPOINT), int(mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT)),
    *(int(mavlink.MAV_CMD_NAV_LOITER_UNLIM), int(mavlink.MAV_CMD_NAV_LOITER_TIME)),
}
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
    with vehicle.collecting(*_NAMES, system_id=system_id) as received:
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
    with vehicle.collecting(*_NAMES, system_id=system_id) as received:

        async def asked(request: str, answers: tuple[str, ...], **fields: int) -> Message:
            def is_answer(message: Message) -> bool:
                answer = message.fields
                addressee = answer.get("target_system"), answer.get("target_component")
                same = all(answer.get(name) == value for name, value in fields.items())
                of_type = (answer.get("mission_type") or 0) == mission_type
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
    fences, rally = [await read_items(vehicle, vehicle.system_id, mission_type, answer_s) for mission_type in types]
    return fences_of(fences, rally)


def fences_of(fences: Sequence[Mapping[str, Any]], rally: Sequence[Mapping[str, Any]] = ()) -> VehicleFences:
    """Return the fences and rally points of MISSION_ITEM_INT messages. Raises LookupError for a polygon cut short."""
    outlines: dict[bool, list[Outline]] = {True: [], False: []}
    items = iter(fences)
    for item in items:
        command, size = item["command"], item["param1"]
        if (command in _CIRCLES or command in _VERTICES) and (size is None or not 0.0 <= size < math.inf):
            raise LookupError("the vehicle's fence has an item without a size")
        if command in _CIRCLES:
            outlines[_CIRCLES[command]].append(_circle(_corner(item), size, _CIRCLES[command]))
        elif command in _VERTICES:
            corners = [item, *itertools.islice(items, max(int(size) - 1, 0))]
            if len(corners) < size or any(corner["command"] != command for corner in corners):
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


_VALUE_S = 0.8  # timeout since the last answer, after which missing parameters are requested again
_IDLE_S, _IDLE_ROUNDS = 1.6, 2  # without the answer, though the autopilot answers: the parameter is absent
_SILENT_S = 6.0  # in which the autopilot answers nothing, before it is no longer asked
_REAL32 = 9  # MAV_PARAM_TYPE


async def read_table(vehicle: Vehicle, autopilot: Autopilot, release: Release | None) -> ParameterTable:
    """Return the parameters that matter for a mission.

    A parameter that does not answer under its name in ``release`` is requested under the names of other releases too.
    """
    names = [known.name for known in autopilot.parameters if known.is_in(release)]
    read = await read_parameters(vehicle, names)
    lacking = {known.known_as for known in autopilot.parameters if known.name in names and known.name not in read}
    others = [known.name for known in autopilot.parameters if known.known_as in lacking and known.name not in names]
    if others:
        read |= await read_parameters(vehicle, others)
    return ParameterTable(autopilot.parameters, release, read)


async def read_parameters(vehicle: Vehicle, names: Iterable[str]) -> dict[str, float]:
    """Return the values of the parameters that exist. All are requested at once; missing answers are requested again.

    An autopilot does not answer a request for an unknown name. So a parameter is absent if its answer is missing in
    rounds in which the answer to a known parameter, requested after it, arrives.
    """
    wanted = list(names)
    values: dict[str, float | None] = {}
    autopilot = autopilot_by_mav_autopilot(int(vehicle.latest["HEARTBEAT"].fields["autopilot"]))
    bytewise = autopilot is not None and autopilot.packs_integers_bytewise
    with vehicle.collecting("PARAM_VALUE") as answers:
        idle_s, idle_rounds, silent_s = 0.0, 0, 0.0
        while missing := [name for name in wanted if name not in values]:
            before, answered, answer_s, witness = len(values), False, _VALUE_S, list(values)[:1]
            for name in (*missing, *witness):
                await vehicle.transmit("PARAM_REQUEST_READ", {"param_id": name, "param_index": -1})
            with contextlib.suppress(TimeoutError):
                while len(values) < len(wanted):
                    answer_s = vehicle.answer_s(_VALUE_S)
                    answer = await asyncio.wait_for(answers.get(), answer_s)
                    name = answer.fields["param_id"]
                    answered = answered or name in witness
                    if name in wanted:
                        values[name] = _value(answer.fields, bytewise)
            if len(values) > before:
                idle_s, idle_rounds, silent_s = 0.0, 0, 0.0
            elif answered:
                idle_s, idle_rounds = idle_s + answer_s, idle_rounds + 1
            else:
                silent_s += answer_s
            if (idle_s >= _IDLE_S and idle_rounds >= _IDLE_ROUNDS) or silent_s >= _SILENT_S:
                break
    # Some of PX4's integers are NaN in the float field; they are read one by one through MAVSDK.
    whole = {name: await vehicle.link.parameter(name) if value is None else value for name, value in values.items()}
    return {name: whole[name] for name in wanted if whole.get(name) is not None}  # type: ignore[misc]  # none is None


def _value(fields: Mapping[str, Any], bytewise: bool) -> float | None:
    """Return a PARAM_VALUE's number: PX4 puts the bytes of an integer where the float should be."""
    value = fields["param_value"]
    if value is None or not bytewise or int(fields["param_type"]) == _REAL32:
        return value if value is None else float(value)
    return float(struct.unpack("<i", struct.pack("<f", value))[0])


@dataclass(eq=False)
class ParameterWatch:
    """Reports when another station sets a parameter that matters for the mission."""

    _table: ParameterTable
    _bytewise: bool
    _own: Mapping[str, float]  # what this mission has set itself, by name
    _note: Callable[[str], object]
    _changed: Callable[[Mapping[str, float]], object] = lambda _values: None  # with the values by key

    def __post_init__(self) -> None:
        self._values = {**self._table.read, **self._own}

    def take(self, message: Message) -> None:
        """Note a PARAM_VALUE of the autopilot; a known one that differs is announced, and the table made again."""
        if message.name != "PARAM_VALUE" or message.component_id != AUTOPILOT_COMPONENT:
            return
        name, value = message.fields["param_id"], _value(message.fields, self._bytewise)
        before = self._values.get(name)
        if value is None or before is None or math.isclose(value, before, rel_tol=1e-4, abs_tol=1e-6):
            return
        self._values[name] = value
        self._note(f"another ground station has set {name} to {value:g}; it was {before:g}")
        self._changed(self._table.of(self._values))


@contextlib.asynccontextmanager
async def temporary_parameters(
    vehicle: Vehicle,
    required_parameters: Iterable[RequiredParameter],
    note: Callable[[str], object],
    may_restore: Callable[[], bool],
) -> AsyncIterator[None]:
    """Set what is needed, and restore it afterwards, unless another station has taken over.

    Raises InputError when a parameter is not taken.
    """
    changed: list[RequiredParameter] = []
    try:
        for need in required_parameters:
            changed.append(need)  # before the answer: an interrupt may come between
            if not await vehicle.link.set_parameter(need.name, need.value):
                changed.pop()
                raise InputError(f"the autopilot did not take {need.name} = {need.value:g}; set it by hand.")
            note(f"{need.name} = {need.value:g} for this flight (was {need.present:g}): {need.why}")
        yield
    finally:
        for need in changed:
            if may_restore() and await vehicle.link.set_parameter(need.name, need.present):
                note(f"{need.name} = {need.present:g} again")
            else:
                note(f"{need.name} is still {need.value:g}; it was {need.present:g} before")
