"""The command line with a wandering planner in place of the paper's: python -m tests.bench.wandering launch ..."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from sidelong.app.cli import main
from sidelong.app.planners.planner_kind import Paper

HARNESS = Path(__file__).parents[1] / "exchange" / "conftest.py"

if __name__ == "__main__":
    spec = importlib.util.spec_from_file_location("exchange_harness", HARNESS)
    harness = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(harness)
    Paper.factory = lambda self, needs: lambda aircraft, wanted, _check: harness.Wandering(seed=1, period_s=2.0)
    Paper.unflyable = lambda self, aircraft, requirement: ()
    main()
