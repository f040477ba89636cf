import pytest
from hypothesis import given
from hypothesis import strategies as st

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import Plan
from sidelong.mission.paper.transition import abcd
from sidelong.mission.upload.fences import FenceError, Fences

FIRST, SECOND = Circle(0.0, 0.0, 50.0, True), Circle(400.0, 0.0, 50.0, True)
MOVE = Plan(SECOND, abcd(FIRST, SECOND))  # bulges to 105 m north between the circles
CIRCLE = Plan(SECOND)


def box(west_m: float, south_m: float, east_m: float, north_m: float) -> list[tuple[float, float]]:
    return [(west_m, south_m), (east_m, south_m), (east_m, north_m), (west_m, north_m)]


def test_no_fence_rejects_nothing() -> None:
    assert Fences().rejection(MOVE, 100.0) is None


def test_a_plan_inside_all_fences_passes() -> None:
    fences = Fences([box(-200, -200, 600, 300)], [box(190, -20, 210, 20)], 50.0, 120.0)
    assert fences.rejection(MOVE, 100.0) is None


@pytest.mark.parametrize(
    ("fences", "plan", "reason"),
    [
        (Fences([box(-200, -200, 600, 90)]), MOVE, "the transition leaves the keep_in polygons"),
        (
            Fences([box(-200, -200, 600, 115)]),
            MOVE,
            "the transition comes within 11 m of the keep_in border, less than 20 m",
        ),
        (Fences([box(-200, -200, 430, 300)]), CIRCLE, "the new circle leaves the keep_in polygons"),
        (
            Fences(keep_out=[box(0, -300, 1, -299), box(190, 90, 210, 150)]),
            MOVE,
            "the transition crosses keep_out polygon 2",
        ),
        (
            Fences(keep_out=[box(460, -10, 500, 10)]),
            CIRCLE,
            "the new circle comes within 10 m of keep_out polygon 1, less than 20 m",
        ),
        (Fences(floor_m=120.0), CIRCLE, "the height of 100 m is below the floor of 120 m"),
        (Fences(ceiling_m=80.0), CIRCLE, "the height of 100 m is above the ceiling of 80 m"),
    ],
)
def test_a_rejection_names_the_part_and_the_fence(fences: Fences, plan: Plan, reason: str) -> None:
    assert fences.rejection(plan, 100.0) == reason
    assert fences.check(100.0)(plan) == reason


def test_overlapping_keep_in_polygons_count_as_one() -> None:
    halves = [box(-200, -200, 210, 300), box(190, -200, 600, 300)]
    assert Fences(halves).rejection(MOVE, 100.0) is None
    assert Fences(halves[:1]).rejection(MOVE, 100.0) is not None


def test_a_keep_out_inside_the_circle_may_be_flown_round() -> None:
    assert Fences(keep_out=[box(390, -10, 410, 10)]).rejection(CIRCLE, 100.0) is None


@given(offset_m=st.floats(0.0, 120.0), margin_m=st.floats(0.0, 50.0))
def test_the_margin_is_kept_to_the_metre(offset_m: float, margin_m: float) -> None:
    """A wall ``offset_m`` east of the circle's easternmost point."""
    fences = Fences(keep_out=[box(450 + offset_m, -500, 1000, 500)], margin_m=margin_m)
    rejected = fences.rejection(CIRCLE, 100.0) is not None
    if abs(offset_m - margin_m) > 0.1:
        assert rejected == (offset_m < margin_m)


@pytest.mark.parametrize(
    ("outline", "words"),
    [
        ([(0, 0), (1, 1)], "keep_out polygon 1 has 2 corners"),
        ([(0, 0), (10, 10), (10, 0), (0, 10)], "sides that cross"),
    ],
)
def test_a_fence_that_is_no_polygon_is_an_error(outline: list[tuple[float, float]], words: str) -> None:
    with pytest.raises(FenceError, match=words):
        Fences(keep_out=[outline])
