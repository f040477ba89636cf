"""Each script of the gallery runs, is short, and draws its picture."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LOG = str(ROOT / "tests/data/px4-follow-walk-and-drive.tlog")
# What each prints, as a pattern with the numbers that have to be in a range, and its arguments.
RUNS = {
    "filter_alone": (r"([01]\.\d) m", (0.3, 1.5), ()),
    "planner_alone": (r"circle at (-?\d+) m north", (-200, 400), ()),
    "own_planner": (r"(\d+) moves", (3, 8), ()),
    "replay_analysis": (r"flight: (\d+) s", (100, 5000), (LOG,)),
    "study_sweep": (r"([\d.]+) % on side", (30, 100), ()),
}


def test_each_example_is_tested_and_has_at_most_60_lines():
    scripts = {path.stem: path for path in (ROOT / "examples").glob("*.py")}
    assert scripts.keys() == {*RUNS, "controller"}  # that one is flown in tests/app/test_study_benchmark.py
    assert all(len(path.read_text().splitlines()) <= 60 for path in scripts.values())


@pytest.mark.parametrize("name", RUNS)
def test_an_example_runs_and_draws_its_picture(name, tmp_path):
    pattern, (least, most), arguments = RUNS[name]
    picture = tmp_path / "picture.png"
    command = [sys.executable, str(ROOT / "examples" / f"{name}.py"), *arguments, str(picture)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=280)
    assert done.returncode == 0, done.stderr
    found = re.search(pattern, done.stdout)
    assert found, done.stdout
    assert least <= float(found[1]) <= most
    assert picture.stat().st_size > 5000
