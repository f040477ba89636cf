import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.geometry.line_kernel import laid_out, line_at, trapezoid
from sidelong.mission.geometry.progress import dead_reckoned, end_circle, line_of, nearest_arc_m, off_track, point_at

RADIUS_M = 50.0


def transition(hold_per_m, length_m):
    path = Path(*laid_out(trapezoid(1 / RADIUS_M, hold_per_m, length_m, 1 / RADIUS_M, 0.0008), 5.0, 7.0, 0.4))
    return Plan(end_circle(path, RADIUS_M), path, 0.0)


def aircraft_at(point, cross_track_m=0.0):
    return AircraftState(
        0.0,
        point.east_m + cross_track_m * math.cos(point.course_rad),
        point.north_m - cross_track_m * math.sin(point.course_rad),
        point.course_rad,
        10.0,
        point.curvature_per_m,
    )


@settings(max_examples=150, deadline=None)
@given(st.floats(-0.02, 0.02), st.floats(0.0, 300.0), st.floats(0.0, 1.5), st.floats(-6.0, 6.0))
@example(0.017918201339188335, 181.0, 0.125, 6.0)
def test_an_aircraft_next_to_its_line_is_found_where_it_is(hold_per_m, length_m, share, cross_track_m):
    plan = transition(hold_per_m, length_m)
    arc_m = share * plan.transition.length_m
    point = point_at(plan, arc_m, aircraft_at(point_at(plan, 0.0, aircraft_at_origin())))
    aircraft = aircraft_at(point, cross_track_m)
    found = point_at(plan, nearest_arc_m(plan, aircraft), aircraft)
    # Where the circle at the end passes next to the line, an aircraft between them may be found on either.
    off_m = math.hypot(found.east_m - aircraft.east_m, found.north_m - aircraft.north_m)
    assert off_m <= abs(cross_track_m) + 2.5
    assert abs(math.remainder(found.course_rad - point.course_rad, 2 * math.pi)) < 0.2
    assert not off_track(aircraft, found)


def aircraft_at_origin():
    return AircraftState(0.0, 0.0, 0.0, 0.0, 10.0, 0.02)


@settings(max_examples=60, deadline=None)
@given(st.floats(-0.02, 0.02), st.floats(0.0, 300.0), st.floats(0.0, 2.0))
def test_many_points_agree_with_one(hold_per_m, length_m, share):
    plan = transition(hold_per_m, length_m)
    arc_m = share * plan.transition.length_m
    one = point_at(plan, arc_m, aircraft_at_origin())
    east_m, north_m, course_rad = found = np.empty((3, 1))
    line_at(*line_of(plan), np.array([arc_m]), 0.0, 0.0, found)
    assert (east_m[0], north_m[0], course_rad[0]) == pytest.approx(
        (one.east_m, one.north_m, one.course_rad), abs=0.03
    )


def test_a_plain_circle_starts_at_the_aircraft():
    circle = Circle(0.0, 0.0, RADIUS_M, clockwise=False)
    aircraft = AircraftState(0.0, RADIUS_M + 3.0, 0.0, 0.0, 10.0, -0.02)
    plan = Plan(circle)
    assert nearest_arc_m(plan, aircraft) == 0.0
    quarter = point_at(plan, RADIUS_M * math.pi / 2, aircraft)
    assert (quarter.east_m, quarter.north_m) == pytest.approx((0.0, RADIUS_M), abs=1e-9)


def test_an_aircraft_elsewhere_has_strayed():
    plan = Plan(Circle(0.0, 0.0, RADIUS_M, clockwise=True))
    away = AircraftState(0.0, 200.0, 0.0, math.pi, 10.0, 0.0)
    assert off_track(away, point_at(plan, nearest_arc_m(plan, away), away))
    wrong_way = AircraftState(0.0, RADIUS_M, 0.0, 0.0, 10.0, 0.0)
    assert off_track(wrong_way, point_at(plan, nearest_arc_m(plan, wrong_way), wrong_way))


def test_dead_reckoning_follows_the_present_turn_within_the_limit():
    turning = AircraftState(0.0, 0.0, 0.0, 0.0, 10.0, 1.0)
    point = dead_reckoned(turning, RADIUS_M * math.pi / 20.0, 1.0 / RADIUS_M)
    assert point.curvature_per_m == 1.0 / RADIUS_M
    assert (point.east_m, point.north_m) == pytest.approx((RADIUS_M, RADIUS_M), abs=0.3)
