"""A study with several aircraft on each target."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from app.study.fleet import FleetResult, run_fleet
from app.study.processes import uninterrupted
from app.study.report import spread
from app.study.settings import StudySettings
from mission.predictive.value_table import ValueTable

# What is told of each aircraft by itself, with the percentile of its tail.
_OF_EACH = {
    "time_in_band": 5,
    "time_on_side": 5,
    "time_on_side_5s": 5,
    "min_range_m": 5,
    "moves_per_hour": 95,
    "quick_changes_per_hour": 95,
}


@dataclass(frozen=True, slots=True, eq=False)
class FleetStudy:
    """All runs, in order."""

    settings: StudySettings
    runs: tuple[FleetResult, ...]


def fly_fleets(
    settings: StudySettings, table: ValueTable, jobs: int | None, progress: Callable[[int], None]
) -> FleetStudy:
    """Fly all runs on so many processes, one for each core by default. progress hears of each run that is done."""
    numbers = settings.numbers
    found: dict[int, FleetResult] = {}
    with uninterrupted():
        pool = multiprocessing.get_context("spawn").Pool(jobs or os.cpu_count() or 1, _begin, (settings, table))
    with pool:
        for number, result in pool.imap_unordered(_fly, numbers):
            found[number] = result
            progress(1)
    return FleetStudy(settings, tuple(found[number] for number in numbers))


def fleet_table(study: FleetStudy) -> Table:
    """Return the figures for people."""
    table = Table("", "mean", "worst", box=box.SIMPLE_HEAD)
    for label, values, scale, digits in (
        ("side seen by at least one, %", [run.time_on_side_any for run in study.runs], 100.0, 2),
        ("by the course of 5 s, %", [run.time_on_side_any_5s for run in study.runs], 100.0, 2),
        ("one in the band, %", [run.time_in_band_any for run in study.runs], 100.0, 2),
        ("least separation, m", [run.min_separation_m for run in study.runs], 1.0, 0),
        ("least range, m", [run.min_range_m for run in study.runs], 1.0, 0),
    ):
        known = scale * np.array([value for value in values if np.isfinite(value)])
        row = (f"{known.mean():.{digits}f}", f"{known.min():.{digits}f}") if known.size else ("-", "-")
        table.add_row(label, *row)
    table.add_row("handovers of the side per run", f"{np.mean([run.handovers for run in study.runs]):.1f}", "")
    return table


def fleet_json(study: FleetStudy) -> dict[str, Any]:
    """Return the summary that ``--json`` writes."""
    settings, runs = study.settings, study.runs

    def over(name: str, tail: int = 5) -> dict[str, float | None]:
        return spread(np.array([getattr(run, name) for run in runs]), tail)

    aircraft = [
        {
            name: spread(np.array([getattr(run.aircraft[k], name) for run in runs]), tail)
            for name, tail in _OF_EACH.items()
        }
        for k in range(settings.fleet)
    ]
    decision_ms = 1e3 * np.percentile(np.concatenate([run.decision_s for run in runs]), (50, 99))
    figures = {
        "targets": settings.runs,
        "skipped": len(settings.skipped),
        "time_on_side_any": over("time_on_side_any"),
        "time_on_side_any_5s": over("time_on_side_any_5s"),
        "time_in_band_any": over("time_in_band_any"),
        "min_separation_m": over("min_separation_m"),
        "min_range_m": over("min_range_m"),
        "handovers": over("handovers", 95),
        "decision_ms": {"p50": float(decision_ms[0]), "p99": float(decision_ms[1])},
        "aircraft": aircraft,
    }
    return {
        "planners": {"predictive": figures},
        "fleet": settings.fleet,
        "runs": settings.runs,
        "noise_draws": settings.noise_draws,
        "seed": settings.seed,
        "targets": settings.runs,
        "skipped": len(settings.skipped),
        "skipped_targets": [{"file": file, "reason": reason} for file, reason in settings.skipped],
    }


_worker: tuple[StudySettings, ValueTable]


def _begin(settings: StudySettings, table: ValueTable) -> None:
    global _worker  # noqa: PLW0603  # what a worker needs is too large to come with every task
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _worker = settings, table


def _fly(number: int) -> tuple[int, FleetResult]:
    settings, table = _worker
    return number, run_fleet(settings, number, table)
