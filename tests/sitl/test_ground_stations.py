"""What QGroundControl asks for when it connects, and the files that ground stations fetch."""

from __future__ import annotations

import math
import struct
import zlib

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.settings import Flavour

REQUEST_MESSAGE, SET_INTERVAL = mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
PROTOCOL_VERSION, MODES, METADATA, CAMERA, GIMBAL_MANAGER = 300, 435, 397, 259, 280
OPEN, READ, LIST, CRC32, BURST, TERMINATE = 4, 5, 3, 14, 15, 1
ACK, NAK = 128, 129
FAILED, END_OF_FILE, NOT_FOUND, UNKNOWN_COMMAND, WRONG_SESSION = 1, 6, 10, 7, 4


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
        # What there is not is said not to be there, so that QGroundControl goes on at once.
        assert ground.command_long(REQUEST_MESSAGE, message_id, 1.0) is not None
    for message_id in (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT):
        assert ground.command_long(SET_INTERVAL, message_id, 500_000) is not None
    for command in (mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION, mavlink.MAV_CMD_REQUEST_STORAGE_INFORMATION):
        assert ground.command_long(command, 1.0) == mavlink.MAV_RESULT_UNSUPPORTED


def test_modes_origin_and_logs_are_told_as_the_real_ones_do(ground, flavour):
    assert ground.command_long(REQUEST_MESSAGE, MODES) == mavlink.MAV_RESULT_ACCEPTED
    modes = ground.all("AVAILABLE_MODES")
    assert [mode.mode_index for mode in modes] == list(range(1, modes[0].number_modes + 1))
    assert ground.command_long(REQUEST_MESSAGE, MODES, 2.0) == mavlink.MAV_RESULT_ACCEPTED
    assert ground.all("AVAILABLE_MODES")[len(modes) :][0].mode_index == 2
    assert (
        ground.command_long(REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN) == mavlink.MAV_RESULT_ACCEPTED
    )
    assert ground.all("GPS_GLOBAL_ORIGIN")[0].latitude == ground.all("HOME_POSITION")[-1].latitude
    ground.send(mavlink.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    ground.run(0.2)
    assert [log.num_logs for log in ground.all("LOG_ENTRY")] == [0]
    unknown = {Flavour.ARDUPLANE: ("FAILED", "DENIED"), Flavour.PX4: ("DENIED", "FAILED")}[flavour]
    results = [getattr(mavlink, f"MAV_RESULT_{name}") for name in unknown]
    assert [ground.command_long(command, CAMERA, 1.0) for command in (REQUEST_MESSAGE, SET_INTERVAL)] == results


def test_the_air_and_the_forces_of_a_bank_are_told_to_who_asks(ground):
    assert (
        ground.command_long(SET_INTERVAL, mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, 500_000) == mavlink.MAV_RESULT_ACCEPTED
    )
    ground.run(1.2)
    imu = ground.all("HIGHRES_IMU")
    assert len(imu) == 2
    assert imu[-1].zacc == pytest.approx(-9.81, abs=0.01)  # on the ground
    assert imu[-1].abs_pressure == pytest.approx(1013.25 * math.exp(-imu[-1].pressure_alt / 8434.0), rel=0.003)


def test_only_px4_tells_what_is_wrong_with_a_parameter(ground, flavour):
    radius = b"NAV_LOITER_RAD" if flavour is Flavour.PX4 else b"WP_LOITER_RAD"
    ground.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    ground.send(mavlink.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, mavlink.MAV_PARAM_TYPE_REAL32))
    ground.send(mavlink.MAVLink_param_set_message(1, 1, radius, 1.0, mavlink.MAV_PARAM_TYPE_INT32))
    ground.run(0.2)
    errors = [error.error for error in ground.all("PARAM_ERROR")]
    assert errors == ([1, 1, 7] if flavour is Flavour.PX4 else [])


def test_parameters_missions_fences_and_rally_points_are_told(ground):
    ground.send(mavlink.MAVLink_param_request_list_message(1, 1))
    for mission_type in (0, 1, 2):
        ground.send(mavlink.MAVLink_mission_request_list_message(1, 1, mission_type))
    ground.run(1.0)
    values = ground.all("PARAM_VALUE")
    assert len({value.param_id for value in values}) == values[0].param_count > 20
    assert {count.mission_type for count in ground.all("MISSION_COUNT")} == {0, 1, 2}


class Files:
    """A client of the file transfer."""

    def __init__(self, ground) -> None:
        self.ground, self.sequence = ground, 0

    def ask(self, opcode: int, name: str = "", offset: int = 0, size: int | None = None, session: int = 3):
        """Return (opcode, offset, data, burst complete) of each answer."""
        data = name.encode()
        head = struct.pack("<HBBBBBxI", self.sequence, session, opcode, size or len(data), 0, 0, offset)
        self.sequence += 1
        before = len(self.ground.heard)
        payload = (head + data).ljust(251, b"\0")
        self.ground.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))
        self.ground.run(0.1)
        answers = []
        for message in self.ground.heard[before:]:
            if message.get_type() == "FILE_TRANSFER_PROTOCOL":
                raw = bytes(message.payload)
                _, _, code, length, asked, complete, at = struct.unpack_from("<HBBBBBxI", raw)
                assert asked == opcode
                answers.append((code, at, raw[12 : 12 + length], bool(complete)))
        return answers


@pytest.mark.parametrize("flavour", [Flavour.ARDUPLANE], indirect=True)
def test_arduplanes_parameters_are_a_file(ground):
    files = Files(ground)
    assert files.ask(LIST, "/") == [(ACK, 0, b"D@PARAM\0", False)]
    ((_, _, listed, _),) = files.ask(LIST, "/@PARAM")
    size = int(listed.rstrip(b"\0").split(b"\t")[1])
    assert files.ask(LIST, "/@PARAM", offset=1)[0][2] == bytes([END_OF_FILE])
    ((code, _, told, _),) = files.ask(OPEN, "@PARAM/param.pck?withdefaults=1")
    assert (code, struct.unpack("<I", told)[0]) == (ACK, size)
    pieces = files.ask(BURST, size=80)
    content = b"".join(data for _, _, data, _ in pieces)
    assert len(content) == size
    assert [complete for *_, complete in pieces] == [False] * (len(pieces) - 1) + [True]
    assert files.ask(READ, offset=80, size=10)[0][2] == content[80:90]
    assert files.ask(READ, offset=size, size=10)[0][2] == bytes([END_OF_FILE])
    assert struct.unpack("<I", files.ask(CRC32, "@PARAM/param.pck")[0][2])[0] == zlib.crc32(content)
    magic, count, total = struct.unpack_from("<HHH", content)
    assert (magic, count, total) == (0x671B, 27, 27)
    assert content[6:].startswith(bytes([4, 14 << 4]) + b"AIRSPEED_CRUISE" + struct.pack("<f", 15.0))


def test_what_is_not_there_is_refused(ground, flavour):
    files = Files(ground)
    unknown, not_open = (FAILED, NOT_FOUND) if flavour is Flavour.ARDUPLANE else (UNKNOWN_COMMAND, WRONG_SESSION)
    assert files.ask(OPEN, "/nothing") == [(NAK, 0, bytes([NOT_FOUND]), False)]
    assert files.ask(READ, size=10)[0][2] == bytes([not_open])
    assert files.ask(6, "/new")[0][2] == bytes([unknown])  # nothing is ever written
    assert files.ask(TERMINATE)[0][0] == ACK
    assert files.ask(ACK) == []
