from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli import app
from app.errors import InputError
from app.study.hills import HillSettings, fly_over
from app.study.settings import PlannerName, StudySettings
from estimators.terrain.ground import Ground
from mission.predictive.planner import table_configuration
from mission.predictive.value_iteration import compute

SETTINGS = StudySettings((PlannerName.PREDICTIVE,), runs=2, duration_s=60.0)


@pytest.fixture(scope="module")
def table():
    configuration = table_configuration(SETTINGS.aircraft(), SETTINGS.requirement())
    return compute(replace(configuration, cells=20, improvements=(5, 3)))


def test_over_hills_the_clearance_is_kept_and_on_flat_ground_nothing_is_hidden(ground: Ground, table) -> None:
    for number in range(2):
        flown = fly_over(HillSettings(SETTINGS, ground), number, table, known=True)
        assert flown.min_clearance_m >= 45.0  # the kinematic aircraft flies some metres beside its line
        assert flown.time_in_sight <= flown.time_in_sight_where_possible <= 1.0
    flat = replace(ground, heights_m=np.zeros_like(ground.heights_m))
    flown = fly_over(HillSettings(SETTINGS, flat), 0, table, known=True)
    assert flown.time_in_sight == 1.0
    assert flown.min_clearance_m == pytest.approx(100.0)
    assert flown.result.time_in_band == 1.0


def test_what_hills_hide_is_not_measured(ground: Ground, table) -> None:
    """Ground that rises above the aircraft everywhere but under the target's start: never in sight, no estimate."""
    pit = np.full_like(ground.heights_m, 3000.0)
    east, north = (np.arange(n) for n in pit.shape[::-1])
    about = (np.abs(ground.west_m + east * ground.step_m) < 9000.0)[None, :] & (
        np.abs(ground.south_m + north * ground.step_m) < 9000.0
    )[:, None]
    rng = np.random.default_rng(3)
    walls = np.where(about & (rng.random(pit.shape) < 0.5), 500.0, 0.0).astype(np.float32)
    flown = fly_over(HillSettings(SETTINGS, replace(ground, heights_m=walls)), 1, table, known=False)
    assert flown.time_in_sight < 0.3
    assert flown.result.moves_per_hour < 60.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "give --home LAT,LON"),
        (["--home", "a,b"], "--home"),
        (["--home", "95,8"], "latitudes go to 89"),
        (["--home", "47.4,8.5"], "N47E008"),
        (["--home", "36.59,-84.24", "--sweep", "aircraft.airspeed_m_s=10,12"], "one design"),
    ],
)
def test_wrong_options_are_one_sentence(hills_folder: Path, options: list[str], words: str) -> None:
    result = CliRunner().invoke(app, ["study", "--terrain", str(hills_folder), *options])
    assert isinstance(result.exception, InputError)
    assert words in str(result.exception)


def test_the_command_tells_both_ways(hills_folder: Path, tmp_path: Path) -> None:
    summary = tmp_path / "hills.json"
    arguments = ["study", "--terrain", str(hills_folder), "--home", "36.59,-84.24", "--runs", "1", "--duration", "30"]
    result = CliRunner().invoke(app, [*arguments, "--jobs", "1", "--json", str(summary)])
    assert result.exit_code == 0, result.output
    told = json.loads(summary.read_text())
    assert set(told) == {"over_known_ground", "as_if_it_were_flat"}
    for way in told.values():
        assert 0.0 <= way["time_in_sight"]["mean"] <= 1.0
        assert math.isfinite(way["min_clearance_m"]["worst"])
    assert "least height over ground" in result.output
