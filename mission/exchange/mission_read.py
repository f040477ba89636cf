"""Reading the mission that is on board, quickly over a bad link.

Where items can be asked for one by one they are asked for all at once, and what is missing again. Otherwise the
list is read in its order, and the end of it has to be acknowledged.
"""

from __future__ import annotations

import math

from mission.exchange.dialect import ProtocolQuirks
from mission.exchange.outbox import DENIED, ERROR, Outbox
from mission.exchange.raw_item import RawItem
from mission.exchange.reports import MissionAcknowledged, MissionCountReported, MissionItemReported, VehicleReport

_AGAIN_S, _AGAIN_ROUND_TRIPS = 0.25, 2.0
_SLOWER, _SLOWEST = 1.25, 2.0


class MissionRead:
    """``done`` when all is read or the deadline (of the link's clock) has passed; then ``items``, None: not read."""

    def __init__(self, outbox: Outbox, quirks: ProtocolQuirks, deadline_s: float) -> None:
        self._outbox, self._all_at_once = outbox, quirks.stores_items_one_by_one
        self._deadline_s, self._again_s = deadline_s, _AGAIN_S
        self._count: int | None = None
        self._read: dict[int, RawItem] = {}
        self._due_s = math.inf
        self._asked_s, self._repeats = outbox.link_s, 0
        self.done = False
        self.items: tuple[RawItem, ...] | None = None
        self.mission_id = 0
        self._ask()

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` is to be called, on the link's clock; -inf: at once, inf: never."""
        return math.inf if self.done else min(self._due_s, self._deadline_s)

    def receive(self, report: VehicleReport) -> None:
        """Take a report."""
        if self.done:
            return
        match report:
            case MissionCountReported() if self._count is None:
                self._again_s = max(_AGAIN_S, _AGAIN_ROUND_TRIPS * (report.link_s - self._asked_s))
                self._repeats = 0
                self._count, self.mission_id = report.count, report.mission_id
                self._go_on()
            case MissionItemReported() if self._count is not None and 0 <= report.seq < self._count:
                if report.seq not in self._read:
                    self._read[report.seq] = report.item
                    self._due_s, self._repeats = report.link_s + self._again_s, 0
                    if len(self._read) == self._count or not self._all_at_once:
                        self._go_on()
            case MissionAcknowledged() if self._count is not None and report.result in (ERROR, DENIED):
                # It was disturbed, by a lost request or another station: from the beginning.
                if not self._all_at_once:
                    self._count = None
                    self._read.clear()

    def expire(self) -> None:
        """Ask again, or give up."""
        if self.done:
            return
        if self._outbox.link_s >= self._deadline_s:
            self.done = True
        elif self._outbox.link_s >= self._due_s:
            self._repeats += 1
            self._ask()

    def _go_on(self) -> None:
        assert self._count is not None
        if len(self._read) < self._count:
            self._ask()
            return
        self.done, self.items = True, tuple(self._read[seq] for seq in range(self._count))
        self._outbox.end_reading()

    def _ask(self) -> None:
        # Where everything comes late, because a link or a processor is busy, repeating it would keep it busy.
        self._due_s = self._outbox.link_s + self._again_s * min(_SLOWER**self._repeats, _SLOWEST)
        if self._count is None:
            self._asked_s = self._outbox.link_s  # of the last time: a round trip is not as long as what was lost
            self._outbox.send_mission("MISSION_REQUEST_LIST")
            return
        missing = [seq for seq in range(self._count) if seq not in self._read]
        for seq in missing if self._all_at_once else missing[:1]:
            self._outbox.send_mission("MISSION_REQUEST_INT", seq=seq)
