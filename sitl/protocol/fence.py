"""Geofence and rally points: stored and returned, replaced as a whole; they have no effect on the flight."""

from __future__ import annotations

from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.protocol.items import Item, checksum


class PointStore:
    """The items of a mission type that is not flown."""

    def __init__(self, with_checksum: bool) -> None:
        self._with_checksum = with_checksum
        self._items: list[Item] = []
        self._arriving: list[Item] = []

    def items(self) -> list[Item]:
        return self._items

    def current_index(self) -> int:
        return -1

    def opaque_id(self) -> int | None:
        return checksum(self._items) if self._with_checksum else None

    def begin(self, count: int) -> int:
        self._arriving = []
        if count == 0:
            self._items = []
        return int(mavlink.MAV_MISSION_ACCEPTED)

    def put(self, index: int, item: Item, current: bool) -> None:
        del index, current
        self._arriving.append(item)

    def finish(self) -> int:
        self._items, self._arriving = self._arriving, []
        return int(mavlink.MAV_MISSION_ACCEPTED)

    def abandon(self) -> int | None:
        arrived_id = checksum(self._arriving) if self._with_checksum else None
        self._arriving = []
        return arrived_id

    def clear(self) -> int:
        self._items = []
        return int(mavlink.MAV_MISSION_ACCEPTED)
