"""Plans as mission items: written next to the flown ones. Source: docs/explanation/exchange.md."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ActivatePlan, Announce, PlanStatus, UploadPlan
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.exchange.activation import Activation, Answer
from sidelong.mission.exchange.dialect import AutopilotDialect
from sidelong.mission.exchange.layout import MissionLayout
from sidelong.mission.exchange.line_progress import first_ahead, flown_after, is_skipped, place_of
from sidelong.mission.exchange.mission_ownership import MissionOwnership
from sidelong.mission.exchange.mission_read import MissionRead
from sidelong.mission.exchange.mission_upload import MissionUpload
from sidelong.mission.exchange.mission_write import WriteResult
from sidelong.mission.exchange.outbox import Outbox
from sidelong.mission.exchange.plan_backend import BackendSettings
from sidelong.mission.exchange.reports import (
    MissionCountReported,
    MissionCurrentReported,
    MissionItemReported,
    PositionTargetReported,
    VehicleReport,
)
from sidelong.mission.geometry.wind import STILL_AIR
from sidelong.mission.upload.items import NAV_LOITER_UNLIM, NAV_WAYPOINT, plan_items
from sidelong.mission.upload.mission_item import MissionItem
from sidelong.mission.upload.waypoints import UnflyableError, first_to_fly

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


class MissionItemBackend:
    """Flies plans by uploads. ``load`` or ``adopt`` comes first."""

    def __init__(self, outbox: Outbox, dialect: AutopilotDialect, settings: BackendSettings) -> None:
        self._outbox, self._dialect, self._settings = outbox, dialect, settings
        self._layout: MissionLayout | None = None
        self._loading: MissionLayout | None = None
        self._read: MissionRead | None = None
        self._queued: UploadPlan | None = None  # until the next tick
        self._change: _Change | None = None
        self._not_taken: _Change | None = None  # the latest one; if it is flown after all, that is still reported
        self._left: MissionLayout | None = None  # the line before, until an item of the present one was reported
        self._ownership = MissionOwnership(outbox, dialect.quirks)
        self._upload = MissionUpload(outbox, dialect, settings.home, self._ownership)
        self._current: MissionCurrentReported | None = None
        self._target: PositionTargetReported | None = None
        self._aircraft: AircraftState | None = None
        self._closed = False
        self._waits = False  # for the next tick, whose link time is that of now
        self.load_result: WriteResult | None = None

    @property
    def mode(self) -> str:
        """The flight mode, by name, in which it flies."""
        return self._dialect.mission_mode

    @property
    def idle(self) -> bool:
        """Whether nothing is under way that should end before the program does."""
        return not self._upload.under_way and (self._change is None or self._change.stage is not _Stage.ACTIVATING)

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` is to be called, on the link's clock; -inf: at once, inf: never."""
        if self._ownership.frozen:
            return self._ownership.next_timer_s
        if self._waits:
            return -math.inf
        activation = self._change.activation if self._change is not None else None
        parts = [part.next_timer_s for part in (self._upload, self._read, activation) if part is not None]
        return min([*parts, self._ownership.next_timer_s])

    # -- the first mission ---------------------------------------------------------------------------------

    def load(self, plan: Plan, lead_in: tuple[MissionItem, ...] = ()) -> None:
        """Upload the first mission.

        Args:
            plan: The plan.
            lead_in: Items before the plan, such as a take-off.

        Raises:
            UnflyableError: No waypoints lead along the plan.
        """
        head = self._dialect.head(self._settings.home)
        first = len(head) + len(lead_in)
        items = (*head, *lead_in, *self.line(plan))
        layout = MissionLayout(items, len(head), first, len(items), self._dialect.min_items).filled()
        self.load_result, self._loading = None, layout
        self._upload.begin(layout.items, _FIRST_UPLOAD_S, lambda: layout.head)
        self._judge_upload()

    def adopt(self, round_trip_s: float) -> None:
        """Begin to read the mission that is flown; the result is in ``adopted``."""
        self._read = MissionRead(self._outbox, self._dialect.quirks, self._outbox.link_s + _READ_S, round_trip_s)

    @property
    def reading(self) -> bool:
        """Whether the mission on board is being read."""
        return self._read is not None and not self._read.done

    def adopted(self) -> Circle | None:
        """Take over the line that is flown and was read, and return the circle it ends in.

        None when the mission could not be read, or what is flown does not end in a circle that needs no one.
        """
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
        self._layout = MissionLayout(items[:kept], head, max(first, head), last + 1, min_items).filled()
        self._upload.adopted(items)
        self._ownership.adopted(self._current)
        item = items[last]
        east_m, north_m = self._settings.plane.east_north_m(item.x * 1e-7, item.y * 1e-7)
        return Circle(east_m, north_m, abs(item.param3), item.param3 > 0.0)

    @property
    def line_first(self) -> int:
        """Index of the first item of the line that is flown."""
        assert self._layout is not None
        return self._layout.first

    @property
    def flown_index(self) -> int | None:
        """Index of the item that is flown, as reported last."""
        return self._current.seq if self._current is not None else None

    def line(self, plan: Plan, wind: Wind = STILL_AIR) -> tuple[MissionItem, ...]:
        """Return the items of a plan as the autopilot stores them.

        Raises:
            UnflyableError: No waypoints lead along the plan.
        """
        settings = self._settings
        tracking = self._dialect.tracking(settings.airspeed_m_s, wind)
        items = plan_items(plan, settings.plane, settings.height_m, settings.tolerance_m, tracking)
        return tuple(self._dialect.stored(item) for item in items)

    def take_control(self) -> None:
        """Begin to detect other operators: sidelong has control of the vehicle now."""
        self._ownership.begin()

    # -- plans ---------------------------------------------------------------------------------------------

    def upload(self, command: UploadPlan) -> None:
        """Bring a plan to the autopilot without flying it yet."""
        change = self._change
        busy = self._upload.under_way or (change is not None and change.stage is _Stage.ACTIVATING)
        if busy or self._closed or self._layout is None:
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
        assert self._layout is not None
        change.stage = _Stage.ACTIVATING
        change.activation = Activation(
            self._outbox,
            change.command,
            change.layout,
            self._layout,
            self._upload.round_trip_s,
            self._target,
            read_in_order=not self._dialect.quirks.stores_items_one_by_one,
        )
        self._waits = True

    def close(self) -> None:
        """Start nothing new."""
        self._closed = True

    def expire(self) -> None:
        """Do what is due."""
        self._waits = False
        self._ownership.expire()
        self._audit()
        if self._ownership.frozen:
            return
        if self._read is not None:
            self._read.expire()
        self._upload.expire()
        self._judge_upload()
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
        assert self._layout is not None
        self._queued = None
        try:
            line = self.line(replace(command.plan, circle=command.commanded), command.wind)
        except UnflyableError as error:
            self._announce(command.number, "failed", str(error))
            return
        if self._current is not None:
            self._layout = self._layout.since(self._current.seq)
        layout = self._layout.with_line(line)
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
        on_the_way_s = self._outbox.vehicle_s(self._upload.round_trip_s)
        if change.activation.repeated:  # the previous request may have arrived, and this one may be delayed
            late_s = max(late_s, 0.0) + _REPEAT_AHEAD_S + _REPEAT_ROUND_TRIPS * on_the_way_s
        elif on_the_way_s > _NEGLIGIBLE_S:
            late_s += on_the_way_s
        else:
            return layout.first + self._first_to_fly(change.command, path, layout)
        return first_ahead(layout, path, self._settings.plane, late_s * self._settings.airspeed_m_s)

    def _first_to_fly(self, command: UploadPlan, transition: Path, layout: MissionLayout) -> int:
        """Return which item of a line the aircraft begins with, from where it is."""
        if self._aircraft is None:
            return 0
        settings = self._settings
        tracking = self._dialect.tracking(settings.airspeed_m_s, command.wind)
        places = [place_of(item, settings.plane) for item in layout.line()[:-1]]
        return first_to_fly(transition, command.commanded, tracking, places, self._aircraft, settings.tolerance_m)

    # -- uploading -----------------------------------------------------------------------------------------

    def _begin_upload(self, layout: MissionLayout, command: UploadPlan) -> None:
        # Long after its departure a plan is of no use, and a better one waits until this upload has ended.
        bound_s = min(_UPLOAD_S, max(command.plan.departure_s - self._outbox.time_s, 0.0) + _USELESS_S)
        self._upload.begin(layout.items, bound_s, self._marked)
        self._judge_upload()

    def _judge_upload(self) -> None:
        result = self._upload.ended()
        if result is None:
            return
        change = self._change
        if change is None:
            self.load_result = result
            self._layout = self._loading if result is WriteResult.ACCEPTED else None
            return
        if result is WriteResult.ACCEPTED:
            change.stage = _Stage.READY
            self._announce(change.command.number, "ready")
        elif (
            result is WriteResult.TIMEOUT
            and not self._closed
            and self._outbox.time_s + self._upload.took_s < change.command.plan.departure_s
        ):
            self._begin_upload(change.layout, change.command)
        else:
            self._change = None
            self._announce(change.command.number, "failed", f"upload {result}")

    def _marked(self) -> int:
        """Return the item to mark as current in an upload: PX4 goes there at once when the last item has come.

        That is the item flown at that moment, so a waypoint passed during the upload is not flown again.
        """
        assert self._layout is not None
        return flown_after(self._layout, self.flown_index, self._aircraft, self._settings.plane, self._upload.took_s)

    # -- what is reported ----------------------------------------------------------------------------------

    def observe(self, aircraft: AircraftState, mode: str) -> None:
        """Process the aircraft's position and flight mode."""
        self._aircraft = aircraft
        change = self._change
        if change is not None and change.activation is not None:
            change.activation.track(aircraft)
            self._judge_activation(change)

    def receive(self, report: VehicleReport) -> None:
        """Process a report of the autopilot."""
        if self._read is not None:
            self._read.receive(report)
        frozen = self._ownership.frozen
        self._ownership.receive(report)
        if not frozen:
            self._upload.receive(report)
            self._judge_upload()
        change = self._change
        match report:
            case MissionCurrentReported():
                self._on_current(report)
            case PositionTargetReported() if self._dialect.quirks.reports_target_at_once:
                self._target = report
                activating = None if change is None or change.activation is None else change.layout
                self._ownership.target(report, (self._layout, self._left, activating))
                if change is not None and change.activation is not None:
                    change.activation.target(report)
                    self._judge_activation(change)
            case MissionCountReported() if change is not None and change.activation is not None:
                change.activation.counted()
            case MissionItemReported() if not self._upload.under_way and self._layout is not None:
                self._ownership.item(report, self._layout)
        self._waits = self._waits or (frozen and not self._ownership.frozen)

    def _on_current(self, report: MissionCurrentReported) -> None:
        if self._ownership.is_late(report):
            return
        previous, self._current = self._current, report
        change = self._change
        self._look_for_skipped(previous, report)
        if change is not None and change.activation is not None:
            change.activation.current(report.seq)
            self._judge_activation(change)
        if self._layout is None:
            return
        if report.seq not in self._layout:
            self._taken_after_all(report.seq)
        if report.seq in self._layout:
            self._left = None
        self._ownership.current(report, self._layout, self._left)

    def _look_for_skipped(self, previous: MissionCurrentReported | None, report: MissionCurrentReported) -> None:
        """Announce that another station has chosen a later item of our line: it is flown."""
        layout, aircraft = self._layout, self._aircraft
        if previous is None or layout is None or aircraft is None or report.seq <= previous.seq:
            return
        since_s = report.link_s - previous.link_s + self._upload.round_trip_s
        flown_m = aircraft.ground_speed_m_s * (_MISSED_S + self._outbox.vehicle_s(since_s))
        if previous.seq in layout and is_skipped(layout, report.seq, aircraft, self._settings.plane, flown_m):
            text = f"another station has chosen item {report.seq} of the mission: flying on from there"
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
        self._upload.break_off()
        if change is not None and change.activation is not None and seq in change.layout:
            return
        command = self._queued if change is None else change.command
        if command is not None:
            self._queued = self._change = None
            self._upload.forget()
            self._announce(command.number, "failed", "the plan before was taken after all")
        self._fly(late, seq)

    def _fly(self, change: _Change, index: int) -> None:
        self._left, self._layout, self._not_taken = self._layout, change.layout.since(index), None
        self._ownership.switched()
        self._announce(change.command.number, "departed")

    def _audit(self) -> None:
        index, layout = self.flown_index, self._layout
        can_ask = not self._upload.under_way and layout is not None and index is not None and index in layout
        self._ownership.audit(index if can_ask else None)

    # -- reporting -----------------------------------------------------------------------------------------

    def _announce(self, number: int, stage: str, detail: str = "") -> None:
        self._outbox.report(PlanStatus(self._outbox.time_s, number, stage, detail))  # type: ignore[arg-type]
