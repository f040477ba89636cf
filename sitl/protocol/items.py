"""Mission items as a vehicle keeps them, and their MAVLink forms."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

ABSOLUTE_FRAMES = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
RELATIVE_FRAMES = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)


class ItemRefused(Exception):
    """An item that the vehicle rejects; ``result`` is the MAV_MISSION_RESULT of the rejection."""

    def __init__(self, result: int) -> None:
        super().__init__(f"MAV_MISSION_RESULT {result}")
        self.result = result


@dataclass(frozen=True, slots=True)
class Item:
    """latitude_e7 and longitude_e7 are 1e-7 degrees, altitude_m is in ``frame``; params are 1 to 4."""

    command: int
    frame: int
    params: tuple[float, float, float, float]
    latitude_e7: int
    longitude_e7: int
    altitude_m: float
    autocontinue: int = 1

    @staticmethod
    def from_message(message: Any) -> Item:
        """Read a MISSION_ITEM_INT or a MISSION_ITEM. Raises ItemRefused for a place that is none."""
        x, y = message.x, message.y
        if message.get_type() == "MISSION_ITEM":
            if not (abs(x) <= 90.0 and abs(y) <= 180.0):
                raise ItemRefused(mavlink.MAV_MISSION_INVALID)
            x, y = round(x * 1e7), round(y * 1e7)
        return Item(
            message.command,
            message.frame,
            (message.param1, message.param2, message.param3, message.param4),
            x,
            y,
            message.z,
            message.autocontinue,
        )

    def message(self, sequence: int, mission_type: int, current: bool, to: tuple[int, int], as_int: bool) -> Any:
        x, y = (self.latitude_e7, self.longitude_e7) if as_int else (self.latitude_e7 / 1e7, self.longitude_e7 / 1e7)
        kind = mavlink.MAVLink_mission_item_int_message if as_int else mavlink.MAVLink_mission_item_message
        return kind(
            *to,
            sequence,
            self.frame,
            self.command,
            int(current),
            self.autocontinue,
            *self.params,
            x,
            y,
            self.altitude_m,
            mission_type,
        )

    @property
    def has_position(self) -> bool:
        return self.frame in ABSOLUTE_FRAMES or self.frame in RELATIVE_FRAMES

    @property
    def latitude_deg(self) -> float:
        return self.latitude_e7 / 1e7

    @property
    def longitude_deg(self) -> float:
        return self.longitude_e7 / 1e7

    def with_params(self, *params: float) -> Item:
        padded = (*params, 0.0, 0.0, 0.0, 0.0)[:4]
        return replace(self, params=(padded[0], padded[1], padded[2], padded[3]))


def checksum(items: list[Item]) -> int:
    """Return a number that changes with the contents of a list; 0 for an empty one."""
    if not items:
        return 0
    rows = [(i.command, i.frame, _nan_as_text(i.params), i.latitude_e7, i.longitude_e7, i.altitude_m) for i in items]
    return zlib.crc32(repr(rows).encode())


def _nan_as_text(values: tuple[float, ...]) -> tuple[float | str, ...]:
    return tuple("nan" if math.isnan(value) else value for value in values)
