"""Studies on a real Dask cluster of this machine."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.errors import InputError
from sidelong.app.study.settings import (
    LVFG,
    PARK,
    Design,
    StudySettings,
)
from sidelong.app.study.study import MEASURES, ResultStore, Study, on_cluster
from tests.studies import run_study

distributed = pytest.importorskip("distributed")

SETTINGS = StudySettings((LVFG, PARK), runs=30, perfect_sensors=True, duration_s=60.0)


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as local:
        yield local


def test_a_worker_may_die_and_nothing_is_lost_or_flown_twice(cluster):
    expected = run_study(SETTINGS, None, jobs=1)
    announced, flown = [], []
    study = Study([Design(SETTINGS), Design(replace(SETTINGS, lag_s=1.0, runs=3))], ResultStore(None))

    def progress(runs):
        flown.append(runs)
        if len(flown) == 3:
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

    study.fly(on_cluster(cluster.scheduler_address, announced.append), lambda _settings: None, 2, progress)
    assert sum(flown) == study.total == 66
    assert study.missing() == 0
    result = study.results()[0]
    for planner in SETTINGS.planners:
        for name in MEASURES:
            np.testing.assert_array_equal(result.planners[planner][name], expected.planners[planner][name])
    assert len(announced) == 1 and "2 workers; dashboard http://127.0.0.1:" in announced[0]


def test_workers_of_other_code_are_refused(cluster, monkeypatch):
    monkeypatch.setattr("sidelong.app.study.study.code_version", lambda: "0.0.1+other")
    study = Study([Design(SETTINGS)], ResultStore(None))
    with pytest.raises(InputError, match=r"not 0\.0\.1\+other"):
        study.fly(on_cluster(cluster.scheduler_address), lambda _settings: None, 30, lambda _runs: None)


def test_no_scheduler_is_reported(monkeypatch):
    monkeypatch.setattr("sidelong.app.study.study._ANSWER_S", 0.2)
    study = Study([Design(SETTINGS)], ResultStore(None))
    with pytest.raises(InputError, match="no Dask scheduler answers at tcp://127"):
        study.fly(on_cluster("tcp://127.0.0.1:9"), lambda _settings: None, 30, lambda _runs: None)
