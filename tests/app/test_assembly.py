"""The control step is put together so that none of its steps has to wait for anything."""

from __future__ import annotations

import pickle
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app import assembly
from sidelong.app.assembly import prepared, winds_m_s, with_vehicle_fences
from sidelong.app.config import Config, load_config
from sidelong.app.errors import InputError
from sidelong.app.fleet.fleet_file import planner_in_fleet
from sidelong.app.link.stored import VehicleFences
from sidelong.app.planners import value_cache
from sidelong.app.planners.registry import planner_by_name
from sidelong.app.process import helper_command, helper_environment
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ControlAcquired, OperatorRequest
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Side, Wind
from sidelong.mission.fleet.team_planner import IN_TEAM, TeamPlanner
from sidelong.mission.predictive import planner

PLANE = LocalPlane(47.3, 8.5)


def test_each_process_of_the_first_compilation_succeeds():
    """If one fails, the flight's own process compiles that part afterwards, and nothing else shows it."""
    given = pickle.dumps((Config(), planner_by_name("predictive")))
    for part in assembly._PARTS:
        command = helper_command(assembly.__name__, part)
        subprocess.run(command, env=helper_environment(), input=given, check=True)


def test_a_change_of_side_computes_and_loads_no_table(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "no" / "such"))
    small = planner.table_configuration
    monkeypatch.setattr(
        planner, "table_configuration", lambda *known: replace(small(*known), cells=4, improvements=(1, 1))
    )
    controller = prepared(load_config(None, {"planner": {"winds_m_s": [5.0]}})).controller()
    monkeypatch.setattr(value_cache, "value_table", lambda *_: pytest.fail("a table was asked for within a step"))
    controller.step(ControlAcquired(1.0, Circle(0.0, 0.0, 50.0, True), "AUTO"))
    (announced,) = controller.step(OperatorRequest(1.0, "side", Side.RIGHT))
    assert announced.text == "operator: side right"
    assert controller.snapshot().side is Side.RIGHT


def square(east_m, north_m, half_m):
    sides = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return tuple(PLANE.latitude_longitude_deg(east_m + half_m * e, north_m + half_m * n) for e, n in sides)


def test_the_vehicles_fences_are_kept_with_the_configured_ones():
    own = {"fences": {"keep_in": [square(0, 0, 1000)], "keep_out": [square(0, 0, 10)]}}
    config, excluded = load_config(None, own), square(500, 500, 50)
    inclusions = square(800, 0, 600), square(800, 300, 600)
    for every, north_m in ((True, (-300, 600)), (False, (-600, 900))):
        both = with_vehicle_fences(config, VehicleFences(inclusions, (excluded,)), every).fences
        corners = [PLANE.east_north_m(*corner) for outline in both.keep_in for corner in outline]
        for axis, (least_m, most_m) in enumerate(((200, 1000), north_m)):
            assert min(corner[axis] for corner in corners) == pytest.approx(least_m, abs=1.0)
            assert max(corner[axis] for corner in corners) == pytest.approx(most_m, abs=1.0)
        assert both.keep_out == [list(square(0, 0, 10)), list(excluded)]
    assert with_vehicle_fences(config, VehicleFences(), True) is config
    points = square(0, 0, 1)
    assert with_vehicle_fences(config, VehicleFences(rally=points), True).fences.rally == list(points)
    assert with_vehicle_fences(config, VehicleFences(inclusions, rally=points), True).fences.rally == list(points)


@pytest.mark.parametrize(
    ("inclusion", "reason"),
    [
        ((square(5000, 0, 100),), "no area in common"),
        ((square(0, 0, 60),), "no circle of aircraft.radius_m"),
        ((square(0, 0, 60)[:2],), "has 2 corners"),
    ],
)
def test_vehicles_fences_that_leave_no_room_are_refused(inclusion, reason):
    config = load_config(None, {"fences": {"keep_in": [square(0, 0, 1000)]}})
    with pytest.raises(InputError, match=f"the vehicle's fences: .*{reason}"):
        with_vehicle_fences(config, VehicleFences(inclusion), True)


@pytest.mark.parametrize(
    ("changes", "winds"),
    [
        ({}, []),
        ({"simulation": {"wind_speed_m_s": 4.0}}, [4.0]),
        ({"link": {"url": "udpin://127.0.0.1:14540"}}, [3.75]),  # no one knows it beforehand
        ({"link": {"url": "udpin://127.0.0.1:14540"}, "planner": {"winds_m_s": [6.0]}}, [6.0]),
        ({"link": {"url": "udpin://127.0.0.1:14540"}, "requirement": {"side": "120-200"}}, []),
    ],
)
def test_a_real_vehicle_is_made_ready_for_a_likely_wind(changes, winds):
    assert winds_m_s(load_config(None, changes)) == winds


@pytest.mark.parametrize("fleet_size", [1, 2])
def test_what_flies_decides_as_what_is_studied(fleet_size):
    config = load_config(None, {"requirement": {"fleet_size": fleet_size}})
    controller, own = (
        prepared(config, kind=planner_in_fleet(config)).controller(),
        planner.USUAL if fleet_size == 1 else IN_TEAM,
    )
    aircraft, requirement = controller.settings.aircraft, controller.settings.requirement
    table = value_cache.value_table(planner.table_configuration(aircraft, requirement, 0.0, own))
    alone = planner.PredictivePlanner(aircraft, requirement, table, own)
    studied, circle = alone if fleet_size == 1 else TeamPlanner(alone), Circle(-250.0, 0.0, 50.0, True)
    assert type(controller.planning.planner) is type(studied)
    for time_s in range(30):
        course_rad = 0.3 * time_s
        state = AircraftState(
            time_s, *circle.position_at_course(course_rad), course_rad, aircraft.airspeed_m_s, circle.curvature_per_m
        )
        velocity_m_s = (2.0, 0.5) if time_s < 15 else (-2.0, 1.0)
        target = TargetEstimate(time_s, 0.0, 0.0, *velocity_m_s, 0.04 * np.eye(4), TrackQuality.GOOD, time_s)
        seen = state, target, Plan(circle), Wind(), 0.5
        flown, expected = controller.planning.decide(*seen), studied.decide(*seen)
        assert (flown.reason, flown.values) == (expected.reason, expected.values)


def test_a_side_is_refused_where_bearings_are_watched_from():
    settings = load_config(None, {"planner": {"name": "paper"}, "requirement": {"side": "120-200"}})
    controller = prepared(settings).controller()
    controller.step(ControlAcquired(1.0, Circle(0.0, 0.0, 50.0, True), "AUTO"))
    before = controller.snapshot().side
    (announced,) = controller.step(OperatorRequest(1.0, "side", Side.RIGHT))
    assert announced.text == "side refused: the mission watches from bearings"
    assert controller.snapshot().side is before
