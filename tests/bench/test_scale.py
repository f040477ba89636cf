"""Large studies and a flight's own share of a core: python -m pytest -s tests/bench/test_scale.py -k NAME.

Other programs slow the wall time down; so the processor time of every process is reported next to it.
SIDELONG_RUNS: another number of runs than the 10,000 (workers: 2,000); SIDELONG_DURATION: of each, s (1200).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest

from sidelong.app.study.settings import (
    PREDICTIVE,
    Design,
    StudySettings,
)
from sidelong.app.study.study import MEASURES, ResultStore, Study, on_cluster, table_of

ROOT = Path(__file__).resolve().parents[2]
PREDICTIVE = StudySettings((PREDICTIVE,))
SAMPLE_S = 2.0


class Watched(threading.Thread):
    """Samples processor time, s, and memory, bytes, of a process and all it starts, by process; other ids too."""

    def __init__(self, process: subprocess.Popen[bytes], *others: int) -> None:
        super().__init__(daemon=True)
        self._process = process
        self._others = [psutil.Process(pid) for pid in others]
        self.cpu_s: list[dict[int, float]] = []
        self.resident: list[int] = []
        self.names: dict[int, str] = {}
        self.start()

    def run(self) -> None:
        first = psutil.Process(self._process.pid)
        while self._process.poll() is None:
            cpu_s, resident = {}, 0
            for one in (first, *first.children(recursive=True), *self._others):
                try:
                    times = one.cpu_times()
                    cpu_s[one.pid] = times.user + times.system
                    resident += one.memory_info().rss
                    self.names.setdefault(one.pid, " ".join(one.cmdline()[1:4]))
                except psutil.Error:
                    continue
            self.cpu_s.append(cpu_s)
            self.resident.append(resident)
            time.sleep(SAMPLE_S)


def sidelong(*words: object) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "sidelong.app", *map(str, words)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
    )


def test_ten_thousand_runs(tmp_path):
    """On a local cluster of two workers, table and report included; memory stays flat."""
    distributed = pytest.importorskip("distributed")
    runs = int(os.environ.get("SIDELONG_RUNS", "10000"))
    duration_s = float(os.environ.get("SIDELONG_DURATION", "1200"))
    store, report, summary = (tmp_path / name for name in ("study.db", "study.html", "study.json"))
    begun_s = time.monotonic()
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as cluster:
        words = ("study", "--planner", "predictive", "--runs", runs, "--duration", duration_s)
        on = ("--scheduler", cluster.scheduler_address, "--store", store, "--report", report, "--json", summary)
        process = sidelong(*words, *on)
        watched = Watched(process, *(worker.pid for worker in cluster.workers.values()))
        assert process.wait() == 0
        wall_s = time.monotonic() - begun_s
    cpu_s = sum(max(sample.get(pid, 0.0) for sample in watched.cpu_s) for pid in watched.names)
    resident_mb = np.array(watched.resident) / 1e6
    flying = resident_mb[len(resident_mb) // 5 : -max(2, len(resident_mb) // 10)]  # without beginning and report
    found = json.loads(summary.read_text())["planners"]["predictive"]
    print(
        f"\n{runs:,} runs of {duration_s:.0f} s: {wall_s / 60.0:.1f} min of wall time, {cpu_s / 60.0:.1f} min of "
        f"processor time, {duration_s * runs / cpu_s:,.0f} x real time each core; memory {flying[0]:.0f} MB early, "
        f"{flying[-1]:.0f} MB late, {resident_mb.max():.0f} MB at most; report {report.stat().st_size / 1e6:.1f} MB, "
        f"store {store.stat().st_size / 1e6:.1f} MB; side {found['time_on_side']}"
    )
    assert flying[-1] <= 1.1 * np.median(flying) + 50.0


def test_two_workers_of_a_cluster_against_one():
    """At least 1.8 times as fast, where two cores are free; the same rows."""
    distributed = pytest.importorskip("distributed")
    settings = replace(PREDICTIVE, runs=int(os.environ.get("SIDELONG_RUNS", "2000")))
    table = table_of(settings)
    rows, runs_per_s, runs_per_cpu_s = [], [], []
    for workers in (1, 2):
        with distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
        ) as cluster:
            processes = [psutil.Process(worker.pid) for worker in cluster.workers.values()]
            warm = Study([Design(replace(settings, runs=2 * workers, seed=9))], ResultStore(None))
            warm.fly(on_cluster(cluster.scheduler_address), lambda _settings: table, 1, lambda _runs: None)
            before_s = [sum(process.cpu_times()[:2]) for process in processes]
            study = Study([Design(settings)], ResultStore(None))
            study.fly(on_cluster(cluster.scheduler_address), lambda _settings: table, 25, lambda _runs: None)
            busy_s = [sum(one.cpu_times()[:2]) - s for one, s in zip(processes, before_s, strict=True)]
        rows.append(study.results()[0].planners[PREDICTIVE])
        runs_per_s.append(settings.runs / study.wall_s)
        runs_per_cpu_s.append(settings.runs / sum(busy_s))
        shares = ", ".join(f"{100.0 * s / study.wall_s:.0f} %" for s in busy_s)
        print(f"\n{workers} workers: {study.wall_s:.1f} s, workers busy {shares}", end="")
    print(
        f"\n{runs_per_s[1] / runs_per_s[0]:.2f} times as fast by the clock, "
        f"{2.0 * runs_per_cpu_s[1] / runs_per_cpu_s[0]:.2f} times by the workers' processor time"
    )
    for name in MEASURES:
        np.testing.assert_array_equal(rows[0][name], rows[1][name])
    assert 2.0 * runs_per_cpu_s[1] / runs_per_cpu_s[0] >= 1.8


@pytest.mark.parametrize("autopilot", ["arduplane", "px4"])
def test_a_flight_leaves_its_core_free(tmp_path, autopilot):
    """At the clock's own speed launch takes a twentieth of a core; the simulated vehicle is distinguished."""
    process = sidelong(
        *(
            "launch",
            "--autopilot",
            autopilot,
            "--set",
            "simulation.speed=1",
            "--duration",
            200,
            "--quiet",
            "--out",
            tmp_path,
        )
    )
    watched = Watched(process)
    assert process.wait() == 0
    # From the take-off on, until it is wound up.
    begin, end = watched.cpu_s[round(60.0 / SAMPLE_S)], watched.cpu_s[-round(10.0 / SAMPLE_S)]
    wall_s = SAMPLE_S * (len(watched.cpu_s) - round(70.0 / SAMPLE_S))
    shares = {pid: (end[pid] - begin[pid]) / wall_s for pid in end if pid in begin}
    print()
    for pid, share in shares.items():
        print(f"{autopilot}: {100.0 * share:5.1f} % of a core: {watched.names[pid][:60]}")
    assert shares[process.pid] <= 0.05
