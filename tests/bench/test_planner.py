"""Run by name: python -m pytest -s tests/bench/test_planner.py."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.study.closed_loop import run
from sidelong.app.study.settings import (
    PREDICTIVE,
    StudySettings,
    studied,
)
from sidelong.app.study.study import table_of
from sidelong.mission.predictive.planner import table_configuration
from sidelong.mission.predictive.value_table import compute
from tests.bench.size import size
from tests.studies import run_study

SETTINGS = StudySettings((PREDICTIVE,), runs=size(4, 1))


@pytest.fixture(scope="module")
def timed_table():
    configuration = table_configuration(SETTINGS.aircraft(), SETTINGS.requirement())
    compute(replace(configuration, cells=4, improvements=(1, 1)))  # loads, or compiles
    begun_s = time.process_time()
    table = compute(configuration)
    return table, time.process_time() - begun_s


def test_the_value_table_takes_a_second(timed_table):
    print(f"\nvalue table: {timed_table[1]:.1f} s of the processor")
    assert timed_table[1] < 3.0


def test_decisions_take_less_than_a_millisecond(timed_table):
    taken_ms = 1e3 * run_study(SETTINGS, timed_table[0], jobs=1).planners[PREDICTIVE].decision_s
    p50_ms, p99_ms = np.percentile(taken_ms, (50, 99))
    print(f"\ndecision: {p50_ms:.3f} ms, p99 {p99_ms:.3f} ms of the processor")
    assert p99_ms < 1.0


def test_a_sector_is_kept():
    settings = StudySettings(runs=size(4, 1), perfect_sensors=True, config=studied(side="120-200"))
    sector, table, shares = settings.requirement().sector, table_of(settings), []
    for number in settings.numbers:
        found = run(settings, PREDICTIVE, number, table, keep_track=True)
        east_m, north_m = (found.track.aircraft_m - found.track.target_m).T
        off_rad = np.arctan2(east_m, north_m) - sector.middle_rad
        off_rad = np.abs((off_rad + math.pi) % (2.0 * math.pi) - math.pi)
        shares.append(float(np.mean(off_rad <= sector.half_width_rad)))
        assert found.min_range_m >= 100.0
        assert found.max_range_m <= 500.0
    print(f"\nin the sector: {100.0 * np.mean(shares):.1f} % of the time, worst {100.0 * min(shares):.1f} %")
    assert np.mean(shares) > 0.98
