"""Time in band and on side, against cases worked out by hand."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sidelong.app.analysis.score import Moment, judge_moments, score
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.requirement import Requirement, Side
from sidelong.mission.viewpoint.watch_course import TargetCourse

REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 3.0)
LEFT = ((0.0, REQUIREMENT),)
RIGHT = replace(REQUIREMENT, side=Side.RIGHT)


def moments(places, velocity=(0.0, 12.0)):
    """The aircraft at ``places`` from the target, one a second. After the first the target has moved enough."""
    return [
        Moment(float(k), k * velocity[0] + east, k * velocity[1] + north, k * velocity[0], k * velocity[1], *velocity)
        for k, (east, north) in enumerate(places)
    ]


def test_left_of_a_target_going_north_is_west():
    west, east = (-200.0, 0.0), (200.0, 0.0)
    assert score(judge_moments(moments([west] * 5), LEFT), "truth").time_on_side == 1.0
    assert score(judge_moments(moments([east] * 5), LEFT), "truth").time_on_side == 0.0
    assert score(judge_moments(moments([east] * 5), ((0.0, RIGHT),)), "truth").time_on_side == 1.0


def test_a_side_changed_on_the_way_counts_from_then_on():
    asked = ((0.0, REQUIREMENT), (6.0, RIGHT))
    assert score(judge_moments(moments([(200.0, 0.0)] * 12), asked), "truth").time_on_side == 0.5


def test_each_moment_counts_until_the_next():
    result = score(judge_moments(moments([(-200, 0), (-200, 0), (-50, 0), (-600, 0), (-200, 0)]), LEFT), "estimate")
    assert result.time_in_band == 0.5
    assert (result.min_range_m, result.max_range_m) == (50.0, 600.0)
    assert result.duration_s == 4.0
    assert result.source == "estimate"


def test_a_standing_target_keeps_its_last_course():
    went = moments([(-200.0, 0.0)] * 2)
    stands = [Moment(2.0 + k, -200.0, 12.0, 0.0, 12.0, 0.1, 0.0) for k in range(5)]
    assert score(judge_moments(went + stands, LEFT), "truth").time_on_side == 1.0


def test_nothing_to_score_is_none():
    assert score(judge_moments([], LEFT), "truth").time_in_band is None
    assert score(judge_moments(moments([(0, 0)]), LEFT), "truth").duration_s == pytest.approx(0.0)


def test_a_band_changed_on_the_way_counts_from_then_on():
    asked = ((0.0, REQUIREMENT), (5.0, replace(REQUIREMENT, range_min_m=250.0)))
    assert score(judge_moments(moments([(-200.0, 0.0)] * 11), asked), "truth").time_in_band == 0.5


def test_a_winding_target_has_the_sides_of_the_course_that_it_made_good():
    """It drives north in a zigzag of 60 degrees; an aircraft west and behind is off the side of each second leg."""
    east_m = north_m = 0.0
    seen = []
    for k in range(101):
        turn_rad = math.radians(60.0 if k // 4 % 2 else -60.0)
        velocity = (3.0 * math.sin(turn_rad), 3.0 * math.cos(turn_rad))
        seen.append(Moment(float(k), east_m - 200.0, north_m - 180.0, east_m, north_m, *velocity))
        east_m, north_m = east_m + velocity[0], north_m + velocity[1]
    result = score(judge_moments(seen, LEFT), "truth")
    assert result.time_on_side == 1.0
    assert result.time_on_side_now == pytest.approx(0.5, abs=0.03)
    by_the_present = score(judge_moments(seen, ((0.0, replace(REQUIREMENT, course_horizon_s=0.0)),)), "truth")
    assert by_the_present.time_on_side == pytest.approx(0.5, abs=0.03)


def test_before_it_has_moved_the_target_has_no_side():
    stands = [Moment(float(k), 200.0, 0.0, 0.0, 0.0, 0.1, 0.0) for k in range(20)]
    assert score(judge_moments(stands, LEFT), "truth").time_on_side is None
    assert score(judge_moments(stands, LEFT), "truth").time_in_band == 1.0


def dropout():
    """Return the estimates of a target that drove north at 5 m/s and stopped at 62 s.

    From 60 to 85 s the payload did not see it: the estimate coasted on by 95 m, then jumped back. The aircraft
    circled west of it.
    """
    rows = np.loadtxt(Path(__file__).parents[1] / "data" / "dropout.csv", delimiter=",", skiprows=1)
    return [Moment(*row) for row in rows.tolist()]


def test_an_estimate_that_jumps_back_after_a_dropout_turns_no_course():
    seen = dropout()
    jumped_m = [after.target_north_m - before.target_north_m for before, after in itertools.pairwise(seen)]
    assert min(jumped_m) < -90.0  # else nothing is tested
    judged = judge_moments(seen, LEFT)
    known = judged.course_rad[judged.side_known]
    assert np.abs(known).max() < math.radians(10.0)
    assert score(judged, "estimate").time_on_side == 1.0


def test_the_page_follows_the_same_course_as_the_judge():
    seen, course, followed = dropout(), TargetCourse(), []
    for one in seen:
        state = one.target_east_m, one.target_north_m, one.target_velocity_east_m_s, one.target_velocity_north_m_s
        course.update(TargetEstimate(one.time_s, *state, np.zeros((4, 4)), TrackQuality.GOOD, one.time_s), 20.0)
        followed.append(math.nan if course.made_good_rad is None else course.made_good_rad)
    unknown = [one.time_s for one, course_rad in zip(seen, followed, strict=True) if math.isnan(course_rad)]
    jumped_s = max(unknown)  # it has no course either until the target has moved
    known = ~np.isnan(followed)
    np.testing.assert_allclose(np.array(followed)[known], judge_moments(seen, LEFT).course_rad[known], atol=1e-9)
    assert seen[-1].time_s > jumped_s
    assert sum(one > jumped_s - 40.0 for one in unknown) <= 21


def test_a_target_that_started_out_of_sight_has_no_course_until_it_is_found():
    """It went east, stood, and was hidden while it went on to the north."""
    course, followed = TargetCourse(), {}
    for time_s in np.arange(70.0).tolist():
        north_m = 3.0 * max(time_s - 50.0, 0.0) if time_s >= 55.0 else 0.0
        state = 3.0 * min(time_s, 20.0), north_m, 3.0 * (time_s < 20.0), 3.0 * (time_s >= 55.0)
        course.update(
            TargetEstimate(time_s, *state, np.diag([1.0, 1.0, 0.01, 0.01]), TrackQuality.GOOD, time_s), 20.0
        )
        followed[time_s] = course.made_good_rad
    assert followed[54.0] == pytest.approx(math.pi / 2)
    assert followed[55.0] is None
    assert followed[69.0] == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize(("sigma_m", "course_rad"), [(4.0, math.pi / 2), (1.0, 0.0)])
def test_the_page_sees_no_course_in_the_wandering_estimate_of_a_standing_target(sigma_m, course_rad):
    """It goes east, then stands; out of sight, its estimate wanders by 11 m to the north."""
    course = TargetCourse()
    for time_s in np.arange(61.0).tolist():
        variance_m2 = sigma_m**2 if time_s >= 50.0 else 1.0
        state = 3.0 * min(time_s, 20.0), 1.1 * max(time_s - 50.0, 0.0), 3.0 * (time_s < 20.0), 0.0
        covariance, seen_s = np.diag([variance_m2, variance_m2, 0.01, 0.01]), min(time_s, 50.0)
        estimate = TargetEstimate(time_s, *state, covariance, TrackQuality.GOOD, seen_s)
        course.update(estimate, 20.0)
    assert course.made_good_rad == pytest.approx(course_rad)


def test_moves_and_reversals_are_counted_from_the_first_judged_moment():
    judged = judge_moments(moments([(-200.0, 0.0)] * 100), LEFT)
    result = score(judged, "truth", [-5.0, 3.0, 11.0, 21.0, 50.0])
    assert (result.moves, result.reversals) == (4, 1)  # 8 s after the last one; 10 s is no reversal


def test_the_last_moment_counts_until_the_end_that_is_given():
    judged = judge_moments(moments([(-200.0, 0.0), (-50.0, 0.0)]), LEFT)
    assert score(judged, "truth").time_in_band == 1.0
    assert score(judged, "truth", end_s=4.0).time_in_band == 0.25
