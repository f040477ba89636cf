"""Mission items and their comparison. Source: <https://mavlink.io/en/messages/common.html#MISSION_ITEM_INT>."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

_TAKE_OFF = 22  # MAV_CMD_NAV_TAKEOFF
_COMPARED_METRES_AS_DEGREES_E7 = 3  # stored coordinates may lose the last digit on the way
_COMPARED_PARAM = 0.6  # ArduPlane keeps whole metres of radius


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One mission item exactly as MISSION_ITEM_INT carries it: MAV_CMD, MAV_FRAME, parameters, NaN if unused.

    x, y: latitude and longitude, 1e-7 degrees. z: altitude in ``frame``, m. autocontinue: the next item follows.
    """

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

    @property
    def latitude_longitude_deg(self) -> tuple[float, float]:
        """Position, degrees."""
        return self.x / 1e7, self.y / 1e7


def e7(latitude_longitude_deg: tuple[float, float]) -> tuple[int, int]:
    """Return a position as fields x and y of MISSION_ITEM_INT."""
    latitude_deg, longitude_deg = latitude_longitude_deg
    return round(latitude_deg * 1e7), round(longitude_deg * 1e7)


def at_place(x: int, y: int, item: MissionItem) -> bool:
    """Return whether an item is at a position (latitude, longitude) in 1e-7 degrees, up to the vehicle's rounding."""
    return max(abs(x - item.x), abs(y - item.y)) <= _COMPARED_METRES_AS_DEGREES_E7


def same_item(a: MissionItem, b: MissionItem) -> bool:
    """Return whether two items are equal up to the vehicle's rounding; PX4 does not store a take-off's pitch."""
    return (
        a.command == b.command
        and at_place(a.x, a.y, b)
        and abs(a.z - b.z) <= _COMPARED_PARAM
        and all(
            a.command == _TAKE_OFF or math.isnan(x) or math.isnan(y) or abs(x - y) <= _COMPARED_PARAM
            for x, y in ((a.param1, b.param1), (a.param3, b.param3))
        )
    )


def difference(sent: Sequence[MissionItem], onboard: Sequence[MissionItem]) -> str:
    """Return in words how the first item that the vehicle stores differently differs; '' if all are equal."""
    for a, b in zip(sent, onboard, strict=False):
        if not same_item(a, b):
            if abs(a.z - b.z) > _COMPARED_PARAM:
                return f"an item reads back a height of {b.z:.0f} m, {a.z:.0f} m was sent"
            what = "command" if a.command != b.command else "radius" if at_place(a.x, a.y, b) else "position"
            return f"an item reads back another {what} than was sent"
    return ""


def same_items(sent: Sequence[MissionItem], onboard: Sequence[MissionItem]) -> bool:
    """Return whether the vehicle stores what was sent, up to its own rounding."""
    return len(sent) == len(onboard) and all(map(same_item, sent, onboard))
