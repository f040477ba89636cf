"""A person changes what is flown: from the next decision on, and where the planner stays the circle is sent again."""

from __future__ import annotations

import math

import pytest

from sidelong.estimators.tracking.tracker import Tracker, TrackerSettings
from sidelong.mission.control.controller import StandoffController, StandoffSettings
from sidelong.mission.control.present import Phase
from sidelong.mission.core.events import (
    ActivatePlan,
    Announce,
    ControlAcquired,
    MissionChange,
    ModeReported,
    OperatorRequest,
    PlanStatus,
    UploadPlan,
)
from sidelong.mission.core.plan import Decision
from sidelong.mission.core.requirement import Aircraft, Requirement, Side
from tests.mission.test_control_step import HERE, RADIUS_M, SPEED_M_S, fly


class Staying:
    """Never moves; reports for what it was made."""

    def __init__(self, aircraft, requirement):
        self.aircraft, self.requirement = aircraft, requirement

    def decide(self, aircraft, target, present, wind, latency_s):
        return Decision(aircraft.time_s, None, "staying")


@pytest.fixture
def watching():
    """Return a controller that has watched a standing target for 20 s, and the planners made so far."""
    made = []

    def make(aircraft, requirement):
        made.append(Staying(aircraft, requirement))
        return made[-1]

    requirement = Requirement(100.0, 500.0, Side.LEFT, 3.0)
    controller = StandoffController(
        StandoffSettings(requirement, Aircraft(SPEED_M_S, RADIUS_M)), Tracker(TrackerSettings()), make
    )
    controller.step(ModeReported(0.0, "AUTO", True))
    controller.step(ControlAcquired(0.0, HERE, "AUTO"))
    fly(controller, 0.0, 20.0)
    return controller, made


def flown(controller, commands):
    """Let the one plan among the commands be taken, and return it."""
    (upload,) = [command for command in commands if isinstance(command, UploadPlan)]
    controller.step(PlanStatus(upload.time_s + 0.4, upload.number, "ready"))
    departs = fly(controller, upload.time_s + 0.1, upload.plan.departure_s + 0.2)
    assert [command.number for command in departs if isinstance(command, ActivatePlan)] == [upload.number]
    controller.step(PlanStatus(upload.plan.departure_s + 0.2, upload.number, "departed"))
    return upload.plan


def announced(commands):
    return [command.text for command in commands if isinstance(command, Announce)]


def test_another_radius_is_flown_on_a_circle_that_touches_the_present_one(watching):
    controller, made = watching
    before = announced(controller.step(MissionChange(20.0, radius_m=80.0, who="operator at this machine")))
    assert before == ["operator: radius 80 m, from the next plan on"]
    assert made[-1].aircraft.radius_m == 80.0
    plan = flown(controller, fly(controller, 20.0, 21.0))
    assert plan.circle.radius_m == 80.0
    apart_m = math.hypot(plan.circle.east_m - HERE.east_m, plan.circle.north_m - HERE.north_m)
    assert apart_m == pytest.approx(80.0 - RADIUS_M, abs=2.0)
    assert not [c for c in fly(controller, 23.0, 30.0) if isinstance(c, UploadPlan)]  # once


def test_another_height_is_sent_at_once_and_every_plan_carries_it(watching):
    controller, _ = watching
    controller.step(MissionChange(20.0, height_m=150.0))
    commands = fly(controller, 20.0, 21.0)
    assert "150 m above home" in announced(commands)[0]
    plan = flown(controller, commands)
    assert (plan.heights.to_m, plan.circle) == (150.0, HERE)
    assert controller.snapshot().height_asked_m == 150.0


def test_another_band_and_side_reach_the_planner_and_send_nothing(watching):
    controller, made = watching
    controller.step(MissionChange(20.0, range_min_m=150.0, range_max_m=400.0, side="120-200"))
    wanted = made[-1].requirement
    assert (wanted.range_min_m, wanted.range_max_m) == (150.0, 400.0)
    assert wanted.sector is not None
    assert controller.snapshot().requirement == wanted
    assert not [c for c in fly(controller, 20.0, 25.0) if isinstance(c, UploadPlan)]


def test_a_change_that_breaks_a_fence_is_objected_to(watching):
    controller, _ = watching
    controller.surroundings.fences = lambda plan: "too high" if plan.circle_height_m(0.0) > 120.0 else None
    assert controller.objection(MissionChange(20.0, height_m=150.0)) == "too high"
    assert controller.objection(MissionChange(20.0, height_m=110.0)) is None


def test_while_holding_a_change_waits_for_resume(watching):
    controller, _ = watching
    controller.step(OperatorRequest(20.0, "hold"))
    assert announced(controller.step(MissionChange(20.0, radius_m=80.0))) == [
        "operator: radius 80 m, when you resume"
    ]
    assert not [c for c in fly(controller, 20.0, 23.0) if isinstance(c, UploadPlan)]
    controller.step(OperatorRequest(23.0, "resume"))
    assert [c.plan.circle.radius_m for c in fly(controller, 23.0, 24.5) if isinstance(c, UploadPlan)] == [80.0]


def test_nothing_is_changed_after_a_yield(watching):
    controller, made = watching
    controller.step(ModeReported(20.0, "RTL", True))
    assert controller.phase is Phase.YIELDED
    (text,) = announced(controller.step(MissionChange(20.0, radius_m=80.0)))
    assert text == "radius 80 m refused: the mission is yielded"
    assert made[-1].aircraft.radius_m == RADIUS_M
