"""What is on board of the mission, as far as it is known, and the upload that changes it: one at a time.

Source: MAVLink mission protocol, <https://mavlink.io/en/services/mission.html>; docs/retries.md#2-one-upload.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from sidelong.mission.exchange.dialect import AutopilotDialect, Home
from sidelong.mission.exchange.mission_ownership import MissionOwnership
from sidelong.mission.exchange.mission_write import MissionWrite, WriteResult
from sidelong.mission.exchange.outbox import Outbox
from sidelong.mission.exchange.reports import VehicleReport
from sidelong.mission.upload.mission_item import MissionItem

_DURATION_WEIGHT = 0.5
_LOSES_UPLOADS = 5  # number of uploads for which a link that lost items is treated as lossy


class MissionUpload:
    """Writes only the items that differ, where the autopilot stores them one by one.

    took_s: what an upload takes, of the vehicle's clock; round_trip_s is of the link's.
    """

    def __init__(self, outbox: Outbox, dialect: AutopilotDialect, home: Home, ownership: MissionOwnership) -> None:
        self._outbox, self._quirks, self._ownership = outbox, dialect.quirks, ownership
        self._tail = dialect.tail(home)
        self._onboard: tuple[MissionItem | None, ...] = ()  # None where a failed upload leaves doubt
        self._write: MissionWrite | None = None
        self._result: WriteResult | None = None
        self._began_s = 0.0
        self._since_lost = _LOSES_UPLOADS  # number of uploads without a lost item
        self.took_s = 0.0
        self.round_trip_s = 0.0

    @property
    def under_way(self) -> bool:
        """Whether something is being written."""
        return self._write is not None

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` is to be called, on the link's clock; -inf: at once, inf: never."""
        return self._write.next_timer_s if self._write is not None else math.inf

    def adopted(self, items: tuple[MissionItem, ...]) -> None:
        """Register the items that were read from the vehicle."""
        self._onboard = items

    def begin(self, items: Sequence[MissionItem], bound_s: float, marked: Callable[[], int]) -> None:
        """Begin the upload of a mission.

        Args:
            items: The items to upload. Items that are never reached are added at the end (PX4 wants a landing).
            bound_s: Time limit, s.
            marked: Returns the number of the item to fly once the mission is accepted.
        """
        items, self._result = (*items, *self._tail), None
        changed = range(len(items))
        if len(self._onboard) == len(items):
            differing = [seq for seq in changed if items[seq] != self._onboard[seq]]
            if not differing:
                self._result = WriteResult.ACCEPTED
                return
            if self._quirks.stores_items_one_by_one:
                changed = range(differing[0], differing[-1] + 1)
        self._began_s = self._outbox.time_s
        self._ownership.writing(len(items))
        self._write = MissionWrite(
            self._outbox,
            self._quirks,
            items,
            changed,
            self._outbox.link_s + bound_s,
            marked,
            self._ownership.mission_ids,
            self._ownership.doubtful,
            self.round_trip_s,
            self._since_lost < _LOSES_UPLOADS,
        )

    def receive(self, report: VehicleReport) -> None:
        """Process a report of the autopilot."""
        if self._write is not None:
            self._write.receive(report)

    def expire(self) -> None:
        """Do what is due."""
        if self._write is not None:
            self._write.expire()

    def break_off(self) -> None:
        """Write not one item more."""
        if self._write is not None:
            self._write.cancel()

    def forget(self) -> None:
        """Ignore further messages about the running upload; what is on board is then unknown."""
        if self._write is not None:
            self._ownership.written(self._write.items, 0, False)
        self._write = self._result = None
        self._onboard = ()

    def ended(self) -> WriteResult | None:
        """Return, once, what became of the upload; None while it goes on."""
        write, result = self._write, self._result
        if write is not None and write.result is not None:
            self._write, result = None, write.result
            self._learn(write, result)
        self._result = None
        return result

    def _learn(self, write: MissionWrite, result: WriteResult) -> None:
        self._since_lost = 0 if write.has_lost else self._since_lost + 1
        if write.round_trip_s is not None:
            self.round_trip_s = write.round_trip_s
            self._ownership.measured(write.round_trip_s)
        if result is WriteResult.ACCEPTED:
            self.took_s += _DURATION_WEIGHT * (self._outbox.time_s - self._began_s - self.took_s)
            self._onboard = write.items
        elif len(write.items) == len(self._onboard):
            doubtful = zip(write.items, self._onboard, strict=True)
            self._onboard = tuple(b if a == b else None for a, b in doubtful)
        else:
            self._onboard = ()
        self._ownership.written(write.items, write.mission_id, result is WriteResult.ACCEPTED)
