"""Reading the mission that is on board, quickly over a bad link.

Where items can be asked for in any order, they are asked for all at once, and what is missing again. Otherwise an
item out of its turn ends the reading. There they are asked for all at once, in their order and each twice: the
vehicle takes a request again, but none after one that was lost. Where that fails again and again, requests overtake
each other, and are sent one after the other. The end of such a reading has to be sent.

Source: MAVLink mission protocol, <https://mavlink.io/en/services/mission.html>; docs/retries.md#1-messages.
"""

from __future__ import annotations

import math

from sidelong.mission.exchange.dialect import ProtocolQuirks
from sidelong.mission.exchange.outbox import DENIED, ERROR, Outbox
from sidelong.mission.exchange.reports import (
    MissionAcknowledged,
    MissionCountReported,
    MissionItemReported,
    VehicleReport,
)
from sidelong.mission.upload.mission_item import MissionItem

_AGAIN_S, _AGAIN_ROUND_TRIPS = 0.25, 2.0
_SLOWER, _SLOWEST = 1.25, 2.0
_DISTURBED_MAX = 5  # how often requests are sent ahead of the answers
_UNANSWERED_MAX = 4  # requests; then the vehicle may have ended the download, and ignores requests


class MissionRead:
    """Reads until all is read or the deadline, of the link's clock, has passed."""

    def __init__(self, outbox: Outbox, quirks: ProtocolQuirks, deadline_s: float, round_trip_s: float = 0.0) -> None:
        self._outbox, self._in_order = outbox, not quirks.stores_items_one_by_one
        self._deadline_s, self._again_s = deadline_s, max(_AGAIN_S, _AGAIN_ROUND_TRIPS * round_trip_s)
        self._disturbed = 0
        self._count: int | None = None
        self._read_of = 0  # number of items of the mission with mission_id
        self._read: dict[int, MissionItem] = {}
        self._due_s = math.inf
        self._asked_s, self._repeats = outbox.link_s, 0
        self.done = False
        self.items: tuple[MissionItem, ...] | None = None  # None: not read
        self.mission_id = 0
        self._ask()

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` is to be called, on the link's clock; -inf: at once, inf: never."""
        return math.inf if self.done else min(self._due_s, self._deadline_s)

    def receive(self, report: VehicleReport) -> None:
        """Process a report of the autopilot."""
        if self.done:
            return
        match report:
            case MissionCountReported() if self._count is None:
                self._again_s = max(self._again_s, _AGAIN_ROUND_TRIPS * (report.link_s - self._asked_s))
                self._repeats = 0
                if (report.count, report.mission_id) != (self._read_of, self.mission_id) or not report.mission_id:
                    self._read.clear()
                self._count = self._read_of = report.count
                self.mission_id = report.mission_id
                self._go_on()
            case MissionItemReported() if self._count is not None and 0 <= report.seq < self._count:
                if report.seq not in self._read:
                    self._read[report.seq] = report.item
                    self._due_s, self._repeats = report.link_s + self._again_s, 0
                    if len(self._read) == self._count or self._singly:
                        self._go_on()
            case MissionAcknowledged() if self._count is not None and report.result in (ERROR, DENIED):
                # It was disturbed, by a lost request or another station: from the beginning.
                if self._in_order:
                    self._disturbed += 1
                    self._begin_again()

    def expire(self) -> None:
        """Ask again, or give up."""
        if self.done:
            return
        if self._outbox.link_s >= self._deadline_s:
            self.call_off()
        elif self._outbox.link_s >= self._due_s:
            self._repeats += 1
            given_up = not self._singly or self._repeats > _UNANSWERED_MAX
            if self._in_order and given_up and self._count is not None:
                self._begin_again()
            else:
                self._ask()

    def call_off(self) -> None:
        """Stop reading: a vehicle that reads items in order ignores other messages until it receives MISSION_ACK."""
        if not self.done and self._in_order:
            self._outbox.end_reading()
        self.done = True

    @property
    def _singly(self) -> bool:
        return self._in_order and self._disturbed > _DISTURBED_MAX

    def _begin_again(self) -> None:
        """Read the list from its beginning, for what has not come; one after the other only from the first item."""
        self._count = None
        if self._singly:
            self._read.clear()
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
            # Asked again it answers again: once more costs little where the first was lost.
            for _ in range(1 + (self._in_order and self._repeats > 0)):
                self._outbox.send_mission("MISSION_REQUEST_LIST")
            return
        missing = [seq for seq in range(self._count) if seq not in self._read]
        if self._singly:
            asked = missing[:1]
        elif self._in_order:
            asked = [seq for seq in range(missing[-1] + 1) for _ in range(2)]
        else:
            asked = missing
        for seq in asked:
            self._outbox.send_mission("MISSION_REQUEST_INT", seq=seq)
