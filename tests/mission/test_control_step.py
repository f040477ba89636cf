"""The control step's rules, with the real tracker and a planner that reports what it is reported."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.estimators.tracking.tracker import Tracker, TrackerSettings
from sidelong.mission.control.controller import StandoffController, StandoffSettings
from sidelong.mission.control.present import Phase
from sidelong.mission.control.surroundings import Surroundings
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import (
    ActivatePlan,
    Announce,
    Command,
    ControlAcquired,
    End,
    LinkReported,
    ModeReported,
    OperatorRequest,
    PlanStatus,
    RoundTripReported,
    UploadPlan,
    Yield,
    YieldRequested,
)
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import Decision, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side

RADIUS_M, SPEED_M_S, HEIGHT_M = 60.0, 15.0, 100.0
TARGET = (300.0, 0.0)
JOINED_S = 3.0
HERE = Circle(0.0, 0.0, RADIUS_M, True)
THERE = Circle(100.0, 50.0, RADIUS_M, True)
LASER = Source("DISTANCE_SENSOR", 154, 1, 100)
GIMBAL = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)


class Scripted:
    """A planner that proposes its plans one after another, each departing ``ahead_s`` after the decision."""

    def __init__(self, circles: Iterable[Circle] = (), ahead_s: float = 2.0) -> None:
        self.circles, self.ahead_s = list(circles), ahead_s
        self.latencies: list[float] = []

    def decide(self, aircraft, target, present, wind, latency_s):
        self.latencies.append(latency_s)
        if not self.circles:
            return Decision(aircraft.time_s, None, "staying")
        plan = Plan(self.circles.pop(0), None, aircraft.time_s + self.ahead_s)
        return Decision(aircraft.time_s, plan, "moving")


def make(planner: Scripted, **settings) -> StandoffController:
    requirement = Requirement(100.0, 500.0, Side.LEFT, 3.0)
    check = settings.pop("check", lambda _plan: None)
    return StandoffController(
        StandoffSettings(requirement, Aircraft(SPEED_M_S, RADIUS_M), **settings),
        Tracker(TrackerSettings()),
        lambda _aircraft, _requirement: planner,
        Surroundings(check),
    )


def fly(
    controller: StandoffController, start_s: float, end_s: float, *, seen: bool = True, radius_m: float = RADIUS_M
) -> list[Command]:
    """Fly round HERE's centre at 10 Hz, looking at a standing target; return the commands.

    A narrower circle touches HERE at JOINED_S, so that the aircraft rolls into it where it is.
    """
    commands: list[Command] = []
    joined_rad = JOINED_S * SPEED_M_S / RADIUS_M
    between_m = RADIUS_M - radius_m
    centre_m = between_m * math.sin(joined_rad), between_m * math.cos(joined_rad)
    for tick in range(round(start_s * 10), round(end_s * 10)):
        time_s = tick / 10
        turn_rad = joined_rad + (time_s - JOINED_S) * SPEED_M_S / radius_m
        east_m = centre_m[0] + radius_m * math.sin(turn_rad)
        north_m = centre_m[1] + radius_m * math.cos(turn_rad)
        course_rad = turn_rad + math.pi / 2
        bank_rad = math.atan(SPEED_M_S**2 / (9.80665 * radius_m))
        velocity = SPEED_M_S * math.sin(course_rad), SPEED_M_S * math.cos(course_rad)
        commands += controller.step(AttitudeReading(time_s, bank_rad, 0.0, course_rad))
        commands += controller.step(PositionReading(time_s, east_m, north_m, HEIGHT_M, *velocity, 0.0))
        if seen:
            away_m = math.hypot(TARGET[0] - east_m, TARGET[1] - north_m)
            yaw_rad = math.atan2(TARGET[0] - east_m, TARGET[1] - north_m)
            pitch_rad = -math.atan2(HEIGHT_M, away_m)
            quaternion = (
                math.cos(pitch_rad / 2) * math.cos(yaw_rad / 2),
                -math.sin(pitch_rad / 2) * math.sin(yaw_rad / 2),
                math.sin(pitch_rad / 2) * math.cos(yaw_rad / 2),
                math.cos(pitch_rad / 2) * math.sin(yaw_rad / 2),
            )
            commands += controller.step(GimbalReading(time_s, quaternion, "earth", GIMBAL))
            commands += controller.step(RangeReading(time_s, math.hypot(away_m, HEIGHT_M), LASER, quality=0.9))
    return commands


def kinds(commands: Iterable[Command], *wanted: type) -> list[Command]:
    return [command for command in commands if isinstance(command, wanted)]


def engaged(controller: StandoffController, until_s: float = 10.0) -> list[Command]:
    controller.step(ModeReported(0.0, "AUTO", True))
    controller.step(ControlAcquired(0.0, HERE, "AUTO"))
    return fly(controller, 0.0, until_s)


def test_nothing_is_commanded_before_engagement():
    controller = make(Scripted([THERE]))
    assert not kinds(fly(controller, 0.0, 20.0), UploadPlan, ActivatePlan, End)
    assert controller.phase is Phase.WAITING
    assert controller.snapshot().estimate is not None


def test_the_estimate_finds_the_target():
    controller = make(Scripted())
    engaged(controller, 30.0)
    estimate = controller.snapshot().estimate
    assert math.hypot(estimate.east_m - TARGET[0], estimate.north_m - TARGET[1]) < 2.0


def test_a_plan_is_prepared_then_departs_at_its_time():
    controller = make(Scripted([THERE], ahead_s=3.0))
    (prepare,) = kinds(engaged(controller, 3.0), UploadPlan)
    ready_s = prepare.time_s + 0.5
    assert not controller.step(PlanStatus(ready_s, prepare.number, "ready"))
    (depart,) = kinds(fly(controller, 3.0, 12.0), ActivatePlan)
    assert depart.time_s == pytest.approx(prepare.plan.departure_s, abs=0.11)
    controller.step(PlanStatus(depart.time_s + 0.1, depart.number, "departed"))
    assert controller.snapshot().plan.circle == THERE
    assert controller.snapshot().moves == 1


def test_only_one_plan_is_under_way():
    controller = make(Scripted([THERE, HERE, THERE]))
    assert len(kinds(engaged(controller, 30.0), UploadPlan)) == 1


def test_a_plan_ready_too_late_is_dropped_and_decided_again():
    controller = make(Scripted([THERE, THERE], ahead_s=1.0))
    (prepare,) = kinds(engaged(controller, 5.0), UploadPlan)
    commands = controller.step(PlanStatus(prepare.plan.departure_s + 5.0, prepare.number, "ready"))
    assert not kinds(commands, ActivatePlan)
    (again,) = kinds(fly(controller, 5.0, 8.0), UploadPlan)
    assert again.number == prepare.number + 1
    assert controller.snapshot().latency_s > 1.0


def test_the_latency_expected_follows_the_links_delay():
    controller = make(Scripted([]), latency_s=1.0)
    controller.step(RoundTripReported(1.0, 0.1))
    assert controller.snapshot().latency_s == 1.0  # as configured, before anything was uploaded
    controller.step(RoundTripReported(2.0, 1.5))
    assert controller.snapshot().latency_s == 3.0  # the announcement's round trip and the items'
    controller.step(RoundTripReported(3.0, 0.1))
    assert controller.snapshot().latency_s == 1.0  # one slow answer is not remembered
    controller.latency.note(2.0)
    assert controller.snapshot().latency_s == pytest.approx(2.1)  # the first reports at once
    for _ in range(5):
        controller.latency.note(0.4)
    assert controller.snapshot().latency_s == pytest.approx(0.5)
    controller.step(RoundTripReported(4.0, 0.6))
    assert controller.snapshot().latency_s == pytest.approx(1.5)  # two round trips more than what was measured
    controller.step(RoundTripReported(5.0, 0.1))
    assert controller.snapshot().latency_s == pytest.approx(0.5)


def test_planning_looks_ahead_by_the_measured_latency():
    planner = Scripted([THERE] * 30, ahead_s=20.0)
    controller = make(planner, latency_s=8.0)
    commands = engaged(controller, 2.0)
    for tick in range(20, 600, 10):
        for prepare in kinds(commands, UploadPlan):
            controller.step(PlanStatus(prepare.time_s + 0.2, prepare.number, "ready"))
            controller.step(PlanStatus(prepare.time_s + 0.3, prepare.number, "failed", "try the next"))
        commands = fly(controller, tick / 10, tick / 10 + 1.0)
    assert planner.latencies[0] == 8.0
    assert planner.latencies[-1] < 1.0


def test_an_upload_that_hangs_does_not_count_but_two_do():
    planner = Scripted([THERE] * 30, ahead_s=20.0)
    controller = make(planner, latency_s=1.0)
    commands = engaged(controller, 2.0)
    latencies = []
    for tick, took_s in zip(range(20, 100, 10), (0.2, 0.2, 0.2, 0.2, 15.0, 0.2, 0.2, 12.0), strict=True):
        (prepare,) = kinds(commands, UploadPlan)
        controller.step(PlanStatus(prepare.time_s + took_s, prepare.number, "ready"))
        controller.step(PlanStatus(prepare.time_s + took_s, prepare.number, "failed", "try the next"))
        latencies.append(controller.snapshot().latency_s)
        commands = fly(controller, tick / 10, tick / 10 + 1.0)
    assert latencies[4:7] == pytest.approx([0.3] * 3)
    assert latencies[7] == pytest.approx(12.1)


@pytest.mark.parametrize(
    ("late_s", "straightness", "departs"),
    [(0.4, 1.0, True), (1.2, 0.5, True), (1.2, 1.0, False), (1.9, 0.5, False)],
)
def test_a_late_plan_departs_while_the_aircraft_is_near_its_line(late_s, straightness, departs):
    controller = make(Scripted([THERE], ahead_s=1.0))
    (prepare,) = kinds(engaged(controller, 3.0), UploadPlan)
    # A line that leaves the circle at the departure, with less curvature.
    departure_s, curvature_per_m = prepare.plan.departure_s, (1.0 - straightness) / RADIUS_M
    turn_rad, step_m = departure_s * SPEED_M_S / RADIUS_M, 2.0
    arc = step_m * np.arange(100)
    course = turn_rad + math.pi / 2 + curvature_per_m * arc
    east_m = RADIUS_M * math.sin(turn_rad) + np.append(0.0, np.cumsum(step_m * np.sin(course[:-1])))
    north_m = RADIUS_M * math.cos(turn_rad) + np.append(0.0, np.cumsum(step_m * np.cos(course[:-1])))
    line = Path(arc, east_m, north_m, course, np.full(100, curvature_per_m))
    controller.changes.under_way.command = replace(prepare, plan=replace(prepare.plan, transition=line))
    fly(controller, 3.0, departure_s + late_s)
    announced = controller.step(PlanStatus(departure_s + late_s, prepare.number, "ready"))
    assert bool(kinds(announced, ActivatePlan)) is departs


def test_a_failed_plan_leaves_the_present_one():
    controller = make(Scripted([THERE]))
    (prepare,) = kinds(engaged(controller, 3.0), UploadPlan)
    controller.step(PlanStatus(3.0, prepare.number, "failed", "timeout"))
    state = controller.snapshot()
    assert state.plan.circle == HERE
    assert (state.moves, state.upload_failures) == (0, 1)


def test_a_report_about_another_plan_is_ignored():
    controller = make(Scripted([THERE]))
    (prepare,) = kinds(engaged(controller, 3.0), UploadPlan)
    assert controller.step(PlanStatus(3.0, prepare.number + 7, "departed")) == ()
    assert controller.snapshot().plan.circle == HERE


@pytest.mark.parametrize(("far_m", "is_direct"), [(-900.0, True), (900.0, False)], ids=["away", "past the target"])
def test_an_aircraft_that_leaves_its_transition_is_sent_to_a_circle_that_keeps_the_range(far_m, is_direct):
    far = Circle(far_m, 0.0, RADIUS_M, True)
    planner = Scripted([far], ahead_s=1.0)
    controller = make(planner)
    (prepare,) = kinds(engaged(controller, 3.0), UploadPlan)
    start = controller.snapshot().aircraft
    # A straight line away from the circle that the aircraft goes on flying.
    arc = np.linspace(0.0, 600.0, 50)
    course = np.full(50, start.course_rad)
    line = Path(arc, start.east_m + arc * np.sin(course), start.north_m + arc * np.cos(course), course, 0.0 * arc)
    controller.step(PlanStatus(prepare.plan.departure_s, prepare.number, "ready"))
    controller.changes.under_way.command = replace(prepare, plan=replace(prepare.plan, transition=line))
    controller.step(PlanStatus(3.1, prepare.number, "departed"))
    (again,) = kinds(fly(controller, 3.0, 20.0), UploadPlan)
    assert (again.plan.circle == far) is is_direct
    if is_direct:
        assert again.plan.transition is None
        return
    path = again.plan.transition
    assert np.hypot(path.east_m - TARGET[0], path.north_m - TARGET[1]).min() >= 95.0


def test_an_aircraft_that_orbits_a_waypoint_next_to_its_line_is_sent_to_the_circle():
    controller = make(Scripted([THERE], ahead_s=1.0))
    (prepare,) = kinds(engaged(controller, JOINED_S), UploadPlan)
    orbit_m = RADIUS_M / 4
    course = np.linspace(0.0, 4.0 * math.pi, 200)
    joined_rad = JOINED_S * SPEED_M_S / RADIUS_M
    east_m = (RADIUS_M - orbit_m) * math.sin(joined_rad) - orbit_m * np.cos(course)
    north_m = (RADIUS_M - orbit_m) * math.cos(joined_rad) + orbit_m * np.sin(course)
    line = Path(orbit_m * course, east_m, north_m, course, np.full(200, 1.0 / RADIUS_M))
    controller.step(PlanStatus(prepare.plan.departure_s, prepare.number, "ready"))
    controller.changes.under_way.command = replace(prepare, plan=replace(prepare.plan, transition=line))
    controller.step(PlanStatus(3.1, prepare.number, "departed"))
    assert kinds(fly(controller, 3.1, 8.0, radius_m=orbit_m), UploadPlan) == []
    (again,) = kinds(fly(controller, 8.0, 14.0, radius_m=orbit_m), UploadPlan)
    assert again.plan.circle == THERE
    assert again.plan.transition is None


def test_a_plan_that_breaks_a_fence_is_not_sent():
    controller = make(
        Scripted([THERE]), check=lambda plan: "the circle leaves keep_in" if plan.circle == THERE else None
    )
    commands = engaged(controller, 3.0)
    assert not kinds(commands, UploadPlan)
    assert any("keep_in" in command.text for command in kinds(commands, Announce))


def test_plans_that_a_fence_forbids_again_and_again_are_announced_once():
    fence = {THERE: "the circle leaves keep_in"}
    controller = make(Scripted([THERE] * 20), check=lambda plan: fence.get(plan.circle))
    texts = [command.text for command in kinds(engaged(controller, 20.0), Announce)]
    assert sum("keep_in" in text for text in texts) == 1


def test_a_changed_mode_yields_at_once_and_for_good():
    controller = make(Scripted([THERE] * 5))
    engaged(controller, 3.0)
    (yielded,) = controller.step(ModeReported(3.0, "FBWA", True))
    assert isinstance(yielded, Yield)
    assert "FBWA" in yielded.reason
    assert controller.step(ModeReported(4.0, "AUTO", True)) == ()
    assert controller.step(ControlAcquired(4.5, HERE, "AUTO")) == ()
    assert not kinds(fly(controller, 5.0, 20.0), UploadPlan, ActivatePlan)
    assert controller.phase is Phase.YIELDED


def test_a_failsafe_is_named_when_the_autopilot_states_its_reason():
    controller = make(Scripted([THERE] * 5))
    engaged(controller, 3.0)
    (first,) = controller.step(ModeReported(3.0, "RTL", True))
    assert first.reason == "the flight mode was changed to RTL"
    (named,) = controller.step(ModeReported(4.0, "RTL", True, "GCS Failsafe On: RTL"))
    assert named.reason == "the flight mode was changed to RTL by a failsafe of the autopilot: GCS Failsafe On: RTL"
    assert controller.snapshot().over == named.reason
    assert controller.step(ModeReported(5.0, "RTL", True, "GCS Failsafe On: RTL")) == ()
    assert controller.step(ModeReported(60.0, "RTL", True, "Battery low")) == ()


def test_disarmed_motors_yield():
    controller = make(Scripted([THERE] * 5))
    engaged(controller, 3.0)
    (yielded,) = controller.step(ModeReported(3.0, "AUTO", armed=False))
    assert yielded == Yield(3.0, "the motors were disarmed")
    assert not kinds(fly(controller, 5.0, 20.0), UploadPlan, ActivatePlan)


def test_a_ready_plan_does_not_depart_after_a_yield():
    controller = make(Scripted([THERE], ahead_s=5.0))
    (prepare,) = kinds(engaged(controller, 3.0), UploadPlan)
    controller.step(PlanStatus(3.0, prepare.number, "ready"))
    controller.step(YieldRequested(3.5, "RC takeover"))
    assert not kinds(fly(controller, 4.0, 15.0), ActivatePlan)


def test_a_target_unseen_for_long_holds_the_circle_then_ends():
    planner = Scripted()
    settings = {"lost_after_s": 10.0, "give_up_after_s": 40.0, "give_up_action": "hold"}
    controller = make(planner, **settings, check=lambda _plan: "the fence")  # no other circle is free
    engaged(controller, 10.0)
    asked = len(planner.latencies)
    fly(controller, 10.0, 25.0, seen=False)
    assert controller.snapshot().decision.reason == "holding the circle: the target is not seen"
    assert len(planner.latencies) <= asked + 11
    (end,) = kinds(fly(controller, 25.0, 60.0, seen=False), End)
    assert end.action == "hold"
    assert end.time_s == pytest.approx(50.0, abs=1.5)
    assert controller.phase is Phase.ENDED


def test_a_target_that_is_not_seen_is_searched_from_a_circle_around_where_it_can_be():
    controller = make(Scripted())
    engaged(controller, 30.0)
    assert not kinds(fly(controller, 30.0, 49.0, seen=False), UploadPlan)
    (searched,) = kinds(fly(controller, 49.0, 52.0, seen=False), UploadPlan)
    circle, target = searched.plan.circle, controller.estimate
    off_m = math.hypot(circle.east_m - target.east_m, circle.north_m - target.north_m)
    keep_m = controller.settings.requirement.range_min_m
    assert circle.radius_m > off_m + keep_m + target.ellipse_95.semi_major_m
    assert kinds(fly(controller, 52.0, 54.0, seen=False), Announce) == []
    assert controller.snapshot().estimate.reason == "no sighting for 23 s"
    controller.step(PlanStatus(54.0, searched.number, "failed", "it cannot be flown"))
    assert kinds(fly(controller, 54.0, 55.0, seen=False), UploadPlan)  # another way, at once


def test_an_operator_holds_resumes_changes_side_and_ends():
    sides: list[Side] = []
    controller = make(Scripted([THERE] * 9))
    controller.planning.make_planner = lambda _aircraft, requirement: sides.append(requirement.side) or Scripted()
    engaged(controller, 0.5)
    controller.step(OperatorRequest(0.5, "hold"))
    assert not kinds(fly(controller, 0.5, 5.0), UploadPlan)
    controller.step(OperatorRequest(5.0, "side", Side.RIGHT))
    assert sides == [Side.RIGHT]
    assert controller.snapshot().side is Side.RIGHT
    controller.step(OperatorRequest(6.0, "resume"))
    assert controller.phase is Phase.WATCHING
    assert kinds(controller.step(OperatorRequest(7.0, "end")), End)
    (refused,) = controller.step(OperatorRequest(8.0, "resume"))
    assert "refused" in refused.text


def test_a_side_that_is_not_named_leaves_a_held_mission_held():
    controller = make(Scripted([THERE] * 9))
    engaged(controller, 0.5)
    controller.step(OperatorRequest(0.5, "hold"))
    (refused,) = controller.step(OperatorRequest(1.0, "side", None))
    assert refused.text == "side refused: no side is named"
    assert controller.phase is Phase.HOLDING


def test_a_late_position_does_not_turn_back_the_clock():
    controller = make(Scripted())
    engaged(controller, 5.0)
    controller.step(PositionReading(2.0, 0.0, 0.0, HEIGHT_M, 0.0, SPEED_M_S, 0.0))
    assert controller.snapshot().time_s == pytest.approx(4.9)


def test_the_link_is_shown_of():
    controller = make(Scripted())
    assert "lost" in controller.step(LinkReported(1.0, False))[0].text
    assert "back" in controller.step(LinkReported(2.0, True))[0].text
