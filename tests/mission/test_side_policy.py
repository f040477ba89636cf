import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.requirement import Requirement, Sector, Side
from sidelong.mission.viewpoint.watch_course import SidePolicy, watching_from

LEFT = Requirement(100.0, 500.0, Side.LEFT, 5.0)


def target(east_m_s, north_m_s, time_s=0.0):
    return TargetEstimate(
        time_s, 0.0, 0.0, east_m_s, north_m_s, np.diag([1.0, 1.0, 0.01, 0.01]), TrackQuality.GOOD, time_s
    )


def test_a_side_follows_the_course():
    policy = SidePolicy(LEFT, 50.0)
    assert policy.viewpoint(-300.0, 0.0, target(0.0, 3.0)).course_rad == pytest.approx(0.0)
    turned = policy.viewpoint(-300.0, 0.0, target(3.0, 0.0, 1.0))
    assert (turned.course_rad, turned.side) == (pytest.approx(math.pi / 2), Side.LEFT)


def test_a_target_that_never_moved_is_watched_from_where_the_aircraft_began():
    policy = SidePolicy(LEFT, 50.0)
    began = policy.viewpoint(0.0, 300.0, target(0.0, 0.0))
    # Left of a course to the east is north.
    assert began.course_rad == pytest.approx(math.pi / 2)
    assert policy.viewpoint(200.0, 200.0, target(0.0, 0.0, 30.0)).course_rad == began.course_rad


def test_either_side_changes_only_well_beyond_the_line():
    policy = SidePolicy(watching_from(LEFT, "either"), 50.0)
    sides = [policy.viewpoint(east_m, 200.0, target(0.0, 3.0)).side for east_m in (-300.0, 40.0, 60.0, -40.0, -60.0)]
    assert sides == [Side.LEFT, Side.LEFT, Side.RIGHT, Side.RIGHT, Side.LEFT]


def test_a_fixed_side_never_changes():
    policy = SidePolicy(LEFT, 50.0)
    assert policy.viewpoint(400.0, 0.0, target(0.0, 3.0)).side is Side.LEFT


def test_a_sector_does_not_follow_the_course():
    policy = SidePolicy(watching_from(LEFT, "120-200"), 50.0)
    for moving in (target(0.0, 3.0), target(3.0, 0.0, 1.0), target(0.0, 0.0, 2.0)):
        view = policy.viewpoint(0.0, -300.0, moving)
        # Its left normal is the middle of the sector.
        assert view.course_rad + Side.LEFT.normal_turn_rad == pytest.approx(math.radians(160.0))


def test_sides_as_a_person_writes_them():
    assert watching_from(LEFT, "right").side is Side.RIGHT
    assert watching_from(LEFT, "either").either_side
    wrapped = watching_from(LEFT, "340-20").sector
    assert wrapped is not None
    assert wrapped.half_width_rad == pytest.approx(math.radians(20.0))
    assert math.remainder(wrapped.middle_rad, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("words", ["", "up", "120", "-5-20"])
def test_other_words_are_refused_by_name(words):
    with pytest.raises(ValueError, match=f"^'{words}' is none of left, right, either, or a sector"):
        watching_from(LEFT, words)


@pytest.mark.parametrize("words", ["120-120", "0-360", "10-400"])
def test_a_sector_has_two_bearings(words):
    with pytest.raises(ValueError, match=f"^the sector {words} needs two different bearings"):
        watching_from(LEFT, words)


def test_a_sector_knows_its_middle():
    assert Sector(0.0, math.pi / 2).middle_rad == pytest.approx(math.pi / 4)


def at(time_s, east_m, north_m):
    return TargetEstimate(
        time_s, east_m, north_m, 0.0, 0.0, np.diag([4.0, 1.0, 0.01, 0.01]), TrackQuality.GOOD, time_s
    )


def test_the_course_made_good_turns_over_its_horizon_and_is_held_when_the_target_stands():
    policy = SidePolicy(LEFT, 50.0, 20.0)
    began = policy.viewpoint(0.0, 300.0, at(0.0, 0.0, 0.0)).course_rad
    assert began == pytest.approx(math.pi / 2)  # of an aircraft to the north
    views = {}
    for k in range(1, 181):
        # North for 60 s at 3 m/s, then east for 60 s, then it stands.
        place = 3.0 * max(0, min(k, 120) - 60), 3.0 * min(k, 60)
        views[k] = policy.viewpoint(0.0, 300.0, at(float(k), *place))
    assert views[3].course_rad == began  # 9 m are too short a way
    assert views[4].course_rad == pytest.approx(0.0)
    assert views[60].course_sigma_rad == pytest.approx(2.0 / 60.0)
    assert views[65].course_rad == pytest.approx(math.atan2(15.0, 45.0))
    assert views[80].course_rad == pytest.approx(math.pi / 2)
    assert views[180].course_rad == pytest.approx(math.pi / 2)
    assert views[180].course_sigma_rad == pytest.approx(2.0 / 10.0)


def test_the_wandering_estimate_of_a_standing_target_makes_no_course():
    """It goes east, stands, and is out of sight: its estimate wanders by 11 m, at a standard deviation of 4 m."""
    for sigma_m, course_rad in ((4.0, math.pi / 2), (1.0, 0.0)):
        policy = SidePolicy(LEFT, 50.0, 20.0)
        for time_s in range(61):
            east_m, north_m = 3.0 * min(time_s, 20), 1.1 * max(time_s - 50, 0)
            velocity_m_s = 3.0 * (time_s < 20)
            seen = replace(at(float(time_s), east_m, north_m), velocity_east_m_s=velocity_m_s)
            if time_s >= 50:
                seen = replace(seen, covariance=np.diag([sigma_m**2, sigma_m**2, 0.01, 0.01]))
            view = policy.viewpoint(0.0, 300.0, seen)
        assert view.course_rad == pytest.approx(course_rad), sigma_m


def test_places_between_sightings_are_interpolated():
    policy = SidePolicy(LEFT, 50.0, 20.0)
    for time_s, east_m, north_m in ((0.0, 0.0, 0.0), (40.0, 0.0, 120.0), (41.0, 4.0, 120.0)):
        moving = replace(at(time_s, east_m, north_m), velocity_north_m_s=3.0)
        view = policy.viewpoint(0.0, 300.0, moving)
    assert view.course_rad == pytest.approx(math.atan2(4.0, 120.0 - 63.0))


@pytest.mark.parametrize("jump_m", [(-60.0, -90.0), (80.0, 0.0)])
def test_the_course_made_good_does_not_follow_a_jump_of_the_estimate(jump_m):
    """A target goes north at 3 m/s. After 30 s the estimate, which had coasted, is found elsewhere."""
    policy, found = SidePolicy(LEFT, 50.0, 20.0), []
    for time_s in range(60):
        east_m, north_m = jump_m if time_s >= 30 else (0.0, 0.0)
        moving = replace(target(0.0, 3.0, float(time_s)), east_m=east_m, north_m=north_m + 3.0 * time_s)
        found.append(policy.viewpoint(-300.0, 0.0, moving).course_rad)
    assert found[4:] == pytest.approx([0.0] * 56, abs=1e-9)


def test_of_a_late_payload_the_places_of_its_sightings_are_remembered():
    """It goes north, then east. For 2 s after the bend the late estimates go on to the north."""
    policy = SidePolicy(LEFT, 50.0, 20.0)
    for time_s in range(60):
        place = 3.0 * max(0, time_s - 30), 3.0 * min(time_s, 30)
        seen = replace(at(time_s - 2.0, *place), velocity_north_m_s=3.0)
        predicted = replace(seen, time_s=float(time_s), north_m=place[1] + 6.0, as_seen=seen)
        view = policy.viewpoint(0.0, 300.0, predicted)
        if time_s == 40:  # it was at (0, 66) when it was seen 20 s before now
            assert view.course_rad == pytest.approx(math.atan2(30.0, 96.0 - 66.0))


def test_of_a_late_payload_motion_is_judged_by_the_sightings():
    """A walker of 1.2 m/s, known to 0.3 m/s as last seen, to 0.8 m/s after the prediction, still moves."""
    for as_seen, course_rad in ((True, 0.0), (False, math.pi / 2)):
        policy = SidePolicy(LEFT, 50.0)
        seen = replace(target(0.0, 1.2), covariance=np.diag([1.0, 1.0, 0.09, 0.09]))
        predicted = replace(seen, time_s=2.0, covariance=np.diag([9.0, 9.0, 0.64, 0.64]))
        view = policy.viewpoint(0.0, 300.0, replace(predicted, as_seen=seen if as_seen else None))
        assert view.course_rad == pytest.approx(course_rad)
