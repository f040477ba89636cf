"""What a display is shown of the vehicle and its payload."""

from __future__ import annotations

import math

from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.estimators.tracking.tracker import Tracker, TrackerSettings
from sidelong.mission.control.sensor_status import SensorStatus

LASER, DOWNWARD = Source("DISTANCE_SENSOR", 154, 1, 100), Source("DISTANCE_SENSOR", 1, 0, 25)
GIMBAL = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
NORTH_AND_DOWN = (math.cos(-0.2), 0.0, math.sin(-0.2), 0.0)  # pitched down by 0.4 rad


def noted(sensor_status: SensorStatus, tracker: Tracker, *readings: object) -> None:
    for reading in readings:
        sensor_status.note(reading, tracker.add(reading), tracker)


def second(time_s: float, slant_range_m: float) -> tuple[object, ...]:
    return (
        PositionReading(time_s, 0.0, 0.0, 120.0, 0.0, 15.0, 0.0),
        AttitudeReading(time_s, 0.3, 0.0, 0.0),
        GimbalReading(time_s, NORTH_AND_DOWN, "earth", GIMBAL),
        RangeReading(time_s, slant_range_m, LASER),
    )


def test_gauges_begin_empty():
    sensor_status = SensorStatus()
    assert sensor_status.range_s == sensor_status.gimbal_s == -math.inf
    assert math.isnan(sensor_status.nis)


def test_gauges_follow_the_devices_in_use():
    sensor_status, tracker = SensorStatus(), Tracker(TrackerSettings())
    noted(sensor_status, tracker, *second(1.0, 308.0), *second(2.0, 308.0), RangeReading(5.0, 120.0, DOWNWARD))
    assert (sensor_status.range_s, sensor_status.gimbal_s) == (2.0, 2.0)
    assert (sensor_status.bank_rad, sensor_status.height_m) == (0.3, 120.0)


def test_an_absurd_range_shows_as_a_rejected_sighting_of_large_innovation():
    sensor_status, tracker = SensorStatus(), Tracker(TrackerSettings())
    for tick in range(20):
        noted(sensor_status, tracker, *second(0.1 * tick, 308.0))
    accepted, calm = sensor_status.sightings - sensor_status.rejected, sensor_status.nis
    noted(sensor_status, tracker, *second(2.0, 600.0), *second(2.1, 308.0)[:3])
    assert accepted > 10
    assert sensor_status.rejected == 1
    assert calm < 20.0 < sensor_status.nis
