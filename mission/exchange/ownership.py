"""Whether the mission that is flown is ours: by what is reported of it, and by reading the item that is flown.

Reports may be late, doubled or overtaken. So a report that does not fit makes us stop commanding at once, and only
several of them over more than a round trip mean that another station commands the vehicle.

Source: docs/watch-endings.md#yield-another-operator-has-control.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from sidelong.mission.exchange.dialect import ProtocolQuirks
from sidelong.mission.exchange.mission_read import MissionRead
from sidelong.mission.exchange.outbox import ExternalControl, Outbox
from sidelong.mission.exchange.reports import (
    MissionCurrentReported,
    MissionItemReported,
    PositionTargetReported,
    VehicleReport,
)
from sidelong.mission.upload.items import MissionLayout
from sidelong.mission.upload.mission_item import MissionItem, at_place, same_item, same_items

_MIN_REPORTS, _MIN_SPAN_S, _SPAN_ROUND_TRIPS = 3, 1.0, 2.0
_REMEMBERED_S, _REMEMBERED = 10.0, 64


@dataclass(slots=True)
class Suspicion:
    """Reports that do not fit to what was commanded from here. Times are of the link's clock."""

    round_trip_s: float = 0.0
    active: bool = False  # the latest report did not fit
    _reports_s: deque[float] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))

    def is_confirmed_by(self, link_s: float) -> bool:
        """Process a report that does not fit; return whether it proves that another operator is in command."""
        self.active = True
        while self._reports_s and link_s - self._reports_s[0] > _REMEMBERED_S:
            self._reports_s.popleft()
        self._reports_s.append(link_s)
        span_s = max(_MIN_SPAN_S, _SPAN_ROUND_TRIPS * self.round_trip_s)
        return len(self._reports_s) >= _MIN_REPORTS and link_s - self._reports_s[0] >= span_s

    def forget(self) -> None:
        """Reset after a change by sidelong: late reports belong to the previous mission."""
        self.active = False
        self._reports_s.clear()


@dataclass(slots=True)
class MissionIdentity:
    """The missions of ours, each as (total, mission_id); a mission_id of 0 is unknown."""

    ours: set[tuple[int, int]] = field(default_factory=set)
    expected: int | None = None  # of a mission that was written; its id is learnt from the first report of it
    doubtful: set[int] = field(default_factory=set)
    writing: int | None = None  # number of items being written; the mission may be on board already

    def written(self, total: int, mission_id: int, accepted: bool = True) -> None:
        """Register a mission that is on board, or may be."""
        self.writing = self.expected = None
        if not accepted:
            self.doubtful.add(total)
            return
        self.doubtful.clear()
        if mission_id:
            self.ours.add((total, mission_id))
        else:
            self.expected = total

    def is_open(self, total: int, mission_id: int) -> bool:
        """Return whether only the items themselves show who wrote the reported mission."""
        unknown = mission_id != 0 and (total, mission_id) not in self.ours
        return unknown and self.writing is None and total in self.doubtful

    def is_ours(self, total: int, mission_id: int) -> bool:
        """Return whether a report is about a mission of sidelong; learn its id if one is expected."""
        if (total, mission_id) in self.ours or self._is_under_way(total, mission_id):
            return True
        if total != self.expected and total not in self.doubtful:
            return False
        self.ours.add((total, mission_id))
        self.expected = None
        return True

    def _is_under_way(self, total: int, mission_id: int) -> bool:
        """Return whether a report is about the list being written: without id it grows item by item."""
        if self.writing is None:
            return False
        shortest = min((own_total for own_total, _ in self.ours), default=self.writing)
        return total == self.writing or (not mission_id and shortest < total < self.writing)


_AUDIT_S, _AUDIT_AGAIN_S = 3.0, 0.6  # between two looks at the item that is flown
_READ_S = 30.0
_LATE_S = 10.0  # a mission of ours that is reported after that was written again by another station
_WRITTEN_MAX = 4
_READS = 2  # an item of the mission before may come late, once
_CHANGED = "another station has changed the mission"


class MissionOwnership:
    """Reports ``ExternalControl`` when another station commands the mission; ``begin`` comes first.

    ``frozen`` while that may be so: no command more until it is known. So it is where an upload of a whole mission
    ended in doubt, until one of ours is reported; one of its length but of an unknown id is read first.
    """

    def __init__(self, outbox: Outbox, quirks: ProtocolQuirks) -> None:
        self._outbox, self._quirks = outbox, quirks
        self._reports, self._contents = Suspicion(), Suspicion()
        self._identity = MissionIdentity()
        # The latest uploads, and whether they were accepted: after one in doubt the next's id may be that one's.
        self._written: deque[tuple[tuple[MissionItem, ...], bool]] = deque(maxlen=_WRITTEN_MAX)
        self._read: MissionRead | None = None
        self._read_of = (0, 0)  # total and id that were reported in the meantime
        self._reads_unlike = 0  # of that mission, in a row
        self._in_doubt = False
        self._begun = False
        self._audit_s = math.inf
        self._identified = False  # the autopilot reports how long its mission is, or names it
        self._latest_id, self._latest_s = 0, -math.inf  # of the last accepted upload, on the link's clock; 0: unknown
        self._flown = -1  # the farthest item of the present line that was reported since the latest upload

    @property
    def frozen(self) -> bool:
        """Whether to command nothing now: the latest report does not fit, or an upload ended in doubt."""
        return self._reports.active or self._contents.active or self._in_doubt

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` and ``audit`` are to be called, on the link's clock; inf: never."""
        return self._audit_s if self._read is None else min(self._audit_s, self._read.next_timer_s)

    @property
    def mission_ids(self) -> frozenset[int]:
        """The ids of the missions that have been ours."""
        return frozenset(mission_id for _, mission_id in self._identity.ours)

    @property
    def doubtful(self) -> bool:
        """Whether one of the latest uploads has an unknown result: its acknowledgement may still arrive."""
        return not all(whole for _, whole in self._written)

    def begin(self) -> None:
        """Begin to detect missions of other stations."""
        self._begun = True
        self._reports.forget()
        if self._quirks.stores_items_one_by_one:
            self._audit_s = self._outbox.link_s + _AUDIT_S

    def measured(self, round_trip_s: float) -> None:
        """Process a measured round trip of the link."""
        self._reports.round_trip_s = self._contents.round_trip_s = round_trip_s

    def adopted(self, report: MissionCurrentReported) -> None:
        """Accept the mission that is flown as sidelong's own."""
        self._identity.ours.add((report.total, report.mission_id))

    def writing(self, items: int) -> None:
        """Begin to write a mission."""
        self._identity.writing = items - self._quirks.home_at_zero

    def written(self, items: tuple[MissionItem, ...], mission_id: int, accepted: bool) -> None:
        """Register a mission that was written, or may have been."""
        self._call_off()
        self._flown = -1  # a list that is taken whole begins at the item that was marked
        self._in_doubt = self._begun and not accepted and not self._quirks.stores_items_one_by_one
        self._written.append((items, accepted))
        self._latest_id, self._latest_s = mission_id if accepted else 0, self._outbox.link_s
        self._identity.written(len(items) - self._quirks.home_at_zero, mission_id, accepted)
        if self.doubtful:
            self._identity.doubtful = {len(one) - self._quirks.home_at_zero for one, _ in self._written}

    def switched(self) -> None:
        """Note the switch to another line: late reports belong to the previous one."""
        self._reports.forget()
        self._flown = -1

    def is_late(self, report: MissionCurrentReported) -> bool:
        """Return whether a report is about a mission that the last upload replaced: its numbers mean other items."""
        replaced = report.mission_id != self._latest_id and report.mission_id in self.mission_ids
        recent = report.link_s - self._latest_s < _LATE_S
        return replaced and recent and 0 not in (report.mission_id, self._latest_id)

    def current(
        self, report: MissionCurrentReported, present: MissionLayout | None, left: MissionLayout | None
    ) -> None:
        """Process a MISSION_CURRENT; present: the line that is flown, left: the previous one, for late reports.

        Going back to an item before the farthest one flown of the present line is another station's choice.
        """
        lines = (present, left)
        self._identified = self._identified or bool(report.total or report.mission_id)
        if not self._begun:
            return
        if self._identity.is_open(report.total, report.mission_id):
            self._in_doubt = True
            if self._read is None or self._read_of != (report.total, report.mission_id):
                self._reads_unlike *= self._read_of == (report.total, report.mission_id)
                self._read_of = report.total, report.mission_id
                self._call_off()
                deadline_s = self._outbox.link_s + _READ_S
                self._read = MissionRead(self._outbox, self._quirks, deadline_s, self._reports.round_trip_s)
            return
        self._call_off()
        self._in_doubt = False
        if self._identified and not self._identity.is_ours(report.total, report.mission_id):
            self._suspect(self._reports, _CHANGED)
        elif report.seq < self._flown or not any(line is not None and report.seq in line for line in lines):
            self._suspect(self._reports, f"another station has chosen item {report.seq} of the mission")
        else:
            self._reports.active = False
            if present is not None and report.seq in present:
                self._flown = report.seq

    def target(self, report: PositionTargetReported, lines: Iterable[MissionLayout | None]) -> None:
        """Process the position that the autopilot flies to: the only evidence of who wrote a mission without id."""
        if not self._begun or self._identified:
            return
        items = [item for line in lines if line is not None for item in line.line()]
        if not any(at_place(report.x, report.y, item) for item in items):
            self._suspect(self._reports, _CHANGED)

    def _call_off(self) -> None:
        if self._read is not None:
            self._read.call_off()
            self._read = None

    def receive(self, report: VehicleReport) -> None:
        """Process a report of the autopilot."""
        if self._read is not None:
            self._read.receive(report)
            self._judge_read(self._read)

    def expire(self) -> None:
        """Continue to read the mission on board, which shows who wrote it."""
        if self._read is not None:
            self._read.expire()
            self._judge_read(self._read)

    def _judge_read(self, read: MissionRead) -> None:
        if not read.done:
            return
        self._read = None  # without an answer the next report begins another
        if read.items is None:
            return
        if any(same_items(written, read.items) for written, _ in self._written):
            self._identity.ours.add(self._read_of)
            self._in_doubt, self._reads_unlike = False, 0
            return
        self._reads_unlike += 1
        if self._reads_unlike >= _READS:
            self._outbox.report(ExternalControl(self._outbox.time_s, _CHANGED))

    def item(self, report: MissionItemReported, layout: MissionLayout) -> None:
        """Compare an item that was read from the vehicle with the mission that should be on board."""
        if not self._begun or report.seq not in layout:
            return
        if same_item(layout.items[report.seq], report.item):
            self._contents.active = False
        else:
            self._audit_s = min(self._audit_s, self._outbox.link_s + _AUDIT_AGAIN_S)
            self._suspect(self._contents, _CHANGED)

    def audit(self, seq: int | None) -> None:
        """Request the item that is flown: another station may have written it, in a mission of the same length."""
        if self._outbox.link_s < self._audit_s:
            return
        self._audit_s = self._outbox.link_s + (_AUDIT_AGAIN_S if self._contents.active else _AUDIT_S)
        if seq is not None:
            self._outbox.send_mission("MISSION_REQUEST_INT", seq=seq)

    def _suspect(self, suspicion: Suspicion, reason: str) -> None:
        if suspicion.is_confirmed_by(self._outbox.link_s):
            self._outbox.report(ExternalControl(self._outbox.time_s, reason))
