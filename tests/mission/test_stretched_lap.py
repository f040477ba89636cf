import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sidelong.mission.core.circle import Circle
from sidelong.mission.paper.transition import TransitionError, stretched_lap

laps = st.fixed_dictionaries(
    {
        "radius_m": st.floats(20, 200),
        "half_width_rad": st.floats(math.radians(20), math.radians(175)),
        "bearing_rad": st.floats(-math.pi, math.pi),
        "move_m": st.floats(0.0, 2000.0),
        "clockwise": st.booleans(),
    }
)


def make(radius_m: float, bearing_rad: float, move_m: float, clockwise: bool) -> tuple[Circle, Circle]:
    return Circle(40.0, -90.0, radius_m, clockwise), Circle(
        40.0 + move_m * math.sin(bearing_rad), -90.0 + move_m * math.cos(bearing_rad), radius_m, clockwise
    )


@settings(max_examples=60, deadline=None)
@given(laps)
def test_it_begins_and_ends_on_the_circles(drawn: dict) -> None:
    half_width_rad = drawn.pop("half_width_rad")
    present, new = make(**drawn)
    path = stretched_lap(present, new, half_width_rad)
    for circle, end in ((present, 0), (new, -1)):
        on_circle_m = circle.position_at_course(float(path.course_rad[end]))
        assert math.dist(on_circle_m, (path.east_m[end], path.north_m[end])) < 1e-6
        assert path.curvature_per_m[end] == pytest.approx(circle.curvature_per_m, rel=1e-9)


@settings(max_examples=40, deadline=None)
@given(laps)
def test_it_is_one_smooth_line_never_tighter_than_the_circle(drawn: dict) -> None:
    half_width_rad = drawn.pop("half_width_rad")
    present, new = make(**drawn)
    path = stretched_lap(present, new, half_width_rad, step_m=drawn["radius_m"] / 200.0)
    steps_m = np.diff(path.arc_m)
    turns_rad = np.diff(path.course_rad)
    middle_rad = (path.course_rad[1:] + path.course_rad[:-1]) / 2.0
    assert np.all(steps_m > 0.0)
    assert np.allclose(np.diff(path.east_m), steps_m * np.sin(middle_rad), atol=1e-4 * drawn["radius_m"])
    assert np.allclose(np.diff(path.north_m), steps_m * np.cos(middle_rad), atol=1e-4 * drawn["radius_m"])
    assert np.allclose(turns_rad, steps_m * (path.curvature_per_m[1:] + path.curvature_per_m[:-1]) / 2.0, atol=1e-4)
    assert np.all(np.abs(path.curvature_per_m) <= (1.0 + 1e-9) / drawn["radius_m"])


def test_the_move_of_the_closed_form() -> None:
    """W = 60 degrees, 333 m at 10 m/s take 46 s, and roll by 4.5 degrees a second at most."""
    path = stretched_lap(Circle(0.0, 0.0, 50.0, True), Circle(333.0, 0.0, 50.0, True), math.radians(60.0))
    assert path.length_m / 10.0 == pytest.approx(46.3, abs=0.1)
    bank_rad = np.arctan(10.0**2 * path.curvature_per_m / 9.80665)
    roll_rate_deg_s = np.degrees(np.abs(np.diff(bank_rad) / np.diff(path.arc_m))) * 10.0
    assert np.max(roll_rate_deg_s) == pytest.approx(4.5, abs=0.1)


def test_no_move_is_the_circle_itself() -> None:
    path = stretched_lap(Circle(5.0, 6.0, 50.0, False), Circle(5.0, 6.0, 50.0, False))
    assert np.allclose(np.hypot(path.east_m - 5.0, path.north_m - 6.0), 50.0)


@pytest.mark.parametrize(
    ("new", "half_width_rad", "word"),
    [
        (Circle(100, 0, 60, True), 1.0, "radius"),
        (Circle(100, 0, 50, False), 1.0, "direction"),
        (Circle(100, 0, 50, True), 3.2, "half_width_rad"),
    ],
)
def test_refusals_name_the_reason(new: Circle, half_width_rad: float, word: str) -> None:
    with pytest.raises(TransitionError, match=word):
        stretched_lap(Circle(0, 0, 50, True), new, half_width_rad)
