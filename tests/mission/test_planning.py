"""Which planner decides, and the way back into its range."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.control.planning import Planning
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind

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
