"""Plans as mission items: written next to the flown ones, one upload at a time, and activated on time.

An aircraft is never sent back to an item that lies behind it.

Source: MAVLink mission protocol, <https://mavlink.io/en/services/mission.html>; docs/explanation/exchange.md;
docs/retries.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ActivatePlan, Announce, PlanStatus, UploadPlan
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.exchange.dialect import AutopilotDialect, ExchangeSettings
from sidelong.mission.exchange.mission_read import MissionRead
from sidelong.mission.exchange.mission_write import MissionWrite, WriteResult
from sidelong.mission.exchange.outbox import CANCELLED, Outbox
from sidelong.mission.exchange.ownership import MissionOwnership
from sidelong.mission.exchange.reports import (
    MissionCountReported,
    MissionCurrentReported,
    MissionItemReported,
    PositionTargetReported,
    VehicleReport,
)
from sidelong.mission.geometry.progress import STILL_AIR, nearest_arc_m, off_track, point_at
from sidelong.mission.upload.items import (
    NAV_LOITER_UNLIM,
    NAV_WAYPOINT,
    MissionLayout,
    UnflyableError,
    first_to_fly,
    plan_items,
)
from sidelong.mission.upload.mission_item import MissionItem, at_place

_SENDS = 5
_MIN_AGAIN_S, _AGAIN_ROUND_TRIPS = 0.4, 2.0
# After the last request: a later report comes from a vehicle that has received it.
_SETTLED_S, _SETTLED_ROUND_TRIPS = 0.5, 1.5
_REPORTS = 2  # of the line before, after that
_ON_M, _ON_RAD = 25.0, math.radians(25.0)  # so near to a plan the aircraft flies it
_TRACK_S, _TRACK_BEFORE_S, _TRACK_NEITHER_S = 2.0, 10.0, 15.0  # durations on the vehicle's clock


class Answer(StrEnum):
    """What became of a switch."""

    OPEN = "open"
    FLOWN = "flown"
    NOT_TAKEN = "not taken"


class Activation:
    """Makes the path of ``layout`` current while that of ``before`` is flown.

    MISSION_SET_CURRENT is repeated. Each request names an item that the aircraft cannot have passed if it received
    the previous request. A vehicle that reads items in order ignores requests while it waits for a MISSION_ACK after
    a download, or for the items of an upload that was announced twice: the acknowledgement is sent again. If no
    answer comes, a query over the same link shows which reports are newer than the last request.
    """

    def __init__(
        self,
        outbox: Outbox,
        command: UploadPlan,
        layout: MissionLayout,
        before: MissionLayout,
        round_trip_s: float,
        target: PositionTargetReported | None,
        read_in_order: bool,
    ) -> None:
        self._read_in_order = read_in_order
        self._outbox, self._command, self.layout, self.before = outbox, command, layout, before
        self._round_trip_s = round_trip_s
        self._target_was_on_line = target is not None and self._is_on_line(target)
        self.sends, self._requested = 0, layout.first  # of the request; the item of the last one
        self._sent_s = -math.inf
        self._settled = False
        self._reports_before = 0
        self._since_s: dict[Answer, float] = {}
        self._due_s = -math.inf
        self.answer = Answer.OPEN
        self.unanswered = False  # it was asked for often enough; now only the answer is waited for
        self.index = layout.first  # the farthest item of the line that is known to be flown

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` is to be called, on the link's clock; -inf: at once, inf: never."""
        return self._due_s if self.answer is Answer.OPEN else math.inf

    def expire(self, first_ahead: int) -> None:
        """Repeat the request, with the first item that the aircraft cannot have passed when it arrives."""
        now_s = self._outbox.link_s
        if self.answer is not Answer.OPEN or now_s < self._due_s:
            return
        again_s = max(_MIN_AGAIN_S, _AGAIN_ROUND_TRIPS * self._round_trip_s)
        if self.sends < _SENDS:
            self.sends, self._sent_s, self._due_s = self.sends + 1, now_s, now_s + again_s
            if self._read_in_order and self.sends > 1:
                self._outbox.end_reading()
                self._outbox.send_mission("MISSION_ACK", type=CANCELLED)
            # Back from an item that is reported late, another station would seem to have chosen the earlier one.
            self._requested = max(first_ahead, self._requested)
            self._outbox.send("MISSION_SET_CURRENT", seq=self._requested)
            return
        settled_s = self._sent_s + max(again_s, _SETTLED_S + _SETTLED_ROUND_TRIPS * self._round_trip_s)
        if now_s < settled_s:
            self._due_s = settled_s
            return
        self.unanswered = True
        if self._settled:
            self._due_s = math.inf
            return
        self._due_s = now_s + again_s
        self._outbox.send_mission("MISSION_REQUEST_LIST")

    def current(self, seq: int) -> None:
        """Process a MISSION_CURRENT."""
        if seq in self.layout:
            self.answer, self.index = Answer.FLOWN, seq
        elif seq in self.before and self._settled:
            self._reports_before += 1
            if self._reports_before >= _REPORTS and self.answer is Answer.OPEN:
                self.answer = Answer.NOT_TAKEN

    def target(self, report: PositionTargetReported) -> None:
        """Process the reported position target; a new one is evidence of the switch."""
        if self.sends and not self._target_was_on_line and self._is_on_line(report):
            self.answer = Answer.FLOWN

    def counted(self) -> None:
        """Process a MISSION_COUNT, the answer to the query after a request: later reports are newer than that."""
        if self.unanswered and not self._settled:
            self._settled = True
            self._outbox.end_reading()

    def track(self, aircraft: AircraftState) -> None:
        """Process the aircraft's position: it is on the new plan, the old one, or neither."""
        if not self.sends or self.answer is not Answer.OPEN:
            return
        on_plan, off_plan = _flies(aircraft, self._command.plan)
        on_before, off_before = _flies(aircraft, self._command.present)
        reported = {
            Answer.FLOWN: on_plan and off_before,
            Answer.NOT_TAKEN: self.unanswered and on_before and off_plan,
            Answer.OPEN: self.unanswered and off_plan and off_before,
        }
        for answer, holds in reported.items():
            if not holds:
                self._since_s.pop(answer, None)
        bounds_s = {Answer.FLOWN: _TRACK_S, Answer.NOT_TAKEN: _TRACK_BEFORE_S, Answer.OPEN: _TRACK_NEITHER_S}
        for answer, holds in reported.items():
            since_s = self._since_s.setdefault(answer, aircraft.time_s) if holds else math.inf
            if aircraft.time_s - since_s >= bounds_s[answer]:
                self.answer = Answer.FLOWN if answer is Answer.FLOWN else Answer.NOT_TAKEN

    def _is_on_line(self, report: PositionTargetReported) -> bool:
        return any(at_place(report.x, report.y, item) for item in self.layout.line())


def _flies(aircraft: AircraftState, plan: Plan) -> tuple[bool, bool]:
    """Return whether an aircraft is close to a plan, and whether it has left it."""
    point = point_at(plan, nearest_arc_m(plan, aircraft), aircraft)
    return not off_track(aircraft, point, _ON_M, _ON_RAD), off_track(aircraft, point)


_NEAR_M = 100.0  # off its line, an aircraft passes a waypoint at such a distance
_SWITCH_M = 15.0  # so far before a waypoint the next one may be flown to


def _place_of(item: MissionItem, plane: LocalPlane) -> tuple[float, float]:
    return plane.east_north_m(item.x * 1e-7, item.y * 1e-7)


_DURATION_WEIGHT = 0.5
_LOSES_UPLOADS = 5  # number of uploads for which a link that lost items is treated as lossy
_FIRST_UPLOAD_S, _UPLOAD_S, _USELESS_S, _READ_S = 30.0, 8.0, 2.0, 5.0
_NEGLIGIBLE_S, _MISSED_S = 0.3, 1.0  # a report may have been missed before
_REPEAT_AHEAD_S, _REPEAT_ROUND_TRIPS = 1.0, 1.5  # a repeated request may arrive so late


class _Stage(StrEnum):
    WRITING = "writing"
    READY = "ready"
    ACTIVATING = "activating"
    NOT_TAKEN = "not taken"


@dataclass(slots=True)
class _Change:
    """A plan whose line has a place in the mission."""

    command: UploadPlan
    layout: MissionLayout
    stage: _Stage = _Stage.WRITING
    activation: Activation | None = None


class _Flown(NamedTuple):
    """The item that was reported last, the aircraft then, and where that was when the item was reported first."""

    seq: int
    aircraft: AircraftState
    begun: AircraftState


class MissionItemBackend:
    """Flies plans by uploads. ``load`` or ``adopt`` comes first."""

    def __init__(self, outbox: Outbox, dialect: AutopilotDialect, settings: ExchangeSettings) -> None:
        self._outbox, self._dialect, self._settings = outbox, dialect, settings
        self.layout: MissionLayout | None = None
        self._loading: MissionLayout | None = None
        self._read: MissionRead | None = None
        self._queued: UploadPlan | None = None  # until the next tick
        self._change: _Change | None = None
        self._not_taken: _Change | None = None  # the latest one; if it is flown after all, that is still reported
        self._left: MissionLayout | None = None  # the line before, until an item of the present one was reported
        self._ownership = MissionOwnership(outbox, dialect.quirks)
        self._write: MissionWrite | None = None
        self._onboard: tuple[MissionItem | None, ...] = ()  # None where a failed upload leaves doubt
        self._began_s = self._took_s = 0.0  # of the upload, and what one takes, on the vehicle's clock
        self._round_trip_s = 0.0  # of the link's clock
        self._since_lost = _LOSES_UPLOADS  # number of uploads without a lost item
        self._current: MissionCurrentReported | None = None
        self._target: PositionTargetReported | None = None
        self._aircraft: AircraftState | None = None
        self._flown: _Flown | None = None
        self._current_is_new = False  # not judged by a position yet
        self._known_s = -math.inf  # of the position that was known when it was reported
        self._closed = False
        self._waits = False  # for the next tick, whose link time is that of now
        self.load_result: WriteResult | None = None

    @property
    def idle(self) -> bool:
        """Whether nothing is under way that should end before the program does."""
        return self._write is None and (self._change is None or self._change.stage is not _Stage.ACTIVATING)

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` is to be called, on the link's clock; -inf: at once, inf: never."""
        if self._ownership.frozen:
            return self._ownership.next_timer_s
        if self._waits:
            return -math.inf
        activation = self._change.activation if self._change is not None else None
        next_s = self._ownership.next_timer_s
        for part in (self._write, self._read, activation):
            if part is not None:
                next_s = min(next_s, part.next_timer_s)
        return next_s

    # -- the first mission ---------------------------------------------------------------------------------

    def load(self, plan: Plan, lead_in: tuple[MissionItem, ...] = ()) -> None:
        """Upload the first mission, with items such as a take-off before the plan; UnflyableError: see ``line``."""
        head = self._dialect.head(self._settings.home)
        first = len(head) + len(lead_in)
        items = (*head, *lead_in, *self.line(plan))
        layout = MissionLayout(items, len(head), first, len(items), self._dialect.min_items).filled()
        self.load_result, self._loading = None, layout
        self._begin_write(layout.items, _FIRST_UPLOAD_S, lambda: layout.head)

    def adopt(self, round_trip_s: float) -> None:
        """Begin to read the mission that is flown; the result is in ``adopted``."""
        self._read = MissionRead(self._outbox, self._dialect.quirks, self._outbox.link_s + _READ_S, round_trip_s)

    @property
    def reading(self) -> bool:
        """Whether the mission on board is being read."""
        return self._read is not None and not self._read.done

    def adopted(self) -> Circle | None:
        """Accept the flown line of the mission that was read; return the unlimited loiter it ends in, or None."""
        read, self._read = self._read, None
        if read is None or read.items is None or self._current is None:
            return None
        items, first = read.items, self._current.seq
        last = next((i for i in range(first, len(items)) if items[i].command != NAV_WAYPOINT), None)
        if last is None or items[last].command != NAV_LOITER_UNLIM or not items[last].param3:
            return None
        head = len(self._dialect.head(self._settings.home))
        min_items = self._dialect.min_items
        kept = max(last + 1, min_items)
        self.layout = MissionLayout(items[:kept], head, max(first, head), last + 1, min_items).filled()
        self._onboard = items
        self._ownership.adopted(self._current)
        item = items[last]
        return Circle(*_place_of(item, self._settings.plane), abs(item.param3), item.param3 > 0.0)

    @property
    def line_first(self) -> int:
        """Index of the first item of the line that is flown."""
        assert self.layout is not None
        return self.layout.first

    @property
    def flown_index(self) -> int | None:
        """Index of the item that is flown, as reported last."""
        return self._current.seq if self._current is not None else None

    @property
    def waypoints_m(self) -> tuple[tuple[float, float], ...]:
        """Positions (east, north) of the waypoints ahead: of the path on its way, else of the path that is flown."""
        layout, seq = self.layout if self._change is None else self._change.layout, self.flown_index
        if layout is None:
            return ()
        first = seq if seq is not None and seq in layout else layout.first
        return tuple(_place_of(item, self._settings.plane) for item in layout.items[first : layout.end - 1])

    def line(self, plan: Plan, wind: Wind = STILL_AIR, home_m: float = 0.0) -> tuple[MissionItem, ...]:
        """Return the items of a plan as the autopilot stores them; UnflyableError: no waypoints lead along it."""
        settings = self._settings
        tracking = self._dialect.tracking(settings.aircraft.airspeed_m_s, wind)
        items = plan_items(plan, settings.plane, settings.height_m, settings.tolerance_m, tracking)
        return tuple(self._dialect.stored(replace(item, z=item.z - home_m)) for item in items)

    def take_control(self) -> None:
        """Begin to detect other operators: sidelong has control of the vehicle now."""
        self._ownership.begin()

    # -- plans ---------------------------------------------------------------------------------------------

    def upload(self, command: UploadPlan) -> None:
        """Bring a plan to the autopilot without flying it yet."""
        change = self._change
        busy = self._write is not None or (change is not None and change.stage is _Stage.ACTIVATING)
        if busy or self._closed or self.layout is None:
            self._announce(command.number, "failed", "the plan before is not settled" if busy else "the flight ends")
            return
        if change is not None and change.stage is _Stage.NOT_TAKEN:
            self._not_taken = change
        self._queued, self._change = command, None
        self._waits = True

    def activate(self, command: ActivatePlan) -> None:
        """Fly a plan now."""
        change = self._change
        if change is None or change.command.number != command.number or change.stage is not _Stage.READY:
            self._announce(command.number, "failed", "it is not on board")
            return
        assert self.layout is not None
        change.stage = _Stage.ACTIVATING
        change.activation = Activation(
            self._outbox,
            change.command,
            change.layout,
            self.layout,
            self._round_trip_s,
            self._target,
            read_in_order=not self._dialect.quirks.stores_items_one_by_one,
        )
        self._waits = True

    def close(self) -> None:
        """Start nothing new."""
        self._closed = True

    def expire(self) -> None:
        """Continue what is due: the reading, writing and activation of a mission, and its audit."""
        self._waits = False
        self._ownership.expire()
        index, layout = self.flown_index, self.layout
        can_ask = self._write is None and layout is not None and index is not None and index in layout
        self._ownership.audit(index if can_ask else None)
        if self._ownership.frozen:
            return
        if self._read is not None:
            self._read.expire()
        if self._write is not None:
            self._write.expire()
        self._judge_write()
        change = self._change
        if self._queued is not None:
            self._lay_out(self._queued)
        elif change is not None and change.activation is not None and change.stage is _Stage.ACTIVATING:
            was_unanswered = change.activation.unanswered
            change.activation.expire(self._first_ahead(change))
            if change.activation.unanswered and not was_unanswered:
                self._announce(change.command.number, "unconfirmed", "the autopilot has not confirmed the switch")

    def _lay_out(self, command: UploadPlan) -> None:
        """Find free places for the plan's items next to those that are flown, and write them there."""
        assert self.layout is not None
        self._queued = None
        try:
            line = self.line(replace(command.plan, circle=command.commanded), command.wind, command.home_m)
        except UnflyableError as error:
            self._announce(command.number, "failed", str(error))
            return
        if self._current is not None:
            self.layout = self.layout.since(self._current.seq)
        layout = self.layout.with_line(line)
        self._change = _Change(command, layout)
        self._begin_upload(layout, command)

    def _first_ahead(self, change: _Change) -> int:
        """Return the first item that the aircraft has not passed when a request of now arrives."""
        assert change.activation is not None
        layout, plan = change.layout, change.command.plan
        path = plan.transition
        if path is None:
            return layout.first
        late_s = self._outbox.time_s - plan.departure_s
        on_the_way_s = self._outbox.vehicle_s(self._round_trip_s)
        if change.activation.sends:  # the previous request may have arrived, and this one may be delayed
            late_s = max(late_s, 0.0) + _REPEAT_AHEAD_S + _REPEAT_ROUND_TRIPS * on_the_way_s
        elif on_the_way_s > _NEGLIGIBLE_S:
            late_s += on_the_way_s
        else:
            return layout.first + self._first_to_fly(change.command, path, layout)
        flown_m = late_s * self._settings.aircraft.airspeed_m_s
        for seq in range(layout.first, layout.end - 1):
            east_m, north_m = _place_of(layout.items[seq], self._settings.plane)
            nearest = int(np.argmin(np.hypot(path.east_m - east_m, path.north_m - north_m)))
            if path.arc_m[nearest] > flown_m + _SWITCH_M:
                return seq
        return layout.end - 1

    def _first_to_fly(self, command: UploadPlan, transition: Path, layout: MissionLayout) -> int:
        if self._aircraft is None:
            return 0
        settings = self._settings
        tracking = self._dialect.tracking(settings.aircraft.airspeed_m_s, command.wind)
        places = [_place_of(item, settings.plane) for item in layout.line()[:-1]]
        return first_to_fly(transition, command.commanded, tracking, places, self._aircraft, settings.tolerance_m)

    # -- uploading -----------------------------------------------------------------------------------------

    def _begin_upload(self, layout: MissionLayout, command: UploadPlan) -> None:
        # Long after its departure a plan is of no use, and a better one waits until this upload has ended.
        bound_s = min(_UPLOAD_S, max(command.plan.departure_s - self._outbox.time_s, 0.0) + _USELESS_S)
        self._begin_write(layout.items, bound_s, self._marked)

    def _begin_write(self, items: Sequence[MissionItem], bound_s: float, marked: Callable[[], int]) -> None:
        """Write the items that differ; ``marked`` returns the number of the item to fly once they are accepted."""
        quirks, ownership = self._dialect.quirks, self._ownership
        items = (*items, *self._dialect.tail(self._settings.home))
        changed = range(len(items))
        if len(self._onboard) == len(items):
            differing = [seq for seq in changed if items[seq] != self._onboard[seq]]
            if not differing:
                self._written(WriteResult.ACCEPTED)
                return
            if quirks.stores_items_one_by_one:
                changed = range(differing[0], differing[-1] + 1)
        self._began_s, deadline_s = self._outbox.time_s, self._outbox.link_s + bound_s
        ownership.writing(len(items))
        self._write = MissionWrite(
            self._outbox,
            quirks,
            items,
            changed,
            deadline_s,
            marked,
            ownership.mission_ids,
            ownership.doubtful,
            self._round_trip_s,
            self._since_lost < _LOSES_UPLOADS,
        )

    def _judge_write(self) -> None:
        write = self._write
        if write is None or write.result is None:
            return
        self._write = None
        self._since_lost = 0 if write.has_lost else self._since_lost + 1
        if write.round_trip_s is not None:
            self._round_trip_s = write.round_trip_s
            self._ownership.measured(write.round_trip_s)
        if write.result is WriteResult.ACCEPTED:
            self._took_s += _DURATION_WEIGHT * (self._outbox.time_s - self._began_s - self._took_s)
            self._onboard = write.items
        elif len(write.items) == len(self._onboard):
            doubtful = zip(write.items, self._onboard, strict=True)
            self._onboard = tuple(b if a == b else None for a, b in doubtful)
        else:
            self._onboard = ()
        self._ownership.written(write.items, write.mission_id, write.result is WriteResult.ACCEPTED)
        self._written(write.result, write.differs)

    def _written(self, result: WriteResult, differs: str = "") -> None:
        change = self._change
        if change is None:
            self.load_result = result
            self.layout = self._loading if result is WriteResult.ACCEPTED else None
            return
        is_early = self._outbox.time_s + self._took_s < change.command.plan.departure_s
        if result is WriteResult.ACCEPTED:
            change.stage = _Stage.READY
            self._announce(change.command.number, "ready")
        elif result is WriteResult.TIMEOUT and is_early and not self._closed:
            self._begin_upload(change.layout, change.command)
        else:
            self._change = None
            self._announce(change.command.number, "failed", f"upload {result}{differs and f': {differs}'}")

    def _marked(self) -> int:
        """Return the item to mark as current in an upload: PX4 goes there at once when the last item has come.

        That is the item flown at that moment, so a waypoint passed during the upload is not flown again.
        """
        layout, aircraft, seq = self.layout, self._aircraft, self.flown_index
        assert layout is not None
        index = min(max(seq if seq is not None else layout.first, layout.first), layout.end - 1)
        if aircraft is None or index == layout.end - 1:
            return index
        east_m, north_m = _place_of(layout.items[index], self._settings.plane)
        off_m = math.hypot(east_m - aircraft.east_m, north_m - aircraft.north_m)
        return index + (off_m < _SWITCH_M + aircraft.ground_speed_m_s * self._took_s)

    # -- what is reported ----------------------------------------------------------------------------------

    def observe(self, aircraft: AircraftState, mode: str) -> None:
        """Process the aircraft's position and flight mode."""
        self._aircraft = aircraft
        change, before = self._change, self._flown
        # After a pause the first positions may be rejected: a report is judged by a newer one.
        if self._current is not None and self._current_is_new and aircraft.time_s > self._known_s:
            self._current_is_new, is_same = False, before is not None and before.seq == self._current.seq
            self._flown = _Flown(self._current.seq, aircraft, before.begun if before and is_same else aircraft)
            self._look_for_skipped(before, aircraft)
        if change is not None and change.activation is not None:
            change.activation.track(aircraft)
            self._judge_activation(change)

    def receive(self, report: VehicleReport) -> None:
        """Process a report of the autopilot."""
        if self._read is not None:
            self._read.receive(report)
        frozen = self._ownership.frozen
        self._ownership.receive(report)
        if not frozen and self._write is not None:
            self._write.receive(report)
            self._judge_write()
        change = self._change
        match report:
            case MissionCurrentReported():
                self._on_current(report)
            case PositionTargetReported() if self._dialect.quirks.reports_target_at_once:
                self._target = report
                activating = None if change is None or change.activation is None else change.layout
                self._ownership.target(report, (self.layout, self._left, activating))
                if change is not None and change.activation is not None:
                    change.activation.target(report)
                    self._judge_activation(change)
            case MissionCountReported() if change is not None and change.activation is not None:
                change.activation.counted()
            case MissionItemReported() if self._write is None and self.layout is not None:
                self._ownership.item(report, self.layout)
        self._waits = self._waits or (frozen and not self._ownership.frozen)

    def _on_current(self, report: MissionCurrentReported) -> None:
        if self._ownership.is_late(report):
            return
        self._current, self._current_is_new, change = report, True, self._change
        self._known_s = -math.inf if self._aircraft is None else self._aircraft.time_s
        if change is not None and change.activation is not None:
            change.activation.current(report.seq)
            self._judge_activation(change)
        if self.layout is None:
            return
        if report.seq not in self.layout:
            self._taken_after_all(report.seq)
        if report.seq in self.layout:
            self._left = None
        self._ownership.current(report, self.layout, self._left)

    def _look_for_skipped(self, before: _Flown | None, aircraft: AircraftState) -> None:
        """Announce that another station has chosen a later item of our line: it is flown.

        The aircraft cannot have passed the waypoint before that; one that misses a waypoint passes it abeam.
        """
        layout, now = self.layout, self._flown
        if before is None or now is None or layout is None or now.seq <= before.seq or before.seq not in layout:
            return
        if now.seq - 1 not in layout or now.seq not in layout:
            return
        # Reports may have come late, all at once: the vehicle's clock counts.
        since_s = aircraft.time_s - before.aircraft.time_s + self._outbox.vehicle_s(self._round_trip_s)
        flown_m = aircraft.ground_speed_m_s * (_MISSED_S + since_s)
        east_m, north_m = _place_of(layout.items[now.seq - 1], self._settings.plane)
        ahead_m = east_m - aircraft.east_m, north_m - aircraft.north_m
        leg_m = east_m - before.begun.east_m, north_m - before.begun.north_m
        left_m = (ahead_m[0] * leg_m[0] + ahead_m[1] * leg_m[1]) / max(math.hypot(*leg_m), 1.0)
        if min(math.hypot(*ahead_m), left_m) > _NEAR_M + flown_m:
            text = f"another station has chosen item {now.seq} of the mission: flying on from there"
            self._outbox.report(Announce(self._outbox.time_s, "plan", text))

    def _judge_activation(self, change: _Change) -> None:
        activation = change.activation
        if activation is None or activation.answer is Answer.OPEN:
            return
        if activation.answer is Answer.NOT_TAKEN:
            if change.stage is _Stage.ACTIVATING:
                change.stage = _Stage.NOT_TAKEN
                self._announce(change.command.number, "failed", "the autopilot did not switch to it")
            return
        self._change = None
        self._fly(change, activation.index)

    def _taken_after_all(self, seq: int) -> None:
        """Take back that a plan was not taken: what is written over it now is broken off."""
        late = self._not_taken
        if late is None or seq not in late.layout:
            return
        change = self._change
        if self._write is not None:
            self._write.cancel()
        if change is not None and change.activation is not None and seq in change.layout:
            return
        command = self._queued if change is None else change.command
        if command is not None:
            self._queued = self._change = None
            if self._write is not None:
                self._ownership.written(self._write.items, 0, False)
            self._write, self._onboard = None, ()
            self._announce(command.number, "failed", "the plan before was taken after all")
        self._fly(late, seq)

    def _fly(self, change: _Change, index: int) -> None:
        self._left, self.layout, self._not_taken = self.layout, change.layout.since(index), None
        self._ownership.switched()
        self._announce(change.command.number, "departed")

    def _announce(self, number: int, stage: str, detail: str = "") -> None:
        self._outbox.report(PlanStatus(self._outbox.time_s, number, stage, detail))  # type: ignore[arg-type]
