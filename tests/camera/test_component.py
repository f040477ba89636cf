"""The MAVLink camera, asked as QGroundControl asks."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.camera.camera import Pictured
from sidelong.app.camera.component import CAMERA_COMPONENT, CameraComponent
from sidelong.app.camera.tracker import Box, Tracked
from sidelong.app.camera.view import View
from sidelong.app.link.frames import Packer
from sidelong.app.link.message import Message
from sidelong.estimators.sensing.readings import AttitudeReading, PositionReading

STATION, OTHER = (255, 190), (254, 190)


class Tracking:
    """Records what it is asked for."""

    def __init__(self):
        self.asked: list[tuple] = []
        view = View((0.0, 0.0, 100.0), (1.0, 0.0, 0.0, 0.0), 500.0, (640, 360), None)
        tracked = Tracked("object", Box(0.6 * 640, 0.5 * 360, 64.0, 36.0), 0.9)
        position, attitude = PositionReading(1.0, 0.0, 0.0, 100.0, 0.0, 0.0, 0.0), AttitudeReading(1.0, 0.0, 0.0, 0.0)
        self.latest = Pictured(1.0, tracked, view, position, attitude, None)

    def follow(self, *where):
        self.asked.append(where)

    def stop(self):
        self.asked.append(("stop",))


@pytest.fixture
def camera():
    tracking = Tracking()
    component = CameraComponent(1, tracking, math.radians(60.0), "rtsp://192.0.2.1/main")
    component.size_px = 640, 360
    return component, tracking


def ask(component, command, *params, station=STATION, to=(1, CAMERA_COMPONENT), now_s=10.0):
    """Return the result and the other answers."""
    fields = {f"param{n}": 0.0 for n in range(1, 8)} | {f"param{n}": p for n, p in enumerate(params, 1)}
    fields |= {"command": command, "target_system": to[0], "target_component": to[1], "confirmation": 0}
    answers = component.command(Message("COMMAND_LONG", *station, fields, 0.0), now_s)
    if not answers:
        return None, []
    name, ack = answers[0]
    assert name == "COMMAND_ACK"
    assert (ack["command"], ack["target_system"], ack["target_component"]) == (command, *station)
    return ack["result"], answers[1:]


@pytest.mark.parametrize(
    ("message_id", "name"),
    [
        (mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION, "CAMERA_INFORMATION"),
        (mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS, "CAMERA_SETTINGS"),
        (mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS, "CAMERA_CAPTURE_STATUS"),
        (mavlink.MAVLINK_MSG_ID_CAMERA_FOV_STATUS, "CAMERA_FOV_STATUS"),
        (mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION, "VIDEO_STREAM_INFORMATION"),
        (mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS, "VIDEO_STREAM_STATUS"),
        (mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS, "CAMERA_TRACKING_IMAGE_STATUS"),
    ],
)
def test_what_a_station_requests_is_sent_and_can_be_packed(camera, message_id, name):
    result, answers = ask(camera[0], mavlink.MAV_CMD_REQUEST_MESSAGE, message_id)
    assert result == mavlink.MAV_RESULT_ACCEPTED
    assert [one[0] for one in answers] == [name]
    frame = Packer((1, CAMERA_COMPONENT)).frame(*answers[0], system_id=1)
    decoded = mavlink.MAVLink(None).parse_buffer(frame)[0]
    assert (decoded.get_type(), decoded.get_srcComponent()) == (name, CAMERA_COMPONENT)
    if name == "CAMERA_INFORMATION":
        assert decoded.flags & mavlink.CAMERA_CAP_FLAGS_HAS_TRACKING_RECTANGLE
        assert decoded.sensor_size_h / decoded.focal_length == pytest.approx(2.0 * math.tan(math.radians(30.0)))


def test_a_point_and_a_rectangle_are_followed_and_stopped(camera):
    component, tracking = camera
    assert ask(component, mavlink.MAV_CMD_CAMERA_TRACK_POINT, 0.3, 0.4)[0] == mavlink.MAV_RESULT_ACCEPTED
    assert ask(component, mavlink.MAV_CMD_CAMERA_TRACK_RECTANGLE, 0.2, 0.3, 0.4, 0.5)[0] == 0
    assert ask(component, mavlink.MAV_CMD_CAMERA_STOP_TRACKING)[0] == 0
    assert tracking.asked == [(0.3, 0.4), pytest.approx((0.3, 0.4, 0.2, 0.2)), ("stop",)]


@pytest.mark.parametrize("params", [(1.2, 0.5), (math.nan, 0.5), (-0.1, 0.5)])
def test_a_point_outside_the_picture_is_denied(camera, params):
    assert ask(camera[0], mavlink.MAV_CMD_CAMERA_TRACK_POINT, *params)[0] == mavlink.MAV_RESULT_DENIED
    assert not camera[1].asked


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("command", "params"),
    [
        (mavlink.MAV_CMD_REQUEST_MESSAGE, ()),
        (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (275,)),
        (mavlink.MAV_CMD_SET_CAMERA_ZOOM, (mavlink.ZOOM_TYPE_STEP,)),
    ],
)
def test_a_number_that_is_none_is_denied(camera, command, params, value):
    assert ask(camera[0], command, *params, value)[0] == mavlink.MAV_RESULT_DENIED
    assert camera[0].zoom == 1.0


def test_a_point_of_a_zoomed_picture_is_where_it_is_seen(camera):
    component, tracking = camera
    result, answers = ask(component, mavlink.MAV_CMD_SET_CAMERA_ZOOM, mavlink.ZOOM_TYPE_RANGE, 100.0 / 7.0)
    assert result == mavlink.MAV_RESULT_ACCEPTED
    assert component.zoom == pytest.approx(2.0)
    assert answers[0][1]["hfov"] == pytest.approx(math.degrees(2 * math.atan(math.tan(math.radians(30.0)) / 2)))
    ask(component, mavlink.MAV_CMD_CAMERA_TRACK_POINT, 0.7, 0.5)
    assert tracking.asked == [pytest.approx((0.6, 0.5))]
    assert ask(component, mavlink.MAV_CMD_REQUEST_MESSAGE, 275)[1][0][1]["point_x"] == pytest.approx(0.7)


def test_each_station_sets_its_own_rate_and_the_fastest_counts(camera):
    component, _ = camera
    for station, interval_us in ((STATION, 5e5), (OTHER, 1e5)):
        asked = ask(component, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 275, interval_us, station=station)
        assert asked[0] == mavlink.MAV_RESULT_ACCEPTED

    def rate_hz(begin_s):
        sent = [one for k in range(100) for one in component.due(begin_s + 0.02 * k)]
        return sum(name == "CAMERA_TRACKING_IMAGE_STATUS" for name, _ in sent) / 2.0

    assert rate_hz(20.0) == pytest.approx(10.0, abs=1.0)
    ask(component, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 275, -1.0, station=OTHER)
    assert rate_hz(30.0) == pytest.approx(2.0, abs=0.6)


def test_commands_to_other_components_and_systems_are_left_to_them(camera):
    for to in ((1, 1), (2, CAMERA_COMPONENT)):
        assert ask(camera[0], mavlink.MAV_CMD_CAMERA_STOP_TRACKING, to=to) == (None, [])
    assert ask(camera[0], mavlink.MAV_CMD_DO_SET_MODE, to=(1, 0)) == (None, [])
    assert ask(camera[0], mavlink.MAV_CMD_DO_SET_MODE)[0] == mavlink.MAV_RESULT_UNSUPPORTED
