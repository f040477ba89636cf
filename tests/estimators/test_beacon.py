"""A beacon's fixes next to the laser and instead of it: errors that stay are not averaged away."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.estimators.sensing.readings import PositionReading, RangeReading, Source, TargetFixReading
from sidelong.estimators.sensing.sighting import BeaconErrors
from sidelong.estimators.tracking.tracker import Tracker, TrackerSettings

BEACON, CAMERA = Source("FOLLOW_TARGET", 0), Source("CAMERA_TRACKING_GEO_STATUS", 100)
SIGMA_M, FADE_S = 3.0, 30.0


def receiver_errors(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return errors (count, 2) of a receiver, one a second, that fade as exp(-t / 30 s)."""
    kept = math.exp(-1.0 / FADE_S)
    errors = np.empty((count, 2))
    errors[0] = rng.normal(0.0, SIGMA_M, 2)
    for i in range(1, count):
        errors[i] = kept * errors[i - 1] + rng.normal(0.0, SIGMA_M * math.sqrt(1.0 - kept**2), 2)
    return errors


def test_a_fix_in_every_second_counts_as_much_as_one_a_minute():
    beacon = BeaconErrors()
    assert beacon.sigma_m(0.0, 3.0) == 3.0
    assert beacon.sigma_m(1.0, 3.0) == pytest.approx(3.0 * math.sqrt(60.0))
    assert beacon.sigma_m(100.0, 3.0) == 3.0


def test_the_ellipse_holds_a_target_that_only_its_beacon_reports_of():
    rng, inside, moments = np.random.default_rng(11), 0, 0
    for _ in range(20):
        tracker, errors = Tracker(TrackerSettings()), receiver_errors(rng, 240)
        for second, (east_m, north_m) in enumerate(errors):
            time_s, truth = 10.0 + second, (1.5 * second, 100.0)
            tracker.add(PositionReading(time_s, 0.0, 0.0, 100.0, 15.0, 0.0, 0.0))
            tracker.add(TargetFixReading(time_s, truth[0] + east_m, truth[1] + north_m, SIGMA_M, BEACON))
            estimate = tracker.estimate(time_s)
            if second > 60 and second % 10 == 0:
                off = np.array([estimate.east_m - truth[0], estimate.north_m - truth[1]])
                inside += float(off @ np.linalg.solve(estimate.covariance[:2, :2], off)) < -2.0 * math.log(0.05)
                moments += 1
    assert 0.90 <= inside / moments <= 1.0


def test_a_beacon_counts_next_to_the_laser_and_a_camera_does_not():
    for source, taken in ((BEACON, 1), (CAMERA, 0)):
        tracker = Tracker(TrackerSettings())
        tracker.add(RangeReading(10.0, 300.0, Source("DISTANCE_SENSOR", 154, 1, 100)))
        assert len(tracker.add(TargetFixReading(10.5, 0.0, 300.0, 3.0, source))) == taken
