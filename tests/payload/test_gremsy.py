from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.payload.driver import DriverSettings
from sidelong.app.payload.gremsy import GremsyDriver


def driver(**settings) -> GremsyDriver:
    return GremsyDriver(DriverSettings(**settings))


def sent(message, component: int) -> bytes:
    return message.pack(mavlink.MAVLink(None, 1, component))


def parameter(value: float, name: bytes = b"LRF_RANGE", component: int = 26) -> bytes:
    return sent(mavlink.MAVLink_param_value_message(name, value, 9, 28, 2), component)


def test_first_requests_are_the_streams_and_the_laser_at_ten_hertz():
    parser = mavlink.MAVLink(None)
    messages = {
        message.get_type(): message
        for frame in driver().due(0.0)
        for message in parser.parse_buffer(frame)
        if message.get_type() != "COMMAND_LONG" or message.target_component == 26
    }
    interval, laser = messages["COMMAND_LONG"], messages["PARAM_EXT_SET"]
    assert (interval.command, interval.param1, interval.param2, interval.param7) == (511, 2.0, 100_000.0, 1.0)
    assert (laser.param_id, laser.param_value[:1]) == ("LRF_MODE", "\x02")


def test_range_is_the_payloads_parameter_or_debug_value():
    assert [one.slant_range_m for one in driver().receive(parameter(312.5), 1.0)] == [312.5]
    debug = sent(mavlink.MAVLink_debug_message(0, 2, 312.5), 26)
    assert [one.slant_range_m for one in driver().receive(debug, 1.0)] == [312.5]


@pytest.mark.parametrize(
    "frame",
    [
        parameter(math.nan),
        parameter(0.0),
        parameter(-1.0),
        parameter(312.5, name=b"EO_ZOOM"),
        parameter(312.5, component=1),
        sent(mavlink.MAVLink_debug_message(0, 3, 312.5), 26),
    ],
)
def test_other_values_are_no_range(frame):
    assert driver().receive(frame, 1.0) == []


def test_attitude_without_a_rotation_is_refused():
    nowhere = mavlink.MAVLink_gimbal_device_attitude_status_message(0, 0, 1, 12, [math.nan] * 4, 0, 0, 0, 0)
    assert driver().receive(sent(nowhere, 154), 1.0) == []
