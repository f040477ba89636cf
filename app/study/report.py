"""What a study found: tables for people, summaries and rows for programs."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from sidelong.app.study.design import word
from sidelong.app.study.measures import ON_FLAT_GROUND, OVER_HILLS, WITHIN_PAN_LIMITS, Measure, decision_ms
from sidelong.app.study.settings import PARTS, StudySettings
from sidelong.app.study.store import MEASURES
from sidelong.app.study.study import PlannerResult, StudyResult
from sidelong.mission.core.path import FloatArray

_COLUMNS = ("planner", "run", "target", "draw", "seed", *MEASURES, "key")


def study_title(result: StudyResult) -> str:
    s, aircraft = result.settings, result.settings.aircraft()
    sensors = "perfect sensors" if s.perfect_sensors else "noisy laser and gimbal"
    target = f"to {s.requirement().target_speed_max_m_s:g} m/s"
    if s.tracks:
        target = f"recorded, {target}"
        runs = f"{len(s.numbers)} runs, {result.simulated_s / len(s.planners) / 3600.0:.1f} h"
    else:
        runs = f"{len(s.numbers)} runs of {s.duration_s / 60.0:.0f} min"
        target += f", legs of {s.legs_s[0]:g}-{s.legs_s[1]:g} s"
    return (
        f"{runs} at {aircraft.airspeed_m_s:g} m/s on circles of {aircraft.radius_m:g} m; target {target}; "
        f"wind {s.config.simulation.wind_speed_m_s:g} m/s; {sensors}"
    )


def study_parts(settings: StudySettings) -> str:
    return f"closed loop, {settings.autopilot}: {PARTS}"


def measures_of(settings: StudySettings) -> tuple[Measure, ...]:
    measures = ON_FLAT_GROUND if settings.hills is None else OVER_HILLS
    return (*measures, WITHIN_PAN_LIMITS) if settings.aircraft().has_pan_limit else measures


def right_aligned(table: Table, first: int) -> Table:
    """Return a table with its columns from the ``first`` on aligned to the right, and not broken."""
    for column in table.columns[first:]:
        column.justify, column.no_wrap = "right", True
    return table


def study_table(result: StudyResult) -> Table:
    """Return the comparison, a column for each planner."""
    table = right_aligned(Table("", "", *map(str, result.planners), box=box.SIMPLE_HEAD), 2)
    planners = list(result.planners.values())

    def row(label: str, name: str, digits: int, values: Iterable[float | None]) -> None:
        table.add_row(label, name, *("-" if one is None else f"{one:.{digits}f}" for one in values))

    for of in measures_of(result.settings):
        for name in ("mean", f"p{of.tail}", "worst"):
            label = of.label if name == "mean" else ""
            row(label, name, of.digits, [of.spread(of.shown(one[of.name]))[name] for one in planners])
    row("observation angle, °", "spread", 0, map(_angle_spread_deg, planners))
    for name in ("p50", "p99"):
        label = "decision, ms" if name == "p50" else ""
        row(label, name, 2, [decision_ms(one.decision_s)[name] for one in planners])
    return table


def sweep_rows(results: Sequence[StudyResult]) -> list[tuple[str, ...]]:
    """Return the comparison of designs: the headings, then a row for each design and planner."""
    first, measures = results[0].design, measures_of(results[0].settings)
    keys = (key.partition(".")[2] for key, _ in first.swept)
    rows = [
        (*map(word, dict(one.design.swept).values()), str(name), *(m.cell(planner[m.name]) for m in measures))
        for one in results
        for name, planner in one.planners.items()
    ]
    return [(*keys, "planner", *(one.heading for one in measures)), *rows]


def sweep_table(results: Sequence[StudyResult]) -> Table:
    """Return the comparison of designs, a row for each and planner."""
    headings, *rows = sweep_rows(results)
    table = right_aligned(Table(*headings, box=box.SIMPLE_HEAD, padding=(0, 0, 0, 1)), 0)
    for row in rows:
        table.add_row(*row)
    return table


def targets_json(settings: StudySettings) -> dict[str, Any]:
    """Return the study's conditions, as written by ``--json``."""
    return {
        "runs": settings.runs,
        "noise_draws": settings.noise_draws,
        "seed": settings.seed,
        "parts": PARTS,
        "targets": settings.runs,
        "skipped": len(settings.skipped),
        "skipped_targets": [{"file": file, "reason": reason} for file, reason in settings.skipped],
    }


def study_json(results: Sequence[StudyResult]) -> dict[str, Any]:
    """Return the summary that ``--json`` writes; of several designs each with its ``swept`` values."""
    each = [{str(name): _planner_json(one, of.settings) for name, one in of.planners.items()} for of in results]
    summary = {
        "planners": each[0] if len(each) == 1 else {},
        **targets_json(results[0].settings),
        "simulated_s": sum(one.simulated_s for one in results),
        "wall_s": results[0].wall_s,
    }
    if len(each) > 1:
        swept = (dict(one.design.swept) for one in results)
        summary["designs"] = [{"swept": of, "planners": own} for of, own in zip(swept, each, strict=True)]
    return summary


def _planner_json(planner: PlannerResult, settings: StudySettings) -> dict[str, Any]:
    return {
        "targets": settings.runs,
        "skipped": len(settings.skipped),
        **{one.name: one.spread(planner[one.name]) for one in measures_of(settings)},
        "observation_spread_deg": _angle_spread_deg(planner),
        "decision_ms": decision_ms(planner.decision_s),
    }


def _angle_spread_deg(planner: PlannerResult) -> float | None:
    values: FloatArray = planner["observation_spread_deg"]
    return float(np.nanmean(values)) if np.isfinite(values).any() else None


def export_runs(results: Sequence[StudyResult], file: Path) -> None:
    """Write a row for each run, as CSV. Columns: swept parameters, then the same for every study. Raises OSError."""
    columns = (*(key for key, _ in results[0].design.swept), *_COLUMNS)
    with file.open("w", newline="", encoding="utf-8") as out:
        csv.writer(out).writerows([columns, *_rows(results)])


def _rows(results: Sequence[StudyResult]) -> Iterator[tuple[Any, ...]]:
    for one in results:
        swept = [value for _, value in one.design.swept]
        for name, planner in one.planners.items():
            for k, run in enumerate(planner.runs):
                values = (float(planner[measure][k]) for measure in MEASURES)
                whose = str(name), run.number, run.target, run.draw, one.settings.seed
                yield *swept, *whose, *(None if math.isnan(value) else value for value in values), run.key
