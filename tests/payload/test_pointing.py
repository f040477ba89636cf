from __future__ import annotations

import math
from dataclasses import replace

import pytest

from sidelong.app.flight.outputs import PayloadPointer
from sidelong.estimators.estimate import TrackQuality
from sidelong.estimators.rotations import from_roll_pitch_yaw
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, Source
from sidelong.estimators.sensing.sighting import line_of_sight
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.control.present import Phase
from tests.faults.flight import FaultedFlight, Scenario

_HEIGHT_M, _ATTITUDE = 100.0, AttitudeReading(0.0, 0.0, 0.0, 0.7)


@pytest.fixture(scope="module")
def flight():
    loop = FaultedFlight(Scenario(seed=2, flavour="arduplane", duration_s=30.0))
    loop.fly()
    return loop


@pytest.fixture(scope="module")
def snapshot(flight):
    return flight.controller.snapshot()


def pointed(
    *snapshots, attitude: AttitudeReading | None = _ATTITUDE, tracker: Tracker | None = None, ground_m: float = 0.0
) -> list[tuple[float, float]]:
    commands: list[tuple[float, float]] = []
    pointer = PayloadPointer(
        lambda pitch_rad, yaw_rad: commands.append((pitch_rad, yaw_rad)),
        tracker or Tracker(TrackerSettings()),
        lambda *_place_m: ground_m,
    )
    for one in snapshots:
        pointer.show(replace(one, attitude=attitude))
    return commands


def missed_m(snapshot, pitch_rad: float, yaw_rad: float, tracker: Tracker, ground_m: float = 0.0) -> float:
    """Return how far from the estimate a gimbal in the tracker's mount points, on the ground."""
    source = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
    gimbal = GimbalReading(0.0, from_roll_pitch_yaw(0.0, pitch_rad, yaw_rad), "vehicle", source)
    sight = line_of_sight(gimbal, _ATTITUDE, tracker.parent_from_mount)
    level_m = (_HEIGHT_M - ground_m) / math.tan(sight.depression_rad)
    bearing_rad = sight.bearing_rad - tracker.calibration.yaw_bias_rad
    aircraft = snapshot.aircraft
    there_m = (
        aircraft.east_m + level_m * math.sin(bearing_rad),
        aircraft.north_m + level_m * math.cos(bearing_rad),
    )
    return math.dist(there_m, snapshot.estimate.position_m(snapshot.time_s))


@pytest.mark.parametrize(
    "mount_deg", [(0.0, 0.0, 0.0), (180.0, 0.0, 0.0), (0.0, 0.0, 90.0), (0.0, 20.0, -150.0)], ids=str
)
def test_gimbal_is_pointed_at_the_estimate_whatever_its_mount(snapshot, mount_deg):
    roll_rad, pitch_rad, yaw_rad = (math.radians(angle) for angle in mount_deg)
    tracker = Tracker(TrackerSettings(mount_roll_pitch_yaw_rad=(roll_rad, pitch_rad, yaw_rad)))
    (command,) = pointed(snapshot, tracker=tracker)
    assert missed_m(snapshot, *command, tracker) < 0.05


def test_gimbal_is_pointed_with_the_yaw_error_that_was_found(flight, snapshot):
    tracker = flight.controller.tracker
    (command,), (uncorrected,) = pointed(snapshot, tracker=tracker), pointed(snapshot)
    assert missed_m(snapshot, *uncorrected, tracker) > 0.15
    assert missed_m(snapshot, *command, tracker) < 0.05


def test_gimbal_is_pointed_at_the_ground_below_the_target(snapshot):
    (command,) = pointed(snapshot, ground_m=60.0)
    assert missed_m(snapshot, *command, Tracker(TrackerSettings()), ground_m=60.0) < 0.05


def test_gimbal_is_commanded_five_times_a_second_at_most(snapshot):
    assert len(pointed(*(replace(snapshot, time_s=snapshot.time_s + 0.05 * step) for step in range(20)))) == 5


def test_a_lost_target_is_looked_for_where_it_is_predicted(snapshot):
    lost = replace(snapshot.estimate, quality=TrackQuality.LOST)
    assert pointed(replace(snapshot, estimate=lost)) == pointed(snapshot)


def test_nothing_is_commanded_without_control_target_or_heading(snapshot):
    for unfit in (replace(snapshot, phase=phase) for phase in (Phase.WAITING, Phase.YIELDED, Phase.ENDED)):
        assert pointed(unfit) == []
    assert pointed(replace(snapshot, estimate=None)) == []
    assert pointed(snapshot, attitude=None) == []
