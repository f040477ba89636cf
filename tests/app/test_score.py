"""Time in band and on side, against cases worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import pytest

from app.analysis.score import Moment, score
from mission.core.requirement import Requirement, Side

REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 3.0)
LEFT = ((0.0, REQUIREMENT),)
RIGHT = replace(REQUIREMENT, side=Side.RIGHT)


def moments(places, velocity=(0.0, 3.0)):
    """The aircraft at ``places``, one a second, the target at the origin."""
    return [Moment(float(k), east, north, 0.0, 0.0, *velocity) for k, (east, north) in enumerate(places)]


def test_left_of_a_target_going_north_is_west():
    west, east = (-200.0, 0.0), (200.0, 0.0)
    assert score(moments([west] * 5), LEFT, "truth").time_on_side == 1.0
    assert score(moments([east] * 5), LEFT, "truth").time_on_side == 0.0
    assert score(moments([east] * 5), ((0.0, RIGHT),), "truth").time_on_side == 1.0


def test_a_side_changed_on_the_way_counts_from_then_on():
    asked = ((0.0, REQUIREMENT), (5.0, RIGHT))
    assert score(moments([(200.0, 0.0)] * 11), asked, "truth").time_on_side == 0.5


def test_each_moment_counts_until_the_next():
    result = score(moments([(-200, 0), (-200, 0), (-50, 0), (-600, 0), (-200, 0)]), LEFT, "estimate")
    assert result.time_in_band == 0.5
    assert (result.min_range_m, result.max_range_m) == (50.0, 600.0)
    assert result.duration_s == 4.0
    assert result.source == "estimate"


def test_a_standing_target_keeps_its_last_course():
    went = moments([(-200.0, 0.0)] * 2)
    stands = [Moment(2.0 + k, -200.0, 0.0, 0.0, 0.0, 0.1, 0.0) for k in range(5)]
    assert score(went + stands, LEFT, "truth").time_on_side == 1.0


def test_nothing_to_score_is_none():
    assert score([], LEFT, "truth").time_in_band is None
    assert score(moments([(0, 0)]), LEFT, "truth").duration_s == pytest.approx(0.0)


def test_a_band_changed_on_the_way_counts_from_then_on():
    asked = ((0.0, REQUIREMENT), (5.0, replace(REQUIREMENT, range_min_m=250.0)))
    assert score(moments([(-200.0, 0.0)] * 11), asked, "truth").time_in_band == 0.5
