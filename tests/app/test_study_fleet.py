"""Studies with two aircraft on each target."""

from __future__ import annotations

import json
import math

import pytest

from app.study.fleet import run_fleet
from app.study.fleet_study import FleetStudy, fleet_json
from app.study.settings import PlannerName, StudySettings
from app.value_cache import value_table
from mission.predictive.planner import table_configuration


@pytest.fixture(scope="module")
def study() -> FleetStudy:
    settings = StudySettings(
        planners=(PlannerName.PREDICTIVE,),
        runs=2,
        duration_s=240.0,
        legs_s=(30.0, 60.0),
        perfect_sensors=True,
        fleet=2,
    )
    table = value_table(table_configuration(settings.aircraft(), settings.requirement()))
    return FleetStudy(settings, tuple(run_fleet(settings, number, table) for number in settings.numbers))


def test_at_least_one_sees_as_much_as_the_better_one_alone(study):
    for run in study.runs:
        assert run.time_on_side_any >= max(one.time_on_side for one in run.aircraft) - 1e-9
        assert run.time_in_band_any >= 0.99


def test_they_keep_apart_by_their_heights_at_least(study):
    assert min(run.min_separation_m for run in study.runs) >= study.settings.layer_m


def test_the_same_run_again_is_the_same(study):
    table = value_table(table_configuration(study.settings.aircraft(), study.settings.requirement()))
    again = run_fleet(study.settings, 1, table)
    assert again.time_on_side_any == study.runs[1].time_on_side_any
    assert again.min_separation_m == study.runs[1].min_separation_m


def test_the_summary_has_its_keys_and_is_json(study):
    told = json.loads(json.dumps(fleet_json(study), allow_nan=False))
    figures = told["planners"]["predictive"]
    for key in ("time_on_side_any", "time_in_band_any", "min_separation_m"):
        assert figures[key].keys() >= {"mean", "worst"}
    assert len(figures["aircraft"]) == 2
    assert math.isfinite(figures["aircraft"][1]["time_in_band"]["worst"])
