"""How wide circles come out, against what the real simulators were measured to fly."""

import math

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.settings import Flavour
from sidelong.sitl.world.airframe import WindVector

CENTRE_M = (500.0, 300.0)
HEIGHT_M = 120.0


def flown(simulate, station, radius_m, seconds=60.0, **changes):
    ground = station(simulate(payload=None, **changes))
    ground.fly(ground.takeoff(HEIGHT_M), ground.loiter(*CENTRE_M, radius_m, HEIGHT_M))
    ground.run(140.0)
    return ground, *ground.radii_m(CENTRE_M, seconds)


@pytest.mark.parametrize(("commanded_m", "measured_m"), [(50, 69.0), (100, 116.0), (150, 167.0)])
def test_arduplane_flies_wider_circles_than_commanded(simulate, station, commanded_m, measured_m):
    _, mean_m, min_m, max_m = flown(simulate, station, commanded_m, airspeed_m_s=22.0)
    assert mean_m == pytest.approx(measured_m, abs=1.0)
    assert max_m - min_m < 0.4


def test_the_excess_shrinks_with_speed(simulate, station):
    _, slow_m, _, _ = flown(simulate, station, 100, airspeed_m_s=15.0)
    assert 105.0 < slow_m < 113.0


def test_the_least_circle_of_arduplane_at_22_m_s_is_about_50_m(simulate, station):
    _, mean_m, _, _ = flown(simulate, station, 20, airspeed_m_s=22.0)
    assert mean_m == pytest.approx(50.0, abs=4.0)


def test_arduplane_in_wind_breathes_by_some_metres(simulate, station):
    _, mean_m, min_m, max_m = flown(simulate, station, 100, airspeed_m_s=22.0, wind=WindVector(5.0, 0.0))
    assert mean_m == pytest.approx(116.0, abs=2.0)
    assert 6.0 < max_m - min_m < 14.0


@pytest.mark.parametrize("commanded_m", [25, -50, 80, -150])
def test_px4_flies_the_signed_radius(simulate, station, commanded_m):
    ground, mean_m, min_m, max_m = flown(simulate, station, commanded_m, flavour=Flavour.PX4)
    assert mean_m == pytest.approx(abs(commanded_m), abs=0.2)
    assert max_m - min_m < 1.0
    assert math.copysign(1.0, ground.simulation.vehicle.craft.roll_rad) == math.copysign(1.0, commanded_m)


def test_px4_silently_flies_the_least_radius_its_roll_limit_allows(simulate, station):
    ground, mean_m, _, _ = flown(simulate, station, 10, flavour=Flavour.PX4)
    true_airspeed_m_s = ground.simulation.vehicle.craft.airspeed_m_s
    assert mean_m == pytest.approx(true_airspeed_m_s**2 / (9.80665 * math.tan(math.radians(50.0))), abs=0.3)


def test_px4_holds_its_circle_in_wind(simulate, station):
    _, mean_m, min_m, max_m = flown(simulate, station, 80, flavour=Flavour.PX4, wind=WindVector(3.0, -2.0))
    assert mean_m == pytest.approx(80.0, abs=0.5)
    assert max_m - min_m < 3.0


@pytest.mark.parametrize(
    ("flavour", "radius_m", "airspeed_m_s", "measured_m"),
    [
        (Flavour.ARDUPLANE, 100.0, 22.0, 131.0),
        (Flavour.PX4, 150.0, 15.0, 152.0),
        (Flavour.PX4, 100.0, 15.0, 104.0),
        (Flavour.PX4, 60.0, 15.0, 67.5),
    ],
)
def test_a_circle_of_waypoints_runs_wide(simulate, station, flavour, radius_m, airspeed_m_s, measured_m):
    ground = station(simulate(flavour=flavour, airspeed_m_s=airspeed_m_s, payload=None))
    count = round(2.0 * math.pi * radius_m / 20.0)
    angles_rad = [2.0 * math.pi * i / count for i in range(2 * count)]
    points = [
        ground.waypoint(400.0 + radius_m * math.sin(a), 400.0 - radius_m * math.cos(a), HEIGHT_M) for a in angles_rad
    ]
    ground.fly(ground.takeoff(HEIGHT_M), *points)
    mission = ground.simulation.vehicle.mission
    ground.run_until(lambda: mission.index > count, step_s=0.5)
    mean_m, _, _ = ground.radii_m((400.0, 400.0), 0.8 * 2.0 * math.pi * radius_m / airspeed_m_s)
    assert mean_m == pytest.approx(measured_m, abs=4.5)


@pytest.mark.parametrize("flavour", list(Flavour))
def test_a_straight_string_of_waypoints_is_followed_closely(simulate, station, flavour):
    ground = station(simulate(flavour=flavour, airspeed_m_s=15.0, payload=None))
    string = [ground.waypoint(200.0, 100.0 * i) for i in range(1, 30)]
    ground.fly(ground.takeoff(), *string)
    craft, mission = ground.simulation.vehicle.craft, ground.simulation.vehicle.mission
    ground.run_until(lambda: mission.index > 12)
    offsets_m = []
    while mission.index < 24:
        ground.run(0.5)
        offsets_m.append(abs(craft.east_m - 200.0))
    assert max(offsets_m) < 2.5


@pytest.mark.parametrize(
    ("east_m", "radius_m", "within_s"), [(20.0, 80.0, 7.0), (100.0, 80.0, 15.0), (0.0, 100.0, 7.0), (0.0, 130.0, 7.0)]
)
def test_px4_joins_a_moved_orbit_within_seconds(simulate, station, east_m, radius_m, within_s):
    ground, *_ = flown(simulate, station, 80, flavour=Flavour.PX4, seconds=1.0)
    x, y = ground.e7(CENTRE_M[0] + east_m, CENTRE_M[1])
    altitude_m = ground.simulation.vehicle.home.altitude_m + HEIGHT_M
    result = ground.command_int(
        mavlink.MAV_CMD_DO_ORBIT, radius_m, math.nan, 0, math.nan, frame=5, x=x, y=y, z=altitude_m
    )
    assert result == mavlink.MAV_RESULT_ACCEPTED
    ground.run(within_s)
    _, min_m, max_m = ground.radii_m((CENTRE_M[0] + east_m, CENTRE_M[1]), 20.0)
    assert radius_m - 3.0 < min_m < max_m < radius_m + 3.0
