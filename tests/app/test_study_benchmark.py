"""The benchmark, and controllers in another process."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from sidelong.app.commands.study import study
from sidelong.app.errors import InputError
from sidelong.app.study.benchmark import CLASSES, TRACKS
from sidelong.app.study.laws import COLUMNS, ExternalController
from sidelong.app.study.recorded import recorded_targets
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.plan import AircraftState

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = f"{sys.executable} {ROOT / 'examples' / 'controller.py'}"


@pytest.fixture
def command():
    app = typer.Typer()
    app.command()(study)
    return lambda *words: CliRunner().invoke(app, words)


def controller(script: str) -> ExternalController:
    return ExternalController(f"{sys.executable} -c '{script}'", 0.022, (100.0, 500.0), "left")


def states() -> tuple[AircraftState, TargetEstimate]:
    aircraft = AircraftState(12.5, 100.0, -200.0, 0.5, 20.0, 0.01)
    return aircraft, TargetEstimate(12.5, 3.0, 4.0, 1.0, -2.0, np.diag([9.0, 9.0, 1.0, 1.0]), TrackQuality.GOOD, 12.5)


def test_controller_reads_states_by_their_columns_and_its_turn_rate_is_flown() -> None:
    script = """
import csv, sys
for row in csv.DictReader(sys.stdin):
    assert row["side"] == "left"
    print(sum(float(row[name]) for name in ("time_s", "target_velocity_north_m_s", "target_sigma_m")), flush=True)
""".replace("'", '"')
    with controller(script) as steered:
        for _ in range(3):
            assert steered(*states()) == pytest.approx((12.5 - 2.0 + 3.0) / 20.0)


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("pass", "ended"),
        ('import sys\nfor _ in sys.stdin: print("left", flush=True)', "answered 'left'"),
        ('import sys\nfor _ in sys.stdin: print("nan", flush=True)', "answered 'nan'"),
        ('import sys\nfor _ in sys.stdin: print(end="1" * 500, flush=True)', "answered too much"),
    ],
)
def test_controller_that_fails_is_reported_with_its_command(script: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error, controller(script) as steered:
        steered(*states())
    assert "it has to" in str(error.value)


def test_controller_that_answers_the_header_is_reported() -> None:
    """Each answer would be that of the row before."""
    script = "import sys\nfor _ in sys.stdin: print(0.1, flush=True)"
    with pytest.raises(InputError, match="answered before it got a row"), controller(script) as steered:
        for _ in range(500):
            steered(*states())


def test_controller_that_is_no_program_is_reported() -> None:
    with pytest.raises(InputError, match="cannot be started"):
        ExternalController("/no/such/program", 0.02, (100.0, 500.0), "left")


def test_benchmark_flies_the_example_controller_and_writes_its_json(command, tmp_path, monkeypatch) -> None:
    head, *rows = (TRACKS / "boat_010.csv").read_text().splitlines(keepends=True)
    (tmp_path / "boat_010.csv").write_text(head + "".join(rows[:300]))  # five minutes
    monkeypatch.setattr("sidelong.app.study.benchmark.TRACKS", tmp_path)
    summary, words = tmp_path / "benchmark.json", ("--planner", "lvfg", "--planner", "controller")
    found = command(
        *("--benchmark", "--runs", "1", "--jobs", "1", *words, "--controller", EXAMPLE, "--json", str(summary))
    )
    assert found.exit_code == 0, found.output
    result = json.loads(summary.read_text())
    assert (result["benchmark"], result["controller"]) == (1, EXAMPLE)
    rows = {(row["airspeed_m_s"], row["planner"]): row for row in result["rows"]}
    assert len(rows) == 2 * len(CLASSES)
    for aircraft in CLASSES:
        law, own = (rows[aircraft.airspeed_m_s, name] for name in ("lvfg", "controller"))
        assert (law["runs"], own["runs"]) == (3, 3)
        assert law["time_in_band"]["worst"] > 0.999
        # It circles next to the target, and a law circles around it.
        assert own["time_on_side"]["mean"] > law["time_on_side"]["mean"] + 0.2
    assert "controller" in found.output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--benchmark", "--airspeed", "15"), "--benchmark: fixes targets, aircraft and noise; leave out --airspeed"),
        (("--planner", "controller"), "give its command by --controller"),
        (("--controller", "x", "--store", "s.db"), "leave out --controller"),
        (("--benchmark", "--jobs", "1", "--seed", "2"), "leave out --seed"),
        (("--fleet", "2", "--set", "aircraft.pan_limit_deg=120"), "a fleet plans for no pan limits"),
    ],
)
def test_options_that_do_not_fit_are_refused(command, words, message) -> None:
    found = command(*words)
    assert found.exit_code != 0
    assert message in str(found.exception)


def test_own_tracks_are_there_with_their_sources() -> None:
    flown = recorded_targets([TRACKS], math.inf).flown
    sources = (TRACKS / "README.md").read_text()
    assert len(flown) == 7
    assert all(f"`{track.name}.csv`" in sources for track in flown)
    assert set(COLUMNS) <= set((ROOT / "docs" / "how-to" / "benchmark.md").read_text().replace("`", " ").split())
