"""Battery, GPS and link as a person is shown of them."""

from __future__ import annotations

import pytest

from sidelong.app.link.quality import LinkReport, Measured
from sidelong.app.link.vehicle import vehicle_status
from tests.messages import latest


def link(*, in_use=True, **measured):
    values = {"silent_s": 0.0, "loss": None, "round_trip_s": None, "received_bytes_s": 0.0, "sent_bytes_s": 0.0}
    return LinkReport("udp", False, in_use, Measured(**values | measured), {})


def test_what_was_not_reported_is_not_known():
    status = vehicle_status({}, ())
    assert (status.battery_percent, status.battery_v, status.gps, status.link_percent) == (None, None, None, None)


@pytest.mark.parametrize(
    ("remaining", "millivolts", "percent", "volts"), [(87, 12600, 87, 12.6), (-1, 65535, None, None), (0, 0, 0, None)]
)
def test_the_battery(remaining, millivolts, percent, volts):
    power = {"battery_remaining": remaining, "voltage_battery": millivolts, "current_battery": 1250}
    status = vehicle_status(latest(SYS_STATUS=power), ())
    assert (status.battery_percent, status.battery_v, status.battery_a) == (percent, volts, 12.5)
    unknown = vehicle_status(latest(SYS_STATUS=power | {"current_battery": -100}), ())  # of PX4 without a sensor
    assert unknown.battery_a is None


@pytest.mark.parametrize(
    ("fix_type", "satellites", "words", "good"),
    [
        (3, 11, "3D, 11 satellites", True),
        (3, 4, "3D, 4 satellites", False),
        (1, 2, "no fix, 2 satellites", False),
        (6, 255, "RTK fixed", True),
        (9, 8, "fix type 9, 8 satellites", True),
    ],
)
def test_the_fix(fix_type, satellites, words, good):
    status = vehicle_status(latest(GPS_RAW_INT={"fix_type": fix_type, "satellites_visible": satellites}), ())
    assert (status.gps, status.gps_good) == (words, good)


def test_the_link_is_the_one_in_use():
    status = vehicle_status({}, (link(in_use=False, loss=0.5), link(loss=0.031, round_trip_s=0.12)))
    assert (status.link_percent, status.round_trip_s) == (97, 0.12)
