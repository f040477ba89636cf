"""A whole study: every planner over the same targets, on several processes."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from app.study.judging import RunResult, Track
from app.study.run import run
from app.study.scene import scene
from app.study.settings import PlannerName, StudySettings
from mission.value_table import ValueTable

Progress = Callable[[int], None]


@dataclass(frozen=True, slots=True, eq=False)
class PlannerResult:
    """One planner's runs, in order: arrays (runs,); decision_s of all runs together.

    Sides are not a number where a target never moved; one planner's values have the same gaps as another's.
    """

    time_in_band: npt.NDArray[np.float64]
    time_on_side: npt.NDArray[np.float64]
    time_on_side_5s: npt.NDArray[np.float64]
    min_range_m: npt.NDArray[np.float64]
    max_range_m: npt.NDArray[np.float64]
    moves_per_hour: npt.NDArray[np.float64]
    quick_changes_per_hour: npt.NDArray[np.float64]
    observation_spread_deg: npt.NDArray[np.float64]
    observation_histogram: npt.NDArray[np.int64]
    decision_s: npt.NDArray[np.float32]
    first_track: Track

    @staticmethod
    def of(runs: list[RunResult]) -> PlannerResult:
        """Sum up runs, the first of which kept its track."""
        track = runs[0].track
        assert track is not None
        return PlannerResult(
            np.array([r.time_in_band for r in runs]),
            np.array([r.time_on_side for r in runs]),
            np.array([r.time_on_side_5s for r in runs]),
            np.array([r.min_range_m for r in runs]),
            np.array([r.max_range_m for r in runs]),
            np.array([r.moves_per_hour for r in runs]),
            np.array([r.quick_changes_per_hour for r in runs]),
            np.array([r.observation_spread_deg for r in runs]),
            np.sum([r.observation_histogram for r in runs], axis=0),
            np.concatenate([r.decision_s for r in runs]),
            track,
        )


@dataclass(frozen=True, slots=True, eq=False)
class StudyResult:
    """simulated_s is the flight time of all planners together."""

    settings: StudySettings
    planners: dict[PlannerName, PlannerResult]
    simulated_s: float
    wall_s: float


def run_study(
    settings: StudySettings,
    table: ValueTable | None,
    jobs: int | None = None,
    progress: Progress = lambda _runs: None,
) -> StudyResult:
    """Fly all runs; the result does not depend on ``jobs`` but for the times of decisions.

    table is needed for the predictive planner only. progress is called with the number of runs just finished. An
    interrupt ends the worker processes at once.
    """
    begun_s = time.perf_counter()
    tasks = [(planner, number) for planner in settings.planners for number in range(settings.all_runs)]
    found: dict[tuple[PlannerName, int], RunResult] = {}
    processes = min(jobs or os.cpu_count() or 1, len(tasks))
    with _uninterrupted():
        # Not forked: a fork copies the locks that other threads of this process hold just then, for ever locked.
        pool = multiprocessing.get_context("spawn").Pool(processes, _begin, (settings, table))
    with pool:
        for task, result in pool.imap_unordered(_fly, tasks):
            found[task] = result
            progress(1)
    planners = {
        planner: PlannerResult.of([found[planner, number] for number in range(settings.all_runs)])
        for planner in settings.planners
    }
    flown_s = sum(scene(settings, number).duration_s for number in range(settings.all_runs))
    return StudyResult(settings, planners, len(settings.planners) * flown_s, time.perf_counter() - begun_s)


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Let processes begin that an interrupt does not reach, not even while they import."""
    answer = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, answer)


_worker: tuple[StudySettings, ValueTable | None]


def _begin(settings: StudySettings, table: ValueTable | None) -> None:
    """Set up a worker process. The parent alone answers an interrupt, by ending its workers."""
    global _worker  # noqa: PLW0603  # what a worker needs is too large to come with every task
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # for one that comes later, in place of another
    _worker = settings, table


def _fly(task: tuple[PlannerName, int]) -> tuple[tuple[PlannerName, int], RunResult]:
    settings, table = _worker
    planner, number = task
    return task, run(settings, planner, number, table, keep_track=number == 0)
