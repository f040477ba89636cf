import math

import pytest

from sidelong.estimators.rotations import from_roll_pitch_yaw
from sidelong.estimators.sensing.pose import PoseHistory, ReadingHistory, gimbal_at
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, Source


def on_circle(time_s, radius_m=90.0, speed_m_s=22.0):
    angle = time_s * speed_m_s / radius_m
    east, north = radius_m * math.sin(angle), radius_m * math.cos(angle)
    return PositionReading(time_s, east, north, 120.0, speed_m_s * math.cos(angle), -speed_m_s * math.sin(angle), 0.0)


def test_at_1_hz_a_tight_circle_is_followed_to_a_decimetre():
    poses = PoseHistory()
    for second in range(11):
        poses.positions.add(on_circle(float(second)))
    for tenth in range(100):
        found, true = poses.position_at(tenth / 10), on_circle(tenth / 10)
        assert math.hypot(found.east_m - true.east_m, found.north_m - true.north_m) < 0.1


def test_a_reading_that_comes_late_takes_its_place():
    poses = PoseHistory()
    for tenth in (0, 1, 2, 5, 3, 4, 5):
        poses.positions.add(on_circle(float(tenth)))
    assert len(poses.positions) == 6
    assert poses.position_at(3.0).east_m == pytest.approx(on_circle(3.0).east_m)


def test_position_is_unknown_before_the_first_and_well_after_the_last():
    poses = PoseHistory()
    assert poses.position_at(0.0) is None
    poses.positions.add(on_circle(5.0))
    assert poses.position_at(4.9) is None
    assert poses.position_at(5.2).east_m == pytest.approx(on_circle(5.2).east_m, abs=0.2)
    assert poses.position_at(6.0) is None


def test_yaw_goes_the_short_way_through_south():
    poses = PoseHistory()
    poses.attitudes.add(AttitudeReading(0.0, 0.2, 0.0, math.radians(175)))
    poses.attitudes.add(AttitudeReading(1.0, 0.4, 0.1, math.radians(-175)))
    found = poses.attitude_at(0.75)
    assert (found.roll_rad, found.pitch_rad) == pytest.approx((0.35, 0.075))
    assert math.degrees(found.yaw_rad) == pytest.approx(-177.5)
    assert poses.attitude_at(1.1) is None


def test_an_hour_of_readings_is_not_kept():
    poses = PoseHistory()
    for second in range(3600):
        poses.positions.add(on_circle(float(second)))
    assert len(poses.positions) < 100
    assert poses.position_at(3598.5) is not None


def test_a_gimbal_turns_on_for_a_moment_after_its_last_reading():
    history, source = ReadingHistory(6.0), Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
    for number in range(6):
        quaternion = from_roll_pitch_yaw(0.0, 0.0, math.radians(0.3 * number))  # 3 degrees/s
        history.add(GimbalReading(0.1 * number, quaternion, "earth", source))
    assert gimbal_at(history, 0.6) is None
    assert gimbal_at(history, 1.0, 0.4) is None
    found, _ = gimbal_at(history, 0.6, 0.4)
    assert found.time_s == 0.6
    assert 2.0 * math.degrees(math.asin(found.quaternion_wxyz[3])) == pytest.approx(1.8, abs=0.01)
