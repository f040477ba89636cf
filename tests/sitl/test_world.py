"""Several vehicles about one target."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from sidelong.sitl.settings import Flavour, Settings, TargetSettings, in_a_row
from sidelong.sitl.simulation import Simulation
from sidelong.sitl.world.geodesy import HomePlane


@pytest.fixture
def pair():
    """Return two simulations with the rows of truth that each has written, 60 s long."""
    first = Settings(seed=4, targets=(TargetSettings("turning", 3.0),))
    rows: list[list] = [[], []]
    plane, wing = in_a_row(first, 2)
    simulations = [
        Simulation(replace(plane, endurance_s=1000.0)),
        Simulation(replace(wing, flavour=Flavour.PX4, airspeed_m_s=20.0, endurance_s=100.0)),
    ]
    for simulation, written in zip(simulations, rows, strict=True):
        simulation.on_truth = written.append
        simulation.advance(60.0)
    return simulations, rows


def test_vehicles_stand_apart_and_look_at_one_target(pair):
    simulations, rows = pair
    assert [one.settings.system_id for one in simulations] == [1, 2]
    assert [one.settings.flavour for one in simulations] == ["arduplane", "px4"]
    assert [one.settings.airspeed_m_s for one in simulations] == [15.0, 20.0]
    assert [one.settings.endurance_s for one in simulations] == [1000.0, 100.0]
    plane = HomePlane(*rows[0][0].aircraft_deg)
    east_m, north_m = plane.east_north_m(*rows[1][0].aircraft_deg)
    assert math.hypot(east_m - 200.0, north_m) < 0.1
    for one, other in zip(*rows, strict=True):
        assert one.time_s == other.time_s
        apart_m = plane.east_north_m(*one.target_deg), plane.east_north_m(*other.target_deg)
        assert math.dist(*apart_m) < 0.02
    assert rows[0][0].target_m != rows[0][-1].target_m


def test_their_sensors_have_noise_of_their_own(pair):
    _, rows = pair
    assert [row.laser_valid for row in rows[0]] != [row.laser_valid for row in rows[1]]


def test_a_vehicle_that_is_lost_reports_and_receives_nothing():
    simulation = Simulation(Settings())
    simulation.connect("ground")
    simulation.lost_s = 5.0
    simulation.advance(5.0)
    assert simulation.take()
    simulation.advance(10.0)
    assert simulation.take() == []
    assert simulation.time_s == pytest.approx(10.0)
