from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.app.payload.driver import AircraftPose, AnglesMeasured, DriverSettings, RangeMeasured
from sidelong.app.payload.viewpro import ViewproDriver, encode, wrapped
from sidelong.estimators.rotations import sight_direction
from sidelong.sitl.payload.devices import DeviceView, SimulatedViewpro
from sidelong.sitl.settings import Quirks
from tests.payload.golden import VIEWPRO_ATTITUDE, VIEWPRO_CAPTURED, VIEWPRO_FRAMES, VIEWPRO_OVER_TCP


def driver(**settings) -> ViewproDriver:
    return ViewproDriver(DriverSettings(**settings))


def status(attitude: str = VIEWPRO_ATTITUDE, range_bytes: bytes = b"\0\0") -> bytes:
    """Return a status frame as the gimbal sends it."""
    return encode(0x40, bytes(23) + bytes.fromhex(attitude) + bytes(4) + range_bytes + bytes(6), 3)


@pytest.mark.parametrize(("frame_id", "data", "frame"), [golden[1:] for golden in VIEWPRO_FRAMES], ids=str)
def test_frames_are_those_of_the_vendors_document(frame_id, data, frame):
    assert encode(frame_id, bytes.fromhex(data)) == bytes.fromhex(frame)


def test_envelope_for_tcp_is_that_of_the_vendors_document():
    inner, outer = map(bytes.fromhex, VIEWPRO_OVER_TCP)
    assert wrapped(inner) == outer


@pytest.mark.parametrize("frame", VIEWPRO_CAPTURED)
def test_captured_frames_are_intact(frame):
    one = driver()
    one.receive(bytes.fromhex(frame), 0.0)
    assert one.damaged == 0
    body = bytes.fromhex(frame)
    assert encode(body[4], body[5:-1], body[3] >> 6) == body


def test_attitude_of_the_vendors_example_is_read():
    (angles,) = driver().receive(status(), 1.0)
    forward, right, down = sight_direction(angles.quaternion_wxyz)
    assert math.degrees(math.atan2(right, forward)) == pytest.approx(39.28, abs=0.01)
    assert math.degrees(math.asin(-down)) == pytest.approx(40.0, abs=0.02)
    assert angles.frame == "vehicle"


def test_range_is_big_endian_in_decimetres():
    measured = driver().receive(status(range_bytes=b"\x0b\xb8"), 1.0)
    assert [one.slant_range_m for one in measured if isinstance(one, RangeMeasured)] == [pytest.approx(300.0)]


def test_no_echo_is_no_range():
    assert [type(one) for one in driver().receive(status(), 1.0)] == [AnglesMeasured]


def test_laser_is_switched_on_and_the_handshake_is_repeated():
    one = driver()
    first = one.due(0.0)
    assert encode(0x1C, b"\x40\x00", first[2][3] >> 6) in first
    assert any(frame[4] == 0x00 for frame in one.due(1.5))


def test_aircraft_attitude_is_sent_as_ardupilot_sends_it():
    gimbal = SimulatedViewpro(Quirks(), np.random.default_rng(1))
    pose = AircraftPose(0.3, -0.1, 4.0, 47.4, 8.5, 520.0, 100.0, 10.0, -11.0, 0.5)
    for frame in driver().aircraft(pose, 0.0):
        gimbal.receive(frame, 0.0, DeviceView(300.0, 0.0, 0.0))
    assert gimbal.aircraft_deg == pytest.approx(
        (math.degrees(0.3), math.degrees(-0.1), math.degrees(4.0 - math.tau)), abs=0.01
    )
