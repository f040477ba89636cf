"""What holds of every driver and the simulated payload of its protocol."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.app.payload.driver import AnglesMeasured, DriverSettings, RangeMeasured
from sidelong.app.payload.registry import kind_by_name
from sidelong.estimators.rotations import sight_direction
from sidelong.sitl.payload.devices import DEVICES, DeviceView
from sidelong.sitl.settings import Quirks
from tests.payload.wiring import Wired, looking

# Protocol, whether it streams, whether it goes over TCP; bearing; errors of range, bearing and elevation.
CASES = [
    *(("siyi", streams, False, -70.0, 0.06, 0.2, 0.1) for streams in (True, False)),
    *(("topotek", streams, False, 170.0, 0.06, 0.05, 0.05) for streams in (True, False)),
    *(("gremsy", streams, False, 170.0, 3e-4, 0.01, 0.01) for streams in (True, False)),
    *(("viewpro", True, over_tcp, 170.0, 0.06, 0.05, 0.05) for over_tcp in (True, False)),
]


@pytest.mark.parametrize(("kind", "streams", "over_tcp", "bearing_deg", "range_off_m", "bearing_off", "off"), CASES)
def test_measurements_agree_with_what_the_gimbal_sees(
    kind, streams, over_tcp, bearing_deg, range_off_m, bearing_off, off
):
    wired = Wired(kind, Quirks(streams=streams), settings=DriverSettings(over_tcp=over_tcp), delay_s=0.03)
    wired.device.over_tcp = over_tcp
    measured = wired.run(5.0, looking(300.0, bearing_deg=bearing_deg, elevation_deg=-21.0, lean_deg=4.0))
    ranges = [one for one in measured if isinstance(one, RangeMeasured)]
    angles = [one for one in measured if isinstance(one, AnglesMeasured)]
    assert len(ranges) > 30
    assert len(angles) > (60 if kind == "siyi" else 30)
    assert all(one.slant_range_m == pytest.approx(300.0, abs=range_off_m) for one in ranges)
    for one in angles:
        forward, right, down = sight_direction(one.quaternion_wxyz)
        assert math.degrees(math.atan2(right, forward)) == pytest.approx(bearing_deg, abs=bearing_off)
        assert math.degrees(math.asin(-down)) == pytest.approx(-21.0, abs=off)
        assert one.frame == "vehicle"


@pytest.mark.parametrize("kind", ["viewpro", "gremsy", "topotek"])
def test_gimbal_is_pointed(kind):
    gimbal = DEVICES[kind](Quirks(), np.random.default_rng(1))
    for command in kind_by_name(kind).make(DriverSettings()).point(math.radians(-30.0), math.radians(200.0)):
        gimbal.receive(command, 0.0, DeviceView(300.0, 0.0, 0.0))
    assert gimbal.commanded_deg == pytest.approx((-160.0, -30.0), abs=0.01)
