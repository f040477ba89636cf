"""How fast a study flies: python -m pytest -s tests/bench/test_engine.py.

SIDELONG_OLD names another checkout, which is measured next to this one: turn about, in processes of their own, the
best of each, so that what else runs on the machine slows both alike.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.bench.size import size

ROOT = Path(__file__).resolve().parents[2]
ROUNDS = size(3, 1)
MEASURE = """
import json, time
import numpy as np
try:
    from sidelong.app.study.closed_loop import run
except ImportError:
    from sidelong.app.study.closed_loop import run_closed_loop as run
from sidelong.app.study.settings import (PREDICTIVE, StudySettings,)
from sidelong.app.planners.value_cache import value_table
from sidelong.mission.predictive.planner import table_configuration
settings = StudySettings(runs=20, seed=1)
table = value_table(table_configuration(settings.aircraft(), settings.requirement()))
run(settings, PREDICTIVE, 0, table)
taken_s, decisions_s, figures = [], [], []
for number in range(4):
    begun_s = time.thread_time()
    flown = run(settings, PREDICTIVE, number, table)
    taken_s.append(time.thread_time() - begun_s)
    decisions_s += flown.decision_s.tolist()
    names = "time_in_band", "time_on_side", "min_range_m", "max_range_m", "moves_per_hour"
    figures.append([getattr(flown, name) for name in names])
print(json.dumps([settings.duration_s / min(taken_s), *np.percentile(decisions_s, (50, 99)).tolist(), figures]))
"""


def measured(checkout):
    done = subprocess.run(
        [sys.executable, "-c", MEASURE],
        cwd=checkout,
        env=os.environ | {"PYTHONPATH": str(checkout)},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def test_a_study_flies_a_thousand_times_as_fast_as_the_clock():
    checkouts = {"this": ROOT}
    if "SIDELONG_OLD" in os.environ:
        checkouts["old"] = Path(os.environ["SIDELONG_OLD"])
    found = {name: [] for name in checkouts}
    for _ in range(ROUNDS):
        for name, checkout in checkouts.items():
            found[name].append(measured(checkout))
    for name, results in found.items():
        times, p50_s, p99_s, _ = max(results)
        print(f"\n{name}: {times:,.0f} x real time, decision {1e6 * p50_s:.0f} us, p99 {1e6 * p99_s:.0f} us")
        for figures in results[0][3]:
            print("   band {:.4f}, side {:.4f}, {:.1f} to {:.1f} m, {:.0f} moves/h".format(*figures))
    assert max(found["this"])[0] >= 1_000.0
