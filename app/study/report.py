"""What a study found: the table for people, the summary for programs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from rich import box
from rich.table import Table

from app.study.study import PlannerResult, StudyResult

FloatArray = npt.NDArray[np.float64]

# The table's rows: label, the runs' values, percentile of the tail, which end is worst, digits.
_SPREADS: tuple[tuple[str, Callable[[PlannerResult], FloatArray], int, Callable[[FloatArray], Any], int], ...] = (
    ("time in band, %", lambda p: 100.0 * p.time_in_band, 5, np.min, 2),
    ("time on side, %", lambda p: 100.0 * p.time_on_side, 5, np.min, 1),
    ("least range, m", lambda p: p.min_range_m, 5, np.min, 0),
    ("greatest range, m", lambda p: p.max_range_m, 95, np.max, 0),
)


def study_title(result: StudyResult) -> str:
    """Return one line that tells what was flown."""
    s = result.settings
    return (
        f"{s.runs} runs of {s.duration_s / 60.0:.0f} min at {s.airspeed_m_s:g} m/s on circles of {s.radius_m:g} m; "
        f"target to {s.target_speed_max_m_s:g} m/s, legs of {s.legs_s[0]:g}-{s.legs_s[1]:g} s; "
        f"wind {s.wind_speed_m_s:g} m/s; {'perfect sensors' if s.perfect_sensors else 'noisy laser and gimbal'}"
    )


def study_table(result: StudyResult) -> Table:
    """Return the comparison, a column for each planner."""
    table = Table("", "", *(str(name) for name in result.planners), box=box.SIMPLE_HEAD)
    for column in table.columns[2:]:
        column.justify = "right"
    planners = list(result.planners.values())
    for label, values, tail, worst, digits in _SPREADS:
        table.add_row(label, "mean", *(f"{values(p).mean():.{digits}f}" for p in planners))
        table.add_row("", f"{tail} %", *(f"{np.percentile(values(p), tail):.{digits}f}" for p in planners))
        table.add_row("", "worst", *(f"{worst(values(p)):.{digits}f}" for p in planners))
    table.add_row("moves per hour", "mean", *(f"{p.moves_per_hour.mean():.0f}" for p in planners))
    table.add_row("observation angle, °", "spread", *(f"{p.observation_spread_deg.mean():.0f}" for p in planners))
    for tail in (50, 99):
        times_s = (1e3 * float(np.percentile(p.decision_s, tail)) for p in planners)
        table.add_row("decision, ms" if tail == 50 else "", f"{tail} %", *(f"{t:.2f}" for t in times_s))
    return table


def study_json(result: StudyResult) -> dict[str, Any]:
    """Return the summary that ``--json`` writes."""
    return {
        "planners": {str(name): _planner_json(planner) for name, planner in result.planners.items()},
        "runs": result.settings.runs,
        "seed": result.settings.seed,
        "simulated_s": result.simulated_s,
        "wall_s": result.wall_s,
    }


def _planner_json(planner: PlannerResult) -> dict[str, Any]:
    p50_s, p99_s = np.percentile(planner.decision_s, (50, 99))
    return {
        "time_in_band": _spread(planner.time_in_band),
        "time_on_side": _spread(planner.time_on_side),
        "min_range_m": {"worst": float(planner.min_range_m.min())},
        "max_range_m": {"worst": float(planner.max_range_m.max())},
        "moves_per_hour": float(planner.moves_per_hour.mean()),
        "observation_spread_deg": float(planner.observation_spread_deg.mean()),
        "decision_ms": {"p50": 1e3 * float(p50_s), "p99": 1e3 * float(p99_s)},
    }


def _spread(values: FloatArray) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "p5": float(np.percentile(values, 5)),
        "worst": float(values.min()),
    }
