"""Benchmarks do not rot: all are collected, and the quick ones of those without sockets run at a tiny size."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PYTEST = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
MODULES = "alarms documents encounters estimation faults joint_estimation records"


def run(*arguments, **environment):
    done = subprocess.run(
        [*PYTEST, *arguments],
        cwd=ROOT,
        env={**os.environ, "SIDELONG_SMOKE": "1", **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:]
    return done.stdout


def test_every_benchmark_is_collected():
    run("--collect-only", "tests/bench", "tests/terrain/bench")


def test_benchmarks_run_at_a_tiny_size():
    out = run(*(f"tests/bench/test_{name}.py" for name in MODULES.split()))
    assert " passed" in out
