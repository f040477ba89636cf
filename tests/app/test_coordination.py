"""What the shell does between the flights of a fleet and its coordinator: clocks, heights, and how time goes on."""

from __future__ import annotations

import math
from collections import defaultdict

import pytest

from sidelong.app.fleet.coordination import Coordination, Participant, VehicleClockReader
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.fleet import FleetAdvice, Neighbour, NeighbourPlanned, Role
from sidelong.mission.core.plan import AircraftState, HeightProfile, Plan
from sidelong.mission.core.requirement import Requirement, Side
from sidelong.mission.fleet.events import (
    ChargeReported,
    ClockReported,
    ReliefRequested,
    RequirementChanged,
    SideRequested,
    Tick,
    VehicleEvent,
    VehicleLost,
    VehicleReported,
)
from sidelong.mission.fleet.reports import FleetReporter
from sidelong.mission.fleet.vehicle import VehicleTime
from tests.messages import message

UTC_S = 1.8e9
STATE = AircraftState(10.0, 1.0, 2.0, 0.0, 15.0, 0.02)
PLAN = Plan(Circle(0.0, 0.0, 50.0, True), None, 0.0, HeightProfile(100.0, 120.0, 0.1))


class Coordinator:
    """Keeps what it is reported and the clocks, answers with what was laid ready."""

    def __init__(self):
        self.received, self.answers, self.clocks = [], [], defaultdict(VehicleTime)

    def offset_s(self, name):
        return self.clocks[name].offset_s if self.clocks[name].known else None

    def step(self, event):
        self.received.append(event)
        if isinstance(event, ClockReported):
            self.clocks[event.name].note(event.time_s, event.mission_time_s, event.sigma_s, discard=event.anew)
        answers, self.answers = self.answers, []
        return tuple(answers)


class Journal:
    def __init__(self):
        self.lines = []

    def write(self, event):
        self.lines.append(event)


@pytest.fixture
def pair(monkeypatch):
    """Return a coordination of two aircraft whose homes are 20 m apart in height, with inputs and outputs."""
    coordinator, journal, announced, noted = Coordinator(), Journal(), {"a": [], "b": []}, []
    clocks = {"a": 10.0, "b": 500.0}
    coordination = Coordination(coordinator, journal, lambda *words: noted.append(words))
    monkeypatch.setattr("sidelong.app.fleet.coordination.time.monotonic", lambda: 1000.0)
    for name, home_above_m in (("a", 0.0), ("b", 20.0)):
        now_s = lambda name=name: clocks[name]  # noqa: E731
        others = lambda name=name: coordination.reported_by_others_s(name)  # noqa: E731
        clock = VehicleClockReader(name, now_s, others, coordination.mission_s)
        coordination.add(Participant(name, None, announced[name].append, clock, home_above_m))
    return coordination, coordinator, journal, announced, noted, clocks


def test_system_time_reports_a_clock_and_an_unset_one_does_not():
    reader = VehicleClockReader("a", lambda: 10.0)
    set_ = message("SYSTEM_TIME", time_unix_usec=int(UTC_S * 1e6), time_boot_ms=10_500)
    announced = reader.report(set_)
    assert announced == ClockReported("a", 10.5, UTC_S, announced.sigma_s)
    assert 0.0 < announced.sigma_s <= 0.05
    assert reader.report(message("SYSTEM_TIME", time_unix_usec=5_000_000, time_boot_ms=10_500)) is None
    assert (
        reader.report(message("SYSTEM_TIME", component=154, time_unix_usec=int(UTC_S * 1e6), time_boot_ms=1)) is None
    )


def test_a_clock_goes_on_where_its_stamps_begin_again():
    wrapped_s = 2**32 * 1e-3
    reader = VehicleClockReader("a", lambda: wrapped_s + 3.0)
    announced = reader.report(message("SYSTEM_TIME", time_unix_usec=int(UTC_S * 1e6), time_boot_ms=3_200))
    assert announced.time_s == pytest.approx(wrapped_s + 3.2)


def test_timesync_counts_half_the_round_trip_and_only_where_there_is_no_utc(monkeypatch):
    wall = [1000.0]
    monkeypatch.setattr("sidelong.app.fleet.coordination.time.monotonic", lambda: wall[0])
    monkeypatch.setattr("sidelong.app.fleet.coordination.time.time", lambda: UTC_S)
    reader = VehicleClockReader("a", lambda: 30.0)
    asked_ns = 999_600_000_000
    answer = message("TIMESYNC", tc1=30_000_000_000, ts1=asked_ns)
    assert reader.report(answer) is None  # UTC may still come
    wall[0], answer.fields["ts1"] = 1004.0, 1_003_600_000_000
    announced = reader.report(answer)
    assert announced.time_s == pytest.approx(30.0)
    assert announced.mission_time_s == pytest.approx(UTC_S - 0.2)
    assert announced.sigma_s >= 0.2
    assert reader.report(message("TIMESYNC", tc1=0, ts1=asked_ns)) is None  # a question
    assert reader.report(message("TIMESYNC", tc1=1, ts1=asked_ns - 10**12)) is None  # an answer to another station
    reader.report(message("SYSTEM_TIME", time_unix_usec=int(UTC_S * 1e6), time_boot_ms=30_000))
    assert reader.report(answer) is None


class Wall:
    """This computer's clock, and two aircraft next to it whose UTC may differ."""

    def __init__(self, coordination, monkeypatch):
        self.now_s, self._coordination = 1000.0, coordination
        monkeypatch.setattr("sidelong.app.fleet.coordination.time.monotonic", lambda: self.now_s)
        monkeypatch.setattr("sidelong.app.fleet.coordination.time.time", lambda: UTC_S + self.now_s)

    def pass_by(self, seconds, utc_ahead_s, round_trip_s=0.02, rate=1.0):
        """Let each report UTC and answer once a second; utc_ahead_s: of this computer's clock, by name."""
        for _ in range(seconds):
            self.now_s += 1.0
            for name, ahead_s in utc_ahead_s.items():
                boot_s = rate * (self.now_s - 900.0) + {"a": 0.0, "b": 490.0}[name]
                utc_us = int((UTC_S + 900.0 + rate * (self.now_s - 900.0) + ahead_s) * 1e6)
                announced = message("SYSTEM_TIME", time_unix_usec=utc_us, time_boot_ms=int(1e3 * boot_s))
                self._coordination.message(name, announced)
                tc1_ns = int(1e9 * (boot_s - rate * round_trip_s / 2.0))
                answer = message("TIMESYNC", tc1=tc1_ns, ts1=int(1e9 * (self.now_s - round_trip_s)))
                self._coordination.message(name, answer)


@pytest.mark.parametrize(
    ("ahead_s", "round_trip_s", "rate", "is_rejected"),
    [
        (3.0, 0.02, 1.0, True),
        (0.6, 0.02, 1.0, True),
        (0.4, 0.02, 1.0, False),
        (0.9, 0.6, 1.0, False),
        (3.0, 0.02, 5.0, False),
    ],
)
def test_of_two_that_report_another_utc_none_is_accepted(pair, monkeypatch, ahead_s, round_trip_s, rate, is_rejected):
    coordination, _, _, _, noted, _ = pair
    wall = Wall(coordination, monkeypatch)
    wall.pass_by(10, {"a": 40.0, "b": 40.0 + ahead_s}, round_trip_s, rate)  # this computer's own clock may be wrong
    apart_s = coordination.coordinator.offset_s("a") - coordination.coordinator.offset_s("b") - 490.0
    if not is_rejected:
        assert noted == []
        assert apart_s == pytest.approx(-ahead_s, abs=0.01)
        return
    ((name, text),) = noted
    assert name == "b"
    assert f"{ahead_s:.1f} s ahead of a's" in text
    assert apart_s == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("is_compared", [True, False])
def test_jump_of_one_utc_does_not_move_mission_time(pair, monkeypatch, is_compared):
    coordination, _, _, _, noted, clocks = pair
    wall = Wall(coordination, monkeypatch)
    rate = 1.0 if is_compared else 5.0  # UTC of a fast simulator is not compared with this computer's

    def mission_s(seconds, b_ahead_s):
        for _ in range(seconds):
            boot_s = rate * (wall.now_s + 1.0 - 900.0)
            clocks.update(a=boot_s, b=boot_s + 490.0)
            wall.pass_by(1, {"a": 40.0, "b": b_ahead_s}, rate=rate)
            yield coordination.now_s - boot_s

    offsets_s = [*mission_s(10, 40.0), *mission_s(4, 3640.0), *mission_s(20, 40.0)]
    assert offsets_s == pytest.approx([UTC_S + 940.0] * 34, abs=0.1)
    assert len(noted) == is_compared


def test_utc_that_comes_late_does_not_move_mission_time(pair, monkeypatch):
    coordination, _, _, _, noted, clocks = pair
    wall = Wall(coordination, monkeypatch)
    for second in range(20):
        clocks.update(a=wall.now_s + 1.0 - 900.0, b=wall.now_s + 1.0 - 410.0)
        wall.pass_by(1, {"a": 40.0 if second > 10 else -1.7e9, "b": 40.0 if second > 12 else -1.7e9})
        if second > 3:
            assert coordination.now_s == pytest.approx(UTC_S + wall.now_s, abs=0.1)  # the clock of this computer
    assert noted == []
    assert coordination.coordinator.offset_s("a") - coordination.coordinator.offset_s("b") == pytest.approx(
        490.0, abs=0.05
    )


def test_without_either_the_positions_report_the_clock_by_their_arrival(monkeypatch):
    wall = [1000.0]
    monkeypatch.setattr("sidelong.app.fleet.coordination.time.monotonic", lambda: wall[0])
    monkeypatch.setattr("sidelong.app.fleet.coordination.time.time", lambda: UTC_S)
    reader = VehicleClockReader("a", lambda: 30.0)
    position = message("GLOBAL_POSITION_INT", time_boot_ms=30_000)
    assert reader.report(position) is None
    wall[0] += 11.0
    announced = reader.report(position)
    assert (announced.time_s, announced.mission_time_s) == (30.0, pytest.approx(UTC_S))
    assert announced.sigma_s >= 0.5
    assert reader.report(message("SYSTEM_TIME", time_unix_usec=int(UTC_S * 1e6), time_boot_ms=30_000)) is not None
    assert reader.report(position) is None


def test_one_whose_utc_stands_still_goes_by_the_others_while_they_are_received_and_then_on_as_before(
    pair, monkeypatch
):
    coordination, _, _, _, _, clocks = pair
    wall = Wall(coordination, monkeypatch)
    by_others = VehicleClockReader("b", lambda: clocks["b"], lambda: coordination.reported_by_others_s("b"))
    wall.pass_by(10, {"a": 0.0})
    clocks["a"] = wall.now_s - 900.0
    utc_us = int((UTC_S + wall.now_s) * 1e6)
    for boot_s in (590.0, 600.0):  # it was reported, and then it does not go on
        by_others.report(message("SYSTEM_TIME", time_unix_usec=utc_us, time_boot_ms=int(1e3 * boot_s)))
    wall.now_s += 0.5
    announced = by_others.report(message("GLOBAL_POSITION_INT", time_boot_ms=600_500))
    assert announced.mission_time_s == pytest.approx(UTC_S + wall.now_s - 0.5)
    wall.now_s += 300.0  # the other one has gone home, and its clock stands still
    assert math.isnan(coordination.reported_by_others_s("b"))
    announced = by_others.report(message("GLOBAL_POSITION_INT", time_boot_ms=900_500))
    assert announced.mission_time_s == pytest.approx(UTC_S + wall.now_s - 0.5)
    wall.pass_by(1, {"a": 0.0})  # it is received again: neither goes by the other now
    announced = by_others.report(message("GLOBAL_POSITION_INT", time_boot_ms=901_500))
    assert announced.mission_time_s == pytest.approx(UTC_S + wall.now_s - 0.5)


def test_mission_time_is_the_latest_of_any_aircraft_and_goes_on_when_all_are_silent(pair):
    coordination, coordinator, _, _, _, clocks = pair
    coordination.advance(0.0)
    assert coordinator.received == []  # no one's clock is known
    coordination.message("a", message("SYSTEM_TIME", time_unix_usec=int(UTC_S * 1e6), time_boot_ms=10_000))
    coordination.message("b", message("SYSTEM_TIME", time_unix_usec=int((UTC_S + 0.2) * 1e6), time_boot_ms=500_000))
    assert coordination.now_s == pytest.approx(UTC_S + 0.2)
    coordination.advance(0.0)
    coordination.advance(0.5)
    clocks["a"] += 2.0
    coordination.advance(0.6)
    coordination.advance(1.2)
    coordination.advance(1.7)
    ticks = [event.mission_time_s - UTC_S for event in coordinator.received if isinstance(event, Tick)]
    assert ticks == pytest.approx([0.2, 2.0, 3.0], abs=1e-3)


def test_what_goes_in_and_comes_out_is_in_the_journal(pair):
    coordination, coordinator, journal, announced, noted, _ = pair
    coordination.message("a", message("SYSTEM_TIME", time_unix_usec=int(UTC_S * 1e6), time_boot_ms=10_000))
    coordinator.answers = [answer := VehicleEvent("a", NeighbourPlanned(10.0, "b", None, None))]
    coordination.lost("b", "its link is lost")
    assert [type(line) for line in journal.lines] == [ClockReported, VehicleLost, VehicleEvent]
    assert announced == {"a": [answer.event], "b": []}
    assert noted == []


def test_the_battery_is_reported_when_it_changes(pair):
    coordination, coordinator, *_ = pair
    for percent in (80, 80, 79, -1):
        coordination.message("b", message("SYS_STATUS", battery_remaining=percent))
    assert coordinator.received == [ChargeReported("b", 500.0, 0.8), ChargeReported("b", 500.0, 0.79)]


def test_heights_are_above_the_common_home_for_the_coordinator_and_above_its_own_for_each(pair, monkeypatch):
    coordination, coordinator, _, announced, _, _ = pair
    report = VehicleReported("b", 500.0, STATE, 100.0, True)
    monkeypatch.setattr(FleetReporter, "after", lambda *_arguments: (report,))
    advice = FleetAdvice(
        500.0, "boat", Role.WANTED, Side.LEFT, None, 160.0, (Neighbour("a", STATE, 90.0, True),), "because"
    )
    coordinator.answers = [VehicleEvent("b", advice), VehicleEvent("b", NeighbourPlanned(500.0, "a", PLAN, None))]
    coordination.stepped("b")(None, ())
    assert coordinator.received[0].height_m == 120.0
    advised, planned = announced["b"]
    assert advised.height_m == 140.0
    assert advised.neighbours[0].height_m == 70.0
    assert (planned.present.heights.from_m, planned.present.heights.to_m) == (80.0, 100.0)
    assert math.isclose(planned.present.heights.slope, 0.1)


def test_what_a_person_asks_reaches_the_coordinator_at_mission_time_and_is_written_down(pair):
    coordination, coordinator, journal, _, _, _ = pair
    coordination.message("a", message("SYSTEM_TIME", time_unix_usec=int(UTC_S * 1e6), time_boot_ms=10_000))
    changed = RequirementChanged(UTC_S, "boat", Requirement(100.0, 500.0, Side.RIGHT, 5.0))
    coordinator.answers = [changed]
    coordination.watch_from(Side.RIGHT, "operator 1")
    coordination.relieve("b", "operator 2")
    assert coordinator.received[-2:] == [
        SideRequested(UTC_S, Side.RIGHT, "operator 1"),
        ReliefRequested("b", UTC_S, "operator 2"),
    ]
    assert coordination.changes == {"boat": [(UTC_S, changed.requirement)]}
    assert set(coordinator.received[-2:]) | {changed} <= set(journal.lines)
