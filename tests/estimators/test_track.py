"""The track through named damage: what goes in, and what must come out."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.estimators.estimate import TrackQuality
from sidelong.estimators.sensing.sighting import Fix
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.track import Track

NO_BIAS = TrackerSettings(yaw_bias_sigma_rad=0.0, pitch_bias_sigma_rad=0.0, range_bias_sigma_m=0.0)


def error_m(track, flown, time_s):
    estimate, true = track.estimate(time_s), flown.target[round(time_s / 0.1)]
    return math.hypot(estimate.east_m - true[0], estimate.north_m - true[1])


def legs(rng, speed_m_s=5.0):
    """A velocity that changes every 15 to 40 s: stops, turns at corners; gathers way and brakes at 1.5 m/s^2."""
    state = {"until_s": 0.0, "course": rng.uniform(0, 2 * math.pi), "wanted": np.zeros(2), "velocity": np.zeros(2)}

    def at(time_s):
        if time_s >= state["until_s"]:
            state["until_s"] = time_s + rng.uniform(15, 40)
            state["course"] += math.radians(rng.choice([-90, -45, 0, 45, 90, 180]))
            speed = rng.choice([0.0, rng.uniform(1, speed_m_s), speed_m_s])
            state["wanted"] = speed * np.array([math.sin(state["course"]), math.cos(state["course"])])
        change = state["wanted"] - state["velocity"]
        length = math.hypot(*change)
        if length > 0:
            state["velocity"] = state["velocity"] + change * min(1.0, 0.15 / length)
        return tuple(state["velocity"])

    return at


@pytest.fixture
def cruise(scene):
    return scene.of(lambda _: (3.0, 1.0), 90.0)


def test_there_is_no_estimate_before_the_first_sighting():
    assert Track(NO_BIAS).estimate(0.0) is None


def test_a_steady_target_is_followed_and_the_quality_is_good(cruise):
    track = Track(NO_BIAS)
    for sighting in cruise.sightings(np.random.default_rng(1)):
        assert track.add(sighting).accepted or sighting.time_s < 60  # one in five thousand may lie beyond the gate
    estimate = track.estimate(90.0)
    assert (estimate.quality, estimate.reason) == (TrackQuality.GOOD, "")
    assert error_m(track, cruise, 89.9) < 2.0
    assert (estimate.velocity_east_m_s, estimate.velocity_north_m_s) == pytest.approx((3.0, 1.0), abs=0.5)
    assert estimate.last_sighting_s == pytest.approx(89.9)


def test_a_range_of_poor_signal_is_rejected_with_its_reason(cruise):
    track = Track(NO_BIAS)
    outcome = track.add(replace(cruise.sightings(np.random.default_rng(1))[0], quality=0.35))
    assert not outcome.accepted
    assert outcome.reason == "signal quality 0.35 is below 0.50"
    assert track.estimate(0.0) is None


def test_a_single_outlier_is_rejected_and_reported_as_the_reason_for_coasting(cruise, moved):
    track = Track(NO_BIAS)
    sightings = cruise.sightings(np.random.default_rng(1))
    for sighting in sightings[:300]:
        track.add(sighting)
    outcome = track.add(moved(sightings[300], slant_range_m=40.0))
    assert not outcome.accepted
    assert outcome.nis > 100
    estimate = track.estimate(32.0)
    assert estimate.quality is TrackQuality.COASTING
    assert "no sighting for 2.1 s" in estimate.reason
    assert "beyond the gate" in estimate.reason


def test_quality_goes_from_good_to_coasting_to_lost_and_back(cruise):
    track = Track(replace(NO_BIAS, lost_after_s=20.0))
    sightings = cruise.sightings(np.random.default_rng(1))
    for sighting in sightings[:300]:
        track.add(sighting)
    found = {after_s: track.estimate(29.9 + after_s).quality for after_s in (0.5, 5.0, 19.0, 21.0)}
    assert list(found.values()) == [
        TrackQuality.GOOD,
        TrackQuality.COASTING,
        TrackQuality.COASTING,
        TrackQuality.LOST,
    ]
    assert "no sighting for 21 s" in track.estimate(50.9).reason
    for sighting in sightings[550:560]:
        assert track.add(sighting).accepted
    assert track.estimate(56.0).quality is TrackQuality.GOOD
    assert error_m(track, cruise, 55.9) < 4.0


def test_after_the_track_was_lost_the_next_sighting_begins_a_new_one_with_the_biases_learnt(cruise, moved):
    """Even 400 m off, where a running track would have waited for more."""
    track = Track(TrackerSettings(lost_after_s=20.0))
    sightings = cruise.sightings(np.random.default_rng(1), yaw_rad=math.radians(0.4))
    for sighting in sightings[:600]:
        track.add(sighting)
    learnt = track.calibration
    outcome = track.add(moved(sightings[850], aircraft_east_m=400.0))
    assert outcome.accepted
    assert "lost" in outcome.reason
    assert track.estimate(85.0).east_m == pytest.approx(cruise.target[850, 0] + 400.0, abs=8.0)
    assert track.calibration.yaw_bias_rad == pytest.approx(learnt.yaw_bias_rad)


def test_an_estimate_does_not_depend_on_what_was_asked_before(cruise):
    """A display asks often, a planner seldom; a coasting track answers both alike, hours later as quickly."""
    asked, unasked = Track(NO_BIAS), Track(NO_BIAS)
    for sighting in cruise.sightings(np.random.default_rng(1))[:300]:
        asked.add(sighting)
        unasked.add(sighting)
    for time_s in (30.3, 33.95, 45.0, 41.2, 80.0):
        asked.estimate(time_s)
    for time_s in (35.55, 50.0):
        ours, theirs = asked.estimate(time_s), unasked.estimate(time_s)
        assert (ours.east_m, ours.time_s) == pytest.approx((theirs.east_m, theirs.time_s))
        assert ours.covariance == pytest.approx(theirs.covariance)


@pytest.mark.parametrize("silent_s", [600.0, 3600.0, 90_000.0])
def test_after_a_long_silence_the_target_is_assumed_near_where_it_was_last_seen(cruise, silent_s):
    track = Track(NO_BIAS)
    for sighting in cruise.sightings(np.random.default_rng(1))[:300]:
        track.add(sighting)
    seen, later = track.estimate(29.9), track.estimate(29.9 + silent_s)
    assert math.dist(later.position_m(later.time_s), seen.position_m(seen.time_s)) < 500.0
    assert later.time_s == 29.9 + silent_s
    assert later.quality is TrackQuality.LOST
    assert np.all(np.isfinite(later.covariance))


def test_a_target_known_too_poorly_is_lost_before_its_time(cruise):
    track = Track(replace(NO_BIAS, lost_sigma_m=15.0))
    for sighting in cruise.sightings(np.random.default_rng(1))[:300]:
        track.add(sighting)
    estimate = track.estimate(50.0)
    assert estimate.quality is TrackQuality.LOST
    assert "position known to" in estimate.reason


@pytest.mark.parametrize("shift_m", [20.0, 60.0, 150.0])
def test_the_gate_opens_again_where_the_target_truly_jumped(cruise, moved, shift_m):
    """Ten sightings after a jump the target is followed where it is, and what was learnt of the biases is kept."""
    track = Track(TrackerSettings())
    sightings = cruise.sightings(np.random.default_rng(1), yaw_rad=math.radians(0.4))
    for sighting in sightings[:600]:
        track.add(sighting)
    learnt = track.calibration
    outcomes = [track.add(moved(sighting, aircraft_east_m=shift_m)) for sighting in sightings[600:620]]
    assert sum(not outcome.accepted for outcome in outcomes) <= 8
    estimate, true = track.estimate(61.9), cruise.target[619]
    assert math.hypot(estimate.east_m - shift_m - true[0], estimate.north_m - true[1]) < 8.0
    assert track.calibration.yaw_bias_rad == pytest.approx(learnt.yaw_bias_rad, abs=learnt.yaw_sigma_rad)


def test_a_target_that_moved_while_unseen_is_followed_from_the_third_agreeing_sighting(cruise, moved):
    track = Track(NO_BIAS)
    sightings = cruise.sightings(np.random.default_rng(1))
    for sighting in sightings[:300]:
        track.add(sighting)
    outcomes = [track.add(moved(sighting, aircraft_east_m=25.0)) for sighting in sightings[350:353]]
    assert [outcome.accepted for outcome in outcomes] == [False, False, True]
    assert track.estimate(35.2).east_m == pytest.approx(cruise.target[352, 0] + 25.0, abs=8.0)


def test_outliers_that_do_not_agree_never_open_the_gate(cruise):
    track = Track(NO_BIAS)
    sightings = cruise.sightings(np.random.default_rng(1))
    for sighting in sightings[:300]:
        track.add(sighting)
    rng = np.random.default_rng(2)
    for sighting in sightings[300:400]:
        outlier_m = rng.choice([-1, 1]) * rng.uniform(20, 90)
        assert not track.add(replace(sighting, slant_range_m=sighting.slant_range_m + outlier_m)).accepted


def test_late_sightings_count_as_if_they_had_come_in_time(cruise):
    """Every fifth comes two seconds late: the estimate ends where the punctual one does."""
    sightings = cruise.sightings(np.random.default_rng(3))[:400]
    punctual, shuffled = Track(NO_BIAS), Track(NO_BIAS)
    for sighting in sightings:
        punctual.add(sighting)
    order = sorted(enumerate(sightings), key=lambda item: item[0] + (20.5 if item[0] % 5 == 4 else 0))
    outcomes = [shuffled.add(sighting) for _, sighting in order]
    assert sum(outcome.reason == "late" for outcome in outcomes) >= 70
    ours, theirs = shuffled.estimate(40.0), punctual.estimate(40.0)
    assert (ours.east_m, ours.north_m) == pytest.approx((theirs.east_m, theirs.north_m), abs=1e-6)
    assert ours.covariance == pytest.approx(theirs.covariance, abs=1e-6)


def test_a_sighting_older_than_the_history_is_rejected(cruise):
    track = Track(NO_BIAS)
    sightings = cruise.sightings(np.random.default_rng(3))
    for sighting in sightings[1:300]:
        track.add(sighting)
    outcome = track.add(sightings[0])
    assert not outcome.accepted
    assert "older than" in outcome.reason


def test_a_late_outlier_changes_nothing(cruise, moved):
    track = Track(NO_BIAS)
    sightings = cruise.sightings(np.random.default_rng(3))
    for sighting in sightings[:300]:
        track.add(sighting)
    before = track.estimate(30.0)
    assert not track.add(moved(sightings[290], slant_range_m=50.0, time_s=0.05)).accepted
    assert track.estimate(30.0).east_m == before.east_m


def test_a_drop_out_of_a_minute_is_bridged(scene):
    """The target holds its course unseen: the ellipse grows to hold it, and the first sightings are taken again."""
    flown = scene.of(lambda _: (4.0, 0.0), 130.0)
    sightings = flown.sightings(np.random.default_rng(4))
    track = Track(TrackerSettings())
    for sighting in sightings[:500]:
        track.add(sighting)
    for time_s in (60.0, 80.0, 109.0):
        estimate = track.estimate(time_s)
        assert error_m(track, flown, time_s) < estimate.ellipse_95.semi_major_m
    assert estimate.quality is not TrackQuality.GOOD
    outcomes = [track.add(sighting) for sighting in sightings[1100:1130]]
    assert all(outcome.accepted for outcome in outcomes)
    assert error_m(track, flown, 112.9) < 5.0


def test_one_outlier_in_ten_and_a_third_of_the_time_unseen(scene):
    """Unflagged outliers of 15 to 90 m, drop-outs of up to a minute, a target that stops and turns: never lost.

    Three seconds after each drop-out the target is within 25 m, most of which is the yaw bias that is not yet known.
    """
    for seed in range(8):
        rng = np.random.default_rng(seed)
        flown = scene.of(legs(rng), 200.0, phase_rad=seed)
        sightings = flown.sightings(rng, yaw_rad=math.radians(rng.normal()))
        track, seen_since_s, unseen_until_s = Track(TrackerSettings()), 0.0, 0.0
        for sighting in sightings:
            if sighting.time_s < unseen_until_s:
                seen_since_s = unseen_until_s
                continue
            if rng.random() < 0.1 / 35:
                unseen_until_s = sighting.time_s + rng.uniform(5, 60)
            if rng.random() < 0.1 and sighting.time_s > 0:
                outlier_m = rng.choice([-1, 1]) * rng.uniform(15, 90)
                sighting = replace(sighting, slant_range_m=sighting.slant_range_m + outlier_m)  # noqa: PLW2901  # the damage
            track.add(sighting)
            if sighting.time_s > seen_since_s + 3.0:
                assert error_m(track, flown, sighting.time_s) < 25.0


def test_uphill_the_ground_is_followed(scene):
    """A road that climbs at 5 %: the target's height is learnt on the way, not taken from the aircraft's."""
    flown = scene.of(lambda _: (5.0, 0.0), 60.0)
    track = Track(NO_BIAS)
    for k, sighting in enumerate(flown.sightings(np.random.default_rng(5))):
        risen_m = 0.05 * 5.0 * k * 0.1
        slant_m = math.sqrt(sighting.slant_range_m**2 - 2 * 120.0 * risen_m + risen_m**2)
        horizontal_m = sighting.slant_range_m * math.cos(sighting.depression_rad)
        drop_m = sighting.slant_range_m * math.sin(sighting.depression_rad) - risen_m
        track.add(replace(sighting, slant_range_m=slant_m, depression_rad=math.atan2(drop_m, horizontal_m)))
        if k > 200:
            assert error_m(track, flown, sighting.time_s) < 3.0


def test_fixes_of_a_camera_alone_make_a_track():
    track = Track(NO_BIAS)
    rng = np.random.default_rng(6)
    for k in range(200):
        east, north = 3.0 * k * 0.2 + rng.normal(0, 3), rng.normal(0, 3)
        assert track.add(Fix(k * 0.2, east, north, 3.0)).accepted
    estimate = track.estimate(39.8)
    assert (estimate.east_m, estimate.north_m) == pytest.approx((119.4, 0.0), abs=3.0)
    assert estimate.velocity_east_m_s == pytest.approx(3.0, abs=0.6)


def test_an_estimate_never_goes_back_in_time(cruise):
    track = Track(NO_BIAS)
    times_s = []
    for sighting in itertools.islice(cruise.sightings(np.random.default_rng(7)), 50):
        track.add(sighting)
        times_s.append(track.estimate(sighting.time_s - 1.0).time_s)
    assert times_s == sorted(times_s)
