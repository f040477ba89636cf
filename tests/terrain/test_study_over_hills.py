from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from sidelong.app.cli import app
from sidelong.app.errors import InputError
from sidelong.app.study.closed_loop import hills_of, run
from sidelong.app.study.settings import (
    PREDICTIVE,
    StudySettings,
    studied,
)
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.predictive.planner import table_configuration
from sidelong.mission.predictive.value_table import compute

SETTINGS = StudySettings((PREDICTIVE,), runs=2, duration_s=60.0)


@pytest.fixture(scope="module")
def table():
    configuration = table_configuration(SETTINGS.aircraft(), SETTINGS.requirement())
    return compute(replace(configuration, cells=20, improvements=(5, 3)))


def test_over_hills_the_clearance_is_kept_and_on_flat_ground_nothing_is_hidden(ground: Ground, table) -> None:
    for number in range(2):
        flown = run(replace(SETTINGS, hills=hills_of(ground)), PREDICTIVE, number, table)
        assert flown.min_clearance_m >= 45.0  # the kinematic aircraft flies some metres next to its line
        assert flown.time_in_sight <= flown.time_in_sight_where_possible <= 1.0
    flat = replace(ground, heights_m=np.zeros_like(ground.heights_m))
    flown = run(replace(SETTINGS, hills=hills_of(flat)), PREDICTIVE, 0, table)
    assert flown.time_in_sight == 1.0
    assert flown.min_clearance_m == pytest.approx(100.0)
    assert flown.time_in_band == 1.0


def test_known_hills_are_cleared_higher_than_ignored_ones(ground: Ground, table) -> None:
    settings = replace(SETTINGS, runs=20, hills=hills_of(ground), config=studied(height_m=60.0), duration_s=200.0)
    known, ignored = (
        [run(replace(settings, terrain=one), PREDICTIVE, number, table) for number in (5, 9)]
        for one in ("known", "ignored")
    )
    assert min(one.min_clearance_m for one in known) >= 45.0
    assert min(one.min_clearance_m for one in ignored) < 45.0
    assert min(one.time_in_sight for one in ignored) < 0.98  # the track waited for its target


def test_what_hills_hide_is_not_measured(ground: Ground, table) -> None:
    """Ground that rises above the aircraft everywhere but under the target's start: never in sight, no estimate."""
    pit = np.full_like(ground.heights_m, 3000.0)
    east, north = (np.arange(n) for n in pit.shape[::-1])
    about = (np.abs(ground.west_m + east * ground.step_east_m) < 9000.0)[None, :] & (
        np.abs(ground.south_m + north * ground.step_north_m) < 9000.0
    )[:, None]
    rng = np.random.default_rng(3)
    walls = np.where(about & (rng.random(pit.shape) < 0.5), 500.0, 0.0).astype(np.float32)
    walled = hills_of(replace(ground, heights_m=walls))
    flown = run(replace(SETTINGS, hills=walled, terrain="ignored"), PREDICTIVE, 1, table)
    assert flown.time_in_sight < 0.3
    assert flown.moves_per_hour < 60.0


def _at(home: str = "[36.59,-84.24]") -> tuple[str, str]:
    return "--set", f"simulation.home={home}"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "give --set simulation.home=[LAT,LON]"),
        ([*_at("a,b")], "simulation.home"),
        ([*_at("[95,8]")], "simulation.home"),
        ([*_at("[47.4,8.5]")], "N47E008"),
        ([*_at(), "--planner", "paper"], "the default planner"),
        ([*_at(), "--fleet", "2"], "one aircraft"),
        ([*_at(), "--sweep", "requirement.side=left,either"], "from one side"),
        ([*_at(), "--sweep", "study.terrain=foggy"], "known or ignored"),
    ],
)
def test_wrong_options_are_one_sentence(hills_folder: Path, options: list[str], words: str) -> None:
    result = CliRunner().invoke(app, ["study", "--terrain", str(hills_folder), *options])
    assert isinstance(result.exception, InputError)
    assert words in str(result.exception)


def test_a_study_over_hills_is_kept_and_goes_on_and_reports_both_ways(hills_folder: Path, tmp_path: Path) -> None:
    summary, store, report, rows = (tmp_path / name for name in ("hills.json", "hills.db", "hills.html", "hills.csv"))
    arguments = ["study", "--terrain", str(hills_folder), *_at(), "--runs", "1", "--duration", "30"]
    arguments += ["--jobs", "1", "--json", str(summary), "--store", str(store)]
    result = CliRunner().invoke(app, [*arguments, "--sweep", "study.terrain=known"])
    assert result.exit_code == 0, result.output
    assert "least height over ground" in result.output
    given = json.loads(summary.read_text())["planners"]["predictive"]
    assert 0.0 <= given["time_in_sight"]["mean"] <= 1.0
    result = CliRunner().invoke(app, [*arguments, "--report", str(report), "--export", str(rows)])
    assert result.exit_code == 0, result.output
    assert "1 of 2 runs are in" in result.output
    known, ignored = json.loads(summary.read_text())["designs"]
    assert (known["swept"], ignored["swept"]) == ({"study.terrain": "known"}, {"study.terrain": "ignored"})
    assert known["planners"]["predictive"] == given
    assert math.isfinite(ignored["planners"]["predictive"]["min_clearance_m"]["worst"])
    assert "time_in_sight" in rows.read_text().splitlines()[0]
    page = report.read_text()  # one run of each spreads over nothing, so the table states all
    assert "<th>in sight, %</th>" in page
    for terrain, design in (("known", known), ("ignored", ignored)):
        sight = design["planners"]["predictive"]["time_in_sight"]
        (row,) = re.findall(f"<tr><td>{terrain}</td><td>predictive</td>.*?</tr>", page)
        assert f"<td>{100.0 * sight['mean']:.1f}/{100.0 * sight['worst']:.1f}</td>" in row


def test_a_sweep_of_the_terrain_needs_one() -> None:
    result = CliRunner().invoke(app, ["study", "--sweep", "study.terrain=ignored"])
    assert isinstance(result.exception, InputError)
    assert "--terrain" in str(result.exception)
