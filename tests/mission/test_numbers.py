"""Whole numbers and NumPy scalars as a library's caller writes them, and what is no number."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, HeightProfile, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Sector, Side, Wind
from sidelong.mission.predictive.planner import PredictivePlanner


@pytest.mark.parametrize("number", [int, np.int64, np.float32, Fraction])
def test_numbers_of_any_kind_become_floats(number):
    circle = Circle(number(300), number(0), number(50), True)
    state = AircraftState(*(number(value) for value in (1, 2, 3, 0, 15, 0)))
    wanted = Requirement(number(100), number(500), "right", number(3))
    plan = Plan(circle, None, number(7))
    found = circle.east_m, circle.radius_m, state.time_s, state.ground_speed_m_s, wanted.range_max_m, plan.departure_s
    assert all(isinstance(value, float) for value in found)
    assert (circle.east_m, state.ground_speed_m_s, plan.departure_s) == (300.0, 15.0, 7.0)
    assert wanted.side is Side.RIGHT


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Circle("300", 0, 50, True), "Circle.east_m must be a number, not '300'"),
        (lambda: Circle(300, None, 50, True), "Circle.north_m must be a number, not None"),
        (lambda: Circle(300, 0, True, True), "Circle.radius_m must be a number, not True"),
        (lambda: Circle(300, 0, 50, "yes"), "Circle.clockwise must be bool"),
        (lambda: AircraftState(0, 0, 0, 0, [15], 0), "AircraftState.ground_speed_m_s must be a number"),
        (lambda: Requirement(100, 500, "above", 3), "Requirement.side must be Side.LEFT or Side.RIGHT, not 'above'"),
        (lambda: Requirement(100, 500, Side.LEFT, 3, sector=(0, 1)), "Requirement.sector must be Sector or None"),
        (lambda: Plan((300, 0, 50)), r"Plan.circle must be Circle, not \(300, 0, 50\)"),
        (lambda: Plan(Circle(0, 0, 50, True), "left"), "Plan.transition must be Path or None, not 'left'"),
        (lambda: Aircraft(15, "auto"), "Aircraft.radius_m must be a number"),
        (lambda: Wind(1j), "Wind.east_m_s must be a number"),
        (lambda: Sector(0, ""), "Sector.to_rad must be a number"),
        (lambda: HeightProfile(0, 1, None), "HeightProfile.slope must be a number"),
    ],
)
def test_anything_else_is_refused_with_the_field_s_name(make, named):
    with pytest.raises(TypeError, match=named) as refused:
        make()
    assert "\n" not in str(refused.value)


def test_a_circle_without_extent_is_refused():
    with pytest.raises(ValueError, match=r"radius_m must be greater than 0, not 0\.0"):
        Circle(0, 0, 0, True)


def test_a_planner_decides_the_same_from_whole_numbers_as_from_floats(paper_table):
    def decided(number):
        aircraft = Aircraft(number(10), number(50))
        wanted = Requirement(number(100), number(500), Side.LEFT, number(3))
        planner = PredictivePlanner(aircraft, wanted, paper_table)
        circle = Circle(number(0), number(250), number(50), True)
        state = AircraftState(number(10), *circle.position_at_course(0.5), 0.5, number(10), circle.curvature_per_m)
        estimate = TargetEstimate(
            number(10), number(0), number(0), number(3), number(0), np.eye(4), "good", number(10)
        )
        return planner.decide(state, estimate, Plan(circle), Wind(), 1.0)

    assert decided(int).values == decided(float).values
