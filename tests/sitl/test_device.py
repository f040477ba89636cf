"""A simulated vehicle whose payload speaks its maker's protocol."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.payload.devices import DEVICES
from sidelong.sitl.settings import Settings
from sidelong.sitl.simulation import Simulation

# A SIYI request for the laser range, as in the manual.
RANGE_REQUEST = bytes.fromhex("5566010000000015d196")


@pytest.mark.parametrize("kind", DEVICES)
def test_vehicle_with_a_device_sends_no_laser_or_gimbal_by_mavlink(kind):
    simulation = Simulation(Settings(device=kind))
    simulation.connect("station")
    simulation.advance(5.0)
    names = {message.get_type() for _, data in simulation.take() for message in _parsed(data)}
    assert "HEARTBEAT" in names
    assert not names & {"DISTANCE_SENSOR", "GIMBAL_DEVICE_ATTITUDE_STATUS"}


def test_device_answers_with_the_range_of_the_truth():
    simulation, truth = Simulation(Settings(device="siyi", seed=4)), []
    simulation.on_truth = truth.append
    simulation.advance(5.0)
    answers = [answer for _ in range(20) for answer in _asked(simulation)]
    ranges_m = [int.from_bytes(answer[8:10], "little") / 10.0 for answer in answers]
    assert len(ranges_m) > 5
    assert sorted(ranges_m)[len(ranges_m) // 2] == pytest.approx(truth[-1].slant_range_m, abs=3.0)


def test_unplugged_device_neither_answers_nor_streams():
    simulation = Simulation(Settings(device="siyi"))
    simulation.advance(5.0)
    simulation.receive_device(bytes.fromhex("5566010200000025010596f4"))
    simulation.unplugged = True
    assert _asked(simulation) == []
    assert simulation.take_device() == []


def _asked(simulation: Simulation) -> list[bytes]:
    simulation.advance(simulation.time_s + 0.5)
    return simulation.receive_device(RANGE_REQUEST)


def _parsed(data: bytes):
    return mavlink.MAVLink(None).parse_buffer(data) or ()
