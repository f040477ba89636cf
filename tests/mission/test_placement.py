import math

import pytest

from sidelong.mission.core.feasibility import fits_band
from sidelong.mission.core.requirement import Aircraft, Requirement, Side
from sidelong.mission.paper.planner import circle_next_to, stand_off_m

AIRCRAFT = Aircraft(airspeed_m_s=10.0, radius_m=50.0)


def requirement(side: Side = Side.LEFT, range_max_m: float = 500.0) -> Requirement:
    return Requirement(100.0, range_max_m, side, 3.0)


def test_left_of_a_target_that_drives_east_is_north_and_flown_clockwise() -> None:
    circle = circle_next_to(10.0, 20.0, math.pi / 2, AIRCRAFT, requirement())
    assert (circle.east_m, circle.north_m) == pytest.approx((10.0, 170.0))
    assert (circle.radius_m, circle.clockwise) == (50.0, True)


def test_right_of_a_target_that_drives_north_is_east_and_flown_counter_clockwise() -> None:
    circle = circle_next_to(0.0, 0.0, 0.0, AIRCRAFT, requirement(Side.RIGHT))
    assert (circle.east_m, circle.north_m) == pytest.approx((150.0, 0.0))
    assert (circle.radius_m, circle.clockwise) == (50.0, False)


def test_the_circle_touches_the_least_range_and_must_fit_the_greatest() -> None:
    assert stand_off_m(AIRCRAFT, requirement()) == 150.0
    assert fits_band(AIRCRAFT, requirement(range_max_m=200.0))
    assert not fits_band(AIRCRAFT, requirement(range_max_m=199.9))
