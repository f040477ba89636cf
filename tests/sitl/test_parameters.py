"""Parameters, in each autopilot's encoding."""

import struct

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.settings import Flavour


def read(ground, name):
    ground.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
    ground.run(0.1)
    return ground.last("PARAM_VALUE")


def test_arduplane_sends_integers_as_floats(simulate, station):
    ground = station(simulate(payload=None))
    value = read(ground, "WP_LOITER_RAD")
    assert (value.param_value, value.param_type) == (80.0, mavlink.MAV_PARAM_TYPE_INT16)
    assert read(ground, "AIRSPEED_CRUISE").param_type == mavlink.MAV_PARAM_TYPE_REAL32


def test_px4_sends_integers_by_their_bytes(simulate, station):
    ground = station(simulate(flavour=Flavour.PX4, payload=None))
    value = read(ground, "MIS_TKO_LAND_REQ")
    assert value.param_type == mavlink.MAV_PARAM_TYPE_INT32
    assert struct.unpack("<i", struct.pack("<f", value.param_value)) == (2,)
    assert read(ground, "FW_AIRSPD_TRIM").param_value == 15.0


def test_px4_takes_integers_by_their_bytes(simulate, station):
    ground = station(simulate(flavour=Flavour.PX4, payload=None))
    encoded = struct.unpack("<f", struct.pack("<i", 10))[0]
    ground.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_DL_LOSS_T", encoded, mavlink.MAV_PARAM_TYPE_INT32))
    ground.run(0.1)
    assert ground.simulation.vehicle.parameters["COM_DL_LOSS_T"] == 10.0


@pytest.mark.parametrize("flavour", list(Flavour))
def test_an_unknown_parameter_gets_no_answer(simulate, station, flavour):
    ground = station(simulate(flavour=flavour, payload=None))
    ground.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH_PARAM", -1))
    ground.send(mavlink.MAVLink_param_set_message(1, 1, b"NO_SUCH_PARAM", 1.0, mavlink.MAV_PARAM_TYPE_REAL32))
    ground.run(5.0)
    assert not ground.all("PARAM_VALUE")


@pytest.mark.parametrize("flavour", list(Flavour))
def test_the_list_is_complete(simulate, station, flavour):
    ground = station(simulate(flavour=flavour, payload=None))
    ground.send(mavlink.MAVLink_param_request_list_message(1, 1))
    ground.run(0.1)
    values = ground.all("PARAM_VALUE")
    assert len({m.param_id for m in values}) == len(values) == values[0].param_count


def test_a_change_is_obeyed_and_reported_to_all(simulate, station):
    ground = station(simulate(payload=None))
    other = station(ground.simulation, alongside=ground, address="other", system_id=250)
    ground.fly(ground.takeoff(60.0), ground.loiter(300.0, 0.0, 100.0, 60.0))
    ground.run(60.0)
    ground.send(mavlink.MAVLink_param_set_message(1, 1, b"AIRSPEED_CRUISE", 19.0, mavlink.MAV_PARAM_TYPE_REAL32))
    ground.run(20.0)
    assert other.last("PARAM_VALUE").param_value == 19.0
    assert other.last("VFR_HUD").airspeed == pytest.approx(19.0, abs=0.1)
