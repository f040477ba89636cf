from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from sidelong.app.payload.driver import AnglesMeasured, DriverSettings
from sidelong.app.payload.siyi import SiyiDriver, encode
from sidelong.estimators.rotations import sight_direction
from sidelong.sitl.payload.devices import DeviceView, SimulatedSiyi
from sidelong.sitl.settings import Quirks
from tests.payload.golden import SIYI_CAPTURED, SIYI_REQUESTS
from tests.payload.wiring import Wired, looking

ATTITUDE, RANGE = 0x0D, 0x15


def answer(command: int, data: bytes) -> bytes:
    """Return a frame as the gimbal sends it; the driver reads no control byte."""
    return encode(command, data, 77)


def driver(**settings) -> SiyiDriver:
    return SiyiDriver(DriverSettings(**settings))


@pytest.mark.parametrize(("command", "data", "sequence", "frame"), [golden[1:] for golden in SIYI_REQUESTS], ids=str)
def test_requests_are_those_of_the_manual(command, data, sequence, frame):
    assert encode(command, bytes.fromhex(data), sequence) == bytes.fromhex(frame)


def test_requests_of_the_manual_are_understood_by_the_simulated_gimbal():
    gimbal = SimulatedSiyi(Quirks(), np.random.default_rng(1))
    wanted = b"".join(bytes.fromhex(frame) for *_, frame in SIYI_REQUESTS)
    answers = gimbal.receive(wanted, 0.0, DeviceView(300.0, 0.0, -0.3))
    assert [one[7] for one in answers] == [0x01, 0x02, 0x07, 0x0A, 0x0D, 0x15]


def test_captured_replies_are_intact_and_read():
    one = driver()
    assert one.receive(b"".join(map(bytes.fromhex, SIYI_CAPTURED)), 0.0) == []
    assert one.damaged == 0
    (angles,) = one.receive(answer(ATTITUDE, bytes(12)), 0.1)
    assert angles.frame == "vehicle"  # the captured configuration is follow mode


def test_first_requests_identify_the_camera_and_start_the_streams():
    sent = b"".join(driver().due(0.0))
    for command in (0x01, 0x02, 0x0A, 0x25):
        assert any(sent[at : at + 2] == b"\x55\x66" and sent[at + 7] == command for at in range(len(sent) - 7))


def test_range_is_in_decimetres_unless_configured():
    frame = answer(RANGE, (2345).to_bytes(2, "little"))
    assert [one.slant_range_m for one in driver().receive(frame, 1.0)] == [pytest.approx(234.5)]
    assert [one.slant_range_m for one in driver(range_unit_m=1.0).receive(frame, 1.0)] == [2345.0]


@pytest.mark.parametrize("count", [0, 49, 0xFFFF])
def test_range_without_echo_is_no_range(count):
    assert driver().receive(answer(RANGE, count.to_bytes(2, "little")), 1.0) == []


def test_yaw_is_positive_to_the_left_and_pitch_up():
    frame = answer(ATTITUDE, struct.pack("<hhhhhh", 300, -200, 0, 0, 0, 0))
    (angles,) = driver().receive(frame, 1.0)
    forward, right, down = sight_direction(angles.quaternion_wxyz)
    assert math.degrees(math.atan2(right, forward)) == pytest.approx(-30.0)
    assert math.degrees(math.asin(down)) == pytest.approx(20.0)
    (flipped,) = driver(flip_yaw=True).receive(frame, 1.0)
    assert sight_direction(flipped.quaternion_wxyz)[1] == pytest.approx(-right)


def test_joints_turn_in_the_order_yaw_roll_pitch():
    # Looking 90 degrees down the inner joint: a camera rolled by 10 degrees then looks sideways, which it would not
    # if roll were the inner joint.
    (angles,) = driver().receive(answer(ATTITUDE, struct.pack("<hhhhhh", 0, -900, 100, 0, 0, 0)), 1.0)
    assert sight_direction(angles.quaternion_wxyz) == pytest.approx(
        (0.0, -math.sin(math.radians(10.0)), 0.985), abs=1e-3
    )


def test_upside_down_mount_is_turned_back():
    one = driver()
    one.receive(answer(0x0A, bytes((0, 0, 0, 0, 1, 2, 0))), 0.0)
    (angles,) = one.receive(answer(ATTITUDE, struct.pack("<hhhhhh", 300, 1700, 0, 0, 0, 0)), 1.0)
    forward, right, down = sight_direction(angles.quaternion_wxyz)
    assert math.degrees(math.asin(down)) == pytest.approx(-10.0)
    assert math.degrees(math.atan2(right, forward)) == pytest.approx(30.0)


def test_fpv_mode_gives_angles_of_the_airframe():
    one = driver()
    one.receive(answer(0x0A, bytes((0, 0, 0, 0, 2, 1, 0))), 0.0)
    (angles,) = one.receive(answer(ATTITUDE, bytes(12)), 1.0)
    assert angles.frame == "body"


@pytest.mark.parametrize("text", ["7A", "\x7a"])
def test_model_is_read_from_text_or_number(text):
    one = driver()
    one.receive(answer(0x02, text.encode().ljust(12, b"\0")), 0.0)
    assert (one.identity.model, one.identity.has_laser) == ("ZT30", True)


def test_a8_has_no_laser_and_is_not_asked_for_ranges():
    one = driver()
    one.due(0.0)
    one.receive(answer(0x02, b"73".ljust(12, b"\0")), 0.0)
    assert one.identity.has_laser is False
    sent = [frame[7] for at in range(1, 300) for frame in one.due(0.01 * at)]
    assert RANGE not in sent
    assert ATTITUDE in sent


@pytest.mark.parametrize("streams", [True, False])
def test_time_of_measurement_is_estimated_to_a_few_milliseconds(streams):
    wired = Wired("siyi", Quirks(streams=streams), delay_s=0.06)

    def turning(now_s: float) -> DeviceView:
        return looking(300.0, bearing_deg=20.0 * now_s - 60.0, elevation_deg=-20.0)(now_s)

    late_s = []
    for one in wired.run(6.0, turning):
        if isinstance(one, AnglesMeasured) and one.time_s > 3.0:
            forward, right, _ = sight_direction(one.quaternion_wxyz)
            seen_s = (math.degrees(math.atan2(right, forward)) + 60.0) / 20.0
            late_s.append(one.time_s - seen_s)
    assert len(late_s) > 20
    assert np.median(late_s) == pytest.approx(0.0, abs=0.012)  # the driver is asked every 10 ms


def test_gimbal_is_pointed_within_its_limits():
    gimbal = SimulatedSiyi(Quirks(), np.random.default_rng(1))
    one = driver()
    one.receive(answer(0x02, b"73".ljust(12, b"\0")), 0.0)
    for command in one.point(math.radians(-30.0), math.radians(200.0)):
        gimbal.receive(command, 0.0, DeviceView(300.0, 0.0, 0.0))
    assert gimbal.commanded_deg == pytest.approx((-135.0, -30.0))
