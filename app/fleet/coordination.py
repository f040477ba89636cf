"""Connects the coordinator with the flights: passes reports and advice on, and keeps both in its journal."""

from __future__ import annotations

import asyncio
import math
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, get_args

from sidelong.app.fleet.vehicle_clock import ToMissionTime, VehicleClockReader
from sidelong.app.flight.loop import Stepped
from sidelong.app.link.message import Message
from sidelong.app.records.journal import JournalWriter
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.core.events import Event, RouteGiven
from sidelong.mission.core.fleet import FleetAdvice, NeighbourPlanned
from sidelong.mission.core.plan import HeightProfile, Plan
from sidelong.mission.core.requirement import Requirement, Side
from sidelong.mission.exchange.mission_controller import InboundEvent, Output
from sidelong.mission.fleet.coordinator import FleetCoordinator
from sidelong.mission.fleet.events import (
    BatteryReported,
    FleetAnnounce,
    FleetCommand,
    FleetEvent,
    LaunchRequested,
    PlansReported,
    ReliefRequested,
    RequirementChanged,
    SideRequested,
    Tell,
    Tick,
    VehicleLost,
    VehicleReported,
)
from sidelong.mission.fleet.reports import FleetReporter

FLEET_JOURNAL_TYPES: tuple[type, ...] = (*get_args(FleetEvent), *get_args(FleetCommand))

_TICK_S = 0.5  # of mission time
_POLL_S = 0.05
_STANDING_S = 1.0  # of the wall clock: without any vehicle's clock, mission time advances by this per second


class Participant:
    """One aircraft of the fleet; mission_s and to_mission_s are as ``VehicleClockReader`` has them.

    Args:
        put_event: Puts an event into its core.
        now_s: Returns the time of its clock, s.
        home_above_m: Height of its home above the common home, m.
    """

    def __init__(
        self,
        name: str,
        controller: StandoffController,
        put_event: Callable[[Event], None],
        now_s: Callable[[], float],
        home_above_m: float = 0.0,
        mission_s: Callable[[], float] = lambda: math.nan,
        to_mission_s: ToMissionTime = lambda _source, time_s: time_s,
    ) -> None:
        self.name, self.controller, self.put_event, self.now_s = name, controller, put_event, now_s
        self.home_above_m = home_above_m
        self.reporter, self.clock = FleetReporter(name), VehicleClockReader(name, now_s, mission_s, to_mission_s)
        self.battery_percent: int | None = None
        self.received_s = -math.inf  # last, by this computer's clock


class Coordination:
    """Steps the coordinator by what the aircraft report, in the order in which it comes.

    note receives the name of an aircraft, '' for all, and the text to display. changes: of the requirement of each
    target, as (since, requirement) in mission time.
    """

    def __init__(
        self,
        coordinator: FleetCoordinator,
        journal: JournalWriter,
        note: Callable[[str, str], object],
        launch: Callable[[str], object] = lambda _name: None,
    ) -> None:
        self.coordinator = coordinator
        self.changes: dict[str, list[tuple[float, Requirement]]] = defaultdict(list)
        self._journal, self._note, self._launch = journal, note, launch
        self._participants: dict[str, Participant] = {}
        self._ahead_s: dict[str, float] = {}  # mission time less the time of each source
        self._utc_rejected = False
        self._ticked_s = -math.inf
        self._moved_s = math.inf

    def add(self, participant: Participant) -> None:
        """Take an aircraft in."""
        self._participants[participant.name] = participant

    # -- mission time --------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Mission time: the latest of any aircraft; -inf before the first whose clock is known."""
        return max(self._ticked_s, *(self._mission_s(one) for one in self._participants.values()))

    def reported_by_others_s(self, name: str) -> float:
        """Return mission time by the clocks of the others, s; NaN where none of them advances.

        The clock of an aircraft that has landed or sends no messages has stopped and does not count.
        """
        since_s = time.monotonic() - _STANDING_S
        known = [
            self._mission_s(participant)
            for other, participant in self._participants.items()
            if other != name and participant.clock.reports_time and participant.received_s >= since_s
        ]
        return max((one for one in known if math.isfinite(one)), default=math.nan)

    def mission_s(self, source: Literal["utc", "host"], time_s: float) -> float:
        """Return mission time for the present time of a source: the first one is it, a new one moves nothing."""
        if source not in self._ahead_s:
            now_s = self.now_s
            self._ahead_s[source] = now_s - time_s if math.isfinite(now_s) else 0.0
        return time_s + self._ahead_s[source]

    def _mission_s(self, participant: Participant) -> float:
        """Return mission time by one aircraft's clock; -inf before that is known."""
        offset_s = self.coordinator.offset_s(participant.name)
        return -math.inf if offset_s is None else participant.now_s() + offset_s

    async def keep_time(self) -> None:
        """Send clock events to the coordinator until cancelled."""
        while True:
            await asyncio.sleep(_POLL_S)
            self.keep_up(time.monotonic())

    def keep_up(self, wall_s: float) -> None:
        """Let the coordinator know how time has gone on; wall_s is the clock of this computer."""
        now_s = self.now_s
        if now_s < self._ticked_s + _TICK_S:
            if wall_s - self._moved_s < _STANDING_S:
                return
            now_s += _STANDING_S  # no vehicle is received any more
        if math.isfinite(now_s):
            self._ticked_s, self._moved_s = now_s, wall_s
            self.put(Tick(now_s))

    # -- what the aircraft report --------------------------------------------------------------------------

    def stepped(self, name: str) -> Stepped:
        """Return the callback for each step of that aircraft's core."""
        participant = self._participants[name]

        def received(event: InboundEvent, outputs: Sequence[Output]) -> None:
            for news in participant.reporter.after(participant.controller, event, outputs, self.now_s):
                self.put(_common_heights(news, participant.home_above_m))

        return received

    def message(self, name: str, message: Message) -> None:
        """Take a message of that aircraft: its clock, its battery."""
        participant = self._participants[name]
        participant.received_s = time.monotonic()
        advised = participant.clock.report(message)
        if message.name == "TIMESYNC":
            self._compare_utc()
        if advised is not None:
            self.put(advised)
        if message.name in ("SYS_STATUS", "BATTERY_STATUS"):
            self._battery(participant, int(message.fields["battery_remaining"]))

    def _compare_utc(self) -> None:
        """Stop using UTC where two vehicles disagree: by their answers to this computer all agree."""
        ahead_s = {name: one.clock.utc_ahead_s for name, one in self._participants.items()}
        known = [(*span, name) for name, span in ahead_s.items() if span is not None]
        if self._utc_rejected or not known:
            return
        latest, earliest = max(known), min(known, key=lambda span: span[1])
        if latest[0] <= earliest[1]:
            return
        self._utc_rejected = True
        for participant in self._participants.values():
            participant.clock.doubt_utc()
        apart_s = (latest[0] + latest[1] - earliest[0] - earliest[1]) / 2.0
        text = f"its UTC is {apart_s:.1f} s ahead of {earliest[2]}'s: all clocks are compared with this computer's"
        self._note(latest[2], text)

    def _battery(self, participant: Participant, percent: int) -> None:
        if percent < 0 or percent == participant.battery_percent or not math.isfinite(participant.now_s()):
            return
        participant.battery_percent = percent
        self.put(BatteryReported(participant.name, participant.now_s(), percent / 100.0))

    def lost(self, name: str, reason: str) -> None:
        """Take an aircraft out whose flight has ended."""
        if math.isfinite(self.now_s):
            self.put(VehicleLost(name, self.now_s, reason))

    # -- what a person asks --------------------------------------------------------------------------------

    def watch_from(self, side: Side, who: str) -> None:
        """Set the required side."""
        self.put(SideRequested(self.now_s, side, who))

    def relieve(self, name: str, who: str) -> None:
        """Let another one take that aircraft's place."""
        self.put(ReliefRequested(name, self.now_s, who))

    # -- output of the coordinator -------------------------------------------------------------------------

    def put(self, event: FleetEvent) -> None:
        """Step the coordinator, and pass on what it led to."""
        self._journal.write(event)
        for command in self.coordinator.step(event):
            self._journal.write(command)
            match command:
                case Tell():
                    advised = self._participants[command.name]
                    advised.put_event(_own_heights(command.event, advised.home_above_m))
                case FleetAnnounce():
                    self._note(command.name, command.text)
                case RequirementChanged():
                    self.changes[command.target].append((command.mission_time_s, command.requirement))
                case LaunchRequested():
                    self._note(command.name, f"is wanted in the air: {command.reason}")
                    self._launch(command.name)


def _common_heights(event: FleetEvent, by_m: float) -> FleetEvent:
    """Return what an aircraft reports with heights above the common home."""
    match event:
        case VehicleReported() if by_m:
            return replace(event, height_m=event.height_m + by_m)
        case PlansReported() if by_m:
            return replace(event, present=_raised(event.present, by_m), coming=_raised(event.coming, by_m))
    return event


def _own_heights(
    advised: FleetAdvice | NeighbourPlanned | RouteGiven, by_m: float
) -> FleetAdvice | NeighbourPlanned | RouteGiven:
    """Return an event for an aircraft with heights above its own home."""
    if by_m == 0.0 or isinstance(advised, RouteGiven):
        return advised
    if isinstance(advised, NeighbourPlanned):
        return replace(advised, present=_raised(advised.present, -by_m), coming=_raised(advised.coming, -by_m))
    neighbours = tuple(replace(one, height_m=one.height_m - by_m) for one in advised.neighbours)
    return replace(advised, height_m=advised.height_m - by_m, neighbours=neighbours)


def _raised(plan: Plan | None, by_m: float) -> Plan | None:
    if plan is None or plan.heights is None:
        return plan
    heights = plan.heights
    return replace(plan, heights=HeightProfile(heights.from_m + by_m, heights.to_m + by_m, heights.slope))
