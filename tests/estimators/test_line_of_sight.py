import math

import pytest

from sidelong.estimators.rotations import from_roll_pitch_yaw
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, Source
from sidelong.estimators.sensing.sighting import lever_arm_plane_m, line_of_sight

DEG = math.pi / 180
GIMBAL = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
LEVEL_MOUNT = (1.0, 0.0, 0.0, 0.0)


def seen(frame, quaternion, attitude=None, mount=LEVEL_MOUNT):
    sight = line_of_sight(GimbalReading(0.0, quaternion, frame, GIMBAL), attitude, mount)
    return sight.bearing_rad / DEG, sight.depression_rad / DEG


def aircraft(roll_deg, pitch_deg, yaw_deg):
    return AttitudeReading(0.0, roll_deg * DEG, pitch_deg * DEG, yaw_deg * DEG)


# cos 45 = 0.70711: a yaw of 90 degrees; cos 15 = 0.96593, sin 15 = 0.25882: a pitch of 30 degrees.
YAW_90 = (0.7071067811865476, 0.0, 0.0, 0.7071067811865476)
PITCH_DOWN_30 = (0.9659258262890683, 0.0, -0.25881904510252074, 0.0)


def test_an_earth_frame_sight_needs_no_aircraft(looking_at):
    assert seen("earth", YAW_90) == pytest.approx((90, 0))
    assert seen("earth", PITCH_DOWN_30) == pytest.approx((0, 30))
    assert seen("earth", looking_at(-132 * DEG, 31 * DEG)) == pytest.approx((-132, 31))


def test_a_recorded_sight_points_where_the_aircraft_saw_its_target():
    # From the ArduPlane flight: true bearing -132.4 + 0.4 degrees of bias, 120 m up at 233.6 m: 30.9 degrees down.
    recorded = (0.3905392289161682, -0.24444212019443512, -0.10837139934301376, -0.8808988332748413)
    assert seen("earth", recorded) == pytest.approx((-132.0, 30.9), abs=1.0)


def test_a_vehicle_frame_sight_turns_with_the_heading_but_not_with_the_bank(looking_at):
    sight = looking_at(60 * DEG, 20 * DEG)
    assert seen("vehicle", sight, aircraft(0, 0, 30)) == pytest.approx((90, 20))
    assert seen("vehicle", sight, aircraft(35, -10, 30)) == pytest.approx((90, 20))


def test_a_body_frame_sight_turns_with_bank_and_pitch(looking_at):
    # Out along the right wing, which is 30 degrees low: it looks down by as much, to the right of the heading.
    assert seen("body", YAW_90, aircraft(30, 0, 40)) == pytest.approx((130, 30))
    # Ahead, nose 10 degrees up: it looks up.
    assert seen("body", LEVEL_MOUNT, aircraft(0, 10, 40)) == pytest.approx((40, -10))
    # Bank turns a sight ahead about itself.
    assert seen("body", LEVEL_MOUNT, aircraft(50, 0, 40)) == pytest.approx((40, 0))


def test_a_turned_mount_adds_to_the_sight_where_it_is_measured_against_the_aircraft():
    mount = from_roll_pitch_yaw(0.0, 0.0, 5 * DEG)
    assert seen("vehicle", YAW_90, aircraft(0, 0, 30), mount) == pytest.approx((125, 0))
    assert seen("body", YAW_90, aircraft(0, 0, 30), mount) == pytest.approx((125, 0))
    assert seen("earth", YAW_90, None, mount) == pytest.approx((90, 0))


@pytest.mark.parametrize("frame", ["vehicle", "body"])
def test_a_sight_against_the_aircraft_is_nothing_without_its_attitude(frame):
    with pytest.raises(ValueError, match="without the aircraft's attitude"):
        seen(frame, YAW_90)


def test_a_lever_arm_turns_with_the_aircraft():
    # 2 m ahead, 1 m right, 0.5 m below; heading east: ahead is east, right is south.
    assert lever_arm_plane_m((2.0, 1.0, 0.5), aircraft(0, 0, 90)) == pytest.approx((2.0, -1.0, -0.5))
    # Rolled on the right side, the belly looks left: right is down, down is left (north when heading east).
    assert lever_arm_plane_m((0.0, 1.0, 0.5), aircraft(90, 0, 90)) == pytest.approx((0.0, 0.5, -1.0))
