"""The fleet's coordinator above two real control steps, whose clocks differ."""

from __future__ import annotations

import math

import pytest

from estimators.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from estimators.tracker import Tracker, TrackerSettings
from mission.control.controller import Phase, StandoffController, StandoffSettings
from mission.core.circle import Circle
from mission.core.events import Command, ControlAcquired, End, UploadPlan
from mission.core.fleet import Role
from mission.core.plan import Decision, Plan
from mission.core.requirement import Aircraft, Requirement, Side
from mission.fleet.coordinator import FleetCoordinator, FleetMember, FleetTarget
from mission.fleet.events import (
    BatteryReported,
    ClockReported,
    FleetAnnounce,
    FleetEvent,
    ForeignAircraftReported,
    LaunchRequested,
    Tell,
    Tick,
)
from mission.fleet.reports import FleetReporter

RADIUS_M, SPEED_M_S = 50.0, 15.0
AIRCRAFT = Aircraft(SPEED_M_S, RADIUS_M)
REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 5.0)
LASER = Source("DISTANCE_SENSOR", 154, 1, 100)
GIMBAL = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
WEST, EAST = -300.0, 300.0  # of a target that goes north: its left and its right
TARGET_SPEED_M_S = 1.0


class Aside:
    """Stays; its cost is how far the aircraft is from the middle of its side of a target that goes north."""

    def __init__(self, requirement: Requirement) -> None:
        self.middle_m = WEST if requirement.side is Side.LEFT else EAST

    def decide(self, aircraft, target, present, wind, latency_s):
        off_m = abs(aircraft.east_m - self.middle_m)
        return Decision(aircraft.time_s, None, "", {"stay_cost_s": off_m, "move_cost_s": off_m + 1.0})


class Vehicle:
    """One aircraft that circles at a place; ahead_s: of its clock against mission time."""

    def __init__(self, name: str, east_m: float, ahead_s: float, height_m: float = 100.0) -> None:
        self.name, self.ahead_s, self.height_m = name, ahead_s, height_m
        self.circle = Circle(east_m, 0.0, RADIUS_M, True)
        self.reporter = FleetReporter(name)
        self.core = StandoffController(
            StandoffSettings(REQUIREMENT, AIRCRAFT),
            Tracker(TrackerSettings()),
            lambda _aircraft, wanted: Aside(wanted),
        )
        self.commands: list[Command] = []
        self.sees = True

    def fly(self, mission_time_s: float) -> list[FleetEvent]:
        time_s = mission_time_s + self.ahead_s
        course_rad = mission_time_s * SPEED_M_S / RADIUS_M
        east_m, north_m = self.circle.position_at_course(course_rad)
        velocity = SPEED_M_S * math.sin(course_rad), SPEED_M_S * math.cos(course_rad)
        bank_rad = math.atan(SPEED_M_S**2 / (9.80665 * RADIUS_M))
        target_m = TARGET_SPEED_M_S * mission_time_s
        yaw_rad = math.atan2(-east_m, target_m - north_m)
        slant_m = math.hypot(east_m, target_m - north_m, self.height_m)
        pitch_rad = -math.asin(self.height_m / slant_m)
        half = 0.5 * yaw_rad, 0.5 * pitch_rad
        sight = (
            math.cos(half[0]) * math.cos(half[1]),
            -math.sin(half[0]) * math.sin(half[1]),
            math.cos(half[0]) * math.sin(half[1]),
            math.sin(half[0]) * math.cos(half[1]),
        )
        events = [
            AttitudeReading(time_s, bank_rad, 0.0, course_rad),
            PositionReading(time_s, east_m, north_m, self.height_m, *velocity, 0.0),
        ]
        if self.sees:
            events += [
                GimbalReading(time_s, sight, "earth", GIMBAL),
                RangeReading(time_s, slant_m, LASER, quality=0.9),
            ]
        return [news for event in events for news in self.take(event, mission_time_s)]

    def take(self, event, mission_time_s: float) -> list[FleetEvent]:
        outputs = self.core.step(event)
        self.commands += outputs
        return list(self.reporter.after(self.core, event, outputs, mission_time_s))


class Fleet:
    def __init__(self, *vehicles: Vehicle, reserve: str = "") -> None:
        self.vehicles = {one.name: one for one in vehicles}
        members = [FleetMember(one.name, AIRCRAFT, TrackerSettings(), one.height_m) for one in vehicles]
        if reserve:
            members.append(FleetMember(reserve, AIRCRAFT, TrackerSettings(), 250.0, reserve=True))
        self.coordinator = FleetCoordinator(
            members, [FleetTarget("boat", REQUIREMENT)], lambda _name, requirement: Aside(requirement)
        )
        self.journal: list[FleetEvent] = []
        self.said: list[FleetAnnounce | LaunchRequested] = []
        self.time_s = 0.0
        for one in vehicles:
            self.tell(ClockReported(one.name, one.ahead_s, 0.0, 0.01))
            for news in one.take(ControlAcquired(one.ahead_s, one.circle, "AUTO"), 0.0):
                self.tell(news)

    def tell(self, event: FleetEvent) -> None:
        self.journal.append(event)
        for command in self.coordinator.step(event):
            if isinstance(command, Tell):
                for news in self.vehicles[command.name].take(command.event, self.time_s):
                    self.tell(news)
            else:
                self.said.append(command)

    def fly(self, duration_s: float, *absent: str) -> None:
        for _ in range(round(duration_s * 10)):
            self.time_s = round(self.time_s + 0.1, 6)
            self.tell(Tick(self.time_s))
            for name, vehicle in self.vehicles.items():
                if name not in absent:
                    for news in vehicle.fly(self.time_s):
                        self.tell(news)

    def role(self, name: str) -> Role:
        return self.coordinator.roles[name][1]


def pair(**other) -> Fleet:
    return Fleet(Vehicle("a", WEST, 100.0), Vehicle("b", EAST, -40.0, **{"height_m": 160.0, **other}))


def test_each_is_told_its_side_and_decides_by_the_joint_estimate():
    fleet = pair()
    fleet.vehicles["b"].sees = False
    fleet.fly(20.0)
    assert (fleet.role("a"), fleet.role("b")) == (Role.WANTED, Role.OPPOSITE)
    assert fleet.vehicles["b"].core.snapshot().side is Side.RIGHT
    seen = fleet.vehicles["b"].core.estimate  # it has no sighting of its own
    assert seen is not None
    assert seen.time_s == pytest.approx(fleet.time_s - 40.0, abs=2.5)  # on its own clock
    assert math.hypot(seen.east_m, seen.north_m - TARGET_SPEED_M_S * (seen.time_s + 40.0)) < 1.0


def test_the_one_left_takes_the_wanted_side_when_the_other_falls_silent():
    fleet = pair()
    fleet.fly(10.0)
    fleet.fly(8.0, "a")
    assert fleet.role("b") is Role.WANTED
    assert any("nothing was heard" in said.text for said in fleet.said if said.name == "a")
    fleet.fly(5.0)
    assert any(said.text == "is back" for said in fleet.said)


def test_a_low_battery_is_relieved_by_the_other_and_a_reserve_is_asked_for_where_there_is_none():
    fleet = pair()
    fleet.fly(10.0)
    fleet.tell(BatteryReported("a", 0.0, 0.25))
    fleet.fly(10.0)
    assert fleet.role("b") is Role.WANTED or fleet.vehicles["a"].core.phase is Phase.WATCHING
    alone = Fleet(Vehicle("a", WEST, 0.0), reserve="c")
    alone.fly(5.0)
    alone.tell(BatteryReported("a", 0.0, 0.25))
    alone.fly(5.0)
    assert [said.name for said in alone.said if isinstance(said, LaunchRequested)] == ["c"]
    assert alone.vehicles["a"].core.phase is Phase.WATCHING
    alone.tell(BatteryReported("a", 0.0, 0.1))
    alone.fly(2.0)
    assert [command.action for command in alone.vehicles["a"].commands if isinstance(command, End)] == ["return"]


def test_no_plan_leads_near_another_at_the_same_height():
    for height_m, refused in ((100.0, True), (160.0, False)):
        fleet = pair(height_m=height_m)
        fleet.fly(5.0)
        core = fleet.vehicles["a"].core
        towards = core.cleared(Plan(Circle(EAST - 120.0, 0.0, RADIUS_M, True), None, core.time_s + 1.0))
        assert isinstance(towards, str) is refused
        if refused:
            assert "b" in towards


def test_a_foreign_aircraft_counts_as_an_obstacle_while_it_is_heard():
    fleet = pair()
    fleet.fly(5.0)
    core = fleet.vehicles["a"].core
    here = Plan(fleet.vehicles["a"].circle, None, core.time_s + 1.0)
    assert isinstance(core.cleared(here), Plan)
    fleet.tell(ForeignAircraftReported("ICAO 4b1805", fleet.time_s, WEST - 200.0, 0.0, 110.0, math.pi / 2, 20.0))
    fleet.fly(1.5)
    assert "4b1805" in str(core.cleared(here))
    fleet.fly(40.0)
    assert isinstance(core.cleared(here), Plan)


def test_the_same_events_lead_to_the_same_commands():
    fleet = pair()
    fleet.fly(10.0)
    again = pair().coordinator
    for event in fleet.journal:
        again.step(event)
    first, second = fleet.coordinator.estimate("boat"), again.estimate("boat")
    assert first is not None
    assert second is not None
    assert (first.covariance == second.covariance).all()
    assert (first.east_m, first.north_m) == (second.east_m, second.north_m)
    assert not any(isinstance(command, UploadPlan) for command in fleet.vehicles["a"].commands)
