"""Aircraft that are not ours: who counts as one, where and how high it is."""

from __future__ import annotations

import math

import pytest

from sidelong.app.link.traffic import TrafficReader
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.geometry.separation import NEAR_COLLISION_M, WELL_CLEAR_M
from tests.messages import message, position

PLANE = LocalPlane(47.0, 8.0)


def adsb(**other):
    fields = {"ICAO_address": 0xABC, "lat": 470_100_000, "lon": 80_000_000, "altitude": 800_000, "heading": 9000}
    return message("ADSB_VEHICLE", 156, **fields | {"hor_velocity": 5000, "flags": 15} | other)


def flying(system_id, component=1, **other):
    fields = {"lat": 470_000_000, "lon": 80_100_000, "alt": 600_000, "vx": 0, "vy": 2000}
    return position(system=system_id, component=component, **fields | other)


@pytest.fixture
def received():
    clock = [100.0]
    return TrafficReader(PLANE, 500.0, {1, 2}, lambda: clock[0]), clock


def test_an_aircraft_by_adsb_is_placed_above_our_home(received):
    announced = received[0].report(adsb())
    assert announced.name == "ADS-B 000ABC"
    assert (announced.state.east_m, announced.state.north_m) == pytest.approx((0.0, 1111.7), abs=2.0)
    assert announced.height_m == 300.0
    assert (announced.state.course_rad, announced.state.ground_speed_m_s) == pytest.approx((math.pi / 2, 50.0))


def test_another_system_is_foreign_and_one_of_the_fleet_is_not(received):
    announced = received[0].report(flying(7))
    assert announced.name == "system 7"
    assert (announced.height_m, announced.state.ground_speed_m_s) == (100.0, 20.0)
    assert announced.state.course_rad == pytest.approx(math.pi / 2)
    assert received[0].report(flying(2)) is None
    assert received[0].report(flying(8, component=154)) is None


def test_aircraft_of_the_fleet_is_foreign_once_it_was_yielded(received):
    foreign, clock = received
    announced = foreign.report(flying(2), "south")
    assert (announced.name, announced.height_m, announced.clear_m) == ("south", 100.0, (0.0, 0.0))
    clock[0] += 2.0
    assert foreign.report(adsb(), "south") is None  # that is another aircraft
    assert foreign.report(flying(7)).clear_m == NEAR_COLLISION_M


def test_each_is_reported_once_a_second(received):
    foreign, clock = received
    assert foreign.report(adsb()) is not None
    assert foreign.report(adsb()) is None
    assert foreign.report(adsb(ICAO_address=1)) is not None
    clock[0] += 1.0
    assert foreign.report(adsb()) is not None


@pytest.mark.parametrize(
    "message",
    [adsb(flags=13), adsb(flags=14), adsb(lat=0, lon=0), adsb(lat=500_000_000), flying(7, lat=0, lon=0)],
    ids=["no altitude", "no place", "null island", "far away", "no fix"],
)
def test_what_reports_no_place_near_us_is_passed_over(received, message):
    assert received[0].report(message) is None


def test_an_unknown_course_is_an_aircraft_that_stands(received):
    assert received[0].report(adsb(flags=3)).state.ground_speed_m_s == 0.0
    assert received[0].report(adsb(ICAO_address=5, heading=65535)).state.ground_speed_m_s == 0.0


def remote_id(**other):
    fields = {"id_or_mac": [1, 2, 3] + [0] * 17, "status": 2, "latitude": 470_100_000, "longitude": 80_000_000}
    fields |= {"altitude_geodetic": 650.0, "direction": 9000, "speed_horizontal": 1500, "speed_vertical": 0}
    return message("OPEN_DRONE_ID_LOCATION", 236, **fields | other)


def test_an_aircraft_by_remote_id_is_placed_above_the_sea(received):
    foreign, _ = received
    assert foreign.report(message("GPS_RAW_INT", 1, alt=500_000, alt_ellipsoid=550_000)) is None
    found = foreign.report(remote_id())
    assert (found.name, found.height_m, found.clear_m) == ("Remote ID 010203", 100.0, NEAR_COLLISION_M)
    assert (found.state.course_rad, found.state.ground_speed_m_s) == pytest.approx((math.pi / 2, 15.0))


@pytest.mark.parametrize(
    "message", [remote_id(id_or_mac=[0] * 20), remote_id(status=1), remote_id(altitude_geodetic=-1000.0)]
)
def test_the_own_remote_id_and_what_is_on_the_ground_are_no_traffic(received, message):
    assert received[0].report(message) is None


def test_the_turn_of_an_aircraft_is_estimated(received):
    foreign, clock = received
    for second in range(12):
        clock[0] = 100.0 + second
        found = foreign.report(adsb(heading=9000 + 300 * second))
    assert found.clear_m == WELL_CLEAR_M
    assert found.state.curvature_per_m * found.state.ground_speed_m_s == pytest.approx(math.radians(3.0), rel=0.05)


def test_the_beacon_of_the_target_is_no_traffic():
    assert TrafficReader(PLANE, 500.0, {1}, lambda: 100.0, _ignored=("ADS-B 000ABC",)).report(adsb()) is None


def test_the_own_transponder_is_no_traffic():
    east_m, north_m = PLANE.east_north_m(47.01, 8.0)
    own = AircraftState(100.0, east_m + 20.0, north_m, math.pi / 2, 48.0, 0.0)
    reader = TrafficReader(PLANE, 500.0, {1}, lambda: 100.0, lambda: (own, 310.0))
    assert reader.report(adsb()) is None
    assert reader.report(adsb(heading=0)) is not None
