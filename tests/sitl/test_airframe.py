"""The point mass: turns, climbs, wind and the ground."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sidelong.sitl.world.airframe import (
    AirframeParameters,
    SimulatedAirframe,
    WindVector,
    true_over_equivalent_airspeed,
)
from sidelong.sitl.world.geodesy import HomePlane

DT_S = 0.02


def airborne(wind=None, speed_m_s=15.0, **build):
    craft = SimulatedAirframe(AirframeParameters(**build), wind or WindVector())
    craft.flying, craft.height_m, craft.airspeed_m_s = True, 100.0, speed_m_s
    return craft


def fly(craft, seconds, roll_rad=0.0, airspeed_m_s=15.0, climb_m_s=0.0):
    for _ in range(round(seconds / DT_S)):
        craft.fly(DT_S, roll_rad, airspeed_m_s, climb_m_s)


def test_a_coordinated_turn_has_the_textbook_radius():
    craft = airborne()
    fly(craft, 10.0, math.radians(30.0))
    turn_rate_rad_s = 9.80665 * math.tan(math.radians(30.0)) / 15.0
    assert craft.yaw_rate_rad_s == pytest.approx(turn_rate_rad_s, rel=1e-6)
    before = (craft.east_m, craft.north_m)
    fly(craft, round(math.tau / turn_rate_rad_s / DT_S) * DT_S, math.radians(30.0))
    assert math.dist(before, (craft.east_m, craft.north_m)) < 0.2


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-1.2, 1.2), min_size=1, max_size=8))
def test_roll_never_changes_faster_than_its_limit(commands):
    craft = airborne()
    limit_rad = craft.build.roll_rate_max_rad_s * DT_S
    for command in commands:
        for _ in range(20):
            before = craft.roll_rad
            craft.fly(DT_S, command, 15.0, 0.0)
            assert abs(craft.roll_rad - before) <= limit_rad + 1e-12


def test_climb_and_sink_are_limited():
    craft = airborne()
    fly(craft, 10.0, climb_m_s=50.0)
    assert craft.climb_m_s == pytest.approx(craft.build.climb_max_m_s, abs=0.01)
    fly(craft, 10.0, climb_m_s=-50.0)
    assert craft.climb_m_s == pytest.approx(-craft.build.sink_max_m_s, abs=0.01)


def test_airspeed_is_reached_with_a_limited_acceleration():
    craft = airborne(speed_m_s=10.0)
    craft.fly(DT_S, 0.0, 30.0, 0.0)
    assert craft.airspeed_m_s - 10.0 <= craft.build.acceleration_max_m_s2 * DT_S + 1e-12
    fly(craft, 20.0, airspeed_m_s=30.0)
    assert craft.airspeed_m_s == pytest.approx(30.0, abs=0.01)


def test_wind_carries_the_craft():
    craft = airborne(WindVector.blowing_from(4.0, math.radians(90.0)))
    fly(craft, 10.0)
    assert craft.velocity_east_m_s == pytest.approx(-4.0)
    assert craft.velocity_north_m_s == pytest.approx(15.0)


def test_it_lifts_off_into_the_wind_with_airspeed_not_ground_speed():
    craft = SimulatedAirframe(AirframeParameters(), WindVector(0.0, -5.0))
    while not craft.flying:
        craft.roll_on_ground(DT_S, 13.0)
    assert craft.airspeed_m_s == pytest.approx(13.0, abs=0.2)
    assert craft.ground_speed_m_s == pytest.approx(8.0, abs=0.2)


def test_it_touches_down_and_stops():
    craft = airborne()
    craft.height_m = 3.0
    while craft.flying:
        craft.fly(DT_S, 0.0, 15.0, -3.0)
    assert craft.height_m == 0.0
    for _ in range(500):
        craft.roll_on_ground(DT_S, None)
    assert craft.ground_speed_m_s == 0.0


@pytest.mark.parametrize(("altitude_m", "ratio"), [(0.0, 1.0), (704.0, 1.0347), (3000.0, 1.1608)])
def test_true_airspeed_grows_as_the_standard_atmosphere_thins(altitude_m, ratio):
    assert true_over_equivalent_airspeed(altitude_m) == pytest.approx(ratio, abs=5e-4)


# A degree of latitude and of longitude on the WGS 84 ellipsoid, from published tables.
@pytest.mark.parametrize(
    ("latitude_deg", "north_m", "east_m"),
    [(0.0, 110_574.0, 111_320.0), (45.0, 111_132.0, 78_847.0), (60.0, 111_412.0, 55_800.0)],
)
def test_a_degree_has_its_tabulated_length(latitude_deg, north_m, east_m):
    plane = HomePlane(latitude_deg, 8.0)
    assert plane.east_north_m(latitude_deg + 0.001, 8.0)[1] == pytest.approx(north_m / 1000.0, rel=2e-5)
    assert plane.east_north_m(latitude_deg, 8.001)[0] == pytest.approx(east_m / 1000.0, rel=2e-5)


@settings(max_examples=100, deadline=None)
@given(st.floats(-80, 80), st.floats(-180, 180), st.floats(-5000, 5000), st.floats(-5000, 5000))
def test_plane_and_globe_agree(latitude_deg, longitude_deg, east_m, north_m):
    plane = HomePlane(latitude_deg, longitude_deg)
    there = plane.latitude_longitude_deg(east_m, north_m)
    assert -180.0 <= there[1] <= 180.0
    assert plane.east_north_m(*there) == pytest.approx((east_m, north_m), abs=1e-4)
