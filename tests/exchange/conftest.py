"""A simulated vehicle, the core, and a link with faults between them, all on one clock that waits for nobody."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.assembly import mission_controller_of, tracker_of
from sidelong.app.autopilots.registry import autopilot_by_mav_autopilot
from sidelong.app.config import Config
from sidelong.app.link.frames import FrameSplitter
from sidelong.app.link.merger import LinkMerger
from sidelong.app.link.message import Message
from sidelong.app.link.quality import LinkQuality
from sidelong.app.link.reports import VehicleReports
from sidelong.app.link.telemetry import Telemetry
from sidelong.app.link.vehicle import Vehicle
from sidelong.mission.control.controller import StandoffController, StandoffSettings
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ControlAcquired, UploadPlan
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.exchange.mission_controller import MissionController
from sidelong.mission.exchange.outbox import SendMessage
from sidelong.mission.exchange.raw_item import RawItem
from sidelong.mission.exchange.reports import TakeoverRequested, TimerExpired
from sidelong.mission.geometry.approach import turn_straight_turn
from sidelong.mission.geometry.progress import nearest_arc_m, point_at
from sidelong.sitl.protocol.link import FaultyLink, LinkFaults
from sidelong.sitl.settings import Flavour, Settings, TargetSettings
from sidelong.sitl.simulation import STEP_S, Simulation

NO_FAULTS = LinkFaults()
OURS, OTHER = (245, 190), (250, 190)
_BOOT_S = 25.0
_MISSION_IDS = {
    "MISSION_CURRENT": ("mission_id", 6),
    "MISSION_ACK": ("opaque_id", 4),
    "MISSION_COUNT": ("opaque_id", 5),
}
_ID_BYTES, _MISSION_CURRENT = slice(7, 10), (42).to_bytes(3, "little")
_RATES_HZ = {30: 20.0, 33: 10.0, 42: 5.0, 87: 2.0, 360: 2.0, 436: 5.0}
_AHEAD_S = 1.5  # a plan departs so long after it could be on board


class Wandering:
    """A planner that moves the circle about home again and again, each time by a transition."""

    def __init__(self, seed: int, period_s: float = 12.0) -> None:
        self._rng = np.random.default_rng(seed)
        self._period_s, self._next_s = period_s, -math.inf

    def decide(self, aircraft, target, present, wind, latency_s):
        arc_m = nearest_arc_m(present, aircraft)
        in_transition = present.transition is not None and arc_m < present.transition.length_m
        if in_transition or aircraft.time_s < self._next_s:
            return Decision(aircraft.time_s, None, "staying")
        self._next_s = aircraft.time_s + self._period_s
        ahead_s = latency_s + _AHEAD_S
        start = point_at(present, arc_m + ahead_s * aircraft.ground_speed_m_s, aircraft)
        east_m, north_m = self._rng.uniform(-200.0, 200.0, 2)
        there = Circle(float(east_m), float(north_m), present.circle.radius_m, present.circle.clockwise)
        departure_s = aircraft.time_s + ahead_s
        state = AircraftState(
            departure_s,
            start.east_m,
            start.north_m,
            start.course_rad,
            aircraft.ground_speed_m_s,
            start.curvature_per_m,
        )
        transition = turn_straight_turn(state, there, there.radius_m)
        return Decision(aircraft.time_s, Plan(there, transition, departure_s), "moving")


class Flight:
    """A flight from the ground, in steps of the vehicle's clock.

    ``events`` and ``outputs`` are what went into the core and came out, one tuple of outputs an event. ``sent`` hears
    of each message as it leaves, ``arrived`` as its first copy reaches the vehicle.
    """

    def __init__(
        self,
        flavour,
        *,
        faults=NO_FAULTS,
        seed=1,
        speed=1.0,
        guidance="mission",
        planner=None,
        begin=True,
        settings=None,
    ):
        self.config = Config.model_validate({"planner": {"name": "paper", "guidance": guidance}})
        self.speed = speed
        self.simulation = Simulation(
            settings
            or Settings(Flavour(flavour), seed=seed, targets=(TargetSettings(speed_max_m_s=0.5),), link_rate=speed)
        )
        self.autopilot = self.simulation.vehicle
        self.dialect = autopilot_by_mav_autopilot(self.autopilot.autopilot_id)
        self.faults = faults
        rngs = [np.random.default_rng((seed, direction)) for direction in (1, 2)]
        self._to_vehicle, self._to_us = (FaultyLink(faults, rng) for rng in rngs)
        self._late = FaultyLink(NO_FAULTS, rngs[0])  # what is held up on its way to us: MISSION_CURRENT
        self._packer = mavlink.MAVLink(None, srcSystem=OURS[0], srcComponent=OURS[1])
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        system_id = self.simulation.settings.system_id
        self.vehicle = Vehicle(SimpleNamespace(system_id=system_id, own_id=OURS))
        self.telemetry, self.reports = Telemetry(system_id), VehicleReports(self.vehicle)
        self.events, self.outputs = [], []
        self.lines: dict[int, tuple] = {}  # of each plan, by number; 0: the first circle
        self.listeners: list[Callable[[object], object]] = []  # of each output
        self.observers: list[Callable[[], object]] = []  # of each step
        self.arrived: Callable[[str, dict], object] = lambda name, fields: None
        self.lost: set[str] = set()  # names of messages that never come through to us
        self._carried = 0
        self._seen: set[int] = set()
        self.simulation.connect("us")
        self.simulation.advance(_BOOT_S)
        for message_id, rate_hz in _RATES_HZ.items():
            self.to_vehicle("COMMAND_LONG", command=511, param1=message_id, param2=1e6 / rate_hz)
        self.core: MissionController | None = None
        self._start_s = self.simulation.time_s
        while self.telemetry.plane is None or "HEARTBEAT" not in self.vehicle.latest:
            self._step_simulation()
            for _, frame in self.simulation.take():
                self._hear(frame)
        self.seed, self.planner = seed, planner or Wandering(seed)
        self.core = self.make_core(self.planner)
        if begin:
            self.take_over()

    def make_core(self, planner):
        settings = self.config.aircraft.aircraft(), self.config.requirement.requirement()
        controller = StandoffController(
            StandoffSettings(settings[1], settings[0], give_up_after_s=1e9),
            tracker_of(self.config),
            lambda _aircraft, _requirement: planner,
        )
        home = self.autopilot.home
        return mission_controller_of(
            self.config,
            controller,
            self.dialect,
            self.telemetry.plane,
            Home(home.latitude_deg, home.longitude_deg, home.altitude_m),
        )

    def take_over(self, flying=False, mode="", round_trip_s=0.0):
        self.put(TakeoverRequested(self.telemetry.now_s, self.link_s, flying, mode, round_trip_s=round_trip_s))

    def spoil(self, faults, late_current_s=0.0):
        """Change the link's faults; MISSION_CURRENT comes later still."""
        self.faults = self._to_vehicle._faults = self._to_us._faults = faults
        self._late._faults = LinkFaults(delay_s=late_current_s)

    @property
    def link_s(self):
        return (self.simulation.time_s - self._start_s) / self.speed

    @property
    def has_control(self):
        return any(isinstance(output, ControlAcquired) for outputs in self.outputs for output in outputs)

    def found(self, kind):
        return [output for outputs in self.outputs for output in outputs if isinstance(output, kind)]

    def put(self, event):
        """Step the core, and carry out what it says."""
        outputs = self.core.step(event)
        self.events.append(event)
        self.outputs.append(outputs)
        for output in outputs:
            if isinstance(output, SendMessage):
                self._send(output)
            elif isinstance(output, UploadPlan) and self.config.planner.guidance == "mission":
                plan = replace(output.plan, circle=output.commanded)
                self.lines[output.number] = self.core._backend.line(plan, output.wind)
            for listener in self.listeners:
                listener(output)

    def run(self, seconds, until=lambda: False):
        """Fly for so much of the vehicle's time, or until something holds; tell whether it does."""
        end_s = self.simulation.time_s + seconds
        while self.simulation.time_s < end_s:
            self.step()
            if until():
                return True
        return False

    def step(self):
        self._step_simulation()
        for frame in self._arriving():
            if frame[_ID_BYTES] == _MISSION_CURRENT:
                self._late.put(frame, self.link_s)
            else:
                self._hear(frame)
        for frame in self._late.take(self.link_s):
            self._hear(frame)
        for observer in self.observers:
            observer()
        for _ in range(4):
            if self.core.next_timer_s > self.link_s:
                break
            self.put(TimerExpired(self.telemetry.now_s, self.link_s))

    def _arriving(self):
        for address, frame in self.simulation.take():
            if address == "us":
                self._to_us.put(frame, self.link_s, len(frame))
        return self._to_us.take(self.link_s)

    def to_vehicle(self, name, *, source=OURS, **fields):
        """Let a station say something, without faults."""
        kind = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        given = (
            dict.fromkeys(kind.fieldnames, 0)
            | {"target_system": self.vehicle.system_id, "target_component": 1}
            | fields
        )
        packer = mavlink.MAVLink(None, srcSystem=source[0], srcComponent=source[1])
        self.simulation.receive("us" if source == OURS else "other", kind(**given).pack(packer))

    def _step_simulation(self):
        self._carry(self._to_vehicle, "us")
        self.simulation.advance(self.simulation.time_s + STEP_S)

    def _carry(self, link, address):
        for number, name, fields, frame in link.take(self.link_s):
            if number not in self._seen:
                self._seen.add(number)
                self.arrived(name, fields)
            self.simulation.receive(address, frame)

    def _send(self, message):
        kind = getattr(mavlink, f"MAVLink_{message.name.lower()}_message")
        fields = {"target_system": self.vehicle.system_id, "target_component": 1} | dict(message.fields)
        self._carried += 1
        frame = kind(**fields).pack(self._packer)
        self._put((self._carried, message.name, fields, frame))

    def _put(self, sent):
        self._to_vehicle.put(sent, self.link_s, len(sent[3]))

    def _hear(self, frame):
        for got in self._parser.parse_buffer(frame) or ():
            if got.get_type() in self.lost:
                continue
            fields = {name: getattr(got, name) for name in got.get_fieldnames()}
            if got.get_type() == "STATUSTEXT":
                fields["text"] = str(fields["text"])
            if got.get_type() in _MISSION_IDS:  # fields that pymavlink does not know yet
                name, offset = _MISSION_IDS[got.get_type()]
                payload = frame[10:-2].ljust(offset + 4, b"\0")
                fields[name] = int.from_bytes(payload[offset : offset + 4], "little")
            message = Message(got.get_type(), got.get_srcSystem(), got.get_srcComponent(), fields, self.link_s)
            self.vehicle.take(message)
            event = self.telemetry.event(message)
            if self.core is None:
                continue
            if event is None:
                event = self.reports.report(message, self.telemetry.now_s, self.link_s)
            if event is not None:
                self.put(event)

    def flown_line(self):
        """Return what the vehicle flies from now on, to the circle that never completes; None outside a mission."""
        mission = self.autopilot.mission
        items, index = mission.items(), mission.index
        end = next((i for i in range(index, len(items)) if items[i].command != 16), None)
        return None if end is None else items[index : end + 1]


class TwoLinkFlight(Flight):
    """The same over two links at once, each with the faults: ``cut`` is the one that carries nothing, if any."""

    def __init__(self, flavour, *, faults=NO_FAULTS, seed=1):
        self._second = None  # the other link's (to the vehicle, to us)
        super().__init__(flavour, faults=faults, seed=seed, begin=False)
        self.cut: int | None = None
        self.merger = LinkMerger(2)
        self.changes = 0
        self._qualities = [LinkQuality(self.link_s) for _ in range(2)]
        self._choose_s = 0.0
        rngs = [np.random.default_rng((seed, direction)) for direction in (3, 4)]
        self._second = tuple(FaultyLink(faults, rng) for rng in rngs)
        self.simulation.connect("second")
        for message_id, rate_hz in _RATES_HZ.items():
            given = {"command": 511, "param1": message_id, "param2": 1e6 / rate_hz}
            fields = dict.fromkeys(mavlink.MAVLink_command_long_message.fieldnames, 0) | given
            asked = mavlink.MAVLink_command_long_message(**fields | {"target_system": 1, "target_component": 1})
            self.simulation.receive("second", asked.pack(self._packer))
        self.take_over()

    def spoil(self, faults, late_current_s=0.0):
        super().spoil(faults, late_current_s)
        for link in self._second:
            link._faults = faults

    def _arriving(self):
        links = (self._to_us, self._second[1])
        for address, frame in self.simulation.take():
            index = ("us", "second").index(address)
            if index != self.cut:
                links[index].put(frame, self.link_s, len(frame))
        for index, link in enumerate(links):
            for data in link.take(self.link_s):
                (frame,) = FrameSplitter().split(data)
                self._qualities[index].frame(frame.source, frame.sequence, len(data), self.link_s)
                if self.merger.passes(index, frame, self.link_s):
                    yield data
        if self.link_s >= self._choose_s:
            self._choose_s = self.link_s + 0.1
            measured = [quality.measured(self.link_s) for quality in self._qualities]
            self.changes += self.merger.choose(measured, self.link_s)

    def _step_simulation(self):
        if self._second is not None:
            self._carry(self._second[0], "second")
        super()._step_simulation()

    def _put(self, sent):
        if self.merger.in_use != self.cut:
            link = self._second[0] if self.merger.in_use else self._to_vehicle
            link.put(sent, self.link_s, len(sent[3]))


@pytest.fixture(scope="session")
def raw_items() -> Callable[[list], list[RawItem]]:
    """Return what makes a vehicle's items comparable with ours."""

    def made(items):
        return [RawItem(i.command, i.frame, *i.params, i.latitude_e7, i.longitude_e7, i.altitude_m) for i in items]

    return made


@pytest.fixture(scope="session")
def fly() -> Callable[..., Flight]:
    """Return what begins a flight."""
    return Flight


@pytest.fixture
def fly_on_two_links() -> Callable[..., TwoLinkFlight]:
    """Return what begins a flight on two links."""
    return TwoLinkFlight


@pytest.fixture
def in_the_air(fly) -> Iterator[Callable[..., Flight]]:
    """Return what begins a flight and brings it onto its first circle."""

    def begin(*args, **kwargs):
        flight = fly(*args, **kwargs)
        assert flight.run(240.0, lambda: flight.has_control), flight.outputs[-3:]
        return flight

    return begin
