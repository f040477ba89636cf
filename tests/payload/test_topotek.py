from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.app.payload.driver import AnglesMeasured, DriverSettings, RangeMeasured
from sidelong.app.payload.topotek import TopotekDriver, encode
from sidelong.estimators.rotations import sight_direction
from sidelong.sitl.payload.device import Seen
from sidelong.sitl.payload.topotek import SimulatedTopotek
from sidelong.sitl.settings import Quirks
from tests.payload.golden import TOPOTEK_REQUESTS
from tests.payload.wiring import Wired, looking


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


def test_angles_that_are_not_hexadecimal_are_refused():
    body = b"#tpGUCrGIA" + b"EC7X" + b"07D0" + b"0000"
    assert driver().receive(body + b"%02X" % (sum(body) & 0xFF), 1.0) == []


@pytest.mark.parametrize("streams", [True, False])
def test_measurements_agree_with_what_the_gimbal_sees(streams):
    wired = Wired("topotek", Quirks(streams=streams), delay_s=0.03)
    measured = wired.run(5.0, looking(300.0, bearing_deg=170.0, elevation_deg=-21.0, lean_deg=4.0))
    ranges = [one for one in measured if isinstance(one, RangeMeasured)]
    angles = [one for one in measured if isinstance(one, AnglesMeasured)]
    assert min(len(ranges), len(angles)) > 30
    assert all(one.slant_range_m == pytest.approx(300.0, abs=0.06) for one in ranges)
    for one in angles:
        forward, right, down = sight_direction(one.quaternion_wxyz)
        assert math.degrees(math.atan2(right, forward)) == pytest.approx(170.0, abs=0.05)
        assert math.degrees(math.asin(-down)) == pytest.approx(-21.0, abs=0.05)


def test_gimbal_is_pointed():
    gimbal = SimulatedTopotek(Quirks(), np.random.default_rng(1))
    for command in driver().point(math.radians(-30.0), math.radians(200.0)):
        gimbal.receive(command, 0.0, Seen(300.0, 0.0, 0.0))
    assert gimbal.commanded_deg == pytest.approx((-160.0, -30.0), abs=0.01)
