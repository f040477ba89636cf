"""From readings to estimate: pairing, sources, frames."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.estimators.sensing.readings import (
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Source,
    TargetFixReading,
)
from sidelong.estimators.terrain.ground import flat_ground
from sidelong.estimators.tracking.tracker import SourceChoice, Tracker, TrackerSettings

NO_BIAS = TrackerSettings(yaw_bias_sigma_rad=0.0, pitch_bias_sigma_rad=0.0, range_bias_sigma_m=0.0)
CAMERA = Source("CAMERA_TRACKING_GEO_STATUS", 100)


@pytest.fixture
def cruise(scene):
    return scene.of(lambda _: (3.0, 1.0), 40.0)


def fed(readings, settings=NO_BIAS):
    tracker = Tracker(settings)
    outcomes = [outcome for reading in readings for outcome in tracker.add(reading)]
    return tracker, outcomes


def error_m(tracker, flown, time_s):
    estimate, true = tracker.estimate(time_s), flown.target[round(time_s / 0.1)]
    return math.hypot(estimate.east_m - true[0], estimate.north_m - true[1])


def test_each_range_makes_one_sighting_at_its_own_time(cruise):
    readings = cruise.readings(np.random.default_rng(1))
    tracker, outcomes = fed(readings)
    ranges = [reading.time_s for reading in readings if isinstance(reading, RangeReading)]
    assert [outcome.sighting.time_s for outcome in outcomes] == ranges
    assert tracker.sightings == len(ranges)
    assert tracker.rejected == sum(not outcome.accepted for outcome in outcomes)
    assert error_m(tracker, cruise, 39.9) < 2.0


@pytest.mark.parametrize(("range_every", "gimbal_every"), [(1, 3), (5, 1), (3, 2), (2, 7)])
def test_range_and_gimbal_of_different_rates_are_paired_by_interpolation(cruise, range_every, gimbal_every):
    readings = cruise.readings(np.random.default_rng(2), range_every=range_every, gimbal_every=gimbal_every)
    tracker, outcomes = fed(readings)
    paired = [outcome.sighting for outcome in outcomes if outcome.accepted]
    assert len(paired) > 0.9 * 400 / range_every - gimbal_every
    # Between two sights 0.7 s apart the bearing bends by less than its own noise.
    assert np.median([math.hypot(s.east_m - 3 * s.time_s, s.north_m - s.time_s) for s in paired]) < 3.0
    assert error_m(tracker, cruise, 39.0) < 3.0


def test_ranges_that_share_their_lines_of_sight_are_not_taken_for_independent(cruise):
    _, often = fed(cruise.readings(np.random.default_rng(2), gimbal_every=5))
    _, seldom = fed(cruise.readings(np.random.default_rng(2), gimbal_every=5, range_every=5))
    assert often[-2].sighting.bearing_sigma_rad > 2.0 * seldom[-1].sighting.bearing_sigma_rad


def test_positions_at_1_hz_are_enough(cruise):
    readings = cruise.readings(np.random.default_rng(3))
    thinned = [r for r in readings if not isinstance(r, PositionReading) or abs(r.time_s % 1.0) < 0.05]
    tracker, outcomes = fed(thinned)
    assert len(outcomes) > 380
    assert error_m(tracker, cruise, 38.9) < 2.0


def test_readings_that_come_in_any_order_within_a_second_lead_to_the_same_place(cruise):
    readings = cruise.readings(np.random.default_rng(4))
    rng = np.random.default_rng(5)
    shuffled = sorted(readings, key=lambda reading: reading.time_s + rng.uniform(0.0, 0.8))
    straight, _ = fed(readings)
    tracker, outcomes = fed(shuffled)
    assert len(outcomes) > 395
    ours, theirs = tracker.estimate(41.0), straight.estimate(41.0)
    assert (ours.east_m, ours.north_m) == pytest.approx((theirs.east_m, theirs.north_m), abs=0.5)


def test_doubled_messages_count_once(cruise):
    readings = cruise.readings(np.random.default_rng(6))
    single, _ = fed(readings)
    doubled, _ = fed([reading for one in readings for reading in (one, one)])
    assert doubled.sightings == single.sightings
    assert doubled.estimate(40.0).east_m == pytest.approx(single.estimate(40.0).east_m, abs=1e-9)


def test_a_repetition_by_the_autopilot_and_its_downward_sensor_are_left_aside(cruise):
    with_traps = []
    for reading in cruise.readings(np.random.default_rng(7)):
        if isinstance(reading, RangeReading):
            repeated = Source("DISTANCE_SENSOR", 1, 1, 100)
            with_traps.append(RangeReading(reading.time_s, 95.0, Source("DISTANCE_SENSOR", 1, 0, 25)))
            with_traps.append(reading)
            with_traps.append(RangeReading(reading.time_s + 0.008, reading.slant_range_m, repeated))
        else:
            with_traps.append(reading)
    tracker, outcomes = fed(with_traps)
    assert len(outcomes) == 400
    assert tracker.ranges.chosen == Source("DISTANCE_SENSOR", 154, 1, 100)
    assert error_m(tracker, cruise, 39.9) < 2.0


def test_a_gimbal_measured_against_the_heading_gives_the_same_target(cruise, looking_at):
    """Yaw relative to a heading that turns all the time: interpolation takes each at the time of the range."""
    turned, heading_rad = [], 0.0
    for reading in cruise.readings(np.random.default_rng(8)):
        if isinstance(reading, AttitudeReading):
            heading_rad = reading.yaw_rad
            turned.append(AttitudeReading(reading.time_s, 0.3, 0.05, heading_rad))
        elif isinstance(reading, GimbalReading):
            w, x, y, z = reading.quaternion_wxyz
            c, s = math.cos(-heading_rad / 2), math.sin(-heading_rad / 2)
            relative = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)
            turned.append(GimbalReading(reading.time_s, relative, "vehicle", reading.source))
        else:
            turned.append(reading)
    tracker, outcomes = fed(turned)
    earth, _ = fed(cruise.readings(np.random.default_rng(8)))
    assert len(outcomes) > 395
    assert tracker.estimate(39.9).east_m == pytest.approx(earth.estimate(39.9).east_m, abs=1.0)
    # The aircraft's own attitude error adds to the bearing's.
    assert outcomes[9].sighting.bearing_sigma_rad > math.hypot(NO_BIAS.yaw_sigma_rad, NO_BIAS.attitude_sigma_rad)


def test_a_laser_that_reports_where_it_points_needs_no_gimbal(cruise):
    """Its quaternion is against the airframe; here that is level and heads north."""
    alone, quaternion = [], (1.0, 0.0, 0.0, 0.0)
    for reading in cruise.readings(np.random.default_rng(9)):
        if isinstance(reading, GimbalReading):
            quaternion = reading.quaternion_wxyz
        elif isinstance(reading, AttitudeReading):
            alone.append(AttitudeReading(reading.time_s, 0.0, 0.0, 0.0))
        elif isinstance(reading, RangeReading):
            alone.append(replace(reading, sensor_quaternion_wxyz=quaternion))
        else:
            alone.append(reading)
    tracker, _ = fed(alone)
    assert error_m(tracker, cruise, 39.9) < 3.0


def test_the_null_rotation_of_a_laser_reports_nothing(cruise):
    readings = [
        replace(reading, sensor_quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))
        if isinstance(reading, RangeReading)
        else reading
        for reading in cruise.readings(np.random.default_rng(9))
        if not isinstance(reading, GimbalReading)
    ]
    tracker, outcomes = fed(readings)
    assert outcomes == []
    assert tracker.estimate(39.9) is None
    assert sum(isinstance(one, RangeReading) for one in readings) > 350


def test_a_sight_that_is_no_rotation_is_dropped(cruise):
    readings = [
        replace(reading, quaternion_wxyz=(0.0, 0.0, 0.0, 0.0))
        if isinstance(reading, GimbalReading) and round(reading.time_s * 10) % 2
        else reading
        for reading in cruise.readings(np.random.default_rng(10))
    ]
    tracker, outcomes = fed(readings)
    assert len(outcomes) > 390
    assert error_m(tracker, cruise, 39.8) < 2.0


def test_a_configured_latency_is_taken_off_the_stamps(cruise):
    """Payload stamped 0.3 s too late: if configured, the tracker is right; else it errs by the aircraft's motion."""
    late = [
        replace(reading, time_s=reading.time_s + 0.3)
        if isinstance(reading, RangeReading | GimbalReading)
        else reading
        for reading in cruise.readings(np.random.default_rng(11))
    ]
    announced, _ = fed(late, replace(NO_BIAS, gimbal_latency_s=0.3, range_latency_s=0.3))
    uninformed, _ = fed(late, replace(NO_BIAS, latency_sigma_s=0.0))
    assert error_m(announced, cruise, 39.9) < 2.0
    assert error_m(uninformed, cruise, 39.9) > 3.0


@pytest.mark.parametrize("late_s", [0.1, 1.0])
def test_of_a_payload_that_is_very_late_the_estimate_of_the_last_sighting_is_given(cruise, late_s):
    late = [
        replace(reading, time_s=reading.time_s + late_s)
        if isinstance(reading, RangeReading | GimbalReading)
        else reading
        for reading in cruise.readings(np.random.default_rng(17))
    ]
    tracker, _ = fed(late, replace(NO_BIAS, gimbal_latency_s=late_s, range_latency_s=late_s))
    estimate = tracker.estimate(39.9 + late_s)
    if late_s < 0.4:
        assert estimate.as_seen is None
    else:
        assert estimate.as_seen.time_s == pytest.approx(39.9, abs=0.15)
        assert estimate.as_seen.covariance.trace() < estimate.covariance.trace()
        assert estimate.as_seen.as_seen is None


def test_a_lever_arm_moves_the_place_that_is_seen_from(cruise):
    _, plain = fed(cruise.readings(np.random.default_rng(12)))
    _, offset = fed(cruise.readings(np.random.default_rng(12)), replace(NO_BIAS, lever_arm_body_m=(2.0, 0.0, 0.5)))
    first, second = plain[50].sighting, offset[50].sighting
    aircraft = cruise.aircraft[50]
    speed = math.hypot(aircraft[2], aircraft[3])
    assert second.aircraft_east_m - first.aircraft_east_m == pytest.approx(2 * aircraft[2] / speed, abs=1e-6)
    assert second.aircraft_height_m - first.aircraft_height_m == pytest.approx(-0.5)


def test_a_cameras_fixes_are_used_only_while_no_laser_speaks(cruise):
    """They may be made from the same laser. Here they are 100 m off while it speaks, and right afterwards."""
    readings = cruise.readings(np.random.default_rng(13))
    tracker, _ = fed(readings)
    before = tracker.estimate(40.0).east_m
    assert tracker.add(TargetFixReading(40.0, before + 100.0, 0.0, 3.0, CAMERA)) == ()
    (outcome,) = tracker.add(TargetFixReading(52.0, 3.0 * 52, 52.0, 3.0, CAMERA))
    assert outcome.accepted
    chosen = Tracker(replace(NO_BIAS, fix_source=SourceChoice(component_id=100)))
    assert chosen.add(TargetFixReading(0.0, 5.0, 6.0, 3.0, CAMERA))[0].accepted
    assert chosen.estimate(0.0).north_m == pytest.approx(6.0)


@pytest.mark.parametrize("seed", [1, 2])
def test_lines_of_sight_alone_keep_to_a_target_that_walks_over_flat_ground(scene, seed):
    """Their noise must not pull the pitch bias away: the place where a line meets the ground is mostly noise."""
    walk = scene.of(lambda _: (1.0, 0.0), 120.0)
    tracker = Tracker(TrackerSettings())
    tracker.stand_on(flat_ground(2.0))
    errors_m = []
    for reading in walk.readings(np.random.default_rng(seed)):
        if not isinstance(reading, RangeReading):
            tracker.add(reading)
        if isinstance(reading, PositionReading) and reading.time_s > 30.0:
            errors_m.append(error_m(tracker, walk, reading.time_s))
    assert math.sqrt(np.mean(np.square(errors_m))) < 5.0
    assert abs(tracker.calibration.pitch_bias_rad) < math.radians(0.3)


@pytest.mark.parametrize("follows", [True, False])
def test_a_gimbal_that_looked_elsewhere_replaces_a_silent_one_only_if_it_turns(scene, follows):
    """Even after the track is lost: a device that looks into one direction follows no target."""
    flown = scene.of(lambda _: (3.0, 1.0), 90.0)
    second = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 171)
    readings = flown.readings(np.random.default_rng(1))
    for index, reading in enumerate(readings):
        if isinstance(reading, GimbalReading) and reading.time_s >= 30.0:
            looks = reading.quaternion_wxyz if follows and reading.time_s > 45.0 else (0.0, 0.0, 0.0, 1.0)
            readings[index] = replace(reading, source=second, quaternion_wxyz=looks)
    tracker, _ = fed(readings, replace(NO_BIAS, lost_after_s=20.0))
    assert (tracker.gimbals.chosen == second) is follows
