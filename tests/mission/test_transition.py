import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from sidelong.mission.core.circle import Circle
from sidelong.mission.paper.transition import (
    TransitionError,
    abcd,
    min_move_m,
    transition_length_m,
)


def test_lengths_of_the_paper() -> None:
    assert transition_length_m(50.0, math.pi / 2) == pytest.approx(192.153, abs=5e-4)
    assert min_move_m(50.0, math.pi / 2) == pytest.approx(284.306, abs=1e-3)


@given(radius_m=st.floats(20, 300), psi_c_rad=st.floats(0.05, math.pi / 2))
def test_length_by_the_series_is_near_the_integral_of_the_heading(radius_m: float, psi_c_rad: float) -> None:
    scale_m = radius_m * psi_c_rad
    integral_m, _ = quad(lambda s: math.sin(math.pi / 2 - psi_c_rad * math.exp(-s / scale_m)), 0.0, 3.0 * scale_m)
    assert transition_length_m(radius_m, psi_c_rad) == pytest.approx(integral_m, rel=1e-3)


moves = st.fixed_dictionaries(
    {
        "radius_m": st.floats(20, 200),
        "psi_c_rad": st.floats(0.1, math.pi / 2),
        "bearing_rad": st.floats(-math.pi, math.pi),
        "extra_m": st.floats(0.0, 3000.0),
        "clockwise": st.booleans(),
    }
)


def make(
    radius_m: float, psi_c_rad: float, bearing_rad: float, extra_m: float, clockwise: bool
) -> tuple[Circle, Circle]:
    move_m = min_move_m(radius_m, psi_c_rad) + extra_m + 1e-9
    present = Circle(-130.0, 70.0, radius_m, clockwise)
    return present, Circle(
        present.east_m + move_m * math.sin(bearing_rad),
        present.north_m + move_m * math.cos(bearing_rad),
        radius_m,
        clockwise,
    )


@settings(max_examples=60, deadline=None)
@given(moves)
def test_abcd_begins_and_ends_on_the_circles(drawn: dict) -> None:
    present, new = make(**drawn)
    path = abcd(present, new, drawn["psi_c_rad"])
    for circle, end in ((present, 0), (new, -1)):
        on_circle_m = circle.position_at_course(float(path.course_rad[end]))
        assert math.dist(on_circle_m, (path.east_m[end], path.north_m[end])) < 1e-6
        assert path.curvature_per_m[end] == pytest.approx(circle.curvature_per_m, rel=1e-9)


@settings(max_examples=60, deadline=None)
@given(moves)
def test_abcd_is_flyable_between_the_circles(drawn: dict) -> None:
    """Course is the line's direction, curvature its change; it never exceeds the circle's and has no step."""
    present, new = make(**drawn)
    step_m = drawn["radius_m"] * drawn["psi_c_rad"] / 50.0
    path = abcd(present, new, drawn["psi_c_rad"], step_m)
    steps_m = np.diff(path.arc_m)
    middle_rad = (path.course_rad[1:] + path.course_rad[:-1]) / 2.0
    assert np.allclose(np.diff(path.east_m), steps_m * np.sin(middle_rad), atol=1e-4 * step_m)
    assert np.allclose(np.diff(path.north_m), steps_m * np.cos(middle_rad), atol=1e-4 * step_m)
    middle_per_m = (path.curvature_per_m[1:] + path.curvature_per_m[:-1]) / 2.0
    assert np.allclose(np.diff(path.course_rad), steps_m * middle_per_m, atol=1e-4 * step_m / drawn["radius_m"])
    assert np.all(np.abs(path.curvature_per_m) <= (1.0 + 1e-9) / drawn["radius_m"])
    rate_per_m2 = np.abs(np.diff(path.curvature_per_m)) / steps_m
    assert np.all(rate_per_m2 <= 1.01 / (drawn["radius_m"] ** 2 * drawn["psi_c_rad"]))
    assert np.all(steps_m > 0.0) and np.all(steps_m <= step_m + 1e-9)


def test_ab_is_the_answer_of_the_heading_channel() -> None:
    """psi = pi/2 - psi_c exp(-mu t) with the paper's numbers, over 2 T of the paper's longest straight move."""
    path = abcd(Circle(0.0, 0.0, 50.0, True), Circle(400.0, 0.0, 50.0, True))
    speed_m_s, mu_per_s = 10.0, 0.12732395
    ab = path.arc_m < 2.0 / mu_per_s * speed_m_s
    expected_rad = math.pi / 2 - math.pi / 2 * np.exp(-mu_per_s * path.arc_m[ab] / speed_m_s)
    assert np.allclose(path.course_rad[ab], expected_rad, atol=1e-6)
    assert (path.east_m[0], path.north_m[0]) == pytest.approx((-50.0, 0.0))


def test_a_long_move_is_straight_between_the_bends() -> None:
    path = abcd(Circle(0.0, 0.0, 50.0, True), Circle(3000.0, 0.0, 50.0, True))
    after_3t = (path.arc_m > 1.3 * 192.0) & (path.arc_m < path.length_m - 1.3 * 192.0)
    assert np.ptp(path.north_m[after_3t]) < 6.0  # what is left of the turn, psi_c e^-3 of 79 m
    assert np.all(np.abs(path.course_rad[after_3t] - math.pi / 2) < math.radians(4.0))


def test_counter_clockwise_is_the_mirror_image() -> None:
    right = abcd(Circle(0.0, 0.0, 60.0, True), Circle(500.0, 0.0, 60.0, True))
    left = abcd(Circle(0.0, 0.0, 60.0, False), Circle(500.0, 0.0, 60.0, False))
    assert np.allclose(left.east_m, right.east_m)
    assert np.allclose(left.north_m, -right.north_m)
    assert np.allclose(left.course_rad, math.pi - right.course_rad)
    assert np.allclose(left.curvature_per_m, -right.curvature_per_m)


def test_the_transition_bulges_away_from_a_target_on_the_inner_side() -> None:
    """Clockwise on the left of a target that moves east: all of the line stays north of A's latitude."""
    path = abcd(Circle(0.0, 150.0, 50.0, True), Circle(400.0, 150.0, 50.0, True))
    assert np.min(path.north_m) == pytest.approx(150.0)
    assert np.max(path.north_m) > 150.0 + 100.0


@pytest.mark.parametrize(
    ("present", "new", "psi_c_rad", "word"),
    [
        (Circle(0, 0, 50, True), Circle(283.8, 0, 50, True), math.pi / 2, "shorter"),
        (Circle(0, 0, 50, True), Circle(400, 0, 60, True), math.pi / 2, "radius"),
        (Circle(0, 0, 50, True), Circle(400, 0, 50, False), math.pi / 2, "direction"),
        (Circle(0, 0, 50, True), Circle(400, 0, 50, True), 2.0, "psi_c_rad"),
    ],
)
def test_refusals_name_the_reason(present: Circle, new: Circle, psi_c_rad: float, word: str) -> None:
    with pytest.raises(TransitionError, match=word):
        abcd(present, new, psi_c_rad)
