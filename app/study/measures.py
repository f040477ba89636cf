"""The measures of a run, and how tables, pages and summaries show them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sidelong.mission.core.path import FloatArray


@dataclass(frozen=True, slots=True)
class Measure:
    """One measure of a run.

    Attributes:
        name: Its attribute of a result, and its key in summaries.
        label: What it is, with the unit that tables show.
        heading: The same over a narrow column.
        tail: Percentile of the runs that are nearly the worst; below 50 the least value is the worst one.
        digits: Digits after the point.
    """

    name: str
    label: str
    heading: str
    tail: int
    digits: int

    def shown(self, values: FloatArray) -> FloatArray:
        """Return the known values in the unit that tables show."""
        return (100.0 if self.label.endswith("%") else 1.0) * values[np.isfinite(values)]

    def spread(self, values: FloatArray) -> dict[str, float | None]:
        """Return mean, tail and worst of the known values; None where there are none."""
        known, names = values[np.isfinite(values)], ("mean", f"p{self.tail}", "worst")
        if not known.size:
            return dict.fromkeys(names)
        worst = known.min() if self.tail < 50 else known.max()
        return dict(zip(names, map(float, (known.mean(), np.percentile(known, self.tail), worst)), strict=True))

    def cell(self, values: FloatArray) -> str:
        """Return mean and worst of the known values in words."""
        found = self.spread(self.shown(values))
        mean, worst = found["mean"], found["worst"]
        return "-" if mean is None else f"{mean:.{self.digits}f}/{worst:.{self.digits}f}"


BAND = Measure("time_in_band", "time in band, %", "in band, %", 5, 2)
SIDE = Measure("time_on_side", "time on side, %", "on side, %", 5, 1)
LEAST = Measure("min_range_m", "least range, m", "least, m", 5, 0)
MOVES = Measure("moves_per_hour", "moves per hour", "moves/h", 95, 0)
REVERSALS = Measure("reversals_per_hour", "reversals per hour", "reversals/h", 95, 1)
ON_FLAT_GROUND = (
    BAND,
    SIDE,
    Measure("time_on_side_now", "by the present course, %", "now, %", 5, 1),
    LEAST,
    Measure("max_range_m", "greatest range, m", "greatest, m", 95, 0),
    MOVES,
    REVERSALS,
)
WITHIN_PAN_LIMITS = Measure("time_within_pan_limits", "within the pan limits, %", "within pan, %", 5, 1)
OVER_HILLS = (
    *ON_FLAT_GROUND,
    Measure("time_in_sight", "time in sight, %", "in sight, %", 5, 1),
    Measure("time_in_sight_where_possible", "where some place sees it, %", "where possible, %", 5, 1),
    Measure("min_clearance_m", "least height over ground, m", "clear, m", 5, 0),
)
OF_FLEETS = (
    Measure("time_on_side_any", "required side seen by at least one, %", "", 5, 2),
    Measure("time_on_side_any_now", "by the present course, %", "", 5, 2),
    Measure("time_in_band_any", "one in the band, %", "", 5, 2),
    Measure("min_separation_m", "least separation, m", "", 5, 0),
    LEAST,
    Measure("handovers", "handovers of the side per run", "", 95, 1),
    Measure("position_error_m", "position error, m", "", 95, 2),
    Measure("in_ellipse", "target within the 95 % ellipse, %", "", 5, 1),
)
EXPLAINED = (
    "Mean / worst run. Now: on the side by the target's present course. Reversals: moves within 10 s of the last one."
)
"""What stands under tables with headings."""


def decision_ms(decision_s: npt.NDArray[np.float32]) -> dict[str, float]:
    """Return percentiles of the processor time of decisions, ms."""
    p50_s, p99_s = np.percentile(decision_s, (50, 99))
    return {"p50": 1e3 * float(p50_s), "p99": 1e3 * float(p99_s)}
