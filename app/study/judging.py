"""The result of a run, its measures, and how tables, pages and summaries show them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sidelong.app.analysis.score import Judgement, Samples, judge, score, within_pan_limits
from sidelong.app.simulation.target import STEP_S
from sidelong.app.study.settings import StudySettings
from sidelong.mission.core.path import FloatArray

_WITHIN = 7  # the column of a log: whether the aircraft is within its envelope


@dataclass(frozen=True, slots=True, eq=False)
class JudgedTrack:
    """A flown run, sampled each step: times (n,), east and north (n, 2)."""

    time_s: FloatArray
    aircraft_m: FloatArray
    target_m: FloatArray
    judged: Judgement


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """What a run came to. Fractions of time are 0..1, NaN where nothing could be judged: the target never moved.

    Attributes:
        time_on_side: by the course made good; time_on_side_now: by the present one.
        observation_spread_deg: standard deviation of the observation angle.
        time_in_sight: NaN over flat ground, as the clearance.
        time_in_sight_where_possible: of the time in which any position on the side and in the band sees the target.
        time_within_pan_limits: NaN without limits.
        decision_s: processor time of the decisions that were measured.
        track: the flown path, None unless asked for.
    """

    time_in_band: float
    time_on_side: float
    time_on_side_now: float
    min_range_m: float
    max_range_m: float
    moves_per_hour: float
    reversals_per_hour: float
    observation_spread_deg: float
    duration_s: float
    time_in_sight: float
    time_in_sight_where_possible: float
    min_clearance_m: float
    time_within_pan_limits: float
    decision_s: npt.NDArray[np.float32]
    track: JudgedTrack | None


def judged_log(settings: StudySettings, log: FloatArray) -> Judgement:
    """Judge each step of a run.

    log: time, aircraft (east, north), target (east, north) and further columns, in steps, shape (n, 5 or more); the
    eighth is 0 while the aircraft is out of its envelope.
    """
    velocity_m_s = np.gradient(log[:, 3:5], log[:, 0], axis=0)
    samples = Samples(log[:, 0], log[:, 1:3], log[:, 3:5], velocity_m_s)
    steps = judge(samples, ((-math.inf, settings.requirement()),))
    return steps.where(log[:, _WITHIN] > 0.0) if log.shape[1] > _WITHIN else steps


def judged(
    settings: StudySettings,
    log: FloatArray,
    changed_s: Sequence[float],
    decision_s: Sequence[float],
    keep_track: bool,
    over_ground: tuple[float, float, float] = (math.nan, math.nan, math.nan),
) -> RunResult:
    """Sum up a log as :func:`judged_log` takes it; changed_s: when each plan departed.

    over_ground: time in sight, the same where that is possible, and the least clearance.
    """
    steps = judged_log(settings, log)
    duration_s = STEP_S * len(log)
    found = score(steps, "truth", changed_s, end_s=float(log[-1, 0]) + STEP_S)
    angle_deg = np.degrees(steps.observation_rad[np.isfinite(steps.observation_rad)])
    scored = found.time_in_band, found.time_on_side, found.time_on_side_now, found.min_range_m, found.max_range_m
    in_band, on_side, on_side_now, min_range_m, max_range_m = (math.nan if one is None else one for one in scored)
    return RunResult(
        in_band,
        on_side,
        on_side_now,
        min_range_m,
        max_range_m,
        3600.0 * found.moves / duration_s,
        3600.0 * found.reversals / duration_s,
        float(angle_deg.std()) if angle_deg.size else math.nan,
        duration_s,
        *over_ground,
        _within_pan_limits(settings, log),
        np.asarray(decision_s, np.float32),
        JudgedTrack(log[:, 0], log[:, 1:3], log[:, 3:5], steps) if keep_track else None,
    )


def _within_pan_limits(settings: StudySettings, log: FloatArray) -> float:
    """Return the share of the time in which the gimbal can look at the target; NaN if it pans all around."""
    aircraft, wind = settings.aircraft(), settings.wind
    if not aircraft.has_pan_limit:
        return math.nan
    # The nose points along the velocity through the air.
    air_m_s = np.gradient(log[:, 1:3], log[:, 0], axis=0) - (wind.east_m_s, wind.north_m_s)
    heading_rad = np.arctan2(air_m_s[:, 0], air_m_s[:, 1])
    return float(within_pan_limits(log[:, 1:3], log[:, 3:5], heading_rad, aircraft.pan_limit_rad).mean())


def shares_of_any(settings: StudySettings, logs: FloatArray) -> tuple[float, float, float]:
    """Return shares of time with at least one aircraft (in band and on side, so by the present course, in band).

    The first two are of the time in which the side is known, NaN where it never is.

    logs: of each aircraft as :func:`judged` takes it, shape (aircraft, n, 6 or more).
    """
    each = [judged_log(settings, log) for log in logs]
    known, in_band = (
        np.logical_or.reduce([getattr(one, name) for one in each]) for name in ("side_known", "in_band")
    )
    on_side = np.logical_or.reduce([one.on_side & one.in_band for one in each])
    now = np.logical_or.reduce([one.on_side_now & one.in_band for one in each])
    return _share(on_side[known]), _share(now[known]), _share(in_band)


def _share(flags: npt.NDArray[np.bool_]) -> float:
    return float(flags.mean()) if flags.size else math.nan


@dataclass(frozen=True, slots=True)
class Measure:
    """One measure of a run: its name in results and summaries, its label, and a heading over a narrow column.

    tail: percentile of the runs that are nearly the worst; below 50 the least value is the worst one.
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
        """Return mean and worst of the values as a table has them."""
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


def decision_ms(decision_s: npt.NDArray[np.float32]) -> dict[str, float]:
    """Return percentiles of the processor time of decisions, ms."""
    p50_s, p99_s = np.percentile(decision_s, (50, 99))
    return {"p50": 1e3 * float(p50_s), "p99": 1e3 * float(p99_s)}
