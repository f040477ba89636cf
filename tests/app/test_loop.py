"""The shell around the core: what comes in goes through journal and core in order, what comes out is carried out."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from sidelong.app.flight.loop import ControlLoop
from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import Telemetry
from sidelong.app.link.vehicle import LinkError, Vehicle
from sidelong.mission.core.events import Announce, End, ModeReported, Yield
from sidelong.mission.exchange.outbox import SendMessage, TakeoverFailed
from sidelong.mission.exchange.reports import CommandAcknowledged, ShutdownRequested, TimerExpired
from tests.messages import acknowledgement, message, position

ACCEPTED = 0
OURS = (245, 190)


class Wire:
    """A link whose far end answers the ``heeded``-th command, as ``answerer`` (system, component) to ``to``."""

    system_id, own_id = 1, OURS

    def __init__(self, heeded=1, answerer=(1, 1), to=OURS, broken=False):
        self.heeded, self.answerer, self.to, self.broken = heeded, answerer, to, broken
        self.sent: list[str] = []
        self.inbox: asyncio.Queue[Message] = asyncio.Queue()

    async def send(self, name, fields):
        if self.broken:
            raise LinkError("the link is gone")
        self.sent.append(name)
        if name == "COMMAND_INT" and len(self.sent) >= self.heeded:
            to = {"target_system": self.to[0], "target_component": self.to[1]}
            system, component = self.answerer
            ack = acknowledgement(fields["command"], component=component, system=system, **to)
            self.inbox.put_nowait(ack)

    async def messages(self):
        while True:
            yield await self.inbox.get()


def commanded(wire, monkeypatch):
    monkeypatch.setattr("sidelong.app.link.vehicle._ANSWER_S", 0.02)

    async def go():
        vehicle = Vehicle(wire)
        running = asyncio.create_task(vehicle.run())
        try:
            return await vehicle.command_int(400, 6, (1.0,), 0, 0, 0.0)
        finally:
            running.cancel()

    return asyncio.run(go())


def test_a_command_is_repeated_until_it_is_answered(monkeypatch):
    wire = Wire(heeded=3)
    assert commanded(wire, monkeypatch) == ACCEPTED
    assert wire.sent == ["COMMAND_INT"] * 3


@pytest.mark.parametrize(("answerer", "to"), [((1, 154), OURS), ((2, 1), OURS), ((1, 1), (255, 190))])
def test_an_acknowledgement_counts_only_from_the_autopilot_and_for_us(monkeypatch, answerer, to):
    assert commanded(Wire(answerer=answerer, to=to), monkeypatch) is None


def test_an_older_autopilot_does_not_say_whom_it_answers(monkeypatch):
    assert commanded(Wire(to=(0, 0)), monkeypatch) == ACCEPTED


def test_the_loop_sends_in_order_drops_what_waits_and_survives_a_link_that_fails():
    async def go(wire):
        loop = ControlLoop(Vehicle(wire), Telemetry(1), Core(), Records(), SimpleNamespace(), lambda _acquired: None)
        for name in ("A", "B", "C"):
            loop._handle(SendMessage(0.0, name, {}))
        running = asyncio.create_task(loop._send_commands())
        for _ in range(10):
            await asyncio.sleep(0)
        loop._handle(SendMessage(0.0, "D", {}))
        assert loop.is_sending
        loop._drop_commands()
        for _ in range(10):
            await asyncio.sleep(0)
        alive = not running.done()
        running.cancel()
        return wire.sent, alive

    assert asyncio.run(go(Wire())) == (["A", "B", "C"], True)
    assert asyncio.run(go(Wire(broken=True))) == ([], True)


class Core:
    """Answers each event with what it is ordered to; asks for a timer as long as ``wants_timer``."""

    def __init__(self, answers=(), wants_timer=False):
        self.answers, self.wants_timer = dict(answers), wants_timer
        self.stepped: list[object] = []
        self.idle = True

    @property
    def next_timer_s(self):
        return -float("inf") if self.wants_timer else float("inf")

    def step(self, event):
        self.stepped.append(event)
        if isinstance(event, TimerExpired):
            self.wants_timer = False
        return self.answers.get(type(event), ())

    def snapshot(self):
        return "the picture"


class Records(list):
    def write(self, record):
        self.append(record)


def run_loop(core, *inputs):
    """Run a loop on inputs (events or messages) until it ends on its own; return it, its records, what was shown."""
    shown = []

    async def go():
        vehicle = Vehicle(Wire())
        display = SimpleNamespace(say=lambda announced: shown.append(announced.text), show=lambda _snapshot: None)
        records = Records()
        loop = ControlLoop(vehicle, Telemetry(1), core, records, display, shown.append)
        running = asyncio.create_task(loop.run())
        await asyncio.sleep(0)
        for one in inputs:
            vehicle.take(one) if isinstance(one, Message) else loop.put(one)
        await running
        return loop, records, vehicle

    return *asyncio.run(go()), shown


STOP = ShutdownRequested(9.0, 9.0)
MODE = ModeReported(1.0, "AUTO", True)


def test_everything_passes_the_journal_before_the_core():
    announced = Announce(1.0, "track", "hello")
    core = Core({ModeReported: (announced, SendMessage(1.0, "X", {}))})
    loop, records, vehicle, shown = run_loop(core, MODE, STOP)
    assert records == [MODE, announced, SendMessage(1.0, "X", {}), STOP]
    assert core.stepped == [MODE, STOP]
    assert shown == ["hello"]
    assert vehicle.listeners == []
    assert loop.outcome is None


def test_a_message_becomes_a_report_with_the_time_of_vehicle_and_link():
    received = [position(5000), acknowledgement()]
    others = [
        acknowledgement(component=154),
        acknowledgement(target_system=255),
        message("MISSION_CURRENT", 154, seq=3),
    ]
    core = Core()
    run_loop(core, *received, *others, STOP)
    position_read, report, stop = core.stepped
    assert position_read.time_s == 5.0
    assert isinstance(report, CommandAcknowledged)
    assert (report.time_s, report.command) == (5.0, 400)
    assert report.link_s >= 0.0
    assert stop is STOP


def test_a_timer_that_is_asked_for_comes_as_an_event():
    core = Core(wants_timer=True)
    core.answers[TimerExpired] = (End(1.0, "hold", "enough"),)
    loop, records, _, shown = run_loop(core, MODE)
    assert [type(one) for one in core.stepped] == [ModeReported, TimerExpired]
    assert loop.outcome == "ended: enough"
    assert shown == ["ending (hold): enough"]
    assert isinstance(records[1], TimerExpired)


def test_a_yield_is_reported_and_the_flight_goes_on_silently():
    core = Core({ModeReported: (Yield(1.0, "the pilot"),)})
    loop, _, _, shown = run_loop(core, MODE, STOP)
    assert loop.outcome == "yielded: the pilot"
    assert shown == ["yielding: the pilot; commanding nothing more until you resume"]


def test_a_takeover_that_fails_ends_it():
    failed = TakeoverFailed(1.0, "the autopilot does not arm")
    loop, _, _, _ = run_loop(Core({ModeReported: (failed,)}), MODE)
    assert loop.failed is failed
