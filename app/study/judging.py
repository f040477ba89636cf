"""The result of a run, as :mod:`sidelong.app.analysis.score` judges it."""

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
    """A flown run, sampled each step.

    Attributes:
        time_s: shape (n,).
        aircraft_m: east and north, shape (n, 2).
        target_m: east and north, shape (n, 2).
    """

    time_s: FloatArray
    aircraft_m: FloatArray
    target_m: FloatArray
    judged: Judgement


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """What a run came to. Fractions are 0..1, NaN where nothing could be judged: the target never moved.

    Attributes:
        time_in_band: fraction of time within the allowed range.
        time_on_side: fraction of time on the required side, by the course made good.
        time_on_side_now: the same by the present course.
        moves_per_hour: departures to another circle.
        reversals_per_hour: those within 10 s of the last one.
        observation_spread_deg: standard deviation of the observation angle.
        duration_s: time flown.
        time_in_sight: fraction of time in which the target is in sight; NaN over flat ground.
        time_in_sight_where_possible: the same of the time in which any position on the side and in the band sees it.
        min_clearance_m: least height over the ground; NaN over flat ground.
        time_within_pan_limits: fraction of time in which the gimbal can look at the target; NaN without limits.
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

    Args:
        log: time, aircraft (east, north), target (east, north) and further columns, in steps, shape (n, 5 or more);
            the eighth is 0 while the aircraft is out of its envelope.
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
    """Sum up a run.

    Args:
        log: as :func:`judged_log` takes it.
        changed_s: when each plan departed.
        decision_s: processor time of the decisions that were measured.
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
    """Return the shares of time on the side, on it by the present course, and in the band, by at least one aircraft.

    Args:
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
