"""Upload of a mission or of its changed part: all items are sent at once, unanswered ones again.

Autopilots accept items strictly in order and ignore the rest. So items may be sent without waiting for each request:
a lost packet costs a fraction of a second, and no item is stored at a wrong index. If the autopilot stores items one
by one, they are read back. Otherwise it accepts the whole list and acknowledges it. The list is read if the
acknowledgement may belong to another upload, or to a part of this one.

Source: MAVLink mission protocol, <https://mavlink.io/en/services/mission.html>; docs/retries.md#1-messages.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from enum import StrEnum

from sidelong.mission.exchange.dialect import ProtocolQuirks
from sidelong.mission.exchange.mission_read import MissionRead
from sidelong.mission.exchange.outbox import ACCEPTED, CANCELLED, DENIED, ERROR, INVALID_SEQUENCE, NO_SPACE, Outbox
from sidelong.mission.exchange.reports import (
    MissionAcknowledged,
    MissionItemReported,
    MissionItemRequested,
    VehicleReport,
)
from sidelong.mission.upload.mission_item import MissionItem, difference, same_item, same_items

# Retransmission timeout: a constant at first, a multiple of the round trip once that is known.
_AGAIN_S, _MIN_AGAIN_S, _AGAIN_ROUND_TRIPS = 0.25, 0.1, 2.0
_READ_S = 5.0  # after an upload that was not acknowledged
_SLOWER, _SLOWEST = 1.25, 2.0
_REFUSALS = 3
_GIVEN_UP_S = 4.0  # of silence: PX4 gives an upload up after 5 s
_LONG_ROUND_TRIP_S = 0.2  # then the items are sent with the announcement, without waiting for the first request


class WriteResult(StrEnum):
    """What an upload came to. After TIMEOUT the vehicle may hold the old mission, the new one or a mixture."""

    ACCEPTED = "accepted"
    DENIED = "denied"
    TIMEOUT = "timeout"


class _Phase(StrEnum):
    ANNOUNCING = "announcing"
    SENDING = "sending"
    VERIFYING = "verifying"


class MissionWrite:
    """Writes ``items``; those outside ``changed`` are already on board.

    Args:
        changed: If it has the length of the items, they replace the whole list on board.
        marked: Returns the item to fly when the list is activated.
        mission_ids_before: Ids of earlier uploads whose acknowledgements may still arrive.
        doubt_before: Whether the acknowledgement of an upload of unknown id may still arrive.
        loses: Whether an earlier upload lost items. Then, or after the first loss, items are sent twice if allowed.
    """

    def __init__(
        self,
        outbox: Outbox,
        quirks: ProtocolQuirks,
        items: Sequence[MissionItem],
        changed: range,
        deadline_s: float,
        marked: Callable[[], int],
        mission_ids_before: Collection[int] = (),
        doubt_before: bool = False,
        round_trip_s: float = 0.0,
        loses: bool = False,
    ) -> None:
        self._outbox, self._quirks, self._marked = outbox, quirks, marked
        self._loses, self.has_lost = loses, False
        self.items, self.changed = tuple(items), changed
        self._deadline_s, self._mission_ids_before = deadline_s, mission_ids_before
        self._doubt_before = doubt_before
        self._round_trip_before_s = round_trip_s
        self._again_s = max(_MIN_AGAIN_S, _AGAIN_ROUND_TRIPS * round_trip_s) if round_trip_s else _AGAIN_S
        self._at_once = round_trip_s > _LONG_ROUND_TRIP_S
        self._overtaken = False
        self._over = False  # the vehicle has reported that it is not receiving a mission
        self._awaited = changed.start
        self._refusals, self._refused = 0, False
        self._onboard: dict[int, MissionItem] = {}
        self._read: MissionRead | None = None
        self._sent_s = self._due_s = 0.0
        self._requested_s = -math.inf
        self._repeats = 0
        self.round_trip_s: float | None = None
        self.result: WriteResult | None = None  # after TIMEOUT and DENIED the items at ``changed`` are unknown
        self.differs = ""  # which item was read back otherwise than sent, in words
        self.mission_id = 0
        self._announce()

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` is to be called, on the link's clock; -inf: at once, inf: never."""
        if self.result is not None:
            return math.inf
        return self._read.next_timer_s if self._read is not None else min(self._due_s, self._deadline_s)

    def receive(self, report: VehicleReport) -> None:
        """Process a report of the autopilot."""
        if self.result is not None:
            return
        if self._read is not None and not self._is_wanted_still(report):
            self._read.receive(report)
            self._judge_read()
            return
        if self._read is not None:
            self._read.call_off()
            self._read = None
        match report:
            case MissionItemRequested() if self._phase is not _Phase.VERIFYING and 0 <= report.seq < len(self.items):
                self._requested(report)
            case MissionAcknowledged() if self._phase is _Phase.ANNOUNCING:
                self._answered(report.result)
            case MissionAcknowledged() if self._phase is _Phase.SENDING:
                self._acknowledged(report)
            case MissionItemReported() if self._phase is _Phase.VERIFYING:
                self._item(report)

    def expire(self) -> None:
        """Send unanswered messages again, or fail after the deadline."""
        if self.result is not None:
            return
        if self._read is not None:
            self._read.expire()
            self._judge_read()
        elif self._outbox.link_s >= self._deadline_s:
            self._give_up()
        elif self._outbox.link_s >= self._due_s:
            if self._over:
                self._verify()
                return
            self._repeats += 1
            self.has_lost = self.has_lost or self._phase is _Phase.SENDING
            self._say()

    def cancel(self) -> None:
        """Cancel: send no further item. What is on board is then unknown."""
        if self.result is None:
            self._outbox.send_mission("MISSION_ACK", type=CANCELLED)
            self.result = WriteResult.TIMEOUT

    def _announce(self) -> None:
        self._phase, self._awaited, self._repeats = _Phase.ANNOUNCING, self.changed.start, 0
        self._over = False
        self._say()

    def _requested(self, report: MissionItemRequested) -> None:
        repeated, self._awaited, self._requested_s = report.seq == self._awaited, report.seq, report.link_s
        repeats, self._repeats = self._repeats, 0
        self._over = False
        self._due_s = report.link_s + self._again_s
        if self._phase is _Phase.ANNOUNCING:
            # After a retransmission it is ambiguous which announcement is answered.
            measured_s = report.link_s - self._sent_s
            self.round_trip_s = measured_s if repeats == 0 else max(measured_s, self._round_trip_before_s)
            self._again_s = max(_MIN_AGAIN_S, _AGAIN_ROUND_TRIPS * self.round_trip_s)
            self._phase = _Phase.SENDING
            if not self._at_once:
                self._say()
        elif repeated and not self._overtaken and report.link_s - self._sent_s >= self._again_s:
            self.has_lost = True
            self._say()  # what came behind the item that was lost was left alone
        elif repeated or self._overtaken:
            self._outbox.send_item(report.seq, self.items[report.seq], report.seq == self._marked())

    def _answered(self, result: int) -> None:
        """Take an answer to the announcement; late ones to the upload before come here too, and say nothing."""
        if result == DENIED and self._quirks.stores_items_one_by_one:
            self._phase = _Phase.SENDING  # it receives already: its first request was lost
            self._say()
        elif result == NO_SPACE:
            self.result = WriteResult.DENIED
        elif result in (ERROR, DENIED):
            self._refusals += not (self._refused or self._at_once)
            self._refused = True
            if self._refusals > _REFUSALS and self._quirks.stores_items_one_by_one:
                self.result = WriteResult.DENIED

    def _acknowledged(self, report: MissionAcknowledged) -> None:
        if report.result in (INVALID_SEQUENCE, DENIED):
            # An item, or the announcement, has come twice; or items overtake each other, and are better sent singly.
            self._overtaken = self._overtaken or report.result == INVALID_SEQUENCE
            return
        if report.result == CANCELLED:
            self._announce()
        elif report.result == ERROR:
            # It receives nothing, either because all is there or because it never began.
            if self._quirks.stores_items_one_by_one:
                self._verify()
            else:
                self._over = True  # the answer to the last item, sent after this one, shows which
        elif report.result != ACCEPTED:
            self.result = WriteResult.DENIED
        elif report.mission_id and report.mission_id in self._mission_ids_before:
            pass  # of the upload before, come late
        elif self._quirks.stores_items_one_by_one or self._doubt_before or self._may_be_given_up(report.link_s):
            self._verify()
        else:
            self.mission_id, self.result = report.mission_id, WriteResult.ACCEPTED

    def _may_be_given_up(self, now_s: float) -> bool:
        """Return whether items may be missing: PX4 repeats its answer to the last item even after giving up."""
        return self._awaited != self.changed[-1] and now_s - self._requested_s > _GIVEN_UP_S

    def _say(self) -> None:
        outbox, changed = self._outbox, self.changed
        self._sent_s = outbox.link_s
        # Where everything comes late, because a link or a processor is busy, repeating it would keep it busy.
        self._due_s = outbox.link_s + self._again_s * min(_SLOWER**self._repeats, _SLOWEST)
        self._refused = False
        if self._phase is _Phase.ANNOUNCING:
            if self._repeats and not self._quirks.stores_items_one_by_one:
                outbox.end_reading()  # it may wait for that, and ignore everything else
            if len(changed) == len(self.items):
                outbox.send_mission("MISSION_COUNT", count=len(self.items))
            else:
                ends = {"start_index": changed.start, "end_index": changed.stop - 1}
                outbox.send_mission("MISSION_WRITE_PARTIAL_LIST", **ends)
        if self._phase is _Phase.SENDING or (self._phase is _Phase.ANNOUNCING and self._at_once):
            marked = self._marked()
            for seq in range(self._awaited, max(changed.stop, self._awaited + 1)):
                for _ in range(self._copies):
                    outbox.send_item(seq, self.items[seq], seq == marked)
        elif self._phase is _Phase.VERIFYING:
            for seq in self._to_verify():
                if seq not in self._onboard:
                    outbox.send_mission("MISSION_REQUEST_INT", seq=seq)

    @property
    def _copies(self) -> int:
        """How often an item is sent: after one that was lost, all that follow were for nothing."""
        twice = (self._loses or self.has_lost) and not self._quirks.stores_items_one_by_one
        return 2 if twice and not self._overtaken else 1

    def _give_up(self) -> None:
        self._outbox.send_mission("MISSION_ACK", type=CANCELLED)
        if self._quirks.stores_items_one_by_one or self._phase is _Phase.ANNOUNCING:
            self.result = WriteResult.TIMEOUT
        else:  # often only the last acknowledgement was lost
            self._read = self._reading()

    def _verify(self) -> None:
        if not self._quirks.stores_items_one_by_one:
            self._read = self._reading()
            return
        self._phase = _Phase.VERIFYING
        self._onboard.clear()
        self._say()
        self._judge()

    def _reading(self) -> MissionRead:
        deadline_s = self._outbox.link_s + _READ_S
        return MissionRead(self._outbox, self._quirks, deadline_s, self.round_trip_s or 0.0)

    def _is_wanted_still(self, report: VehicleReport) -> bool:
        """Return whether the vehicle still requests items although an acknowledgement has arrived."""
        if not isinstance(report, MissionItemRequested) or report.link_s >= self._deadline_s:
            return False
        return report.seq in self.changed and report.seq >= self._awaited

    def _to_verify(self) -> list[int]:
        return [seq for seq in self.changed if not (seq == 0 and self._quirks.home_at_zero)]

    def _item(self, report: MissionItemReported) -> None:
        if report.seq in self.changed:
            self._onboard[report.seq] = report.item
            self._due_s, self._repeats = report.link_s + self._again_s, 0
            self._judge()

    def _judge(self) -> None:
        if any(seq not in self._onboard for seq in self._to_verify()):
            return
        if all(same_item(self.items[seq], self._onboard[seq]) for seq in self._to_verify()):
            self.result = WriteResult.ACCEPTED
        else:
            verified = self._to_verify()
            self.differs = difference([self.items[seq] for seq in verified], [self._onboard[seq] for seq in verified])
            self._announce()

    def _judge_read(self) -> None:
        if self._read is None or not self._read.done:
            return
        onboard, self.mission_id = self._read.items, self._read.mission_id
        self._read = None
        self.differs = self.differs if onboard is None else difference(self.items, onboard)
        if onboard is not None and same_items(self.items, onboard):
            self.result = WriteResult.ACCEPTED
        elif self._outbox.link_s >= self._deadline_s:
            self.result = WriteResult.TIMEOUT
        else:
            self._announce()
