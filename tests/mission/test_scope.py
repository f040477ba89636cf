import math

import pytest

from sidelong.mission.core.requirement import Aircraft, Requirement, Side
from sidelong.mission.paper.scope import scope

AIRCRAFT = Aircraft(airspeed_m_s=10.0, radius_m=50.0)


def requirement(threshold: float = 1.0, target_speed_max_m_s: float = 3.0) -> Requirement:
    return Requirement(100.0, 500.0, Side.LEFT, target_speed_max_m_s, threshold)


def test_the_papers_numbers() -> None:
    of = scope(AIRCRAFT, requirement())
    assert of.x_tr_m == pytest.approx(192.153, abs=5e-4)
    assert of.shortest_time_s == pytest.approx(110.907, abs=5e-4)
    assert of.shortest_move_m == pytest.approx(332.722, abs=5e-4)
    assert of.longest_move_m == pytest.approx(332.722 + 94.248, abs=1e-3)
    assert of.straight_left_m == pytest.approx(48.416, abs=5e-4)
    right_of_47 = 2.0 * of.x_tr_m / AIRCRAFT.radius_m - 2.0
    left_of_47 = of.shortest_move_m / AIRCRAFT.radius_m
    assert right_of_47 == pytest.approx(5.686, abs=5e-4)
    assert left_of_47 == pytest.approx(6.654, abs=5e-4)


def test_the_least_threshold_leaves_no_straight_part() -> None:
    least = scope(AIRCRAFT, requirement()).min_threshold
    assert least == pytest.approx(0.9081, abs=1e-4)
    assert scope(AIRCRAFT, requirement(least)).straight_left_m == pytest.approx(0.0, abs=1e-9)


def test_a_standing_target_needs_no_move() -> None:
    of = scope(AIRCRAFT, requirement(target_speed_max_m_s=0.0))
    assert of.shortest_time_s == math.inf
    assert of.shortest_move_m == of.longest_move_m == pytest.approx(math.sqrt(500**2 - 150**2) - 50)


def test_a_threshold_below_the_stand_off_distance_wants_a_move_before_the_target_has_moved() -> None:
    assert scope(AIRCRAFT, requirement(threshold=0.2)).shortest_move_m < 0.0
