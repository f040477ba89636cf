"""The fleet's coordinator above two real control steps, whose clocks differ."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from dataclasses import replace

import pytest

from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.tracking.tracker import Tracker, TrackerSettings
from sidelong.mission.control.controller import StandoffController, StandoffSettings
from sidelong.mission.control.present import Phase
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import (
    Announce,
    Command,
    ControlAcquired,
    End,
    MissionChange,
    RouteGiven,
    UploadPlan,
)
from sidelong.mission.core.fleet import FleetAdvice, Role
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side
from sidelong.mission.exchange.outbox import ExternalControl
from sidelong.mission.fleet.coordinator import FleetCoordinator, FleetTarget, assign_evenly
from sidelong.mission.fleet.events import (
    ChargeReported,
    ClockReported,
    FleetAnnounce,
    FleetEvent,
    ForeignAircraftReported,
    LaunchRequested,
    PlansReported,
    ReliefRequested,
    RequirementChanged,
    SideRequested,
    SightingReported,
    TargetRouteGiven,
    Tick,
    VehicleEvent,
    VehicleReported,
)
from sidelong.mission.fleet.reports import FleetReporter
from sidelong.mission.fleet.roles import RoleCosts
from sidelong.mission.fleet.vehicle import FleetMember
from sidelong.mission.geometry.separation import MIN_SEPARATION_M, circles_apart_m
from sidelong.mission.route.route import progress_of

RADIUS_M, SPEED_M_S = 50.0, 15.0
AIRCRAFT = Aircraft(SPEED_M_S, RADIUS_M)
REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 5.0)
LASER = Source("DISTANCE_SENSOR", 154, 1, 100)
GIMBAL = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
WEST, EAST = -300.0, 300.0  # of a target that goes north: its left and its right
TARGET_SPEED_M_S = 1.0
ROUTE = RouteGiven(0.0, (0.0, 0.0), (-1000.0, 1000.0), False, 10.0, None, "either")


class Aside:
    """Stays; a role costs it as much as it is from the middle of that side of a target that goes north."""

    def __init__(self, requirement: Requirement) -> None:
        self.middle_m = WEST if requirement.side is Side.LEFT else EAST
        self.course_rad = math.nan

    def decide(self, aircraft, target, present, wind, latency_s):
        return Decision(aircraft.time_s, None, "")

    def role_costs(self, aircraft, target, present, wind, latency_s):
        off_m = aircraft.east_m - target.east_m
        return RoleCosts(abs(off_m - self.middle_m) / 5.0, abs(off_m + self.middle_m) / 5.0)

    def presume(self, course_rad):
        self.course_rad = course_rad

    def follow(self, route, progress):
        self.route, self.progress = route, progress


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
        self.sees, self.shift_m = True, 0.0  # of what it sees, towards east
        self.yaw_error_rad = 0.0
        self.phase_rad = 0.0

    def fly(self, mission_time_s: float) -> list[FleetEvent]:
        time_s = mission_time_s + self.ahead_s
        course_rad = mission_time_s * SPEED_M_S / RADIUS_M + self.phase_rad
        east_m, north_m = self.circle.position_at_course(course_rad)
        velocity = SPEED_M_S * math.sin(course_rad), SPEED_M_S * math.cos(course_rad)
        bank_rad = math.atan(SPEED_M_S**2 / (9.80665 * RADIUS_M))
        target_m = TARGET_SPEED_M_S * mission_time_s
        off_m = self.shift_m - east_m
        yaw_rad = math.atan2(off_m, target_m - north_m) + self.yaw_error_rad
        slant_m = math.hypot(off_m, target_m - north_m, self.height_m)
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
        self.members = members
        self.coordinator = self.new_coordinator()
        self.journal: list[FleetEvent] = []
        self.advice: dict[str, FleetAdvice] = {}  # the last of each aircraft
        self.routes: dict[str, list[RouteGiven]] = defaultdict(list)
        self.announced: list[FleetAnnounce | LaunchRequested | RequirementChanged] = []
        self.time_s = 0.0
        for one in vehicles:
            self.put_event(ClockReported(one.name, one.ahead_s, 0.0, 0.01))
            for news in one.take(ControlAcquired(one.ahead_s, one.circle, "AUTO"), 0.0):
                self.put_event(news)

    def new_coordinator(self) -> FleetCoordinator:
        self.judged: list[Aircraft] = []  # the aircraft as the coordinator takes them to be
        self.judges: list[Aside] = []

        def judge(_name: str, aircraft: Aircraft, requirement: Requirement) -> Aside:
            self.judged.append(aircraft)
            self.judges.append(Aside(requirement))
            return self.judges[-1]

        return FleetCoordinator(self.members, [FleetTarget("boat", REQUIREMENT)], judge)

    def put_event(self, event: FleetEvent) -> None:
        self.journal.append(event)
        for command in self.coordinator.step(event):
            if isinstance(command, VehicleEvent):
                if isinstance(command.event, FleetAdvice):
                    self.advice[command.name] = command.event
                if isinstance(command.event, RouteGiven):
                    self.routes[command.name].append(command.event)
                for news in self.vehicles[command.name].take(command.event, self.time_s):
                    self.put_event(news)
            else:
                self.announced.append(command)

    def fly(self, duration_s: float, *absent: str) -> None:
        for _ in range(round(duration_s * 10)):
            self.time_s = round(self.time_s + 0.1, 6)
            self.put_event(Tick(self.time_s))
            for name, vehicle in self.vehicles.items():
                if name not in absent:
                    for news in vehicle.fly(self.time_s):
                        self.put_event(news)

    def role(self, name: str) -> Role:
        return self.coordinator.roles[name][1]


def pair(**other) -> Fleet:
    return Fleet(Vehicle("a", WEST, 100.0), Vehicle("b", EAST, -40.0, **{"height_m": 160.0, **other}))


def test_each_is_reported_its_side_and_decides_by_the_joint_estimate():
    fleet = pair()
    fleet.vehicles["b"].sees = False
    fleet.fly(20.0)
    assert (fleet.role("a"), fleet.role("b")) == (Role.WANTED, Role.OPPOSITE)
    assert fleet.vehicles["b"].core.snapshot().side is Side.RIGHT
    seen = fleet.vehicles["b"].core.estimate  # it has no sighting of its own
    assert seen is not None
    assert seen.time_s == pytest.approx(fleet.time_s - 40.0, abs=2.5)  # on its own clock
    assert math.hypot(seen.east_m, seen.north_m - TARGET_SPEED_M_S * (seen.time_s + 40.0)) < 1.0


def test_all_go_by_one_course_also_who_comes_later():
    fleet = pair()
    fleet.fly(30.0, "b")
    assert fleet.advice["a"].course_rad == pytest.approx(0.0, abs=0.1)
    assert "b" not in fleet.advice
    fleet.fly(3.0)
    assert fleet.role("b") is Role.OPPOSITE
    assert fleet.advice["b"].course_rad == fleet.advice["a"].course_rad
    assert {judge.course_rad for judge in fleet.judges} == {fleet.advice["b"].course_rad}


def test_the_one_left_takes_the_required_side_when_the_other_falls_silent():
    fleet = pair()
    fleet.fly(10.0)
    fleet.fly(8.0, "a")
    assert fleet.role("b") is Role.WANTED
    assert any("no message received" in announced.text for announced in fleet.announced if announced.name == "a")
    fleet.fly(5.0)
    assert any(announced.text == "is back" for announced in fleet.announced)


def test_sightings_that_are_left_out_are_announced_and_so_is_their_return():
    fleet = Fleet(Vehicle("a", WEST, 0.0), Vehicle("b", EAST, 0.0, 160.0), Vehicle("c", EAST, 0.0, 220.0))
    fleet.fly(20.0)
    fleet.vehicles["c"].shift_m = 60.0
    fleet.fly(15.0)
    fleet.vehicles["c"].shift_m = 0.0
    fleet.fly(40.0)
    announced = [one.text for one in fleet.announced if one.name == "c" and "sightings" in one.text]
    left_out = r"its sightings are left out: it sees the target \d+ m from where the others do"
    assert re.fullmatch(left_out, announced[0])
    assert announced[1:] == ["its sightings are used again"]


def test_a_payload_that_is_used_for_a_moment_is_not_announced_again():
    fleet = pair()
    fleet.fly(20.0)
    fleet.vehicles["b"].shift_m = 60.0
    for _ in range(5):
        fleet.fly(10.0)
        for one in fleet.vehicles.values():
            one.sees = False
        fleet.fly(2.0)
        for one in fleet.vehicles.values():
            one.sees = True
    announced = [(one.name, "left out" in one.text) for one in fleet.announced if "sightings" in one.text]
    assert announced == [("b", True)]


def error_m(fleet: Fleet) -> float:
    now = fleet.coordinator.estimate("boat")
    return math.hypot(now.east_m, now.north_m - TARGET_SPEED_M_S * now.time_s)


def test_two_payloads_that_contradict_each_other_are_reported_and_each_aircraft_watches_by_its_own():
    fleet = pair()
    fleet.vehicles["b"].yaw_error_rad = math.radians(20.0)
    fleet.fly(15.0)
    for name, other in (("a", "b"), ("b", "a")):
        (text,) = [one.text for one in fleet.announced if one.name == name]
        assert re.fullmatch(
            rf"its sightings are left out: it sees .* from where {other} does; either may be .*", text
        )
        assert fleet.advice[name].estimate is None
    estimate = fleet.vehicles["a"].core.estimate
    assert math.hypot(estimate.east_m, estimate.north_m - TARGET_SPEED_M_S * (estimate.time_s - 100.0)) < 5.0
    assert fleet.coordinator.estimate("boat").ellipse_95.semi_major_m > 50.0


def test_a_payload_whose_target_has_jumped_does_not_lead():
    fleet = pair()
    fleet.fly(20.0)
    fleet.vehicles["b"].shift_m = 60.0
    fleet.fly(30.0)
    (text,) = [one.text for one in fleet.announced if one.name == "b"]
    jumped = (
        r"its sightings are left out: it sees the target \d+ m from where a does: its target's position has jumped"
    )
    assert re.fullmatch(jumped, text)
    assert not [one for one in fleet.announced if one.name == "a"]
    assert fleet.advice["b"].estimate is not None
    assert error_m(fleet) < 3.0


def test_a_yaw_error_that_an_aircraft_corrects_is_shared_corrected():
    fleet = pair()
    fleet.vehicles["b"].yaw_error_rad = math.radians(90.0)
    fleet.fly(100.0)
    assert "its sightings are used again" in [one.text for one in fleet.announced if one.name == "b"]
    assert fleet.advice["a"].estimate is not None
    assert error_m(fleet) < 3.0


@pytest.mark.parametrize("off_s", [-11.0, 11.0])
def test_a_clock_that_is_set_wrong_for_a_while_is_no_silence(off_s):
    fleet = pair()
    fleet.fly(10.0)
    ahead_s = fleet.vehicles["a"].ahead_s
    fleet.put_event(ClockReported("a", fleet.time_s + ahead_s, fleet.time_s + off_s, 0.02))
    fleet.fly(5.0)
    fleet.put_event(ClockReported("a", fleet.time_s + ahead_s, fleet.time_s, 0.02))
    fleet.fly(20.0)
    assert not any(
        "is out" in announced.text for announced in fleet.announced if isinstance(announced, FleetAnnounce)
    )
    fleet.fly(8.0, "a")
    announced = [announced.text for announced in fleet.announced if announced.name == "a"]
    assert announced == [
        f"its UTC jumped by {off_s:.1f} s: it is not used while it is off",
        "its UTC is used again",
        "is out: no message received for 6 s",
    ]


def test_jump_of_one_utc_is_reported_once_and_does_not_move_mission_time():
    fleet = Fleet(Vehicle("a", WEST, ahead_s=500.0), Vehicle("b", EAST, ahead_s=-80.0))
    fleet.fly(5.0)
    for off_s in [0.0] * 10 + [3600.0] * 4 + [0.0] * 10:
        fleet.fly(1.0)
        for one in fleet.vehicles.values():
            own_s = off_s if one.name == "a" else 0.0
            fleet.put_event(ClockReported(one.name, fleet.time_s + one.ahead_s, fleet.time_s + own_s, 0.02))
        assert fleet.advice["b"].time_s == pytest.approx(fleet.time_s - 80.0, abs=1.5)
    announced = [(one.name, one.text) for one in fleet.announced if "UTC" in one.text]
    assert announced == [
        ("a", "its UTC jumped by 3600.0 s: it is not used while it is off"),
        ("a", "its UTC is used again"),
    ]


@pytest.mark.parametrize(
    ("first_s", "then_s", "taken"),
    [(-18.0, 0.0, True), (0.0, -18.0, False), (0.0, 0.8, True), (0.0, 3600.0, False)],
)
def test_lasting_jump_counts_if_it_is_small_or_agrees_with_another_clock(first_s, then_s, taken):
    fleet = Fleet(Vehicle("a", WEST, ahead_s=0.0), Vehicle("b", EAST, ahead_s=0.0))
    coordinator = fleet.new_coordinator()
    for second in range(40):
        off_s = first_s if second < 10 else then_s
        coordinator.step(ClockReported("a", 100.0 + second, second + off_s, 0.02))
        coordinator.step(ClockReported("b", 700.0 + second, second, 0.02))
        if second in (9, 20):
            assert coordinator.offset_s("a") == pytest.approx(first_s - 100.0, abs=0.01)
    assert coordinator.offset_s("a") == pytest.approx((then_s if taken else first_s) - 100.0, abs=0.01)


def test_clock_of_a_rebooted_autopilot_counts_at_once():
    coordinator = Fleet(Vehicle("a", WEST, ahead_s=0.0)).new_coordinator()
    coordinator.step(ClockReported("a", 1000.0, 5000.0, 0.02))
    coordinator.step(ClockReported("a", 3.0, 5010.0, 0.02))
    assert coordinator.offset_s("a") == pytest.approx(5007.0)


def test_one_that_circles_about_the_target_does_not_take_the_side_from_one_that_watches():
    fleet = pair()
    holder, near = fleet.vehicles["a"], fleet.vehicles["b"]
    holder.circle, near.circle = Circle(-60.0, 250.0, RADIUS_M, True), Circle(-40.0, 0.0, RADIUS_M, True)
    near.phase_rad = math.pi  # it would cost less now and then, and see nothing from there
    held = []
    for _ in range(40):
        fleet.fly(1.0)
        held.append(fleet.role("a"))
    assert set(held[3:]) == {Role.WANTED}


def test_a_low_battery_gives_up_the_side_and_goes_home_once_another_one_watches():
    fleet = pair()
    fleet.fly(10.0)
    fleet.put_event(ChargeReported("a", 0.0, 0.25))
    fleet.fly(10.0)
    assert fleet.role("a") is fleet.role("b") is Role.WANTED  # b is still on the other side
    assert fleet.vehicles["a"].core.phase is Phase.WATCHING
    fleet = Fleet(Vehicle("a", WEST, 0.0), Vehicle("b", WEST - 30.0, 0.0, 160.0))
    fleet.fly(10.0)
    assert fleet.role("a") is Role.WANTED
    fleet.put_event(ChargeReported("a", 0.0, 0.25))
    fleet.fly(5.0)
    assert [command.action for command in fleet.vehicles["a"].commands if isinstance(command, End)] == ["return"]
    assert (fleet.role("b"), fleet.vehicles["b"].core.phase) == (Role.WANTED, Phase.WATCHING)


def test_whoever_is_alone_asks_for_a_reserve_and_leaves_without_one_only_when_it_must():
    alone = Fleet(Vehicle("a", WEST, 0.0), reserve="c")
    alone.fly(5.0)
    alone.put_event(ReliefRequested("a", alone.time_s))
    alone.fly(5.0)
    assert [announced.name for announced in alone.announced if isinstance(announced, LaunchRequested)] == ["c"]
    assert alone.vehicles["a"].core.phase is Phase.WATCHING
    alone.put_event(ChargeReported("a", 0.0, 0.1))
    alone.fly(2.0)
    assert [command.action for command in alone.vehicles["a"].commands if isinstance(command, End)] == ["return"]


def test_whoever_has_watched_for_its_time_is_relieved_by_the_other():
    fleet = Fleet(Vehicle("a", WEST, 0.0), Vehicle("b", WEST - 30.0, 0.0, 160.0))
    fleet.members[0] = replace(fleet.members[0], endurance_s=20.0)
    fleet.coordinator = fleet.new_coordinator()
    for one in fleet.vehicles.values():
        fleet.put_event(ClockReported(one.name, 0.0, 0.0, 0.01))
        fleet.put_event(PlansReported(one.name, Plan(one.circle)))
    fleet.fly(15.0)
    assert fleet.role("a") is Role.WANTED
    fleet.fly(10.0)
    assert (fleet.role("a"), fleet.role("b")) == (Role.LEAVE, Role.WANTED)
    assert [command.action for command in fleet.vehicles["a"].commands if isinstance(command, End)] == ["return"]


def test_a_persons_side_holds_for_all_at_once_and_is_not_taken_back():
    fleet = pair()
    fleet.fly(10.0)
    fleet.put_event(SideRequested(fleet.time_s, Side.RIGHT, "operator 1"))
    fleet.fly(1.5)
    for _ in range(5):
        assert (fleet.role("a"), fleet.role("b")) == (Role.OPPOSITE, Role.WANTED)
        assert [one.core.snapshot().side for one in fleet.vehicles.values()] == [Side.LEFT, Side.RIGHT]
        fleet.fly(4.0)
    changed = [announced for announced in fleet.announced if isinstance(announced, RequirementChanged)]
    assert [(one.target, one.requirement) for one in changed] == [("boat", replace(REQUIREMENT, side=Side.RIGHT))]


def test_a_band_that_one_core_took_up_holds_for_the_roles_and_leaves_the_required_side():
    fleet = pair()
    fleet.fly(10.0)
    fleet.put_event(SideRequested(fleet.time_s, Side.RIGHT))
    for vehicle in fleet.vehicles.values():
        change = MissionChange(vehicle.core.time_s, radius_m=60.0, range_min_m=150.0)
        for news in vehicle.take(change, fleet.time_s):
            fleet.put_event(news)
    fleet.fly(2.0)
    assert fleet.coordinator.requirement("boat") == replace(REQUIREMENT, range_min_m=150.0, side=Side.RIGHT)
    flown = {one.core.settings.aircraft.radius_m for one in fleet.vehicles.values()}
    assert flown == {made.radius_m for made in fleet.judged[-2:]} == {60.0}
    assert (fleet.role("a"), fleet.role("b")) == (Role.OPPOSITE, Role.WANTED)


def test_a_reserve_is_asked_for_when_no_one_is_left():
    fleet = Fleet(Vehicle("a", WEST, 0.0), Vehicle("b", EAST, 0.0, 160.0), reserve="c")
    fleet.fly(5.0)
    fleet.fly(8.0, "b")
    assert not any(isinstance(announced, LaunchRequested) for announced in fleet.announced)
    fleet.fly(8.0, "a", "b")
    assert [announced.name for announced in fleet.announced if isinstance(announced, LaunchRequested)] == ["c"]


def test_aircraft_are_given_out_to_the_targets_and_a_lost_target_frees_its_own():
    members = [FleetMember(name, AIRCRAFT, TrackerSettings(), 100.0 + 60.0 * k) for k, name in enumerate("abcd")]
    targets = [FleetTarget(name, REQUIREMENT) for name in ("boat", "bike")]
    members = [replace(one, target="bike" if one.name == "d" else "boat") for one in members]
    coordinator = FleetCoordinator(members, targets, lambda _name, _aircraft, requirement: Aside(requirement))
    routes: list[tuple[str, bool]] = []  # which aircraft got a route, or none
    places = {"a": (-300.0, 0.0), "b": (300.0, 0.0), "c": (2700.0, 0.0), "d": (3300.0, 0.0)}

    def fly(from_s: int, until_s: int, unseen: str = "") -> None:
        for k in range(from_s, until_s):
            for command in coordinator.step(Tick(float(k))):
                if isinstance(command, VehicleEvent) and isinstance(command.event, RouteGiven):
                    routes.append((command.name, command.event.east_m == ROUTE.east_m))
            for name, (east_m, north_m) in places.items():
                state = AircraftState(float(k), east_m, north_m, 0.0, SPEED_M_S, 1.0 / RADIUS_M)
                coordinator.step(VehicleReported(name, float(k), state, 100.0, watching=True))
                target = coordinator.roles[name][0]
                off_m = (0.0 if target == "boat" else 3000.0) - east_m
                slant_m, drop_rad = math.hypot(off_m, 100.0), math.atan2(100.0, abs(off_m))
                bearing_rad = math.copysign(math.pi / 2, off_m)
                if target != unseen:
                    seen = Sighting(float(k), slant_m, bearing_rad, drop_rad, 1.0, 0.01, 0.01, east_m, north_m, 100.0)
                    coordinator.step(SightingReported(name, seen))

    for name, place in places.items():
        coordinator.step(ClockReported(name, 0.0, 0.0, 0.01))
        circle = Circle(*place, RADIUS_M, True)
        coordinator.step(PlansReported(name, Plan(circle)))
    coordinator.step(TargetRouteGiven("boat", ROUTE))
    fly(0, 10)
    assert routes == [("a", True), ("b", True)]
    assert {name: target for name, (target, _) in coordinator.roles.items()} == {
        "a": "boat",
        "b": "boat",
        "c": "bike",
        "d": "bike",
    }
    places |= {"b": places["c"], "c": places["b"]}
    fly(10, 14)
    assert coordinator.roles["b"][0] == "boat"  # what is gained has to last
    fly(14, 20)
    assert (coordinator.roles["b"][0], coordinator.roles["c"][0]) == ("bike", "boat")
    assert routes[2:] == [("b", False), ("c", True)]
    fly(20, 90, unseen="bike")
    assert {target for target, _ in coordinator.roles.values()} == {"boat"}


def cleared(core, plan):
    core.surroundings.flown = core.flown
    return core.surroundings.cleared(plan)


def test_no_plan_leads_near_another_at_the_same_height():
    for height_m, refused in ((100.0, True), (160.0, False)):
        fleet = pair(height_m=height_m)
        fleet.fly(5.0)
        core = fleet.vehicles["a"].core
        towards = cleared(core, Plan(Circle(EAST - 120.0, 0.0, RADIUS_M, True), None, core.time_s + 1.0))
        assert isinstance(towards, str) is refused
        if refused:
            assert "b" in towards


def alarm(fleet: Fleet, name: str) -> str:
    """Return the alarm about separation that the core of an aircraft knows."""
    return fleet.vehicles[name].core.snapshot().separation


def test_aircraft_that_sinks_out_of_its_layer_raises_an_alarm_and_leaves_its_circle():
    fleet = Fleet(Vehicle("a", WEST, 100.0, 100.0), Vehicle("b", WEST + 60.0, -40.0, 160.0))
    fleet.fly(10.0)
    upper, lower = fleet.vehicles["b"], fleet.vehicles["a"]
    assert alarm(fleet, "b") == ""
    assert not any(isinstance(command, UploadPlan) for command in upper.commands + lower.commands)
    for _ in range(150):
        upper.height_m -= 0.1
        fleet.fly(0.1)
    crossing = r"the height differs by only 4\d m from that of a, and their circles cross"
    assert re.fullmatch(rf"only 4\d m from a; 50 m are required|{crossing}", alarm(fleet, "b"))
    assert alarm(fleet, "a") == ""
    assert not any(isinstance(command, UploadPlan) for command in lower.commands)
    (upload,) = [command for command in upper.commands if isinstance(command, UploadPlan)]
    circle, target_m = upload.plan.circle, (0.0, TARGET_SPEED_M_S * fleet.time_s)
    assert circles_apart_m(circle, lower.circle) >= MIN_SEPARATION_M
    range_m = math.dist((circle.east_m, circle.north_m), target_m)
    assert 100.0 + RADIUS_M < range_m < 500.0 - RADIUS_M
    assert upper.core.settings.requirement.side is Side.RIGHT
    assert circle.east_m > 0.4 * range_m
    (reason,) = [one.text for one in upper.commands if isinstance(one, Announce) and "leaving" in one.text]
    assert reason.startswith("leaving the circle: a is only 4")

    fleet.put_event(PlansReported("b", Plan(circle)))  # it has departed, and circles there
    fleet.fly(10.0)
    assert alarm(fleet, "b") == ""


def test_of_two_taken_over_side_by_side_the_one_below_its_layer_climbs():
    fleet = Fleet(Vehicle("a", WEST, 100.0, 100.0), Vehicle("b", WEST, -40.0, 160.0))
    upper, lower = fleet.vehicles["b"], fleet.vehicles["a"]
    upper.height_m = 100.0
    fleet.fly(10.0)
    assert alarm(fleet, "a") or alarm(fleet, "b")
    assert not any(isinstance(command, UploadPlan) for command in lower.commands)
    (upload,) = [command for command in upper.commands if isinstance(command, UploadPlan)]
    assert (upload.plan.circle, upload.plan.transition) == (upper.circle, None)
    assert "climbing to 160 m on the present circle" in upload.reason


def test_reported_distance_below_the_required_one_always_raises_an_alarm():
    fleet = pair()
    fleet.fly(5.0)
    fleet.vehicles["b"].height_m = 100.0  # on circles far apart
    fleet.fly(5.0)
    assert (alarm(fleet, "a"), alarm(fleet, "b")) == ("", "")
    where = fleet.vehicles["a"].core.aircraft
    fleet.put_event(ForeignAircraftReported("system 9", fleet.time_s, where.east_m, where.north_m, 120.0, 0.0, 0.0))
    fleet.fly(1.0)
    assert re.fullmatch(r"only \d\d m from system 9; 50 m are required", alarm(fleet, "a"))
    fleet.fly(10.0)
    assert alarm(fleet, "a") == ""


def test_another_program_on_the_same_fleet_is_reported_and_does_not_share_a_layer_silently():
    fleet = pair()
    fleet.fly(5.0)
    taken = fleet.vehicles["b"]
    stolen = ExternalControl(taken.core.time_s, "another station has changed the mission")
    outputs = (stolen, *taken.core.step(stolen))
    for news in taken.reporter.after(taken.core, object(), outputs, fleet.time_s):
        fleet.put_event(news)
    raised = []
    for height_m in [160.0] + 5 * [104.0] + 6 * [160.0]:
        report = ForeignAircraftReported("b", fleet.time_s, EAST, 0.0, height_m, 0.0, 15.0, member=True)
        fleet.put_event(report)
        fleet.fly(1.0, "b")
        raised.append(alarm(fleet, "a"))
    text = "the height differs by only 4 m from that of b, which was yielded and may come here"
    assert set(raised) == {"", text}
    assert raised[0] == raised[-1] == ""
    assert [announced.text for announced in fleet.announced] == [
        "is out: another station has changed the mission; make sure that only one program commands the fleet"
    ]
    assert [one.name for one in fleet.advice["a"].neighbours if one.ours] == []


def test_a_foreign_aircraft_counts_as_an_obstacle_while_it_is_received():
    fleet = pair()
    fleet.fly(5.0)
    core = fleet.vehicles["a"].core
    here = Plan(fleet.vehicles["a"].circle, None, core.time_s + 1.0)
    assert isinstance(cleared(core, here), Plan)
    fleet.put_event(ForeignAircraftReported("ICAO 4b1805", fleet.time_s, WEST - 200.0, 0.0, 110.0, math.pi / 2, 20.0))
    fleet.fly(1.5)
    assert "4b1805" in str(cleared(core, here))
    fleet.fly(40.0)
    assert isinstance(cleared(core, here), Plan)


def test_a_payload_that_sees_something_else_is_reported():
    fleet = Fleet(*(Vehicle(name, east_m, 0.0, 100.0 + 60.0 * k) for k, (name, east_m) in enumerate(
        (("a", WEST), ("b", EAST), ("c", EAST + 80.0)))))  # fmt: skip
    fleet.fly(10.0)
    fleet.vehicles["c"].shift_m = 60.0
    fleet.fly(15.0)
    assert any("left out" in announced.text for announced in fleet.announced if announced.name == "c")
    estimate = fleet.coordinator.estimate("boat")
    assert estimate is not None
    assert math.hypot(estimate.east_m, estimate.north_m - TARGET_SPEED_M_S * estimate.time_s) < 2.0


def test_route_goes_to_each_aircraft_at_its_own_time_and_its_progress_to_all_judges():
    fleet = pair()
    fleet.put_event(TargetRouteGiven("boat", ROUTE))
    fleet.fly(20.0)
    for name, vehicle in fleet.vehicles.items():
        (given,) = fleet.routes[name]
        assert given == replace(ROUTE, time_s=given.time_s)
        assert 0.0 < given.time_s - vehicle.ahead_s < 2.0
    assert {judge.route.length_m for judge in fleet.judges} == {2000.0}
    along_m = progress_of(fleet.judges[0].route, fleet.judges[0].progress).along_m
    assert along_m == pytest.approx(1000.0 + TARGET_SPEED_M_S * fleet.time_s, abs=15.0)
    assert fleet.judges[0].progress is fleet.judges[1].progress
    fleet.put_event(SideRequested(fleet.time_s, Side.RIGHT))
    assert fleet.judges[-1].progress is fleet.judges[0].progress


def test_the_same_events_lead_to_the_same_commands():
    fleet = pair()
    fleet.fly(10.0)
    again = fleet.new_coordinator()
    for event in fleet.journal:
        again.step(event)
    first, second = fleet.coordinator.estimate("boat"), again.estimate("boat")
    assert first is not None
    assert second is not None
    assert (first.covariance == second.covariance).all()
    assert (first.east_m, first.north_m) == (second.east_m, second.north_m)
    assert not any(isinstance(command, UploadPlan) for command in fleet.vehicles["a"].commands)


@pytest.mark.parametrize(
    ("at", "costs_s", "given", "gained_s"),
    [
        (["x", "x", "y"], [[10, 90], [20, 80], [90, 10]], ["x", "x", "y"], 0.0),
        (["x", "y", "y"], [[10, 90], [80, 20], [90, 10]], ["x", "y", "y"], 0.0),  # whoever is over may be with either
        (["x", "x", "x"], [[10, 90], [20, 40], [10, 70]], ["x", "y", "x"], math.inf),
        (["x", "y", "y"], [[10, 90], [10, 60], [90, 10]], ["x", "x", "y"], 50.0),
        (["", "", ""], [[10, 90], [80, 20], [90, 10]], ["x", "y", "y"], math.inf),
    ],
)
def test_aircraft_are_spread_evenly_with_the_least_cost(at, costs_s, given, gained_s):
    costs = [[RoleCosts(each_s, each_s) for each_s in own] for own in costs_s]
    assert assign_evenly(["x", "y"], costs, at, 0.0) == (given, gained_s)


def test_each_goes_where_a_side_is_left_for_it():
    left, right = RoleCosts(5.0, 60.0), RoleCosts(60.0, 5.0)
    own = [[left, left], [right, left], [left, right], [right, right]]  # on which side of x and y each of them is
    given, gained_s = assign_evenly(["x", "y"], own, ["x", "x", "y", "y"], 0.0)
    assert gained_s == 55.0  # both next to y are on the same side of it
    assert given in (["x", "y", "y", "x"], ["y", "x", "x", "y"])
    two_left = [[left, left], [left, left], [right, right], [right, right]]
    given, gained_s = assign_evenly(["x", "y"], two_left, ["x", "x", "y", "y"], 0.0)
    assert sorted(given[:2]) == sorted(given[2:]) == ["x", "y"]
    assert gained_s == 110.0


def test_none_changes_its_target_for_less_than_a_change_costs():
    def alongside(*each_s: float) -> list[RoleCosts]:
        return [RoleCosts(one_s, one_s) for one_s in each_s]

    targets = ["x", "y"]
    assert assign_evenly(targets, [alongside(30, 10), alongside(10, 30)], ["x", "y"], 15.0) == (["y", "x"], 10.0)
    assert assign_evenly(targets, [alongside(24, 10), alongside(10, 24)], ["x", "y"], 15.0) == (["x", "y"], 0.0)
    assert assign_evenly(targets, [alongside(5, 5)] * 4, ["y", "x", "x", "y"], 15.0) == (["y", "x", "x", "y"], 0.0)
    # Also while another has to: of three next to x the one goes that is nearest to y, and the others stay.
    uneven = [alongside(10, 90), alongside(10, 60), alongside(10, 80), alongside(20, 14)]
    assert assign_evenly(targets, uneven, ["x", "x", "x", "y"], 15.0) == (["x", "y", "x", "y"], math.inf)
    # A target that no one sees is none of these: whoever is with it is free, and goes where most is wanted.
    assert assign_evenly(["x"], [alongside(10), alongside(90)], ["x", "z"], 15.0) == (["x", "x"], math.inf)
