"""What QGroundControl requests when it connects."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.settings import Flavour

REQUEST_MESSAGE, SET_INTERVAL = mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
PROTOCOL_VERSION, MODES, METADATA, CAMERA, GIMBAL_MANAGER = 300, 435, 397, 259, 280


@pytest.fixture(params=list(Flavour))
def flavour(request) -> Flavour:
    return request.param


@pytest.fixture
def ground(simulate, station, flavour):
    """Return a station that the vehicle has been hearing for half a minute."""
    ground = station(simulate(flavour=flavour))
    ground.heartbeat()
    ground.run(30.0)
    return ground


def test_every_command_of_qgroundcontrols_start_up_is_answered(ground):
    for message_id in (mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, mavlink.MAVLINK_MSG_ID_HOME_POSITION):
        assert ground.command_long(REQUEST_MESSAGE, message_id) == mavlink.MAV_RESULT_ACCEPTED
    for message_id in (PROTOCOL_VERSION, MODES, METADATA, CAMERA, GIMBAL_MANAGER):
        # What there is not is reported not to be there, so that QGroundControl goes on at once.
        assert ground.command_long(REQUEST_MESSAGE, message_id, 1.0) is not None
    for message_id in (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT):
        assert ground.command_long(SET_INTERVAL, message_id, 500_000) is not None
    for command in (mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION, mavlink.MAV_CMD_REQUEST_STORAGE_INFORMATION):
        assert ground.command_long(command, 1.0) == mavlink.MAV_RESULT_UNSUPPORTED


def test_unknown_messages_are_refused_as_the_real_ones_do(ground, flavour):
    unknown = {Flavour.ARDUPLANE: ("FAILED", "DENIED"), Flavour.PX4: ("DENIED", "FAILED")}[flavour]
    results = [getattr(mavlink, f"MAV_RESULT_{name}") for name in unknown]
    assert [ground.command_long(command, CAMERA, 1.0) for command in (REQUEST_MESSAGE, SET_INTERVAL)] == results


def test_only_px4_reports_what_is_wrong_with_a_parameter(ground, flavour):
    radius = b"NAV_LOITER_RAD" if flavour is Flavour.PX4 else b"WP_LOITER_RAD"
    ground.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    ground.send(mavlink.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, mavlink.MAV_PARAM_TYPE_REAL32))
    ground.send(mavlink.MAVLink_param_set_message(1, 1, radius, 1.0, mavlink.MAV_PARAM_TYPE_INT32))
    ground.run(0.2)
    errors = [error.error for error in ground.all("PARAM_ERROR")]
    assert errors == ([1, 1, 7] if flavour is Flavour.PX4 else [])


def test_parameters_missions_fences_and_rally_points_are_reported(ground):
    ground.send(mavlink.MAVLink_param_request_list_message(1, 1))
    for mission_type in (0, 1, 2):
        ground.send(mavlink.MAVLink_mission_request_list_message(1, 1, mission_type))
    ground.run(1.0)
    values = ground.all("PARAM_VALUE")
    assert len({value.param_id for value in values}) == values[0].param_count > 20
    assert {count.mission_type for count in ground.all("MISSION_COUNT")} == {0, 1, 2}
