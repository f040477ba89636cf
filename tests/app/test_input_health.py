"""Inputs are judged by the flight's health model before it begins."""

from __future__ import annotations

import math

import pytest

from sidelong.app.config import Config
from sidelong.app.flight.session import InputHealth, VehicleInputs
from tests.exchange.conftest import Flight
from tests.faults.flight import FaultedFlight, Scenario
from tests.faults.flight_faults import GIMBAL, Fault, repeated, turned


def test_vehicle_on_the_ground_has_sound_inputs_until_its_gimbal_is_silent():
    flight = Flight("px4", begin=False)
    inputs = InputHealth(Config(), VehicleInputs(flight.vehicle))
    flight.run(30.0)
    (check,) = inputs.checks()
    assert check.ready, check
    flight.simulation.mute_payload("GIMBAL_DEVICE_ATTITUDE_STATUS")
    flight.run(8.0)
    (check,) = inputs.checks()
    assert not check.ready
    assert check.found.startswith("no orientation from the gimbal")
    inputs.close()
    flight.simulation.muted.clear()
    flight.run(3.0)
    assert not inputs.checks()[0].ready


@pytest.mark.parametrize(
    ("change", "words"),
    [(repeated(GIMBAL, "q"), "frozen"), (turned(90.0), "its yaw is off by about +")],
    ids=["frozen", "turned"],
)
def test_wrong_gimbal_of_a_flying_aircraft_is_found(change, words):
    flight = FaultedFlight(Scenario(1, "px4", 60.0), [Fault("gimbal", 30.0, math.inf, change)])
    inputs = InputHealth(Config(), VehicleInputs(flight.vehicle))
    assert flight.run(25.0) is False
    assert inputs.checks()[0].ready
    flight.run(20.0)
    (check,) = inputs.checks()
    assert not check.ready
    assert words in check.found
