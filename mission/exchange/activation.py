"""The switch to a plan on board, until the autopilot or the track answers it. Source: docs/retries.md#3-one-plan."""

from __future__ import annotations

import math
from enum import StrEnum

from sidelong.mission.core.events import UploadPlan
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.exchange.layout import MissionLayout
from sidelong.mission.exchange.outbox import CANCELLED, Outbox
from sidelong.mission.exchange.reports import PositionTargetReported
from sidelong.mission.geometry.progress import nearest_arc_m, off_track, point_at
from sidelong.mission.upload.mission_item import at_place

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
        self._sends = 0
        self._sent_s = -math.inf
        self._settled = False
        self._reports_before = 0
        self._since_s: dict[Answer, float] = {}
        self._due_s = -math.inf
        self.answer = Answer.OPEN
        self.unanswered = False  # it was asked for often enough; now only the answer is waited for
        self.index = layout.first  # the farthest item of the line that is known to be flown

    @property
    def repeated(self) -> bool:
        """Whether the next request is not the first."""
        return self._sends > 0

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` is to be called, on the link's clock; -inf: at once, inf: never."""
        return self._due_s if self.answer is Answer.OPEN else math.inf

    def expire(self, first_ahead: int) -> None:
        """Repeat the request.

        Args:
            first_ahead: Number of the first item that the aircraft cannot have passed when the request arrives.
        """
        now_s = self._outbox.link_s
        if self.answer is not Answer.OPEN or now_s < self._due_s:
            return
        again_s = max(_MIN_AGAIN_S, _AGAIN_ROUND_TRIPS * self._round_trip_s)
        if self._sends < _SENDS:
            self._sends, self._sent_s, self._due_s = self._sends + 1, now_s, now_s + again_s
            if self._read_in_order and self._sends > 1:
                self._outbox.end_reading()
                self._outbox.send_mission("MISSION_ACK", type=CANCELLED)
            self._outbox.send("MISSION_SET_CURRENT", seq=first_ahead)
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
        if self._sends and not self._target_was_on_line and self._is_on_line(report):
            self.answer = Answer.FLOWN

    def counted(self) -> None:
        """Process the answer to the query: later reports are newer than the last request."""
        if self.unanswered and not self._settled:
            self._settled = True
            self._outbox.end_reading()

    def track(self, aircraft: AircraftState) -> None:
        """Process the aircraft's position: it is on the new plan, the old one, or neither."""
        if not self._sends or self.answer is not Answer.OPEN:
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
