"""A study with several aircraft on each target: joint decisions, compared with laws that hold phases."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from sidelong.app.study.fleet import FleetPlannerName, FleetResult, run_fleet
from sidelong.app.study.processes import uninterrupted
from sidelong.app.study.report import spread, targets_json
from sidelong.app.study.settings import StudySettings
from sidelong.mission.predictive.value_table import ValueTable

# Measures reported for each aircraft, with the percentile of their tail.
_OF_EACH = {
    "time_in_band": 5,
    "time_on_side": 5,
    "time_on_side_now": 5,
    "min_range_m": 5,
    "moves_per_hour": 95,
    "reversals_per_hour": 95,
}
# Measures reported for all aircraft together.
_OF_ALL = {
    "time_on_side_any": 5,
    "time_on_side_any_now": 5,
    "time_in_band_any": 5,
    "min_separation_m": 5,
    "min_range_m": 5,
    "handovers": 95,
    "position_error_m": 95,
    "in_ellipse": 5,
}


@dataclass(frozen=True, slots=True, eq=False)
class FleetStudy:
    """All runs of each planner, in order."""

    settings: StudySettings
    runs: dict[FleetPlannerName, tuple[FleetResult, ...]]


def fly_fleets(
    settings: StudySettings,
    table: ValueTable,
    jobs: int | None,
    progress: Callable[[int], None],
    planners: Sequence[FleetPlannerName] = tuple(FleetPlannerName),
) -> FleetStudy:
    """Fly all runs in parallel processes, one per core by default. progress is called after each run."""
    tasks = [(planner, number) for number in settings.numbers for planner in planners]
    found: dict[tuple[FleetPlannerName, int], FleetResult] = {}
    processes = min(jobs or os.cpu_count() or 1, len(tasks))
    if processes == 1:
        for planner, number in tasks:
            found[planner, number] = run_fleet(settings, number, table, planner)
            progress(1)
    else:
        with uninterrupted():
            pool = multiprocessing.get_context("spawn").Pool(processes, _begin, (settings, table))
        with pool:
            for task, result in pool.imap_unordered(_fly, tasks):
                found[task] = result
                progress(1)
    return FleetStudy(
        settings, {planner: tuple(found[planner, number] for number in settings.numbers) for planner in planners}
    )


def fleet_table(study: FleetStudy) -> Table:
    """Return the figures for people: means, and the worst of all runs."""
    table = Table("mean / worst", *study.runs, box=box.SIMPLE_HEAD)
    for label, name, scale, digits, worst in (
        ("required side seen by at least one, %", "time_on_side_any", 100.0, 2, np.min),
        ("by the present course, %", "time_on_side_any_now", 100.0, 2, np.min),
        ("one in the band, %", "time_in_band_any", 100.0, 2, np.min),
        ("least separation, m", "min_separation_m", 1.0, 0, np.min),
        ("least range, m", "min_range_m", 1.0, 0, np.min),
        ("handovers of the side per run", "handovers", 1.0, 1, np.max),
        ("position error, m", "position_error_m", 1.0, 2, np.max),
    ):
        cells = []
        for runs in study.runs.values():
            known = scale * np.array([value for run in runs if np.isfinite(value := getattr(run, name))])
            cells.append(f"{known.mean():.{digits}f} / {worst(known):.{digits}f}" if known.size else "-")
        table.add_row(label, *cells)
    return table


def fleet_json(study: FleetStudy) -> dict[str, Any]:
    """Return the summary that ``--json`` writes."""
    settings = study.settings
    return {
        "planners": {planner.value: _figures(settings, runs) for planner, runs in study.runs.items()},
        "fleet": settings.fleet,
        **targets_json(settings),
    }


def _figures(settings: StudySettings, runs: Sequence[FleetResult]) -> dict[str, Any]:
    decision_ms = 1e3 * np.percentile(np.concatenate([run.decision_s for run in runs]), (50, 99))
    aircraft = [
        {
            name: spread(np.array([getattr(run.aircraft[k], name) for run in runs]), tail)
            for name, tail in _OF_EACH.items()
        }
        for k in range(settings.fleet)
    ]
    return {
        **{name: spread(np.array([getattr(run, name) for run in runs]), tail) for name, tail in _OF_ALL.items()},
        "decision_ms": {"p50": float(decision_ms[0]), "p99": float(decision_ms[1])},
        "aircraft": aircraft,
    }


_worker: tuple[StudySettings, ValueTable]


def _begin(settings: StudySettings, table: ValueTable) -> None:
    global _worker  # noqa: PLW0603  # what a worker needs is too large to come with every task
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _worker = settings, table


def _fly(task: tuple[FleetPlannerName, int]) -> tuple[tuple[FleetPlannerName, int], FleetResult]:
    settings, table = _worker
    planner, number = task
    return task, run_fleet(settings, number, table, planner)
