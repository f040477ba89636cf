"""A parameter that another ground station changes in flight is reported once."""

import struct

from sidelong.app.autopilots.autopilot import Parameter, ParameterTable, Purpose
from sidelong.app.link.stored import ParameterWatch
from tests.messages import message

PARAMETERS = (Parameter("WP_LOITER_RAD", Purpose.CIRCLE), Parameter("AIRSPEED_CRUISE", Purpose.AIRSPEED))


def value_of(name, value, component=1, kind=9):
    return message("PARAM_VALUE", component, param_id=name, param_value=value, param_type=kind)


def watch(own=(), *, bytewise=False):
    notes: list[str] = []
    table = ParameterTable(PARAMETERS, None, {"WP_LOITER_RAD": 60.0, "AIRSPEED_CRUISE": 15.0})
    return ParameterWatch(table, bytewise, dict(own), notes.append), notes


def test_changed_parameter_is_reported_once():
    watching, notes = watch()
    for _ in range(3):
        watching.take(value_of("WP_LOITER_RAD", 90.0))
    assert notes == ["another ground station has set WP_LOITER_RAD to 90; it was 60"]


def test_answers_own_changes_and_other_components_are_no_news():
    watching, notes = watch({"AIRSPEED_CRUISE": 18.0})
    watching.take(value_of("WP_LOITER_RAD", 60.000001))
    watching.take(value_of("AIRSPEED_CRUISE", 18.0))
    watching.take(value_of("WP_LOITER_RAD", 5.0, component=154))
    watching.take(value_of("UNKNOWN", 5.0))
    assert notes == []


def test_integer_that_px4_sends_as_bytes_is_decoded():
    watching, notes = watch(bytewise=True)
    watching.take(value_of("WP_LOITER_RAD", struct.unpack("<f", struct.pack("<i", 80))[0], kind=6))
    assert notes == ["another ground station has set WP_LOITER_RAD to 80; it was 60"]
