"""A simulated vehicle, the core, and a link with faults between them, all on one clock that waits for no one."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.analysis.replay import JournalReplay
from sidelong.app.assembly import mission_controller_of, tracker_of
from sidelong.app.autopilots.registry import autopilot_by_mav_autopilot
from sidelong.app.config import Config
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.link.frames import OWN_ID, FrameSplitter, Packer
from sidelong.app.link.quality import LinkQuality
from sidelong.app.link.raw_links import LinkMerger
from sidelong.app.records.journal import Header, JournalReader, JournalWriter, encode
from sidelong.mission.control.controller import StandoffController, StandoffSettings
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ControlAcquired, UploadPlan
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.geometry.approach import turn_straight_turn
from sidelong.mission.geometry.progress import nearest_arc_m, point_at
from sidelong.mission.upload.items import UnflyableError
from sidelong.mission.upload.mission_item import MissionItem
from sidelong.sitl.settings import Flavour, LinkFaults, Settings, TargetSettings
from sidelong.sitl.simulation import Simulation
from tests.faulty_loop import NO_FAULTS, FaultyLoop, Link
from tests.sitl_vehicle import RATES_HZ, SitlVehicle

_ID_BYTES, _MISSION_CURRENT = slice(7, 10), (42).to_bytes(3, "little")
_AHEAD_S = 1.5  # a plan departs this long after it could be on board


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


class Flight(FaultyLoop[bytes]):
    """A flight from the ground, in steps of the vehicle's clock.

    ``events`` and ``outputs`` are what went into the core and came out, one tuple of outputs an event. ``arrived`` is
    called with each message as its first copy reaches the vehicle.
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
        self.simulation = Simulation(
            settings
            or Settings(Flavour(flavour), seed=seed, targets=(TargetSettings(speed_max_m_s=0.5),), link_rate=speed)
        )
        self.autopilot = self.simulation.vehicle
        self.dialect = autopilot_by_mav_autopilot(self.autopilot.autopilot_id)
        rngs = [np.random.default_rng((seed, direction)) for direction in (1, 2)]
        super().__init__(SitlVehicle(self.simulation), Link(NO_FAULTS, rngs[1]), Link(NO_FAULTS, rngs[0]), speed)
        self._late = Link(NO_FAULTS, rngs[0])  # holds MISSION_CURRENT up on its way to us
        self.events, self.outputs, self._each_output = [], [], []
        self.has_control = False
        self.lines: dict[int, tuple] = {}  # of each plan, by number; 0: the first circle
        self.output_listeners: list[Callable[[object], object]] = []
        self.observers: list[Callable[[], object]] = []  # of each step
        self.arrived: Callable[[str, dict], object] = lambda name, fields: None
        self.lost: set[str] = set()  # names of messages that never come through to us
        self.sent: dict[bytes, tuple[str, dict]] = {}  # frames that have not arrived yet
        self.listeners.append(self._note)
        self.connect()
        self.seed, self.planner = seed, planner or Wandering(seed)
        self.core = self.make_core(self.planner)
        self.spoil(faults)
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

    def spoil(self, faults, late_current_s=0.0):
        """Change the link's faults; MISSION_CURRENT comes later still."""
        self.faults = self.up.faults = self.down.faults = faults
        self._late.faults = LinkFaults(delay_s=late_current_s)

    def found(self, kind):
        return [output for output in self._each_output if isinstance(output, kind)]

    def forget_outputs(self):
        self.outputs.clear()
        self._each_output.clear()
        self.has_control = False

    def to_vehicle(self, name, *, source=OWN_ID, **fields):
        """Send the vehicle a message from any station, without faults."""
        frame = Packer(source).frame(name, fields, self.simulated.system_id)
        self.simulation.receive("us" if source == OWN_ID else "other", frame)

    def send(self, message):
        frame = self._packer.frame(message.name, message.fields, self.simulated.system_id)
        self.sent[frame] = (message.name, dict(message.fields))
        self.transmit(frame)

    def deliver(self, frame, address="us"):
        name, fields = self.sent.pop(frame, (None, {}))
        if name is not None:
            self.arrived(name, fields)
        self.simulation.receive(address, frame)

    def arriving(self):
        for frame in self.through():
            if frame[_ID_BYTES] == _MISSION_CURRENT:
                self._late.put(frame, self.link_s)
            else:
                yield frame
        yield from self._late.take(self.link_s)

    def through(self):
        return super().arriving()

    def on_message(self, message):
        if message.name not in self.lost:
            super().on_message(message)

    def expire(self):
        for observer in self.observers:
            observer()
        super().expire()

    def _note(self, event, outputs):
        self.events.append(event)
        self.outputs.append(outputs)
        self._each_output.extend(outputs)
        for output in outputs:
            self.has_control |= isinstance(output, ControlAcquired)
            if isinstance(output, UploadPlan) and self.config.planner.guidance == "mission":
                plan = replace(output.plan, circle=output.commanded)
                with contextlib.suppress(UnflyableError):  # the core refuses it, too
                    self.lines[output.number] = self.core._backend.line(plan, output.wind)
            for listener in self.output_listeners:
                listener(output)

    def replayed(self, path):
        """Write the flight's journal, and replay it with a core of its own."""
        writer = JournalWriter(path, Header("test", {}, self.telemetry.plane, {}), pytest.fail)
        for event, outputs in zip(self.events, self.outputs, strict=True):
            writer.write(event)
            for output in outputs:
                writer.write(output)
        writer.close()
        lines = path.read_bytes().splitlines(keepends=True)[1:]
        assert [encode(record) for record in JournalReader(path, JOURNAL_TYPES)] == lines
        again = self.make_core(type(self.planner)(self.seed))
        replay = JournalReplay(again.controller, again)
        for _ in replay.run(JournalReader(path, JOURNAL_TYPES)):
            pass
        return replay

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
        self._second = tuple(Link(faults, rng) for rng in rngs)
        self.simulation.connect("second")
        for message_id, rate_hz in RATES_HZ.items():
            asked = {"command": 511, "param1": message_id, "param2": 1e6 / rate_hz}
            self.simulation.receive("second", self._packer.frame("COMMAND_LONG", asked, 1))
        self.take_over()

    def spoil(self, faults, late_current_s=0.0):
        super().spoil(faults, late_current_s)
        for link in self._second or ():
            link.faults = faults

    def through(self):
        if self._second is None:
            yield from super().through()
            return
        links = (self.down, self._second[1])
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

    def step(self):
        for frame in self._second[0].take(self.link_s) if self._second else ():
            self.deliver(frame, "second")
        super().step()

    def transmit(self, frame):
        if self.merger.in_use != self.cut:
            link = self._second[0] if self.merger.in_use else self.up
            link.put(frame, self.link_s, len(frame))


@pytest.fixture(scope="session")
def raw_items() -> Callable[[list], list[MissionItem]]:
    """Return what makes a vehicle's items comparable with ours."""

    def made(items):
        return [
            MissionItem(i.command, i.frame, *i.params, i.latitude_e7, i.longitude_e7, i.altitude_m) for i in items
        ]

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
