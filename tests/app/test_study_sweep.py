import csv
import json
import math
import signal
import sqlite3
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from sidelong.app.commands.study import study
from sidelong.app.config import load_config
from sidelong.app.errors import InputError
from sidelong.app.study.settings import (
    LVFG,
    PAPER,
    Design,
    StudySettings,
    configured,
    designs,
    parsed_sweep,
)
from sidelong.app.study.study import MEASURES, ResultStore, Study, on_processes, run_ids
from tests.studies import run_study

SMALL = StudySettings((LVFG,), runs=4, perfect_sensors=True, duration_s=20.0)
QUICK = ("--planner", "lvfg", "--runs", "3", "--duration", "30", "--set", "study.perfect_sensors=true", "--jobs", "1")


@pytest.fixture
def command():
    app = typer.Typer()
    app.command()(study)
    return lambda *words: CliRunner().invoke(app, words)


def rows(file):
    with sqlite3.connect(file) as db:
        return sorted(db.execute(f"SELECT key, planner, target, draw, {', '.join(MEASURES)} FROM runs"))


@pytest.mark.parametrize(
    ("words", "values"),
    [
        ("aircraft.airspeed_m_s=12,15,18", (12.0, 15.0, 18.0)),
        ("requirement.range_max_m=300:600:50", (300.0, 350.0, 400.0, 450.0, 500.0, 550.0, 600.0)),
        ("sensors.angle_sigma_deg=0.1:0.3:0.1", (0.1, 0.2, 0.3)),
        ("requirement.side=left,right,120-200", ("left", "right", "120-200")),
    ],
)
def test_a_sweep_names_its_values(words, values):
    assert parsed_sweep(words) == (words.partition("=")[0], values)


def test_every_combination_is_a_design():
    sweeps = [parsed_sweep("aircraft.airspeed_m_s=12,15"), parsed_sweep("simulation.wind_speed_m_s=0,3")]
    found = designs(StudySettings(), {"aircraft": {"radius_m": 60.0}}, sweeps)
    assert [str(one) for one in found] == [
        f"aircraft.airspeed_m_s={v}, simulation.wind_speed_m_s={w}" for v in (12, 15) for w in (0, 3)
    ]
    assert [one.settings.aircraft().radius_m for one in found] == pytest.approx([60.0] * 4)
    assert found[3].settings.wind.east_m_s == 3.0
    assert found[3].settings.requirement().target_speed_max_m_s == 7.5


def test_every_parameter_that_shapes_a_study_reaches_it():
    swept = {
        "aircraft.bank_max_deg": 30.0,
        "aircraft.roll_rate_max_deg_s": 10.0,
        "requirement.range_min_m": 120.0,
        "requirement.threshold": 0.8,
        "sensors.range_sigma_m": 3.0,
        "study.lag_s": 0.5,
    }
    (found,) = designs(StudySettings(), {}, [parsed_sweep(f"{key}={value}") for key, value in swept.items()])
    s = found.settings
    assert (s.aircraft().bank_max_rad, s.aircraft().roll_rate_max_rad_s) == pytest.approx(
        (math.radians(30.0), math.radians(10.0))
    )
    assert (s.requirement().range_min_m, s.requirement().threshold) == (120.0, 0.8)
    assert (s.config.sensors.range_sigma_m, s.lag_s) == (3.0, 0.5)


def test_a_radius_that_fits_is_found_for_each_value_that_is_swept(tmp_path):
    file = tmp_path / "mission.toml"
    file.write_text("[aircraft]\nradius_m = 'auto'\n")
    found = designs(StudySettings(), configured(load_config(file)), [parsed_sweep("aircraft.airspeed_m_s=12,30")])
    assert [one.settings.aircraft().radius_m for one in found] == pytest.approx([42.0, 105.0])


def test_what_cannot_be_flown_is_passed_over_and_reported():
    given = []
    (found,) = designs(StudySettings(), {}, [parsed_sweep("aircraft.radius_m=50,300")], given.append)
    assert found.settings.aircraft().radius_m == pytest.approx(50.0)
    assert len(given) == 1 and "radius_m=300" in given[0] and "does not fit" in given[0]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--sweep", "aircraft.airspeed_m_s"), "KEY=V1,V2"),
        (("--sweep", "aircraft.speed=1"), "aircraft.airspeed_m_s"),
        (("--sweep", "link.url=a"), "no parameter that shapes a study"),
        (("--sweep", "aircraft.airspeed_m_s=5:1:1"), "no values"),
        (("--sweep", "aircraft.airspeed_m_s=5:9:0"), "no values"),
        (("--sweep", "aircraft.airspeed_m_s=5:9:0.0001"), "values; give a larger STEP"),
        (("--sweep", "aircraft.radius_m=1:2"), "FROM:TO:STEP is like"),
        (("--sweep", "aircraft.airspeed_m_s=fast"), "aircraft.airspeed_m_s"),
        (("--sweep", "aircraft.radius_m=300"), "radius_m"),
        (("--set", "study.lag_s=nan"), "study.lag_s"),
        (("--autopilot", "inav"), "--autopilot: there is no simulated 'inav'; give arduplane or px4"),
        (("--run", "20"), "--run"),
        (("--export", "a.xlsx"), "--export"),
        (("--report", "a.pdf"), "--report"),
        (("--store", "nowhere/a.db"), "nowhere"),
        (("--store", __file__), "--store"),
    ],
)
def test_wrong_input_is_one_sentence(command, words, named):
    result = command(*words)
    assert isinstance(result.exception, InputError)
    assert named in str(result.exception)
    assert "\n" not in str(result.exception)


def test_a_configuration_is_studied_as_it_would_be_flown(command, tmp_path):
    file, summary = tmp_path / "mission.toml", tmp_path / "study.json"
    file.write_text("[aircraft]\nairspeed_m_s = 18\nradius_m = 80\n[requirement]\nside = 'right'\n")
    assert command(str(file), *QUICK, "--json", str(summary)).exit_code == 0
    settings = replace(SMALL, runs=3, duration_s=30.0, config=load_config(file))
    expected = run_study(settings, None, jobs=1).planners[LVFG]
    given = json.loads(summary.read_text())["planners"]["lvfg"]
    assert given["min_range_m"]["worst"] == expected["min_range_m"].min()
    assert given["time_on_side"]["mean"] == pytest.approx(expected["time_on_side"].mean())


def test_an_autopilot_stands_for_its_lag(command, tmp_path):
    def given(*words):
        summary = tmp_path / "study.json"
        assert command("--planner", "paper", *QUICK[2:], *words, "--json", str(summary)).exit_code == 0
        return json.loads(summary.read_text())["planners"]["paper"]["max_range_m"]

    assert given("--autopilot", "arduplane") == given("--set", "study.lag_s=0.45") == given()
    assert given("--autopilot", "px4") == given("--autopilot", "px4", "--set", "study.lag_s=0.43") != given()


def test_autopilot_and_lag_shape_a_flight():
    settings = replace(SMALL, planners=(PAPER,), runs=1, duration_s=300.0)
    found = [
        run_study(one, None, jobs=1).planners[PAPER]
        for one in (settings, replace(settings, autopilot="px4"), replace(settings, lag_s=1.0))
    ]
    assert found[0]["moves_per_hour"].max() > 0.0
    assert not np.array_equal(found[0]["max_range_m"], found[1]["max_range_m"])
    assert not np.array_equal(found[0]["max_range_m"], found[2]["max_range_m"])


def test_what_is_stored_is_not_flown_again(tmp_path):
    file = tmp_path / "study.db"
    flown = []

    def counted(store, settings):
        study = Study([Design(settings)], store)
        study.fly(on_processes(1), lambda _settings: None, 2, flown.append)
        return study.results()[0]

    first = ResultStore(file)
    counted(first, SMALL)
    first.close()
    assert flown == [2, 2]
    again = ResultStore(file)
    result = counted(again, replace(SMALL, runs=5))
    assert flown == [2, 2, 1]
    counted(again, replace(SMALL, runs=5, lag_s=1.0))
    assert flown == [2, 2, 1, 2, 2, 1]
    expected = run_study(replace(SMALL, runs=5), None, jobs=1).planners[LVFG]
    for name in MEASURES:
        np.testing.assert_array_equal(result.planners[LVFG][name], expected[name])


def test_a_study_that_fails_keeps_what_was_flown(tmp_path):
    kept = []

    def interrupted(runs):
        kept.append(runs)
        if len(kept) == 2:
            raise KeyboardInterrupt

    store = ResultStore(tmp_path / "study.db")
    study = Study([Design(SMALL)], store)
    with pytest.raises(KeyboardInterrupt):
        study.fly(on_processes(1), lambda _settings: None, 1, interrupted)
    assert study.missing() == 2
    study.fly(on_processes(1), lambda _settings: None, 1, lambda _runs: None)
    assert study.missing() == 0


def test_other_code_is_another_result(monkeypatch):
    own = next(run_ids(SMALL, LVFG))
    monkeypatch.setattr("sidelong.app.study.study.code_version", lambda: "other")
    assert next(run_ids(SMALL, LVFG)).key != own.key


KILLED_AFTER_TWO = """
import os, signal
from sidelong.app.cli import main
from sidelong.app.study.study import ResultStore
add, left = ResultStore.add, [1, 1]
def add_and_die(*arguments):
    add(*arguments)
    left.pop()
    if not left:
        os.kill(os.getpid(), signal.SIGKILL)
ResultStore.add = add_and_die
main()
"""


def test_a_killed_study_goes_on_where_it_stopped(tmp_path):
    file = tmp_path / "study.db"
    words = [
        "--planner",
        "lvfg",
        "--runs",
        "60",
        "--duration",
        "60",
        "--set",
        "study.perfect_sensors=true",
        "--store",
        str(file),
    ]
    command = [sys.executable, "-c", KILLED_AFTER_TWO, "study", *words, "--jobs", "2"]
    assert subprocess.run(command, timeout=120.0, check=False).returncode == -signal.SIGKILL
    before = rows(file)
    assert 2 <= len(before) < 60
    settings = StudySettings((LVFG,), runs=60, perfect_sensors=True, duration_s=60.0)
    store, whole = ResultStore(file), ResultStore(tmp_path / "whole.db")
    resumed, study = Study([Design(settings)], store), Study([Design(settings)], whole)
    flown = []
    resumed.fly(on_processes(1), lambda _settings: None, 5, flown.append)
    assert sum(flown) == 60 - len(before)
    study.fly(on_processes(1), lambda _settings: None, 5, lambda _runs: None)
    assert rows(file) == rows(tmp_path / "whole.db")
    assert set(before) <= set(rows(file))


def test_a_sweep_is_reported_exported_and_shown(command, tmp_path):
    summary, table, page = tmp_path / "study.json", tmp_path / "runs.csv", tmp_path / "study.html"
    words = (
        *("--sweep", "aircraft.airspeed_m_s=10,12", "--sweep", "requirement.range_max_m=400,500"),
        *("--store", str(tmp_path / "study.db"), *QUICK),
    )
    result = command(*words, "--json", str(summary), "--export", str(table), "--report", str(page))
    assert result.exit_code == 0, result.output
    assert all(heading in result.output for heading in ("airspeed_m_s", "range_max_m", "least, m", "reversals/h"))
    given = json.loads(summary.read_text())
    assert [design["swept"] for design in given["designs"]] == [
        {"aircraft.airspeed_m_s": v, "requirement.range_max_m": r} for v in (10.0, 12.0) for r in (400.0, 500.0)
    ]
    assert given["simulated_s"] == 4 * 3 * 30.0
    with table.open(newline="") as file:
        read = list(csv.DictReader(file))
    assert len(read) == 12
    fastest = [float(row["time_on_side"]) for row in read if row["aircraft.airspeed_m_s"] == "12.0"][:3]
    assert np.mean(fastest) == pytest.approx(given["designs"][2]["planners"]["lvfg"]["time_on_side"]["mean"])
    text = page.read_text()
    assert "http" not in text.replace("http-equiv", "").replace("http://www.w3.org/2000/svg", "")  # a name
    for name in ("map-0-lvfg", "worst-0"):
        assert f'id="{name}"' in text
    assert 'id="spread-0"' not in text  # three runs have no distribution
    shown = text.partition("<code>")[2].partition("</code>")[0]
    assert "--sweep aircraft.airspeed_m_s=10,12 --sweep requirement.range_max_m=400,500" in shown
    again = command(*words, "--export", str(tmp_path / "runs.csv"))
    assert "12 of 12 runs are in" in " ".join(again.output.split())
    assert (tmp_path / "runs.csv").read_bytes() == table.read_bytes()


def test_the_page_reports_the_command_that_flies_a_run_again(command, tmp_path):
    page, own_page = tmp_path / "study.html", tmp_path / "run.html"
    assert command(*QUICK, "--seed", "3", "--report", str(page)).exit_code == 0
    again = [
        line.partition("</code>")[0] for line in page.read_text().split("<code>sidelong study ") if "--run " in line
    ]
    assert again  # a target that does not move in this short time has no side
    one, summary = again[0].replace("run.html", str(own_page)).split(), tmp_path / "one.json"
    assert command(*one, "--jobs", "1", "--json", str(summary)).exit_code == 0
    assert 'id="worst-0"' in own_page.read_text()
    share = json.loads(summary.read_text())["planners"]["lvfg"]["time_on_side"]["worst"]
    assert f"on the side {100.0 * share:.1f} %" in page.read_text()


def test_a_store_with_views_or_triggers_is_refused(tmp_path):
    ResultStore(tmp_path / "own.db").close()
    ResultStore(tmp_path / "own.db").close()
    for name, statement in {
        "trigger": "create trigger t after insert on runs begin delete from runs; end",
        "view": "create view v as with recursive n(k) as (select 1 union all select k + 1 from n) select k from n",
    }.items():
        file = tmp_path / f"{name}.db"
        ResultStore(file).close()
        with sqlite3.connect(file) as database:
            database.execute(statement)
        with pytest.raises(InputError, match="holds something else"):
            ResultStore(file)
