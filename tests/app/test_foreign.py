"""Aircraft that are not ours: who counts as one, where and how high it is."""

from __future__ import annotations

import math

import pytest

from sidelong.app.fleet.flight import ForeignAircraft
from sidelong.estimators.frames import LocalPlane
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
    return ForeignAircraft(PLANE, 500.0, {1, 2}, lambda: clock[0]), clock


def test_an_aircraft_by_adsb_is_placed_above_our_home(received):
    announced = received[0].report(adsb())
    assert announced.identity == "ADS-B 000ABC"
    assert (announced.east_m, announced.north_m) == pytest.approx((0.0, 1111.7), abs=2.0)
    assert announced.height_m == 300.0
    assert (announced.course_rad, announced.speed_m_s) == pytest.approx((math.pi / 2, 50.0))


def test_another_system_is_foreign_and_one_of_the_fleet_is_not(received):
    announced = received[0].report(flying(7))
    assert announced.identity == "system 7"
    assert (announced.height_m, announced.speed_m_s) == (100.0, 20.0)
    assert announced.course_rad == pytest.approx(math.pi / 2)
    assert received[0].report(flying(2)) is None
    assert received[0].report(flying(8, component=154)) is None


def test_aircraft_of_the_fleet_is_foreign_once_it_was_yielded(received):
    foreign, clock = received
    announced = foreign.report(flying(2), "south")
    assert (announced.identity, announced.height_m, announced.member) == ("south", 100.0, True)
    clock[0] += 2.0
    assert foreign.report(adsb(), "south") is None  # that is another aircraft
    assert not foreign.report(flying(7)).member


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
    assert received[0].report(adsb(flags=3)).speed_m_s == 0.0
    assert received[0].report(adsb(ICAO_address=5, heading=65535)).speed_m_s == 0.0
