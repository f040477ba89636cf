import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import GRAVITY_M_S2, Aircraft
from sidelong.mission.geometry import line_kernel as kernel
from sidelong.mission.geometry.progress import end_circle, point_at

RADIUS_M = 50.0
RAMP = kernel.sharpness_per_m2(10.0, kernel.craft_of(Aircraft(10.0, RADIUS_M)))
SENSES = st.sampled_from([-1.0, 1.0])
HOLDS = st.floats(-1.0 / RADIUS_M, 1.0 / RADIUS_M)
LENGTHS = st.floats(0.0, 400.0)
ORIGIN = AircraftState(0.0, 0.0, 0.0, 0.0, 10.0, 1.0 / RADIUS_M)


def trapezoid(start_per_m, hold_per_m, length_m, sense):
    return kernel.trapezoid(start_per_m, hold_per_m, length_m, sense / RADIUS_M, RAMP)


def path_of(shape, east_m=0.0, north_m=0.0, course_rad=0.0):
    return Path(*kernel.laid_out(shape, east_m, north_m, course_rad))


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
    path = path_of(trapezoid(start.curvature_per_m, hold, length, sense), *start[:3])
    assert_flyable(path)
    for share, next_hold, next_length, next_sense in retargets:
        plan = Plan(end_circle(path, RADIUS_M), path)
        here = point_at(plan, share * path.length_m, ORIGIN)
        path = path_of(trapezoid(here.curvature_per_m, next_hold, next_length, next_sense), *here[:3])
        assert path.curvature_per_m[0] == pytest.approx(here.curvature_per_m, abs=1e-12)
        assert_flyable(path)


def end_circle_at_origin(sense):
    return end_circle(path_of(trapezoid(sense / RADIUS_M, sense / RADIUS_M, 1.0, sense)), RADIUS_M)


@settings(max_examples=80, deadline=None)
@given(HOLDS, HOLDS, LENGTHS, SENSES, st.floats(-math.pi, math.pi))
def test_ends_on_its_circle(start_per_m, hold, length, sense, course_rad):
    path = path_of(trapezoid(start_per_m, hold, length, sense), 10.0, -20.0, course_rad)
    circle = end_circle(path, RADIUS_M)
    assert circle.clockwise is (sense > 0.0)
    assert path.curvature_per_m[-1] == pytest.approx(circle.curvature_per_m, abs=1e-12)
    assert math.hypot(path.east_m[-1] - circle.east_m, path.north_m[-1] - circle.north_m) == pytest.approx(
        RADIUS_M, abs=1e-9
    )


@settings(max_examples=60, deadline=None)
@given(HOLDS, HOLDS, LENGTHS, SENSES)
def test_coarse_samples_agree_with_the_fine_path(start_per_m, hold, length, sense):
    shape = trapezoid(start_per_m, hold, length, sense)
    arcs = np.minimum(10.0 * np.arange(math.ceil(shape.end_m / 10.0) + 1), shape.end_m)
    east, north, turned = kernel.displaced_m(shape, arcs)
    path = path_of(shape)
    if path.length_m > 2.0:
        assert turned[-1] == pytest.approx(path.course_rad[-1])
        assert east[-1] == pytest.approx(path.east_m[-1], abs=0.05)
        assert north[-1] == pytest.approx(path.north_m[-1], abs=0.05)


@settings(max_examples=60, deadline=None)
@given(HOLDS, HOLDS, LENGTHS, SENSES, st.floats(0.0, 1.0))
def test_mirror_swaps_left_and_right(start_per_m, hold, length, sense, course_rad):
    one = trapezoid(start_per_m, hold, length, sense)
    other = trapezoid(-start_per_m, -hold, length, -sense)
    path, mirrored = path_of(one, course_rad=course_rad), path_of(other, course_rad=-course_rad)
    np.testing.assert_allclose(mirrored.east_m, -path.east_m, atol=1e-9)
    np.testing.assert_allclose(mirrored.north_m, path.north_m, atol=1e-9)
    np.testing.assert_allclose(mirrored.curvature_per_m, -path.curvature_per_m, atol=1e-15)


def test_a_quarter_circle_comes_out():
    path = path_of(trapezoid(1.0 / RADIUS_M, 1.0 / RADIUS_M, RADIUS_M * math.pi / 2, 1.0))
    assert (path.east_m[-1], path.north_m[-1]) == pytest.approx((RADIUS_M, RADIUS_M), abs=1e-9)
    assert path.course_rad[-1] == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(("radius_m", "turn_m"), [(80.0, 40.0), (40.0, 25.43), (20.0, 20.0)])
def test_a_transition_turns_as_tightly_as_reported_where_the_bank_allows(radius_m, turn_m):
    aircraft = Aircraft(12.0, radius_m)
    assert kernel.turn_radius_m(radius_m, 12.0, kernel.craft_of(aircraft, 1.0)) == radius_m
    assert kernel.turn_radius_m(radius_m, 12.0, kernel.craft_of(aircraft, 0.5)) == pytest.approx(turn_m, abs=0.05)
    shallow = Aircraft(12.0, radius_m, math.radians(20.0))
    assert kernel.turn_radius_m(radius_m, 12.0, kernel.craft_of(shallow, 0.5)) == pytest.approx(
        min(radius_m, max(turn_m, 40.34)), abs=0.05
    )


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
    per_second = kernel.sharpness_per_m2(speed_m_s, kernel.craft_of(Aircraft(speed_m_s, radius_m))) * speed_m_s
    roll_rad_s = speed_m_s**2 * per_second / GRAVITY_M_S2
    assert math.degrees(roll_rad_s) == pytest.approx(roll_deg_s, rel=1e-3)
