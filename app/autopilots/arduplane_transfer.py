"""The mission protocol with ArduPlane, spoken by ourselves: write a part of the list, quickly over a bad link.

MAVSDK writes whole lists only, and lets the vehicle ask again for each item that is lost, which ArduPlane does after
a second. ArduPlane takes the items strictly in their order and leaves any other alone, so it may be told them all at
once, and told again: a lost packet costs a fraction of a second, and nothing can be stored out of its place.
"""

from __future__ import annotations

import asyncio
import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from app.autopilots.autopilot import same_item
from app.link.link import RawItem, UploadResult
from app.link.message import Message
from app.link.vehicle import Vehicle

# So long nothing is heard before everything unanswered is said again; once the round trip is known, so many of them.
_AGAIN_S, _AGAIN_MIN_S, _AGAIN_ROUND_TRIPS = 0.25, 0.1, 2.0
_REQUESTS = ("MISSION_REQUEST", "MISSION_REQUEST_INT")
_HOME = 0  # the vehicle puts its own home there, whatever it is told
_COME_TWICE = (mavlink.MAV_MISSION_INVALID_SEQUENCE, mavlink.MAV_MISSION_DENIED)  # an item, or the beginning


async def write_items(vehicle: Vehicle, items: Sequence[RawItem], changed: range, timeout_s: float) -> UploadResult:
    """Make the vehicle hold ``items``, of which those outside ``changed`` are there already.

    ``changed`` as long as ``items`` replaces the whole list, however long that was. ACCEPTED: read back, and the
    same. After TIMEOUT and DENIED what the vehicle holds at ``changed`` is not known.
    """
    try:
        async with asyncio.timeout(timeout_s):
            while await _sent(vehicle, items, changed):
                held = await read_items(vehicle, [seq for seq in changed if seq != _HOME])
                if all(same_item(items[seq], item) for seq, item in held.items()):
                    return UploadResult.ACCEPTED
            return UploadResult.DENIED
    except TimeoutError:
        return UploadResult.TIMEOUT


async def _sent(vehicle: Vehicle, items: Sequence[RawItem], changed: range) -> bool:
    """Send the items until the vehicle wants no more; False when it refuses them."""
    clock = asyncio.get_running_loop().time
    again_s = _AGAIN_S
    awaited: int | None = None  # the item it wants next, once it wants any
    with vehicle.hearing(*_REQUESTS, "MISSION_ACK") as heard:
        while True:
            await _say(vehicle, items, changed, awaited)
            said_s = clock()
            until_s = said_s + again_s
            while (message := await _next(heard, until_s)) is not None:
                if message.name == "MISSION_ACK":
                    result = message.fields["type"]
                    if result == mavlink.MAV_MISSION_DENIED and awaited is None:
                        awaited = changed.start  # it receives already: its first request was lost
                        break
                    if result not in _COME_TWICE:
                        # ERROR: it receives nothing, either because all is there or because it never began.
                        taken = (mavlink.MAV_MISSION_ACCEPTED, mavlink.MAV_MISSION_ERROR)
                        return result in taken and awaited is not None
                elif message.fields["seq"] in changed:
                    began, awaited = awaited is None, int(message.fields["seq"])
                    if began:
                        again_s = max(_AGAIN_MIN_S, _AGAIN_ROUND_TRIPS * (clock() - said_s))
                        break
                    until_s = clock() + again_s


async def _say(vehicle: Vehicle, items: Sequence[RawItem], changed: range, awaited: int | None) -> None:
    if awaited is not None:
        for seq in range(awaited, changed.stop):
            await _send(vehicle, "MISSION_ITEM_INT", seq=seq, current=0, **dataclasses.asdict(items[seq]))
    elif len(changed) == len(items):
        await _send(vehicle, "MISSION_COUNT", count=len(items))
    else:
        ends = {"start_index": changed.start, "end_index": changed.stop - 1}
        await _send(vehicle, "MISSION_WRITE_PARTIAL_LIST", **ends)


async def read_mission(vehicle: Vehicle, timeout_s: float) -> tuple[RawItem, ...] | None:
    """Return all the items that the vehicle holds, or None when they did not come in time."""
    try:
        async with asyncio.timeout(timeout_s):
            held = await read_items(vehicle, range(await _count(vehicle)))
    except TimeoutError:
        return None
    return tuple(held[seq] for seq in range(len(held)))


async def _count(vehicle: Vehicle) -> int:
    with vehicle.hearing("MISSION_COUNT") as heard:
        while True:
            await _send(vehicle, "MISSION_REQUEST_LIST")
            message = await _next(heard, asyncio.get_running_loop().time() + _AGAIN_S)
            if message is not None and message.fields["mission_type"] == mavlink.MAV_MISSION_TYPE_MISSION:
                return int(message.fields["count"])


async def read_items(vehicle: Vehicle, wanted: Collection[int]) -> dict[int, RawItem]:
    """Return the items at ``wanted`` as the vehicle holds them; asks until it has them all, so bound it."""
    clock = asyncio.get_running_loop().time
    held: dict[int, RawItem] = {}
    with vehicle.hearing("MISSION_ITEM_INT") as heard:
        while len(held) < len(wanted):
            for seq in wanted:
                if seq not in held:
                    await _send(vehicle, "MISSION_REQUEST_INT", seq=seq)
            until_s = clock() + _AGAIN_S
            while len(held) < len(wanted) and (message := await _next(heard, until_s)):
                if (seq := int(message.fields["seq"])) in wanted:
                    held[seq] = _item(message.fields)
                    until_s = clock() + _AGAIN_S
    return held


def _item(fields: Mapping[str, Any]) -> RawItem:
    values: dict[str, Any] = {field.name: fields[field.name] for field in dataclasses.fields(RawItem)}
    values.update({name: math.nan for name, value in values.items() if value is None})
    return RawItem(**values)


async def _next(heard: asyncio.Queue[Message], until_s: float) -> Message | None:
    try:
        async with asyncio.timeout_at(until_s):
            return await heard.get()
    except TimeoutError:
        return None


async def _send(vehicle: Vehicle, name: str, **fields: float) -> None:
    await vehicle.tell(name, {**fields, "mission_type": mavlink.MAV_MISSION_TYPE_MISSION})
