"""What keeps the items of a mission type: as it is, of geofence and rally points, which do not affect the flight."""

from __future__ import annotations

from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.protocol.items import Item, checksum


class Store:
    """Items that are replaced as a whole when all have come. All results are MAV_MISSION_RESULT."""

    def __init__(self, with_checksum: bool) -> None:
        self._with_checksum = with_checksum
        self._items: list[Item] = []
        self._arriving: list[Item] = []

    def items(self) -> list[Item]:
        return self._items

    def current_index(self) -> int:
        return -1

    def opaque_id(self) -> int | None:
        """Return a checksum of the items, None where the autopilot has none."""
        return checksum(self._items) if self._with_checksum else None

    def begin(self, count: int) -> int:
        """Prepare for an upload of ``count`` items."""
        self._arriving = []
        return self.clear() if count == 0 else int(mavlink.MAV_MISSION_ACCEPTED)

    def put(self, index: int, item: Item, current: bool) -> None:
        """Take an item. Raises ItemRefused."""
        self._arriving.append(item)

    def finish(self) -> int:
        """Take over the upload: all items have come."""
        self._items, self._arriving = self._arriving, []
        return int(mavlink.MAV_MISSION_ACCEPTED)

    def abandon(self) -> int | None:
        """Forget the upload: it was cut. Return the checksum of what had come."""
        arrived_id = checksum(self._arriving) if self._with_checksum else None
        self._arriving = []
        return arrived_id

    def clear(self) -> int:
        self._items = []
        return int(mavlink.MAV_MISSION_ACCEPTED)
