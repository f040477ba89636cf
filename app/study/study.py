"""A whole study: every planner over the same targets, for each design; what is known already is not flown again."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sidelong.app.planners.registry import PLANNER_NAMES, planner_by_name
from sidelong.app.planners.value_cache import value_table
from sidelong.app.study.design import Design
from sidelong.app.study.judging import JudgedTrack, RunResult
from sidelong.app.study.parallel import Task, Workers, parallel
from sidelong.app.study.settings import (
    MISSION_PLANNERS,
    PREDICTIVE,
    StudySettings,
)
from sidelong.app.study.store import MEASURES, ResultStore, RunId, run_ids
from sidelong.estimators.compiled import is_cached
from sidelong.mission.core.path import FloatArray
from sidelong.mission.fleet.team_planner import IN_TEAM
from sidelong.mission.predictive.planner import USUAL, table_configuration
from sidelong.mission.predictive.value_table import ValueTable

Progress = Callable[[int], None]
_TableOf = Callable[[StudySettings], ValueTable]


@dataclass(frozen=True, slots=True, eq=False)
class PlannerResult:
    """One planner's runs, in order.

    Sides are not a number where a target never moved, nor sight and clearance over flat ground; one planner's values
    have the same gaps as another's.

    Attributes:
        measures: arrays (runs,) by the name of the measure.
        decision_s: processor time of the measured decisions of all runs together.
    """

    runs: tuple[RunId, ...]
    measures: dict[str, FloatArray]
    decision_s: npt.NDArray[np.float32]

    @staticmethod
    def of(runs: Iterable[tuple[RunId, RunResult]]) -> PlannerResult:
        ids, results = zip(*runs, strict=True)
        measures = {name: np.array([getattr(one, name) for one in results]) for name in MEASURES}
        return PlannerResult(ids, measures, np.concatenate([one.decision_s for one in results]))

    def __getitem__(self, name: str) -> FloatArray:
        return self.measures[name]


@dataclass(frozen=True, slots=True, eq=False)
class StudyResult:
    """Of one design. wall_s: how long the whole study took."""

    design: Design
    planners: dict[str, PlannerResult]
    wall_s: float

    @property
    def settings(self) -> StudySettings:
        return self.design.settings

    @property
    def simulated_s(self) -> float:
        """The flight time of all planners together."""
        return sum(float(planner["duration_s"].sum()) for planner in self.planners.values())


class Study:
    """Designs, and where their results are kept."""

    def __init__(self, designs: Sequence[Design], store: ResultStore) -> None:
        self.designs, self.store = tuple(designs), store
        self.wall_s = 0.0
        self.total = sum(len(d.settings.planners) * len(d.settings.numbers) for d in designs)

    def missing(self) -> int:
        """Return how many runs are still to be flown."""
        return sum(len(missing) for _, _, missing in self._missing())

    def fly(self, workers: Workers, tables: _TableOf, batch_size: int, progress: Progress) -> None:
        """Fly what is missing. progress is called with the number of runs just kept."""
        begun_s = time.perf_counter()

        def batches() -> Iterator[Task]:
            for settings, planner, missing in self._missing():
                table = tables(settings) if missing and planner == PREDICTIVE else None
                for i in range(0, len(missing), batch_size):
                    yield settings, planner, tuple(missing[i : i + batch_size]), table

        try:
            with contextlib.closing(parallel(workers, flown, batches())) as flying:
                for (_, _, runs, _), results in flying:
                    self.store.add(zip(runs, results, strict=True))
                    progress(len(results))
        finally:
            self.wall_s += time.perf_counter() - begun_s

    def results(self) -> list[StudyResult]:
        """Sum up each design; all runs have to be there."""
        return [
            StudyResult(
                design,
                {
                    p: PlannerResult.of(self.store.results(run_ids(design.settings, p)))
                    for p in design.settings.planners
                },
                self.wall_s,
            )
            for design in self.designs
        ]

    def _missing(self) -> Iterator[tuple[StudySettings, str, list[RunId]]]:
        for design in self.designs:
            for planner in design.settings.planners:
                yield design.settings, planner, self.store.missing(run_ids(design.settings, planner))


def flown(settings: StudySettings, planner: str, runs: Sequence[RunId], table: ValueTable | None) -> list[RunResult]:
    return [one_flown(settings, planner, one.number, table) for one in runs]


def one_flown(
    settings: StudySettings, planner: str, number: int, table: ValueTable | None, keep_track: bool = False
) -> RunResult:
    """Fly one run: a planner by the whole core in a closed loop, a law by its commands alone."""
    # What is compiled takes a second to load.
    if planner in MISSION_PLANNERS:
        from sidelong.app.study.closed_loop import run  # noqa: PLC0415

        return run(settings, planner, number, table, keep_track)
    from sidelong.app.study.laws import run_law  # noqa: PLC0415

    return run_law(settings, planner, number, keep_track)


def is_compiled(*planners: str) -> bool:
    """Return whether runs of planners can be flown without compilation."""
    from sidelong.estimators.filters.imm_kernel import update  # noqa: PLC0415  # as above

    own = [one for one in planners if one in PLANNER_NAMES]
    return is_cached(update) and all(planner_by_name(one).is_compiled() for one in own)


def flown_again(flown: RunId, settings: StudySettings) -> JudgedTrack:
    """Return the path of a run, which is not kept: the run is flown again."""
    table = table_of(settings) if flown.planner == PREDICTIVE else None
    track = one_flown(settings, flown.planner, flown.number, table, keep_track=True).track
    assert track is not None
    return track


def table_of(settings: StudySettings, progress: Callable[[float], None] = lambda _share: None) -> ValueTable:
    """Return the predictive planner's value table; it is computed where none is kept."""
    wind_speed_m_s = settings.config.simulation.wind_speed_m_s
    own = IN_TEAM if settings.config.requirement.fleet_size > 1 else USUAL
    configuration = table_configuration(settings.aircraft(), settings.requirement(), wind_speed_m_s, own)
    return value_table(configuration, progress)
