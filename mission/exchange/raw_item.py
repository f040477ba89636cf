"""Mission items as MISSION_ITEM_INT carries them, and whether two are the same."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sidelong.mission.upload.items import Item

_TAKE_OFF = 22  # MAV_CMD_NAV_TAKEOFF
_COMPARED_METRES_AS_DEGREES_E7 = 3  # stored coordinates may lose the last digit on the way
_COMPARED_PARAM = 0.6  # ArduPlane keeps whole metres of radius


@dataclass(frozen=True, slots=True)
class RawItem:
    """One mission item exactly as MISSION_ITEM_INT carries it (param NaN: unused)."""

    command: int
    frame: int
    param1: float
    param2: float
    param3: float
    param4: float
    x: int
    y: int
    z: float
    autocontinue: int = 1


def raw_item(item: Item) -> RawItem:
    """Return an item in the units of MISSION_ITEM_INT, without changes for any autopilot.

    Args:
        item: The mission item.

    """
    return RawItem(
        command=item.command,
        frame=item.frame,
        param1=item.param1,
        param2=item.param2,
        param3=item.param3,
        param4=item.param4,
        x=round(item.latitude_deg * 1e7),
        y=round(item.longitude_deg * 1e7),
        z=item.height_m,
        autocontinue=int(item.autocontinue),
    )


def at_place(x: int, y: int, item: RawItem) -> bool:
    """Return whether an item's position is in units of 1e-7 degrees.

    Args:
        x: Field x of MISSION_ITEM_INT.
        y: Field y of MISSION_ITEM_INT.
        item: The item they belong to.

    """
    return max(abs(x - item.x), abs(y - item.y)) <= _COMPARED_METRES_AS_DEGREES_E7


def same_item(a: RawItem, b: RawItem) -> bool:
    """Return whether two items are equal up to the vehicle's rounding; PX4 does not store a take-off's pitch.

    Args:
        a: One item.
        b: The other item.

    """
    return (
        a.command == b.command
        and at_place(a.x, a.y, b)
        and abs(a.z - b.z) <= _COMPARED_PARAM
        and all(
            a.command == _TAKE_OFF or math.isnan(x) or math.isnan(y) or abs(x - y) <= _COMPARED_PARAM
            for x, y in ((a.param1, b.param1), (a.param3, b.param3))
        )
    )


def same_items(sent: Sequence[RawItem], onboard: Sequence[RawItem]) -> bool:
    """Return whether the vehicle stores what was sent, up to its own rounding.

    Args:
        sent: The items that were sent.
        onboard: The items read from the vehicle.

    """
    return len(sent) == len(onboard) and all(map(same_item, sent, onboard))
