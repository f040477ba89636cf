"""What a study found: the table for people, the summary for programs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from rich import box
from rich.table import Table

from sidelong.app.study.settings import PARTS, Fidelity, StudySettings
from sidelong.app.study.study import PlannerResult, Study, StudyResult

FloatArray = npt.NDArray[np.float64]

_Spread = tuple[str, Callable[[PlannerResult], FloatArray], int, Callable[[FloatArray], Any], int]
_OVER_GROUND = ("time_in_sight", "time_in_sight_where_possible", "min_clearance_m")
# The table's rows: label, the runs' values, percentile of the tail, which end is worst, digits.
_SPREADS: tuple[_Spread, ...] = (
    ("time in band, %", lambda p: 100.0 * p.time_in_band, 5, np.min, 2),
    ("time on side, %", lambda p: 100.0 * p.time_on_side, 5, np.min, 1),
    ("by the present course, %", lambda p: 100.0 * p.time_on_side_now, 5, np.min, 1),
    ("least range, m", lambda p: p.min_range_m, 5, np.min, 0),
    ("greatest range, m", lambda p: p.max_range_m, 95, np.max, 0),
)
# The same over hills.
_SPREADS_OVER_GROUND: tuple[_Spread, ...] = (
    ("time in sight, %", lambda p: 100.0 * p.time_in_sight, 5, np.min, 1),
    ("where some place sees it, %", lambda p: 100.0 * p.time_in_sight_where_possible, 5, np.min, 1),
    ("least height over ground, m", lambda p: p.min_clearance_m, 5, np.min, 0),
)


def study_title(result: StudyResult) -> str:
    """Return one line that describes the study."""
    s = result.settings
    target = f"to {s.target_speed_max_m_s:g} m/s"
    if s.tracks:
        target = f"recorded, {target}"
        runs = f"{len(s.numbers)} runs, {result.simulated_s / len(s.planners) / 3600.0:.1f} h"
    else:
        runs = f"{len(s.numbers)} runs of {s.duration_s / 60.0:.0f} min"
        target += f", legs of {s.legs_s[0]:g}-{s.legs_s[1]:g} s"
    return (
        f"{runs} at {s.airspeed_m_s:g} m/s on circles of {s.radius_m:g} m; target {target}; "
        f"wind {s.wind_speed_m_s:g} m/s; {'perfect sensors' if s.perfect_sensors else 'noisy laser and gimbal'}"
    )


def study_fidelity(settings: StudySettings) -> str:
    """Return one line that names the fidelity and the parts that were flown."""
    autopilot = f", {settings.autopilot}" if settings.fidelity is Fidelity.CLOSED_LOOP else ""
    return f"fidelity {settings.fidelity}{autopilot}: {PARTS[settings.fidelity]}"


def study_table(result: StudyResult) -> Table:
    """Return the comparison, a column for each planner."""
    table = Table("", "", *(str(name) for name in result.planners), box=box.SIMPLE_HEAD)
    for column in table.columns[2:]:
        column.justify = "right"
    planners = list(result.planners.values())
    for label, values, tail, worst, digits in _SPREADS + (_SPREADS_OVER_GROUND if result.settings.hills else ()):
        known = [v[np.isfinite(v)] for v in map(values, planners)]
        for name, of in (("mean", np.mean), (f"{tail} %", partial(np.percentile, q=tail)), ("worst", worst)):
            words = (f"{of(v):.{digits}f}" if v.size else "-" for v in known)
            table.add_row(label if name == "mean" else "", name, *words)
    table.add_row("moves per hour", "mean", *(f"{p.moves_per_hour.mean():.0f}" for p in planners))
    table.add_row("reversals per hour", "mean", *(f"{p.reversals_per_hour.mean():.1f}" for p in planners))
    table.add_row("observation angle, °", "spread", *(_mean(p.observation_spread_deg) for p in planners))
    for tail in (50, 99):
        times_s = (1e3 * float(np.percentile(p.decision_s, tail)) for p in planners)
        table.add_row("decision, ms" if tail == 50 else "", f"{tail} %", *(f"{t:.2f}" for t in times_s))
    return table


def sweep_table(study: Study) -> Table:
    """Return the comparison of designs, a row for each and planner."""
    keys = [key.partition(".")[2] for key, _ in study.designs[0].swept]
    headings = summary_headings(study.designs[0].settings)
    table = Table(*keys, "planner", *headings, box=box.SIMPLE_HEAD, padding=(0, 0, 0, 1))
    for column in table.columns:
        column.justify, column.no_wrap = "right", True
    for design in study.designs:
        for name, planner in study.result(design).planners.items():
            swept = (f"{value:g}" if isinstance(value, float) else value for _, value in design.swept)
            table.add_row(*swept, str(name), *summary_row(design.settings, planner))
    return table


def summary_headings(settings: StudySettings) -> tuple[str, ...]:
    """Return the headings over :func:`summary_row`."""
    return tuple(heading for heading, _ in _summary(settings))


def summary_row(settings: StudySettings, planner: PlannerResult) -> tuple[str, ...]:
    """Return a planner's figures in one line."""
    return tuple(words(planner) for _, words in _summary(settings))


def _summary(settings: StudySettings) -> tuple[tuple[str, Callable[[PlannerResult], str]], ...]:
    return _SUMMARY if settings.hills is None else _SUMMARY + _SUMMARY_OVER_GROUND


def _mean(values: FloatArray) -> str:
    values = values[np.isfinite(values)]
    return f"{values.mean():.0f}" if values.size else "-"


def _mean_and_worst(values: FloatArray) -> str:
    values = 100.0 * values[np.isfinite(values)]
    return f"{values.mean():.1f}/{values.min():.1f}" if values.size else "-"


HEADINGS_EXPLAINED = (
    "Shares of time: mean / worst run; now: on the side by the target's present course. Least range of all runs. "
    "Moves per hour, and reversals: moves within 10 s of the last one."
)
_SUMMARY: tuple[tuple[str, Callable[[PlannerResult], str]], ...] = (
    ("in band, %", lambda p: _mean_and_worst(p.time_in_band)),
    ("on side, %", lambda p: _mean_and_worst(p.time_on_side)),
    ("now, %", lambda p: _mean_and_worst(p.time_on_side_now)),
    ("least, m", lambda p: f"{p.min_range_m.min():.0f}"),
    ("moves/h", lambda p: f"{p.moves_per_hour.mean():.0f}"),
    ("reversals/h", lambda p: f"{p.reversals_per_hour.mean():.1f}"),
)
_SUMMARY_OVER_GROUND: tuple[tuple[str, Callable[[PlannerResult], str]], ...] = (
    ("in sight, %", lambda p: _mean_and_worst(p.time_in_sight)),
    ("where possible, %", lambda p: _mean_and_worst(p.time_in_sight_where_possible)),
    ("clear, m", lambda p: f"{np.nanmin(p.min_clearance_m):.0f}"),
)


def targets_json(settings: StudySettings) -> dict[str, Any]:
    """Return the study's conditions, as written by ``--json``."""
    return {
        "runs": settings.runs,
        "noise_draws": settings.noise_draws,
        "seed": settings.seed,
        "fidelity": str(settings.fidelity),
        "parts": PARTS[settings.fidelity],
        "targets": settings.runs,
        "skipped": len(settings.skipped),
        "skipped_targets": [{"file": file, "reason": reason} for file, reason in settings.skipped],
    }


def study_json(result: StudyResult) -> dict[str, Any]:
    """Return the summary that ``--json`` writes."""
    return {
        "planners": planners_json(result),
        **targets_json(result.settings),
        "simulated_s": result.simulated_s,
        "wall_s": result.wall_s,
    }


def sweep_json(study: Study) -> dict[str, Any]:
    """Return the summary of a study with several designs: ``designs``, each with its ``swept`` values."""
    of = [{"swept": dict(one.swept), "planners": planners_json(study.result(one))} for one in study.designs]
    whole = study_json(study.result(study.designs[0]))
    flown_s = study.store.simulated_s(study.run_ids())
    return whole | {"planners": {}, "designs": of, "simulated_s": flown_s}


def planners_json(result: StudyResult) -> dict[str, Any]:
    """Return each planner's figures."""
    return {str(name): _planner_json(planner, result.settings) for name, planner in result.planners.items()}


def _planner_json(planner: PlannerResult, settings: StudySettings) -> dict[str, Any]:
    p50_s, p99_s = np.percentile(planner.decision_s, (50, 99))
    return {
        "targets": settings.runs,
        "skipped": len(settings.skipped),
        "time_in_band": spread(planner.time_in_band, 5),
        "time_on_side": spread(planner.time_on_side, 5),
        "time_on_side_now": spread(planner.time_on_side_now, 5),
        "min_range_m": spread(planner.min_range_m, 5),
        "max_range_m": spread(planner.max_range_m, 95),
        "moves_per_hour": spread(planner.moves_per_hour, 95),
        "reversals_per_hour": spread(planner.reversals_per_hour, 95),
        **({name: spread(getattr(planner, name), 5) for name in _OVER_GROUND} if settings.hills else {}),
        "observation_spread_deg": spread(planner.observation_spread_deg, 95)["mean"],
        "decision_ms": {"p50": 1e3 * float(p50_s), "p99": 1e3 * float(p99_s)},
    }


def spread(values: FloatArray, tail: int) -> dict[str, float | None]:
    """Return mean, tail and worst; the worst is the least where the tail is a low percentile, else the greatest."""
    values = values[np.isfinite(values)]
    if not values.size:
        return dict.fromkeys(("mean", f"p{tail}", "worst"))
    worst = values.min() if tail < 50 else values.max()
    return {"mean": float(values.mean()), f"p{tail}": float(np.percentile(values, tail)), "worst": float(worst)}
