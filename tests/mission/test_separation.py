"""Foreign aircraft: the closest approach along a plan, and which plans are refused."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.fleet import Neighbour
from sidelong.mission.core.plan import AircraftState, Flown, HeightProfile, Plan
from sidelong.mission.geometry.separation import NEAR_COLLISION_M, WELL_CLEAR_M, Separation, closest_of

CIRCLE = Plan(Circle(0.0, 0.0, 50.0, True))
OWN = AircraftState(100.0, 0.0, 50.0, math.pi / 2, 15.0, 0.0)
FLOWN = Flown(OWN, 100.0, CIRCLE, airspeed_m_s=15.0)


def coming(east_m=0.0, away_m=2400.0, height_m=100.0, speed_m_s=40.0, **more):
    """Return an aircraft that flies north, from so far south."""
    state = AircraftState(100.0, east_m, -away_m, 0.0, speed_m_s, more.pop("curvature_per_m", 0.0))
    return Neighbour("ADS-B ABCDEF", state, height_m, False, clear_m=WELL_CLEAR_M, **more)


def separation(*others):
    found = Separation()
    found.note(others)
    return found


def test_the_closest_approach_is_predicted_from_the_plan():
    found = closest_of(separation(coming(east_m=300.0, height_m=120.0)).encounters(FLOWN, None))
    assert found.in_s == pytest.approx(60.0, abs=5.0)
    assert 240.0 < found.horizontal_m < 310.0
    assert (found.vertical_m, found.height_m) == (20.0, 120.0)
    assert found.share < 1.0
    assert "not well clear: ADS-B ABCDEF comes within" in str(found)


@pytest.mark.parametrize(
    "other",
    [
        coming(east_m=700.0),
        coming(height_m=180.0),
        coming(away_m=-400.0, east_m=650.0),  # it flies away
        coming(climb_m_s=2.0),  # 120 m higher by then
        coming(curvature_per_m=1.0 / 800.0),  # it turns away
    ],
)
def test_traffic_that_passes_clear_is_no_encounter(other):
    assert closest_of(separation(other).encounters(FLOWN, None)).share >= 1.0


def test_an_old_report_predicts_nothing():
    late = FLOWN._replace(aircraft=replace(OWN, time_s=130.0))
    assert closest_of(separation(coming()).encounters(late, None)) is None


def test_a_plan_to_another_height_keeps_clear():
    near = separation(coming())
    climbing = Plan(CIRCLE.circle, None, 100.0, HeightProfile(100.0, 190.0, 2.5 / 15.0))
    assert closest_of(near.encounters(FLOWN, None)).share < 0.5
    assert closest_of(near.encounters(FLOWN, climbing)).share >= 1.0


def test_a_foreign_aircraft_is_kept_clear_of():
    near = separation(coming(east_m=800.0))
    there = Plan(Circle(500.0, 0.0, 50.0, True), None, 100.0)
    assert "comes within" in near.breach(there, FLOWN)
    away = Plan(Circle(-300.0, 0.0, 50.0, True), None, 100.0)
    assert near.breach(away, FLOWN) is None


def test_a_plan_that_makes_an_encounter_no_worse_is_allowed():
    near = separation(coming(east_m=200.0))
    assert near.breach(Plan(Circle(-150.0, 0.0, 50.0, True), None, 100.0), FLOWN) is None


def test_an_unmanned_aircraft_may_come_nearer_than_a_manned_one():
    state = coming(east_m=300.0).state
    other = Neighbour("system 7", state, 100.0, False, clear_m=NEAR_COLLISION_M)
    assert closest_of(separation(other).encounters(FLOWN, None)).share >= 1.0
