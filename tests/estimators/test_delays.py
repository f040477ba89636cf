"""Delays of laser and gimbal stamps are found from an aircraft that circles, and corrected."""

import math
from dataclasses import replace
from itertools import takewhile

import numpy as np
import pytest

from sidelong.estimators.rotations import from_roll_pitch_yaw, multiply
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.payload_fit import PayloadFit
from sidelong.estimators.tracking.payload_kernel import EARTH, SHARED, Readings, fit_readings
from sidelong.estimators.tracking.tracker import Tracker

LASER, GIMBAL = Source("DISTANCE_SENSOR", 154, 1, 100), Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
STEP_S, HEIGHT_M, SPEED_M_S, RADIUS_M = 0.2, 100.0, 15.0, 60.0
YAW_BIAS_RAD, RANGE_SIGMA_M, ANGLE_SIGMA_RAD = math.radians(0.5), 0.8, math.radians(0.35)
LEVEL = (1.0, 0.0, 0.0, 0.0)


def target_m(time_s):
    """A target that walks, stands for a while, and walks on in another direction."""
    first = np.minimum(time_s, 90.0)
    last = np.maximum(time_s - 130.0, 0.0)
    return np.stack([1.2 * first + 0.3 * last, 0.4 * first - 1.5 * last], axis=-1)


def aircraft(moves: bool):
    """Return time, place (n, 2) and heading of circles, to another of which the aircraft flies straight on twice."""
    places, headings, heading_rad = [np.array([0.0, -220.0])], [0.0], 0.0
    for k in range(round(280.0 / STEP_S)):
        straight = moves and (80.0 < k * STEP_S < 86.0 or 170.0 < k * STEP_S < 178.0)
        sense = -1.0 if moves and k * STEP_S > 178.0 else 1.0
        heading_rad += 0.0 if straight else sense * SPEED_M_S / RADIUS_M * STEP_S
        step_m = SPEED_M_S * STEP_S * np.array([math.sin(heading_rad), math.cos(heading_rad)])
        places.append(places[-1] + step_m)
        headings.append(heading_rad)
    return STEP_S * np.arange(len(places)), np.array(places), np.array(headings)


def readings(
    gimbal_s, range_s, frame="earth", moves=True, latency_s=0.0, seed=1, yaw_rad=YAW_BIAS_RAD, factor=1.0, off_m=0.0
):
    """Yield what the vehicle reports, the payload's readings with the stamps of their arrival."""
    rng = np.random.default_rng(seed)
    time_s, place_m, heading_rad = aircraft(moves)
    velocity = np.gradient(place_m, STEP_S, axis=0)

    def line(at_s):
        at_s = max(at_s, 0.0)
        own = [np.interp(at_s, time_s, axis) for axis in place_m.T]
        return target_m(np.array(at_s)) - own, np.interp(at_s, time_s, heading_rad)

    for k, now_s in enumerate(time_s.tolist()):
        yield PositionReading(now_s, *place_m[k].tolist(), HEIGHT_M, *velocity[k].tolist(), 0.0)
        yield AttitudeReading(now_s, 0.3, 0.0, math.remainder(heading_rad[k], math.tau))
        (east, north), heading = line(now_s - gimbal_s)
        yaw, pitch = math.atan2(east, north) + yaw_rad, -math.atan2(HEIGHT_M, math.hypot(east, north))
        yaw += ANGLE_SIGMA_RAD * rng.standard_normal() - (heading if frame == "vehicle" else 0.0)
        pitch += ANGLE_SIGMA_RAD * rng.standard_normal()
        cy, sy, cp, sp = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(pitch / 2), math.sin(pitch / 2)
        yield GimbalReading(now_s - latency_s, (cy * cp, -sy * sp, cy * sp, sy * cp), frame, GIMBAL)
        (east, north), _ = line(now_s - range_s)
        slant_m = math.hypot(east, north, HEIGHT_M) + RANGE_SIGMA_M * rng.standard_normal()
        if rng.random() < 0.03:
            slant_m += rng.uniform(-90.0, 90.0)
        yield RangeReading(now_s - latency_s, factor * slant_m + off_m, LASER)


def taken(fit, one):
    match one:
        case PositionReading():
            fit.position(one)
        case AttitudeReading():
            fit.attitude(one)
        case GimbalReading():
            fit.gimbal(one)
        case RangeReading():
            fit.range(one)


def fitted(*args, until_s=280.0, **kwargs):
    fit, found = PayloadFit(TrackerSettings(), LEVEL), None
    for one in takewhile(lambda one: one.time_s <= until_s, readings(*args, **kwargs)):
        taken(fit, one)
        found = fit.found or found
    return found


@pytest.mark.parametrize("frame", ["earth", "vehicle"])
@pytest.mark.parametrize("delays_s", [(0.0, 0.0), (0.2, 0.0), (0.0, 0.5), (1.0, 1.0), (2.0, 0.0), (2.0, 2.0)])
def test_delays_are_found_together_with_the_yaw_bias(delays_s, frame):
    found = fitted(*delays_s, frame, until_s=178.0)  # then a sudden turn lets a late payload see the target jump
    assert found.gimbal_s == pytest.approx(delays_s[0], abs=0.05)
    assert found.range_s == pytest.approx(delays_s[1], abs=0.05)
    assert abs(found.gimbal_s - delays_s[0]) < 3.0 * found.gimbal_sigma_s
    assert found.yaw_bias_rad == pytest.approx(YAW_BIAS_RAD, abs=math.radians(0.4))
    assert found.range_factor == 1.0
    assert abs(found.range_bias_m) < 3.0


@pytest.mark.parametrize(
    ("yaw_deg", "factor", "off_m", "frame"),
    [
        *((20.0, 1.0, 0.0, "earth"), (-30.0, 1.0, 0.0, "vehicle"), (0.5, 1.5, 0.0, "earth")),
        *((0.5, 0.7, 0.0, "vehicle"), (0.5, 1.0, 100.0, "earth"), (0.5, 1.0, -50.0, "vehicle")),
    ],
)
def test_large_errors_of_yaw_and_range_are_found_together_with_the_delays(yaw_deg, factor, off_m, frame):
    found = fitted(0.5, 0.0, frame, yaw_rad=math.radians(yaw_deg), factor=factor, off_m=off_m)
    assert found.yaw_bias_rad == pytest.approx(math.radians(yaw_deg), abs=math.radians(2.0))
    assert found.range_factor == pytest.approx(1.0 / factor, rel=0.04)
    assert found.range_bias_m == pytest.approx(0.87 * off_m, abs=10.0)  # of the level range
    assert found.gimbal_s == pytest.approx(0.5, abs=0.15)


@pytest.mark.parametrize(("factor", "off_m"), [(1.0, -50.0), (1.4, 0.0)])
@pytest.mark.parametrize("ground_m", [0.0, math.nan])  # unknown ground is no witness against it
def test_large_range_error_that_begins_in_flight_is_found(factor, off_m, ground_m):
    fit, found = PayloadFit(TrackerSettings(), LEVEL), None
    fit.ground = lambda _east_m, _north_m: ground_m
    for one in takewhile(lambda one: one.time_s <= 230.0, readings(0.0, 0.0)):
        if isinstance(one, RangeReading) and one.time_s > 70.0:
            one = replace(one, slant_range_m=factor * one.slant_range_m + off_m)  # noqa: PLW2901
        taken(fit, one)
        found = fit.found or found
    assert found.range_factor == pytest.approx(1.0 / factor, rel=0.05)
    assert found.range_bias_m == pytest.approx(0.87 * off_m, abs=12.0)


def test_a_large_yaw_error_is_as_likely_as_none():
    """Else a target that turns wildly with the aircraft is more likely than a yaw that is off by 40 degrees."""
    costs = []
    for yaw_rad in (0.0, math.radians(40.0)):
        fit = PayloadFit(TrackerSettings(), LEVEL)
        for one in takewhile(lambda one: one.time_s <= 100.0, readings(0.0, 0.0, yaw_rad=yaw_rad)):
            taken(fit, one)
        rows, start = fit._readings(100.0, 100.0, (0.0, 0.0)), np.zeros(SHARED)
        start[2] = math.tan(yaw_rad)
        sigmas = np.array([1e-4, 1e-4, 1.0, 1.0, 1e-7, 1e-5])
        costs.append(fit_readings(rows, sigmas, np.zeros(SHARED, np.bool_), start, 0.1)[3])
    assert abs(costs[1] - costs[0]) < 15.0


def test_a_target_straight_below_the_aircraft_gives_no_warning():
    tracker, down = Tracker(TrackerSettings()), (math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0)
    with np.errstate(all="raise"):
        for now_s in np.arange(0.0, 40.0, 0.1).tolist():
            tracker.add(PositionReading(now_s, 0.0, 11.0 * now_s, HEIGHT_M, 0.0, 11.0, 0.0))
            tracker.add(AttitudeReading(now_s, 0.0, 0.0, 0.0))
            tracker.add(GimbalReading(now_s, down, "earth", GIMBAL))
            tracker.add(RangeReading(now_s, HEIGHT_M, LASER))


def test_no_large_errors_are_sought_where_the_biases_are_not_estimated():
    fit_of = TrackerSettings(yaw_bias_sigma_rad=0.0)
    assert fed(fit_of, 0.0, 0.0, factor=1.5).range_error == (1.0, 0.0)


def test_angles_relative_to_the_aircraft_need_a_change_of_circle():
    """On one circle about a slow target, a late payload looks like a target elsewhere; sigma has to show it."""
    steady = fitted(0.5, 0.5, "vehicle", moves=False, until_s=80.0)
    changed = fitted(0.5, 0.5, "vehicle", until_s=150.0)
    assert steady.gimbal_sigma_s > 0.15
    assert changed.gimbal_sigma_s < 0.05
    assert changed.gimbal_s == pytest.approx(0.5, abs=0.05)


def fed(settings, *args, until_s=math.inf, **kwargs):
    tracker = Tracker(settings)
    for one in takewhile(lambda one: one.time_s < until_s, readings(*args, **kwargs)):
        tracker.add(one)
    return tracker


def error_m(tracker, time_s=280.0):
    estimate = tracker.estimate(time_s)
    return float(np.hypot(*(np.array([estimate.east_m, estimate.north_m]) - target_m(np.array(time_s)))))


def test_tracker_corrects_the_delays_that_it_finds():
    late = fed(TrackerSettings(), 2.0, 0.5, "vehicle")
    assert late.delays.gimbal_s == pytest.approx(2.0, abs=0.05)
    assert error_m(late) < 3.0
    assert error_m(fed(TrackerSettings(latency_sigma_s=0.0), 2.0, 0.5, "vehicle")) > 10.0


@pytest.mark.parametrize(
    ("yaw_deg", "off_m", "corrected"), [(0.5, 0.0, False), (20.0, 0.0, True), (0.5, -50.0, True)]
)
def test_sightings_are_shared_without_the_errors_that_were_found(yaw_deg, off_m, corrected):
    tracker, off = Tracker(TrackerSettings()), []
    for one in readings(0.0, 0.0, yaw_rad=math.radians(yaw_deg), off_m=off_m):
        for outcome in tracker.add(one):
            shared = tracker.without_known_errors(outcome.sighting)
            off.append(math.dist((shared.east_m, shared.north_m), target_m(np.array(shared.time_s))))
    assert np.median(off[-100:]) < 8.0  # the errors alone: 70 m, 45 m
    assert tracker.payload.is_confirmed is (off_m == 0.0)
    assert (tracker.corrections > 0) is corrected


def test_a_payload_is_confirmed_by_readings_after_it_is_suspect_only():
    tracker = fed(TrackerSettings(), 0.0, 0.0)
    assert tracker.payload.is_confirmed
    tracker.payload.restart()
    assert not tracker.payload.is_confirmed
    assert not fed(TrackerSettings(latency_sigma_s=0.0), 0.0, 0.0).payload.is_confirmed


@pytest.mark.parametrize(("late_s", "used_s"), [(0.5, 0.5), (0.2, 0.0)])
def test_gimbal_is_found_late_on_a_steady_circle_where_no_likely_yaw_error_explains_it(late_s, used_s):
    """Of a yaw error with a standard deviation of 1 degree, 0.5 s would need 7 degrees, and 0.2 s 3 degrees."""
    steady = fed(TrackerSettings(), late_s, 0.0, "earth", moves=False, until_s=60.0)
    found = 0.0 if steady.delays is None else steady.delays.gimbal_s
    assert found == pytest.approx(used_s, abs=0.1)


@pytest.mark.parametrize("frame", ["earth", "vehicle"])
@pytest.mark.parametrize("seed", range(3))
def test_correct_stamps_are_never_corrected_below_zero(frame, seed):
    tracker = Tracker(TrackerSettings())
    for one in readings(0.0, 0.0, frame, seed=seed):
        tracker.add(one)
        assert min(tracker.payload.used_s) >= 0.0
    assert tracker.payload.is_confirmed


@pytest.mark.parametrize(("late_s", "used_s"), [(0.03, 0.0), (0.15, 0.15)])
def test_configured_delays_stay_until_they_are_evidently_wrong(late_s, used_s):
    """A payload cannot measure after its stamp."""
    found = fed(TrackerSettings(), late_s, late_s).delays
    assert (found.gimbal_s, found.range_s) == pytest.approx((used_s, used_s), abs=0.05)


def test_configured_latencies_are_where_the_estimate_starts():
    """What an earlier flight found holds from the first sighting on, each for its own device."""
    settings = TrackerSettings(gimbal_latency_s=0.4, range_latency_s=1.0, latency_sigma_s=0.1)
    known, unknown = fed(settings, 0.4, 1.0, until_s=15.0), fed(TrackerSettings(), 0.4, 1.0, until_s=15.0)
    assert known.delays is None
    assert error_m(known, 15.0) < 3.0
    assert error_m(unknown, 15.0) > 6.0
    late = fed(settings, 0.4, 1.0)
    assert late.delays.gimbal_s == pytest.approx(0.4, abs=0.05)
    assert late.delays.range_s == pytest.approx(1.0, abs=0.05)
    assert error_m(late) < 3.0


def test_clock_that_is_set_back_begins_the_fit_again():
    fit = PayloadFit(TrackerSettings(), LEVEL)
    for one in readings(0.5, 0.5):
        taken(fit, one)
    fit.range(RangeReading(10.0, 200.0, LASER))
    fit.fit(280.0)
    assert fit.found is None


def test_a_target_straight_below_has_no_direction():
    time_s = np.arange(0.0, 60.0, 0.5)
    still = np.zeros((len(time_s), 4))
    down = np.column_stack([time_s, still[:, :2], np.ones(len(time_s)), time_s - time_s[-1]])
    ranges = np.column_stack([time_s, np.full(len(time_s), 100.0), time_s - time_s[-1]])
    at = np.column_stack([time_s, still])
    scene = Readings(at, at[:, :4].copy(), down, ranges, EARTH, (0.01, 1.0, 0.0, 0.0), (0.0, 0.0))
    _, _, _, cost, _ = fit_readings(scene, np.ones(SHARED), np.zeros(SHARED, np.bool_), np.zeros(SHARED), 0.0)
    assert np.isfinite(cost)


@pytest.mark.parametrize("frame", ["earth", "vehicle"])
@pytest.mark.parametrize("seed", range(4))
def test_fits_from_different_starts_come_to_the_same_likelihood(frame, seed):
    """A fit that ends early looks less likely than another one, and lets correct stamps be replaced."""
    fit = PayloadFit(TrackerSettings(), LEVEL)
    for one in takewhile(lambda one: one.time_s <= 140.0, readings(0.0, 0.0, frame, seed=seed)):
        taken(fit, one)
    rows = fit._readings(140.0, 100.0, (0.0, 0.0))
    sigmas = np.array([1e-4, 1e-4, math.radians(1.0), 1.0, 1e-7, 1e-5])
    costs = [
        fit_readings(rows, sigmas, np.zeros(SHARED, np.bool_), np.zeros(SHARED), scale_m)[3]
        for scale_m in (0.0, 0.1, 1.0)
    ]
    assert max(costs) - min(costs) < 15.0


def test_bound_on_a_drift_is_about_its_size_and_zero_without_one():
    drifting, steady = PayloadFit(TrackerSettings(), LEVEL), PayloadFit(TrackerSettings(), LEVEL)
    for one in takewhile(lambda one: one.time_s <= 120.0, readings(0.0, 0.0, moves=False)):
        taken(steady, one)
        longer_m = 0.3 * max(one.time_s - 40.0, 0.0)
        is_range = isinstance(one, RangeReading)
        taken(drifting, replace(one, slant_range_m=one.slant_range_m + longer_m) if is_range else one)
    assert steady.wander_m(120.0) == 0.0
    assert 15.0 < drifting.wander_m(120.0) < 60.0


@pytest.mark.parametrize("drift", ["range", "yaw"])
def test_a_drift_is_corrected_by_the_error_that_it_has_come_to(drift):
    fit = PayloadFit(TrackerSettings(), LEVEL)
    for one in takewhile(lambda one: one.time_s <= 175.0, readings(0.0, 0.0, yaw_rad=0.0)):
        since_s = max(one.time_s - 50.0, 0.0)
        if drift == "range" and isinstance(one, RangeReading):
            one = replace(one, slant_range_m=one.slant_range_m + 0.4 * since_s)  # noqa: PLW2901
        if drift == "yaw" and isinstance(one, GimbalReading):
            turn = from_roll_pitch_yaw(0.0, 0.0, 0.003 * since_s)
            one = replace(one, quaternion_wxyz=multiply(turn, one.quaternion_wxyz))  # noqa: PLW2901
        taken(fit, one)
    assert fit.drifts
    assert fit.found is not None
    assert fit.found.range_bias_m == pytest.approx(45.0 if drift == "range" else 0.0, abs=10.0)
    assert fit.found.yaw_bias_rad == pytest.approx(0.375 if drift == "yaw" else 0.0, abs=0.05)
