"""Studies in the closed loop: the whole core flies a vehicle of the simulator."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from sidelong.app.commands.study import study
from sidelong.app.study import closed_loop
from sidelong.app.study.closed_loop import run
from sidelong.app.study.scene import scene
from sidelong.app.study.settings import (
    PAPER,
    PARTS,
    PREDICTIVE,
    StudySettings,
    studied,
)
from sidelong.app.study.study import table_of
from sidelong.mission.route.route import route_of

SETTINGS = StudySettings((PAPER,), runs=1, duration_s=400.0, config=studied(target_speed_max_m_s=4.0))


@pytest.fixture
def command():
    app = typer.Typer()
    app.command()(study)
    return lambda *words: CliRunner().invoke(app, words)


@pytest.mark.parametrize("autopilot", ["arduplane", "px4"])
def test_a_run_watches_its_target_by_the_plans_that_it_uploads(autopilot):
    found = run(replace(SETTINGS, autopilot=autopilot), PAPER, 0, None, keep_track=True)
    target = scene(SETTINGS, 0).target.at(200.0)
    assert found.duration_s == pytest.approx(400.0, abs=0.3)
    assert tuple(found.track.target_m[2000]) == pytest.approx((target.east_m, target.north_m), abs=1.0)
    assert found.moves_per_hour > 0.0
    assert found.time_in_band > 0.9
    assert found.time_on_side > 0.6


def test_the_start_and_the_noise_do_not_depend_on_the_planner():
    settings = replace(SETTINGS, duration_s=60.0)
    found = [run(settings, planner, 0, table_of(settings), keep_track=True).track for planner in (PAPER, PREDICTIVE)]
    np.testing.assert_array_equal(found[0].target_m, found[1].target_m)
    np.testing.assert_array_equal(found[0].aircraft_m[:20], found[1].aircraft_m[:20])


def test_the_planner_knows_the_route_of_a_run(monkeypatch):
    """A route far from the target is followed by the planner, and changes nothing while the target is not on it."""
    settings, made = replace(SETTINGS, duration_s=30.0), []
    route = route_of(np.array([0.0, 500.0]), np.array([2000.0, 2000.0]))
    monkeypatch.setattr(closed_loop, "scene", lambda *of: replace(scene(*of), route=route))
    follow = closed_loop.PredictivePlanner.follow
    monkeypatch.setattr(
        closed_loop.PredictivePlanner, "follow", lambda self, *of: (made.append(of[0]), follow(self, *of))
    )
    run(settings, PREDICTIVE, 0, table_of(settings))
    assert [one.length_m for one in made] == [pytest.approx(500.0)]


@pytest.mark.parametrize("wind_m_s", [0.0, 3.0])
def test_a_laser_without_errors_brings_the_aircraft_no_farther_from_its_target(wind_m_s):
    config = studied(target_speed_max_m_s=4.0, wind_speed_m_s=wind_m_s, radius_m=50.0 if not wind_m_s else 84.5)
    found = run(replace(SETTINGS, config=config, perfect_sensors=True), PAPER, 0, None, keep_track=True)
    range_m = np.hypot(*(found.track.aircraft_m - found.track.target_m).T)
    assert found.min_range_m == pytest.approx(range_m.min())
    assert math.isnan(found.min_clearance_m)
    assert found.time_in_band > 0.9


def test_a_run_in_gusts_is_repeated_and_differs_from_one_in_calm_air():
    gusty, calm = (studied(target_speed_max_m_s=4.0, turbulence=level) for level in ("moderate", "none"))
    paths_m = [
        run(replace(SETTINGS, config=one, duration_s=60.0), PAPER, 0, None, keep_track=True).track.aircraft_m
        for one in (gusty, gusty, calm)
    ]
    np.testing.assert_array_equal(paths_m[0], paths_m[1])
    assert 1.0 < np.hypot(*(paths_m[0] - paths_m[2]).T).max() < 100.0


def test_a_report_names_its_parts(command, tmp_path):
    summary, page = tmp_path / "study.json", tmp_path / "study.html"
    words = ("--planner", "paper", "--runs", "2", "--duration", "60", "--jobs", "1")
    result = command(*words, "--json", str(summary), "--report", str(page))
    assert result.exit_code == 0, result.output
    assert json.loads(summary.read_text())["parts"] == PARTS
    for text in (" ".join(result.output.split()), page.read_text()):
        assert f"closed loop, arduplane: {PARTS}" in text
