import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sidelong.estimators.rotations import (
    from_roll_pitch_yaw,
    interpolated,
    multiply,
    normalized,
    rotate,
    sight_direction,
)

DEG = math.pi / 180
angle = st.floats(-math.pi, math.pi)
quaternion = st.tuples(angle, angle, angle).map(lambda angles: from_roll_pitch_yaw(*angles))
vector = st.tuples(*[st.floats(-100, 100)] * 3)


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg", "yaw_deg", "forward", "right"),
    [
        (0, 0, 0, (1, 0, 0), (0, 1, 0)),
        (0, 0, 90, (0, 1, 0), (-1, 0, 0)),  # nose east: the right wing points south
        (0, 30, 0, (math.sqrt(3) / 2, 0, -0.5), (0, 1, 0)),  # nose up: down is positive
        (30, 0, 0, (1, 0, 0), (0, math.sqrt(3) / 2, 0.5)),  # right wing low
        (90, 0, 90, (0, 1, 0), (0, 0, 1)),
    ],
)
def test_the_axes_of_a_turned_aircraft_point_as_drawn_by_hand(roll_deg, pitch_deg, yaw_deg, forward, right):
    ned_from_body = from_roll_pitch_yaw(roll_deg * DEG, pitch_deg * DEG, yaw_deg * DEG)
    assert rotate(ned_from_body, (1.0, 0.0, 0.0)) == pytest.approx(forward, abs=1e-12)
    assert rotate(ned_from_body, (0.0, 1.0, 0.0)) == pytest.approx(right, abs=1e-12)


@settings(max_examples=60, deadline=None)
@given(quaternion, quaternion, vector)
def test_a_product_turns_as_its_factors_one_after_the_other(a_from_b, b_from_c, in_c):
    assert rotate(multiply(a_from_b, b_from_c), in_c) == pytest.approx(
        rotate(a_from_b, rotate(b_from_c, in_c)), abs=1e-9
    )


@settings(max_examples=60, deadline=None)
@given(quaternion, vector)
def test_a_rotation_keeps_lengths(a_from_b, in_b):
    assert math.hypot(*rotate(a_from_b, in_b)) == pytest.approx(math.hypot(*in_b), abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(quaternion)
def test_a_sight_points_along_its_forward_axis(parent_from_sight):
    assert sight_direction(parent_from_sight) == pytest.approx(rotate(parent_from_sight, (1.0, 0.0, 0.0)), abs=1e-12)


def test_half_way_between_two_rotations_is_the_middle_one_whatever_their_signs():
    first, second = from_roll_pitch_yaw(0, 0, 170 * DEG), from_roll_pitch_yaw(0, 0, -170 * DEG)
    for sign in (1, -1):
        middle = interpolated(first, tuple(sign * part for part in second), 0.5)
        assert sight_direction(middle) == pytest.approx((-1, 0, 0), abs=1e-12)


def test_a_quaternion_of_zero_is_no_rotation():
    with pytest.raises(ValueError, match="zero length"):
        normalized((0.0, 0.0, 0.0, 0.0))
