import contextlib
import json
import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from sidelong.app.commands.study import study
from sidelong.app.errors import InputError
from sidelong.app.study.report import study_json
from sidelong.app.study.settings import (
    LVFG,
    ORBIT,
    PAPER,
    PARK,
    StudySettings,
)
from sidelong.app.study.study import MEASURES
from tests.studies import run_study

LAWS = (PAPER, LVFG, PARK, ORBIT)


@pytest.fixture(scope="module")
def small():
    settings = StudySettings(LAWS, runs=3, perfect_sensors=True, duration_s=150.0)
    finished = []
    return run_study(settings, None, jobs=1, progress=finished.append), finished


@pytest.fixture
def command():
    app = typer.Typer()
    app.command()(study)
    return lambda *words: CliRunner().invoke(app, words)


def test_the_result_does_not_depend_on_the_number_of_processes(small):
    result, finished = small
    again = run_study(result.settings, None, jobs=2)
    assert sum(finished) == 3 * len(LAWS)
    for name in LAWS:
        for measure in MEASURES:
            np.testing.assert_array_equal(result.planners[name][measure], again.planners[name][measure])


def test_the_summary_has_every_key(small):
    result, _ = small
    summary = json.loads(json.dumps(study_json([result]), allow_nan=False))
    assert set(summary) == {
        *("planners", "runs", "seed", "simulated_s", "wall_s"),
        *("noise_draws", "targets", "skipped", "skipped_targets", "parts"),
    }
    assert (summary["runs"], summary["targets"], summary["skipped"]) == (3, 3, 0)
    assert summary["simulated_s"] == 3 * len(LAWS) * 150.0
    for planner in summary["planners"].values():
        assert {"mean", "p5", "worst"} == set(planner["time_in_band"]) == set(planner["time_on_side"])
        assert planner["time_on_side"]["worst"] <= planner["time_on_side"]["p5"] <= planner["time_on_side"]["mean"]
        assert planner["min_range_m"]["worst"] <= planner["max_range_m"]["worst"]
        assert 0.0 <= planner["decision_ms"]["p50"] <= planner["decision_ms"]["p99"]
        assert 0.0 <= planner["moves_per_hour"]["mean"] <= planner["moves_per_hour"]["worst"]
        assert 0.0 <= planner["reversals_per_hour"]["worst"] <= planner["moves_per_hour"]["worst"]
        assert planner["time_on_side_now"]["worst"] <= planner["time_on_side_now"]["mean"]


def test_the_command_prints_a_table_and_writes_its_files(command, tmp_path):
    summary, page = tmp_path / "study.json", tmp_path / "study.html"
    result = command(
        *(
            "--runs",
            "1",
            "--duration",
            "60",
            "--planner",
            "lvfg",
            "--planner",
            "park",
            "--set",
            "study.perfect_sensors=true",
        ),
        *("--jobs", "1", "--json", str(summary), "--report", str(page)),
    )
    assert result.exit_code == 0, result.output
    assert "time on side, %" in result.output
    assert set(json.loads(summary.read_text())["planners"]) == {"lvfg", "park"}
    assert "<figure" in page.read_text()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--target-speed", "10"), "--target-speed"),
        (("--target-speed", "nan"), "--target-speed"),
        (("--set", "simulation.wind_speed_m_s=90"), "simulation.wind_speed_m_s"),
        (("--set", "study.legs_s=[200,40]"), "study.legs_s"),
        (("--set", "study.legs_s=fast"), "study.legs_s"),
        (("--report", "study.doc"), "study.doc"),
        (("--report", "nowhere/study.html"), "nowhere"),
        (("--json", "nowhere/study.json"), "nowhere"),
    ],
)
def test_wrong_input_is_one_sentence(command, words, named):
    result = command(*words)
    assert isinstance(result.exception, InputError)
    assert named in str(result.exception)
    assert "\n" not in str(result.exception)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc")
def test_an_interrupt_ends_all_processes():
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from tests.studies import run_study; from sidelong.app.study.settings import *;"
        "s = StudySettings((LVFG,), runs=2000, perfect_sensors=True, duration_s=20.0);"
        "run_study(s, None, jobs=2, progress=lambda runs: print(runs, flush=True))"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as whole:
        try:
            assert whole.stdout is not None
            assert whole.stdout.readline() == b"1\n"
            children = Path(f"/proc/{whole.pid}/task/{whole.pid}/children").read_text().split()
            whole.send_signal(signal.SIGINT)
            _, complaint = whole.communicate(timeout=60.0)
        finally:
            whole.kill()
    assert complaint.rstrip().endswith(b"KeyboardInterrupt")
    assert complaint.count(b"KeyboardInterrupt") == 1  # no worker complains
    assert len(children) >= 2  # two workers, and Python's own tracker of what they share
    for child in children:
        with contextlib.suppress(ProcessLookupError):
            descriptor = os.pidfd_open(int(child))
            ended, _, _ = select.select([descriptor], [], [], 30.0)
            os.close(descriptor)
            assert ended, f"worker {child} is still running"
