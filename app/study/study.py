"""A whole study: every planner over the same targets, for each design; what is known already is not flown again."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sidelong.app.study.batch import Batch, Executor, one_flown
from sidelong.app.study.design import Design
from sidelong.app.study.judging import RunResult, Track
from sidelong.app.study.processes import on_processes
from sidelong.app.study.settings import PlannerName, StudySettings
from sidelong.app.study.store import MEASURES, ResultStore, RunId, run_ids
from sidelong.app.value_cache import value_table
from sidelong.mission.predictive.planner import table_configuration
from sidelong.mission.predictive.value_table import ValueTable

Progress = Callable[[int], None]
_TableOf = Callable[[StudySettings], ValueTable | None]


@dataclass(frozen=True, slots=True, eq=False)
class PlannerResult:
    """One planner's runs, in order: arrays (runs,); decision_s of all runs together.

    Sides are not a number where a target never moved, nor sight and clearance over flat ground; one planner's values
    have the same gaps as another's.
    """

    runs: tuple[RunId, ...]
    time_in_band: npt.NDArray[np.float64]
    time_on_side: npt.NDArray[np.float64]
    time_on_side_now: npt.NDArray[np.float64]
    min_range_m: npt.NDArray[np.float64]
    max_range_m: npt.NDArray[np.float64]
    moves_per_hour: npt.NDArray[np.float64]
    reversals_per_hour: npt.NDArray[np.float64]
    observation_spread_deg: npt.NDArray[np.float64]
    duration_s: npt.NDArray[np.float64]
    time_in_sight: npt.NDArray[np.float64]
    time_in_sight_where_possible: npt.NDArray[np.float64]
    min_clearance_m: npt.NDArray[np.float64]
    observation_histogram: npt.NDArray[np.int64]
    decision_s: npt.NDArray[np.float32]

    @staticmethod
    def of(runs: Iterable[tuple[RunId, RunResult]]) -> PlannerResult:
        """Sum up runs."""
        ids, values, histogram, decision_s = [], [], np.zeros(72, np.int64), []
        for which, result in runs:
            ids.append(which)
            values.append([getattr(result, name) for name in MEASURES])
            histogram += result.observation_histogram
            decision_s.append(result.decision_s)
        measures = dict(zip(MEASURES, np.array(values).T, strict=True))
        return PlannerResult(
            runs=tuple(ids), observation_histogram=histogram, decision_s=np.concatenate(decision_s), **measures
        )


@dataclass(frozen=True, slots=True, eq=False)
class StudyResult:
    """Of one design. simulated_s is the flight time of all planners together."""

    settings: StudySettings
    planners: dict[PlannerName, PlannerResult]
    simulated_s: float
    wall_s: float


class Study:
    """Designs, and where their results are kept."""

    def __init__(self, designs: Sequence[Design], store: ResultStore) -> None:
        self.designs, self.store = tuple(designs), store
        self.wall_s = 0.0
        self.total = sum(len(d.settings.planners) * len(d.settings.numbers) for d in designs)

    def run_ids(self) -> Iterator[RunId]:
        """Return every run."""
        for _, settings, planner in self._parts():
            yield from run_ids(settings, planner)

    def missing(self) -> int:
        """Return how many runs are still to be flown."""
        return sum(1 for _ in self.store.missing(self.run_ids()))

    def fly(self, executor: Executor, tables: _TableOf, batch_size: int, progress: Progress) -> None:
        """Fly what is missing. progress is called with the number of runs just kept."""
        begun_s = time.perf_counter()
        under_way: dict[Batch, list[RunId]] = {}

        def batches() -> Iterator[tuple[Batch, ValueTable | None]]:
            for k, settings, planner in self._parts():
                missing = list(self.store.missing(run_ids(settings, planner)))
                table = tables(settings) if missing and planner is PlannerName.PREDICTIVE else None
                for i in range(0, len(missing), batch_size):
                    runs = missing[i : i + batch_size]
                    batch = Batch(k, planner, tuple(run.number for run in runs))
                    under_way[batch] = runs
                    yield batch, table

        flying = executor(tuple(design.settings for design in self.designs), batches())
        try:
            for batch, results in flying:
                runs = under_way.pop(batch)
                self.store.add(self.designs[batch.design].settings, zip(runs, results, strict=True))
                progress(len(results))
        finally:
            if hasattr(flying, "close"):
                flying.close()  # ends what it began
            self.wall_s += time.perf_counter() - begun_s

    def result(self, design: Design) -> StudyResult:
        """Sum up one design, whose runs are all there."""
        settings = design.settings
        planners = {p: PlannerResult.of(self.store.results(run_ids(settings, p))) for p in settings.planners}
        simulated_s = sum(float(planner.duration_s.sum()) for planner in planners.values())
        return StudyResult(settings, planners, simulated_s, self.wall_s)

    def _parts(self) -> Iterator[tuple[int, StudySettings, PlannerName]]:
        for k, design in enumerate(self.designs):
            for planner in design.settings.planners:
                yield k, design.settings, planner


def run_study(
    settings: StudySettings,
    table: ValueTable | None,
    jobs: int | None = None,
    progress: Progress = lambda _runs: None,
) -> StudyResult:
    """Fly one design on this machine and keep nothing.

    The result does not depend on ``jobs`` but for the times of decisions. table is needed for the predictive planner
    only. An interrupt ends the worker processes at once.
    """
    store = ResultStore(None)
    try:
        study = Study([Design(settings)], store)
        study.fly(on_processes(jobs), lambda _settings: table, 1, progress)
        return study.result(study.designs[0])
    finally:
        store.close()


def flown_again(flown: RunId, settings: StudySettings) -> Track:
    """Return the path of a run, which is not kept: the run is flown again."""
    table = table_of(settings) if flown.planner is PlannerName.PREDICTIVE else None
    track = one_flown(settings, flown.planner, flown.number, table, keep_track=True).track
    assert track is not None
    return track


def table_of(settings: StudySettings, progress: Callable[[float], None] = lambda _share: None) -> ValueTable:
    """Return the predictive planner's value table; it is computed where none is kept."""
    configuration = table_configuration(settings.aircraft(), settings.requirement(), settings.wind_speed_m_s)
    return value_table(configuration, progress)
