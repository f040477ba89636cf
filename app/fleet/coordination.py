"""Makes the coordinator and connects it with the flights: passes reports and advice on, and keeps its journal.

It also gives the mission time of each vehicle's clock, from the messages that report both.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeVar, cast, get_args

from sidelong.app.analysis.replay import Comparison
from sidelong.app.assembly import MADE_UP_ROUTE, planner_needs, tracker_settings
from sidelong.app.fleet.fleet_file import FleetFile, TeamPredictive
from sidelong.app.flight.loop import Stepped
from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT
from sidelong.app.records.journal import JournalWriter
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.joint_track import JointTrack
from sidelong.mission.control.alarms import Charge
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.surroundings import Surroundings
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import Event
from sidelong.mission.core.fleet import FleetAdvice, Neighbour, NeighbourPlanned, Role
from sidelong.mission.core.plan import AircraftState, HeightProfile, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind
from sidelong.mission.exchange.mission_controller import InboundEvent, Output
from sidelong.mission.fleet import events
from sidelong.mission.fleet.coordinator import FleetCoordinator, FleetTarget, WatchedCourse
from sidelong.mission.fleet.reports import FleetReporter
from sidelong.mission.fleet.team_planner import TeamPlanner
from sidelong.mission.fleet.vehicle import FleetMember
from sidelong.mission.route.route import RouteFollower

_UTC_SINCE_S = 1.5e9  # an earlier time is a clock that has not been set
_UTC_SIGMA_S = 0.02  # GPS time, stamped by the autopilot's main loop
_HOST_SIGMA_S = 0.1  # of this computer's clock against UTC
_ARRIVAL_SIGMA_S = 0.5
_UTC_VALID_S = 10.0
_UTC_AWAITED_S = 3.0  # at the beginning, before the answers to TIMESYNC are used
_ASKED_MAX_S = 10.0
_RATE_OVER_S, _RATE_OFF_MAX = 4.0, 0.2  # of the vehicle's clock; a clock that is set once passes for a while only
_WRAP_S = 2**32 * 1e-3  # time_boot_ms has 32 bits
_AGREES_S = 0.25  # in addition to half a round trip: the delay of a busy computer


class _SameRate:
    """Whether two clocks go equally fast, looked at over some seconds each time; ``unknown`` before the first."""

    def __init__(self, unknown: bool) -> None:
        self.holds = unknown
        self._first_s: tuple[float, float] | None = None

    def look(self, one_s: float, other_s: float) -> None:
        first_s, other_first_s = self._first_s or (one_s, other_s)
        passed_s = one_s - first_s
        if self._first_s is None or passed_s < 0.0:
            self._first_s = one_s, other_s
        elif passed_s > _RATE_OVER_S:
            self.holds = abs(other_s - other_first_s - passed_s) < _RATE_OFF_MAX * passed_s
            self._first_s = one_s, other_s


ToMissionTime = Callable[[Literal["utc", "host"], float], float]
"""Returns mission time for the time of a source: the vehicles' UTC, or this computer's clock."""


@dataclass(eq=False)
class VehicleClockReader:
    """Reads one vehicle's SYSTEM_TIME, which holds UTC and the vehicle's own clock; without UTC, its TIMESYNC.

    An answer to TIMESYNC reports the vehicle's clock as it was half a round trip ago, which is also the uncertainty.
    Without both, a position counts as measured when it was received. A simulator that runs faster than real time and
    still reports this computer's UTC can be compared with neither: its positions then count as measured at the
    mission time of the other vehicles. If no other vehicle has one, its own clock continues from its latest report.
    """

    _name: str
    now_s: Callable[[], float]  # of its own clock
    _mission_s: Callable[[], float] = lambda: math.nan  # that the others have reached; NaN where they have none
    _to_mission_s: ToMissionTime = lambda _source, time_s: time_s

    def __post_init__(self) -> None:
        self._reported_s = time.monotonic()
        self._utc_received_s = self._reported_s + _UTC_AWAITED_S - _UTC_VALID_S
        self._utc_rate, self._host_rate = _SameRate(unknown=True), _SameRate(unknown=False)
        self._utc_offset_s: float | None = None  # from its own clock
        self._host_offset_s: tuple[float, float] | None = None  # of this computer's clock, and half a round trip
        self._utc_rejected, self._restarted = False, False
        self._reported_offset_s: float | None = None  # of mission time from its own clock
        self._leads = False

    @property
    def reports_time(self) -> bool:
        """Whether mission time may go by this clock: it does not hang on the others'."""
        return self._utc_rate.holds or self._leads

    @property
    def utc_ahead_s(self) -> tuple[float, float] | None:
        """How far its UTC is ahead of this computer's clock, s: least and greatest; None while unknown.

        The span is at least 0.5 s wide. If the spans of two vehicles on one computer do not overlap, one of them does
        not report UTC: its simulator lags, or its receiver does not know the leap seconds yet.
        """
        if self._utc_offset_s is None or self._host_offset_s is None or not self._host_rate.holds:
            return None
        offset_s, unknown_s = self._host_offset_s
        ahead_s = self._utc_offset_s - offset_s
        return ahead_s - unknown_s - _AGREES_S, ahead_s + unknown_s + _AGREES_S

    def reject_utc(self) -> None:
        """Use the answers to TIMESYNC from now on, even where UTC is reported."""
        self._utc_rejected = self._restarted = True

    def report(self, message: Message) -> events.ClockReported | None:
        """Return the message as a report of the vehicle's clock; None: its time is missing or rejected."""
        reported = self._report(message)
        if reported is not None:
            self._reported_offset_s = reported.mission_time_s - reported.time_s
        return reported

    def _report(self, message: Message) -> events.ClockReported | None:
        if message.component_id != AUTOPILOT_COMPONENT:
            return None
        fields, received_s = message.fields, time.monotonic()
        if message.name == "SYSTEM_TIME":
            utc_s = fields["time_unix_usec"] * 1e-6
            if utc_s < _UTC_SINCE_S:
                return None
            vehicle_s = self._unwrapped_s(fields["time_boot_ms"] * 1e-3)
            self._utc_rate.look(vehicle_s, utc_s)
            self._utc_offset_s = utc_s - vehicle_s
            if self._utc_rejected or not self._utc_rate.holds:
                return None
            self._utc_received_s = self._reported_s = received_s
            return events.ClockReported(self._name, vehicle_s, self._to_mission_s("utc", utc_s), _UTC_SIGMA_S)
        if not self._utc_rate.holds:
            return self._by_other_clocks(fields) if message.name == "GLOBAL_POSITION_INT" else None
        if message.name == "TIMESYNC" and fields["tc1"]:
            round_trip_s = received_s - fields["ts1"] * 1e-9
            if not 0.0 <= round_trip_s < _ASKED_MAX_S:
                return None  # the reply to another system's request
            half_s, vehicle_s = 0.5 * round_trip_s, self._unwrapped_s(math.fmod(fields["tc1"] * 1e-9, _WRAP_S))
            host_s = time.time() - half_s
            self._host_rate.look(vehicle_s, host_s)
            self._host_offset_s = host_s - vehicle_s, half_s
            if received_s - self._utc_received_s <= _UTC_VALID_S and not self._utc_rejected:
                return None
            self._reported_s = received_s
            restarted, self._restarted = self._restarted, False
            mission_s, sigma_s = self._to_mission_s("host", host_s), math.hypot(half_s, _HOST_SIGMA_S)
            return events.ClockReported(self._name, vehicle_s, mission_s, sigma_s, restarted)
        if message.name == "GLOBAL_POSITION_INT" and received_s - self._reported_s > _UTC_VALID_S:
            vehicle_s = self._unwrapped_s(fields["time_boot_ms"] * 1e-3)
            mission_s = self._to_mission_s("host", time.time())
            return events.ClockReported(self._name, vehicle_s, mission_s, _ARRIVAL_SIGMA_S)
        return None

    def _by_other_clocks(self, fields: Mapping[str, Any]) -> events.ClockReported:
        vehicle_s = self._unwrapped_s(fields["time_boot_ms"] * 1e-3)
        # Two that went by each other would fall back by what each learns too late.
        mission_s = math.nan if self._leads else self._mission_s()
        if math.isnan(mission_s):
            self._leads = True
            if self._reported_offset_s is None:
                self._reported_offset_s = self._to_mission_s("host", time.time()) - vehicle_s
            mission_s = vehicle_s + self._reported_offset_s
        return events.ClockReported(self._name, vehicle_s, mission_s, _ARRIVAL_SIGMA_S)

    def _unwrapped_s(self, stamp_s: float) -> float:
        """Return a stamp of milliseconds in 32 bits on the vehicle's clock, which does not wrap around."""
        now_s = self.now_s()
        return stamp_s if not math.isfinite(now_s) else stamp_s + _WRAP_S * round((now_s - stamp_s) / _WRAP_S)


FLEET_JOURNAL_TYPES: tuple[type, ...] = (*get_args(events.FleetEvent), *get_args(events.FleetCommand))

_TICK_S = 0.5  # of mission time
_POLL_S = 0.05
_STANDING_S = 1.0  # of the wall clock: without any vehicle's clock, mission time advances by this per second


@dataclass(eq=False)
class Participant:
    """One aircraft of the fleet."""

    name: str
    controller: StandoffController
    put_event: Callable[[Event], None]
    clock: VehicleClockReader
    home_above_m: float = 0.0  # height of its home above the common home
    charge: Charge = field(default_factory=Charge)
    received_s: float = -math.inf  # last, by this computer's clock

    def __post_init__(self) -> None:
        self.reporter = FleetReporter(self.name)


@dataclass(eq=False)
class Coordination:
    """Steps the coordinator by what the aircraft report, in the order in which it comes.

    note receives the name of an aircraft, '' for all, and the text to display.
    """

    coordinator: FleetCoordinator
    _journal: JournalWriter
    _note: Callable[[str, str], object]
    _launch: Callable[[str], object] = lambda _name: None

    def __post_init__(self) -> None:
        self.changes: dict[str, list[tuple[float, Requirement]]] = defaultdict(list)  # by target, in mission time
        self._participants: dict[str, Participant] = {}
        self._ahead_s: dict[str, float] = {}  # mission time less the time of each source
        self._utc_rejected = False
        self._ticked_s = -math.inf
        self._moved_s = math.inf

    def add(self, participant: Participant) -> None:
        """Let an aircraft of the fleet take part from now on."""
        self._participants[participant.name] = participant

    # -- mission time --------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Mission time: the latest of any aircraft; -inf before the first whose clock is known."""
        return max(self._ticked_s, *(self._mission_s(participant) for participant in self._participants.values()))

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
        return max((time_s for time_s in known if math.isfinite(time_s)), default=math.nan)

    def mission_s(self, source: Literal["utc", "host"], time_s: float) -> float:
        """Return mission time at the present time of a source; a new source continues at the mission time so far."""
        if source not in self._ahead_s:
            now_s = self.now_s
            self._ahead_s[source] = now_s - time_s if math.isfinite(now_s) else 0.0
        return time_s + self._ahead_s[source]

    def _mission_s(self, participant: Participant) -> float:
        """Return mission time by one aircraft's clock; -inf before that is known."""
        offset_s = self.coordinator.offset_s(participant.name)
        return -math.inf if offset_s is None else participant.clock.now_s() + offset_s

    async def keep_time(self) -> None:
        """Send clock events to the coordinator until cancelled."""
        while True:
            await asyncio.sleep(_POLL_S)
            self.advance(time.monotonic())

    def advance(self, wall_s: float) -> None:
        """Send a ``Tick`` if one is due; wall_s: this computer's monotonic clock."""
        now_s = self.now_s
        if now_s < self._ticked_s + _TICK_S:
            if wall_s - self._moved_s < _STANDING_S:
                return
            now_s += _STANDING_S  # no vehicle is received any more
        if math.isfinite(now_s):
            self._ticked_s, self._moved_s = now_s, wall_s
            self.put(events.Tick(now_s))

    # -- what the aircraft report --------------------------------------------------------------------------

    def stepped(self, name: str) -> Stepped:
        """Return what to call after each step of a named aircraft's core, with its event and outputs."""
        participant = self._participants[name]

        def received(event: InboundEvent, outputs: Sequence[Output]) -> None:
            for news in participant.reporter.after(participant.controller, event, outputs, self.now_s):
                self.put(_raised(news, participant.home_above_m))

        return received

    def message(self, name: str, message: Message) -> None:
        """Process a message of an aircraft: its clock and its battery's charge."""
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
            participant.clock.reject_utc()
        apart_s = (latest[0] + latest[1] - earliest[0] - earliest[1]) / 2.0
        text = f"its UTC is {apart_s:.1f} s ahead of {earliest[2]}'s: all clocks are compared with this computer's"
        self._note(latest[2], text)

    def _battery(self, participant: Participant, percent: int) -> None:
        now_s = participant.clock.now_s()
        if percent < 0 or not math.isfinite(now_s):
            return
        before = participant.charge.percent
        participant.charge.take(now_s, percent)
        charge = round(participant.charge.percent or 0.0)
        if before is None or charge != round(before):
            self.put(events.ChargeReported(participant.name, now_s, charge / 100.0))

    def lost(self, name: str, reason: str) -> None:
        """Remove an aircraft whose flight has ended."""
        if math.isfinite(self.now_s):
            self.put(events.VehicleLost(name, self.now_s, reason))

    # -- what a person asks --------------------------------------------------------------------------------

    def watch_from(self, side: Side, who: str) -> None:
        """Ask for another side from now on; ``who``: the person who asks, as the page knows them."""
        self.put(events.SideRequested(self.now_s, side, who))

    def relieve(self, name: str, who: str) -> None:
        """Ask that another aircraft takes this one's place; ``who``: the person who asks, as the page knows them."""
        self.put(events.ReliefRequested(name, self.now_s, who))

    # -- output of the coordinator -------------------------------------------------------------------------

    def put(self, event: events.FleetEvent) -> None:
        """Step the coordinator, and pass on what it led to."""
        self._journal.write(event)
        for command in self.coordinator.step(event):
            self._journal.write(command)
            match command:
                case events.VehicleEvent():
                    advised = self._participants[command.name]
                    advised.put_event(_raised(command.event, -advised.home_above_m))
                case events.FleetAnnounce():
                    self._note(command.name, command.text)
                case events.RequirementChanged():
                    self.changes[command.target].append((command.mission_time_s, command.requirement))
                case events.LaunchRequested():
                    self._note(command.name, f"is wanted in the air: {command.reason}")
                    self._launch(command.name)


def compare_coordination(coordinator: FleetCoordinator, records: Iterable[object]) -> Comparison:
    """Step a coordinator through its journal, and compare its commands."""
    comparison, commands = Comparison(), get_args(events.FleetCommand)
    for record in records:
        if isinstance(record, commands):
            comparison.flown(record)
        else:
            comparison.replayed(record, coordinator.step(cast(events.FleetEvent, record)))
    return comparison


T = TypeVar("T")


def _raised(item: T, by_m: float) -> T:
    """Return an event or a plan with its heights above another home."""
    given: Any = item
    match given if by_m else None:
        case events.VehicleReported() | Neighbour():
            given = replace(given, height_m=given.height_m + by_m)
        case events.PlansReported() | NeighbourPlanned():
            given = replace(given, present=_raised(given.present, by_m), coming=_raised(given.coming, by_m))
        case FleetAdvice():
            neighbours = tuple(_raised(neighbour, by_m) for neighbour in given.neighbours)
            given = replace(given, height_m=given.height_m + by_m, neighbours=neighbours)
        case Plan(heights=HeightProfile() as heights):
            given = replace(given, heights=HeightProfile(heights.from_m + by_m, heights.to_m + by_m, heights.slope))
    return cast(T, given)


def coordinator_of(fleet: FleetFile, progress: Callable[[float], None] = lambda _share: None) -> FleetCoordinator:
    """Return the coordinator, compiled and ready to run; progress is called with the value tables' progress.

    It assigns the roles by the predictive planner's costs, whichever planner the aircraft use.
    """
    members, nothing = fleet.members, Surroundings()
    configs = {member.name: member.config for member in members}
    factories = {name: TeamPredictive().factory(planner_needs(config, progress)) for name, config in configs.items()}

    def judge(name: str, aircraft: Aircraft, wanted: Requirement) -> TeamPlanner:
        planner = factories[name](aircraft, wanted, nothing)
        assert isinstance(planner, TeamPlanner)  # a fleet's file has a side
        return planner

    for name, config in configs.items():
        _warm_up(judge(name, config.aircraft.aircraft(), config.requirement.requirement()))
    flying = [
        FleetMember(
            member.name,
            member.config.aircraft.aircraft(),
            tracker_settings(member.config.sensors, member.config.planner.lost_after_s),
            member.config.aircraft.height_m,
            member.target,
            reserve=member.reserve,
            endurance_s=math.inf if member.relieve_after_min is None else 60.0 * member.relieve_after_min,
        )
        for member in members
    ]
    return FleetCoordinator(flying, [FleetTarget(name, asked) for name, asked in fleet.asked.items()], judge)


def _warm_up(planner: TeamPlanner) -> None:
    """Call the compiled functions of a fleet flight once and discard the results, so that they are loaded."""
    track = JointTrack({name: TrackerSettings() for name in ("west", "east")})
    for name, east_m, bearing_rad in (("west", -250.0, 0.5 * math.pi), ("east", 250.0, -0.5 * math.pi)):
        track.add(name, Sighting(0.0, 270.0, bearing_rad, 0.3, 1.0, 0.01, 0.01, east_m, 0.0, 80.0))
    estimate = track.estimate(0.0)
    assert estimate is not None
    WatchedCourse(Requirement(100.0, 500.0, Side.LEFT, 5.0)).update(estimate, None)
    west, east = (Circle(east_m, 0.0, 60.0, clockwise=True) for east_m in (-250.0, 250.0))
    state = AircraftState(0.0, *west.position_at_course(0.0), 0.0, 15.0, west.curvature_per_m)
    other = Neighbour("east", replace(state, east_m=250.0), 160.0, ours=True, target="target")
    planner.role_costs(state, estimate, Plan(west), Wind(), 0.5)
    planner.advise(NeighbourPlanned(0.0, "east", Plan(east), None))
    planner.advise(FleetAdvice(0.0, "target", Role.WANTED, Side.LEFT, estimate, 100.0, (other,)))
    planner.decide(state, estimate, Plan(west), Wind(), 0.5)
    follower = RouteFollower(MADE_UP_ROUTE)
    follower.update(estimate)
    planner.follow(MADE_UP_ROUTE, follower.progress)
