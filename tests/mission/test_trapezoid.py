import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import GRAVITY_M_S2, Aircraft
from sidelong.mission.geometry.progress import point_at
from sidelong.mission.geometry.trapezoid import Trapezoids, end_circle, sharpness_per_m2, turn_radius_m

RADIUS_M = 50.0
RAMP = sharpness_per_m2(Aircraft(10.0, RADIUS_M), 10.0)
SENSES = st.sampled_from([-1.0, 1.0])
HOLDS = st.floats(-1.0 / RADIUS_M, 1.0 / RADIUS_M)
LENGTHS = st.floats(0.0, 400.0)
ORIGIN = AircraftState(0.0, 0.0, 0.0, 0.0, 10.0, 1.0 / RADIUS_M)


def trapezoid(start_per_m, hold_per_m, length_m, sense):
    return Trapezoids.between(start_per_m, [hold_per_m], [length_m], [sense / RADIUS_M], RAMP)


def assert_flyable(path):
    assert np.all(np.diff(path.arc_m) > 0.0)
    assert np.all(np.abs(path.curvature_per_m) <= 1.0 / RADIUS_M + 1e-9)
    assert np.all(np.abs(np.diff(path.curvature_per_m)) <= RAMP * np.diff(path.arc_m) + 1e-12)
    # The sampled line really has the curvature it reports.
    turned = 0.5 * (path.curvature_per_m[1:] + path.curvature_per_m[:-1]) * np.diff(path.arc_m)
    np.testing.assert_allclose(np.diff(path.course_rad), turned, atol=1e-9)
    chord = np.hypot(np.diff(path.east_m), np.diff(path.north_m))
    assert np.all(chord <= np.diff(path.arc_m) + 1e-9)
    assert np.all(chord >= np.diff(path.arc_m) * (1.0 - 1e-3))


@settings(max_examples=150, deadline=None)
@given(SENSES, HOLDS, LENGTHS, SENSES, st.lists(st.tuples(st.floats(0.0, 1.2), HOLDS, LENGTHS, SENSES), max_size=4))
def test_any_retarget_at_any_moment_is_continuous_and_bounded(begin, hold, length, sense, retargets):
    start = point_at(Plan(end_circle_at_origin(begin)), 0.0, ORIGIN)
    path = trapezoid(start.curvature_per_m, hold, length, sense).path(
        0, start.east_m, start.north_m, start.course_rad
    )
    assert_flyable(path)
    for share, next_hold, next_length, next_sense in retargets:
        plan = Plan(end_circle(path, RADIUS_M), path)
        here = point_at(plan, share * path.length_m, ORIGIN)
        path = trapezoid(here.curvature_per_m, next_hold, next_length, next_sense).path(
            0, here.east_m, here.north_m, here.course_rad
        )
        assert path.curvature_per_m[0] == pytest.approx(here.curvature_per_m, abs=1e-12)
        assert_flyable(path)


def end_circle_at_origin(sense):
    path = trapezoid(sense / RADIUS_M, sense / RADIUS_M, 1.0, sense).path(0, 0.0, 0.0, 0.0)
    return end_circle(path, RADIUS_M)


@settings(max_examples=80, deadline=None)
@given(HOLDS, HOLDS, LENGTHS, SENSES, st.floats(-math.pi, math.pi))
def test_ends_on_its_circle(start_per_m, hold, length, sense, course_rad):
    path = trapezoid(start_per_m, hold, length, sense).path(0, 10.0, -20.0, course_rad)
    circle = end_circle(path, RADIUS_M)
    assert circle.clockwise is (sense > 0.0)
    assert path.curvature_per_m[-1] == pytest.approx(circle.curvature_per_m, abs=1e-12)
    assert math.hypot(path.east_m[-1] - circle.east_m, path.north_m[-1] - circle.north_m) == pytest.approx(
        RADIUS_M, abs=1e-9
    )


@settings(max_examples=60, deadline=None)
@given(HOLDS, HOLDS, LENGTHS, SENSES)
def test_coarse_samples_agree_with_the_fine_path(start_per_m, hold, length, sense):
    one = trapezoid(start_per_m, hold, length, sense)
    end_m = float(one.end_m[0])
    arcs = np.minimum(10.0 * np.arange(math.ceil(end_m / 10.0) + 1), end_m)[None, :]
    east, north, turned = one.displaced_m(arcs, 0.3)
    path = one.path(0, 0.0, 0.0, 0.3)
    if path.length_m > 2.0:
        assert turned[0, -1] == pytest.approx(path.course_rad[-1] - 0.3)
        assert east[0, -1] == pytest.approx(path.east_m[-1], abs=0.05)
        assert north[0, -1] == pytest.approx(path.north_m[-1], abs=0.05)


@settings(max_examples=60, deadline=None)
@given(HOLDS, HOLDS, LENGTHS, SENSES, st.floats(0.0, 1.0))
def test_mirror_swaps_left_and_right(start_per_m, hold, length, sense, course_rad):
    one = trapezoid(start_per_m, hold, length, sense)
    other = trapezoid(-start_per_m, -hold, length, -sense)
    path, mirrored = one.path(0, 0.0, 0.0, course_rad), other.path(0, 0.0, 0.0, -course_rad)
    np.testing.assert_allclose(mirrored.east_m, -path.east_m, atol=1e-9)
    np.testing.assert_allclose(mirrored.north_m, path.north_m, atol=1e-9)
    np.testing.assert_allclose(mirrored.curvature_per_m, -path.curvature_per_m, atol=1e-15)


def test_a_quarter_circle_comes_out():
    one = trapezoid(1.0 / RADIUS_M, 1.0 / RADIUS_M, RADIUS_M * math.pi / 2, 1.0)
    path = one.path(0, 0.0, 0.0, 0.0)
    assert (path.east_m[-1], path.north_m[-1]) == pytest.approx((RADIUS_M, RADIUS_M), abs=1e-9)
    assert path.course_rad[-1] == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(("radius_m", "turn_m"), [(80.0, 40.0), (40.0, 25.43), (20.0, 20.0)])
def test_a_transition_turns_as_tightly_as_reported_where_the_bank_allows(radius_m, turn_m):
    aircraft = Aircraft(12.0, radius_m)
    assert turn_radius_m(aircraft, 12.0, 1.0) == radius_m
    assert turn_radius_m(aircraft, 12.0, 0.5) == pytest.approx(turn_m, abs=0.05)
    shallow = Aircraft(12.0, radius_m, math.radians(20.0))
    assert turn_radius_m(shallow, 12.0, 0.5) == pytest.approx(min(radius_m, max(turn_m, 40.34)), abs=0.05)


@pytest.mark.parametrize(
    ("speed_m_s", "radius_m", "roll_deg_s"),
    [
        (10.0, 100.0, 5.0),  # a gentle turn: a sixth of 30 degrees/s
        (12.0, 40.0, 2.0 * 20.16 / 3.0),  # from 20.2 degrees of bank to the opposite in 3 s
        (30.0, 60.0, 15.0),  # a steep one: no more than half the roll rate
    ],
)
def test_ramp_keeps_the_planned_roll_rate(speed_m_s, radius_m, roll_deg_s):
    # tan(bank) = v^2 curvature / g, differentiated at wings level.
    per_second = sharpness_per_m2(Aircraft(speed_m_s, radius_m), speed_m_s) * speed_m_s
    roll_rad_s = speed_m_s**2 * per_second / GRAVITY_M_S2
    assert math.degrees(roll_rad_s) == pytest.approx(roll_deg_s, rel=1e-3)
