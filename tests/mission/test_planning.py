"""Which planner decides, and the way back into its range."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.control.planning import PlanChanges, Planning, UploadLatency
from sidelong.mission.control.plausibility import Plausibility
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import PlanStatus, RouteGiven
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind
from sidelong.mission.route.progress_kernel import update_progress
from sidelong.mission.route.route import way_of
from sidelong.mission.viewpoint.viewpoint_kernel import TargetState

AIRCRAFT = Aircraft(22.0, 80.0, math.radians(60.0), math.radians(30.0))
REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 9.0)
START = AircraftState(0.0, 0.0, -560.0, 0.0, 22.0, 0.0)
CIRCLING = Plan(Circle(80.0, -560.0, 80.0, True), None, 0.0)


def target_at(time_s, east_m, velocity_m_s):
    return TargetEstimate(time_s, east_m, 0.0, *velocity_m_s, np.eye(4), TrackQuality.GOOD, time_s)


@pytest.mark.parametrize(("after_s", "goes_on"), [(3.0, True), (12.0, False)])
def test_an_approach_that_has_begun_is_flown_on_for_some_seconds(after_s, goes_on):
    """The target has turned, and another circle would serve it better: every second that would be another one."""
    planning = Planning(lambda _aircraft, _requirement: None, AIRCRAFT, REQUIREMENT)
    first = planning.decide(START, target_at(0.0, 0.0, (0.0, 5.0)), CIRCLING, Wind(), 0.5).plan
    assert first is not None
    later = replace(START, time_s=first.departure_s + after_s)
    decided = planning.decide(later, target_at(later.time_s, 0.0, (5.0, 0.0)), first, Wind(), 0.5)
    assert (decided.plan is None) is goes_on


def test_an_approach_that_no_longer_leads_to_the_target_is_given_up():
    planning = Planning(lambda _aircraft, _requirement: None, AIRCRAFT, REQUIREMENT)
    first = planning.decide(START, target_at(0.0, 0.0, (0.0, 5.0)), CIRCLING, Wind(), 0.5).plan
    later = replace(START, time_s=first.departure_s + 1.0)
    far_m = first.circle.east_m + math.copysign(600.0, first.circle.east_m)
    assert planning.decide(later, target_at(later.time_s, far_m, (5.0, 0.0)), first, Wind(), 0.5).plan is not None


ROUTE = RouteGiven(0.0, (0.0, 0.0), (0.0, 900.0), False, 12.0, None, "either")


class _Following:
    """A planner that updates the progress along the route as its decisions would."""

    def decide(self, *_: object) -> None: ...

    def follow(self, route, progress) -> None:
        self.route, self.progress = route, progress

    def see(self, time_s: float) -> None:
        target = TargetState(time_s, 0.0, 4.0 * time_s, 0.0, 4.0, np.diag([4.0, 4.0, 0.1, 0.1]))
        update_progress(way_of(self.route), target, self.progress)


def test_a_new_planner_continues_with_the_progress_along_the_route():
    planning = Planning(lambda *_: _Following(), AIRCRAFT, REQUIREMENT)
    planning.follow(ROUTE)
    for k in range(30):
        planning.planner.see(float(k))
    before = planning.route_progress
    planning.renew(AIRCRAFT, replace(REQUIREMENT, side=Side.RIGHT))
    assert before.on_route
    assert planning.route_progress == before
    planning.planner.see(30.0)
    assert planning.route_progress.along_m == pytest.approx(120.0, abs=5.0)


def test_a_route_without_way_points_takes_the_last_one_back():
    planning = Planning(lambda *_: _Following(), AIRCRAFT, REQUIREMENT)
    planning.follow(ROUTE)
    announced = planning.follow(replace(ROUTE, east_m=(), north_m=()))
    assert announced == "no route of the target is known"
    assert (planning.planner.route, planning.route_progress) == (None, None)


def test_refused_plan_is_recognised_by_its_circle_until_another_one_departs():
    changes = PlanChanges(Plausibility(), UploadLatency(5.0))
    changes.begin(CIRCLING, CIRCLING.circle, CIRCLING.circle)
    wide, moved = Circle(0.0, 0.0, 200.0, True), Circle(60.0, 0.0, 200.0, True)
    changes.upload(1.0, Plan(wide), Wind(), "searching")
    changes.report(PlanStatus(2.0, 1, "failed", "denied"), 2.0, None, watching=True)
    assert changes.has_refused(Plan(moved))
    assert not changes.has_refused(Plan(replace(moved, clockwise=False)))
    assert not changes.has_refused(Plan(Circle(150.0, 0.0, 200.0, True)))
    changes.upload(3.0, Plan(wide), Wind(), "searching")
    changes.report(PlanStatus(4.0, 2, "departed"), 4.0, None, watching=True)
    assert not changes.has_refused(Plan(moved))
