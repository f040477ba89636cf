from __future__ import annotations

import math

import pytest

from sidelong.app.payload.driver import DriverSettings
from sidelong.app.payload.topotek import TopotekDriver, encode
from sidelong.estimators.rotations import sight_direction
from tests.payload.golden import TOPOTEK_REQUESTS


def driver(**settings) -> TopotekDriver:
    return TopotekDriver(DriverSettings(**settings))


@pytest.mark.parametrize(("destination", "control", "command", "data", "frame"), TOPOTEK_REQUESTS, ids=str)
def test_requests_are_those_of_public_programs(destination, control, command, data, frame):
    assert encode(destination, control, command, data) == frame


def test_angles_are_hundredths_of_a_degree_with_pitch_downwards():
    body = b"#tpGUCrGIA" + b"EC78" + b"07D0" + b"0000"
    (angles,) = driver().receive(body + b"%02X" % (sum(body) & 0xFF), 1.0)
    forward, right, down = sight_direction(angles.quaternion_wxyz)
    assert math.degrees(math.atan2(right, forward)) == pytest.approx(-50.0)
    assert math.degrees(math.asin(down)) == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("data", "ranges_m"),
    [(b"00300.4", [300.4]), (b"12345.6", [12345.6]), (b"ERR", []), (b"00000.0", []), (b"0030x.4", []), (b"", [])],
)
def test_range_is_text_in_metres(data, ranges_m):
    body = b"#tpMU%XrLRF" % len(data) + data
    measured = driver().receive(body + b"%02X" % (sum(body) & 0xFF), 1.0)
    assert [one.slant_range_m for one in measured] == ranges_m


@pytest.mark.parametrize("yaw", [b"EC7X", b"EC7 ", b"\t73\t"])
def test_angles_that_are_not_hexadecimal_are_refused(yaw):
    body = b"#tpGUCrGIA" + yaw + b"07D0" + b"0000"
    assert driver().receive(body + b"%02X" % (sum(body) & 0xFF), 1.0) == []
