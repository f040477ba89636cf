"""The camera of a flight: what it shows, records and passes on, from rendered pictures."""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import time
from contextlib import nullcontext
from types import SimpleNamespace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.camera.runner import CameraRunner, Here
from sidelong.app.camera.video import VideoReplay
from sidelong.app.config import CameraSection
from sidelong.app.link.message import Message
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.rotations import from_roll_pitch_yaw
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, Source
from sidelong.sitl.world.picture import CameraPose, Scenery

VIEW_DEG, SIZE_PX, RATE_HZ, BEGIN_S, PICTURES = 12.0, (640, 360), 15.0, 20.0, 30
HERE_M, TARGET_M = (0.0, -200.0, 100.0), (0.0, 0.0)
PITCH_RAD = -math.atan2(100.0, 200.0)
ESTIMATE = TargetEstimate(BEGIN_S, *TARGET_M, 0.0, 0.0, np.diag([9.0, 4.0, 0.1, 0.1]), TrackQuality.GOOD, BEGIN_S)


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Return the pictures of the page, the messages of the camera and the recording of two seconds."""
    return run(tmp_path_factory.mktemp("run") / "video.ts", PICTURES, 0.0)[:3]


def run(record, pictures, lookalikes):
    """Track for a number of pictures; return also the CPU time that was spent on each one, s."""
    taken, shown, spent_s = [], [], 0.0
    vehicle = SimpleNamespace(system_id=1, take=taken.append)
    tracker = SimpleNamespace(parent_from_mount=(1.0, 0.0, 0.0, 0.0), estimate=lambda _time_s: ESTIMATE)
    runner = CameraRunner(
        CameraSection(source="/dev/null", view_deg=VIEW_DEG, delay_s=0.0),
        vehicle,
        tracker,
        None,
        lambda _text: None,
        Here("a flight", LocalPlane(47.4, 8.5), 400.0),
        record=record,
        show=lambda picture: shown.append(picture()),
    )
    scenery = Scenery(np.zeros((60, 2)), lambda _e, _n: 0.0, 3, trees=0.0, lookalikes=lookalikes)
    sight = from_roll_pitch_yaw(0.0, PITCH_RAD, 0.0)
    for k in range(pictures):
        time_s = BEGIN_S + k / RATE_HZ
        runner._timeline.on_message(time_s, 1000.0 + time_s)
        for reading in (
            PositionReading(time_s, *HERE_M, 0.0, 0.0, 0.0),
            AttitudeReading(time_s, 0.0, 0.0, 0.0),
            GimbalReading(time_s, sight, "earth", Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)),
        ):
            runner.camera.event(reading)
        if k == 1:
            runner.camera.follow(0.5, 0.5)
        picture = scenery.picture(time_s, CameraPose(HERE_M, 0.0, PITCH_RAD), math.radians(VIEW_DEG), SIZE_PX)
        begun_s = time.process_time()
        runner._take(picture, 1000.0 + time_s)
        spent_s += time.process_time() - begun_s
    runner._output.close()
    runner._marks.close()
    return shown, taken, record, spent_s / pictures, runner


def test_the_page_gets_object_estimate_and_ellipse_in_the_picture(ran):
    marks, jpeg = ran[0][-1].split(b"\n", 1)
    marks = json.loads(marks)
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape == (360, 640, 3)
    assert marks["state"] == "object"
    left, top, right, bottom = marks["box"]
    assert left < 0.5 < right
    assert top < 0.5 < bottom
    assert marks["estimate"] == pytest.approx([0.5, 0.5], abs=0.01)
    # Three times the root of chi-square's 5.99, at the focal length and range of the picture.
    focal, range_m = 0.5 / math.tan(math.radians(0.5 * VIEW_DEG)), math.hypot(100.0, 200.0)
    widths = [x for x, _ in marks["ellipse"]]
    assert 0.5 * (max(widths) - min(widths)) == pytest.approx(3.0 * 2.448 * focal / range_m, rel=0.03)


def test_the_flight_gets_the_tracking_status_stamped_at_capture(ran):
    (first, *_) = (message.fields for message in ran[1])
    assert first["tracking_status"] == 1
    assert first["point_x"] == pytest.approx(0.5, abs=0.02)
    assert BEGIN_S < first["capture_s"] < BEGIN_S + 1.0
    assert len(ran[1]) == pytest.approx(PICTURES / RATE_HZ / 0.4, abs=1.5)


def test_the_recording_is_played_in_step_with_what_was_drawn(ran):
    replay = VideoReplay(ran[2])
    marks = json.loads(replay.shown(BEGIN_S + 1.0).split(b"\n", 1)[0])
    assert marks["time_s"] == pytest.approx(BEGIN_S + 1.0, abs=1.0 / RATE_HZ)
    assert marks["state"] == "object"


def test_an_error_of_the_camera_reaches_neither_the_flight_nor_the_link(tmp_path):
    runner = run(tmp_path / "video.ts", 1, 0.0)[4]
    runner.camera.event = runner._component.command = Mock(side_effect=ZeroDivisionError)
    runner.stepped(None, ())
    runner._commanded(Message("COMMAND_LONG", 255, 190, {}, 0.0))
    vehicle = SimpleNamespace(
        system_id=1, listeners=[], bystanders=[], link=Mock(serving=lambda *_: nullcontext(print))
    )
    runner._vehicle = vehicle
    with pytest.raises(ZeroDivisionError):  # announced by the flight, which goes on
        asyncio.run(runner.run())
    assert vehicle.listeners == vehicle.bystanders == []


def test_the_gimbal_is_claimed_while_something_is_tracked_and_given_back(tmp_path):
    runner, sent = run(tmp_path / "video.ts", PICTURES, 0.0)[4], []
    runner._vehicle = SimpleNamespace(system_id=1, take=lambda _message: None)
    runner._transmit = lambda frame: sent.extend(mavlink.MAVLink(None).parse_buffer(frame))
    for k in range(40):
        if k == 30:
            runner.camera.stop()
        runner._point_s = -math.inf
        runner._work()
    claims = [m for m in sent if getattr(m, "command", None) == mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE]
    assert 1 < len(claims) < 15
    assert {(m.param1, m.param2, m.param3, m.param4) for m in claims[:-1]} == {(1.0, 100.0, -1.0, -1.0)}
    assert (claims[-1].param1, claims[-1].param2) == (-3.0, -3.0)


def test_the_gimbal_itself_counts_and_not_what_the_autopilot_repeats_of_it(tmp_path):
    runner = run(tmp_path / "video.ts", PICTURES, 0.0)[4]
    seen = runner.camera.latest.view
    time_s = BEGIN_S + PICTURES / RATE_HZ
    wrong = from_roll_pitch_yaw(0.0, PITCH_RAD, 1.0)
    for source, after_s in ((1, 0.0), (154, 0.0), (1, 0.01)):
        turned = from_roll_pitch_yaw(0.0, PITCH_RAD, 0.0) if source == 154 else wrong
        runner.camera.event(
            GimbalReading(time_s + after_s, turned, "earth", Source("GIMBAL_DEVICE_ATTITUDE_STATUS", source))
        )
    pictured = runner.camera.picture(np.zeros((*SIZE_PX[::-1], 3), np.uint8), time_s)
    assert pictured.view.ned_from_sight == pytest.approx(seen.ned_from_sight)


def test_the_time_stamps_of_the_stream_never_step_back(tmp_path):
    runner, stamps = run(tmp_path / "video.ts", 1, 0.0)[4], []
    output = SimpleNamespace(
        put=lambda _picture, time_s, stamp_us, _klv: stamps.append((time_s, stamp_us)), is_full=True
    )
    for after_s in (0.0, -0.3, -0.2, 0.1):
        runner._write(output, np.zeros((*SIZE_PX[::-1], 3), np.uint8), None, BEGIN_S + 1.0 + after_s, b"")
    assert all(now > before for two in zip(*stamps, strict=True) for before, now in itertools.pairwise(two))
