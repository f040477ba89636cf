"""Whatever comes in, what the core does about one event is bounded: counted, not timed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.ekf import TargetEkf
from sidelong.estimators.sensing.pose import PoseHistory
from sidelong.estimators.sensing.readings import AttitudeReading, PositionReading, RangeReading, Source
from sidelong.estimators.sensing.sighting import Fix
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.track import Track
from sidelong.estimators.tracking.tracker import Pairing
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Aircraft, Requirement, Side
from sidelong.mission.geometry.approach import approach

LASER = Source("DISTANCE_SENSOR", 154, 1, 100)


@pytest.fixture
def predictions(monkeypatch):
    counted = []
    real = TargetEkf.predict
    monkeypatch.setattr(TargetEkf, "predict", lambda self, time_s: (counted.append(time_s), real(self, time_s))[1])
    return counted


@pytest.mark.parametrize("later_s", [3600.0, 4_294_967.0, 1e12])
def test_an_estimate_far_ahead_takes_this_many_steps_and_no_more(predictions, later_s):
    track = Track(TrackerSettings(filter="ekf"))
    track.add(Fix(100.0, 0.0, 0.0, 5.0))
    assert track.estimate(100.0 + later_s).quality is TrackQuality.LOST
    assert len(predictions) <= 125


def test_a_sighting_long_after_the_last_does_not_either(predictions):
    track = Track(TrackerSettings(filter="ekf", lost_after_s=1e9))
    for time_s in (100.0, 100.2, 100_000.0):
        track.add(Fix(time_s, 0.0, 0.0, 5.0))
    assert len(predictions) <= 65


def test_late_sightings_repeat_this_many_and_no_more(predictions):
    track = Track(TrackerSettings(filter="ekf"))
    for number in range(400):
        track.add(Fix(100.0 + 0.01 * number, 0.0, 0.0, 5.0))
    predictions.clear()
    outcome = track.add(Fix(100.005, 0.0, 0.0, 5.0))
    assert not outcome.accepted
    assert len(predictions) <= 65


@pytest.mark.parametrize("far_m", [1e4, 1.5e7])
def test_the_way_to_a_far_target_has_this_many_points_and_no_more(far_m):
    aircraft = AircraftState(0.0, 0.0, 0.0, 0.3, 15.0, 0.0)
    target = TargetEstimate(0.0, far_m, 0.0, 1.0, 0.0, np.eye(4), TrackQuality.GOOD, 0.0)
    plan = approach(aircraft, target, Aircraft(15.0, 60.0), Requirement(100.0, 500.0, Side.LEFT, 3.0))
    path = plan.transition
    assert len(path.arc_m) <= 3003
    end = plan.circle.position_at_course(float(path.course_rad[-1]))
    assert math.hypot(path.east_m[-1] - end[0], path.north_m[-1] - end[1]) < 1e-6 * far_m + 0.1


def test_this_many_ranges_wait_and_no_more():
    poses = PoseHistory()
    pairing = Pairing(TrackerSettings(), poses)
    ranges = [RangeReading(100.0 + 0.001 * number, 200.0, LASER) for number in range(1000)]
    for one in ranges:
        pairing.add_range(one)
    assert pairing.waiting == ranges[-32:]


def test_nothing_is_known_in_a_long_gap():
    poses = PoseHistory()
    for time_s in (100.0, 102.0, 107.0):
        poses.positions.add(PositionReading(time_s, 15.0 * time_s, 0.0, 100.0, 15.0, 0.0, 0.0))
        poses.attitudes.add(AttitudeReading(time_s, 0.1, 0.0, 0.0))
    assert poses.position_at(101.0).east_m == pytest.approx(1515.0)
    assert poses.attitude_at(101.0).roll_rad == 0.1
    assert poses.position_at(105.0) is None
    assert poses.attitude_at(105.0) is None
