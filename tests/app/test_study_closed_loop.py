"""Studies in the closed loop: the same runs as the kinematic ones, flown by the whole core."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
import typer
from typer.testing import CliRunner

from sidelong.app.commands.study import study
from sidelong.app.errors import InputError
from sidelong.app.study.closed_loop import run_closed_loop
from sidelong.app.study.run import run
from sidelong.app.study.settings import PARTS, Fidelity, PlannerName, StudySettings, studied

SETTINGS = StudySettings((PlannerName.PAPER,), runs=1, duration_s=400.0, config=studied(target_speed_max_m_s=4.0))


@pytest.fixture
def command():
    app = typer.Typer()
    app.command()(study)
    return lambda *words: CliRunner().invoke(app, words)


@pytest.mark.parametrize("autopilot", ["arduplane", "px4"])
def test_a_run_comes_close_to_the_kinematic_one(autopilot):
    found = run_closed_loop(replace(SETTINGS, autopilot=autopilot), PlannerName.PAPER, 0, None, keep_track=True)
    kinematic = run(SETTINGS, PlannerName.PAPER, 0, None, keep_track=True)
    assert found.duration_s == pytest.approx(kinematic.duration_s, abs=0.3)
    assert tuple(found.track.aircraft_m[0]) == pytest.approx(tuple(kinematic.track.aircraft_m[0]), abs=0.1)
    assert tuple(found.track.target_m[2000]) == pytest.approx(tuple(kinematic.track.target_m[2000]), abs=1.0)
    assert found.moves_per_hour > 0.0
    assert found.time_in_band == pytest.approx(kinematic.time_in_band, abs=0.1)
    assert found.time_on_side == pytest.approx(kinematic.time_on_side, abs=0.1)


def test_a_report_names_its_fidelity_and_parts(command, tmp_path):
    summary, page = tmp_path / "study.json", tmp_path / "study.html"
    words = ("--fidelity", "closed-loop", "--planner", "paper", "--runs", "2", "--duration", "60", "--jobs", "1")
    result = command(*words, "--json", str(summary), "--report", str(page))
    assert result.exit_code == 0, result.output
    given = json.loads(summary.read_text())
    assert (given["fidelity"], given["parts"]) == ("closed-loop", PARTS[Fidelity.CLOSED_LOOP])
    for text in (" ".join(result.output.split()), page.read_text()):
        assert f"fidelity closed-loop, arduplane: {PARTS[Fidelity.CLOSED_LOOP]}" in text
    assert "--fidelity closed-loop" in page.read_text()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--planner", "lvfg"), "--planner"),
        (("--latency", "1"), "--latency"),
        (("--perfect-sensors",), "--perfect-sensors"),
        (("--fleet", "2"), "--fleet"),
    ],
)
def test_what_a_closed_loop_cannot_fly_is_refused_in_one_sentence(command, words, named):
    result = command("--fidelity", "closed-loop", *words)
    assert isinstance(result.exception, InputError)
    assert named in str(result.exception)
