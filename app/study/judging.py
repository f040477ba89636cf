"""How a run is judged: range band, side by the course made good, changes of plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sidelong.app.study.course import LONG, SHORT, course_made_good_rad
from sidelong.app.study.settings import StudySettings

FloatArray = npt.NDArray[np.float64]

STEP_S = 0.1
_JUDGED_EVERY = 5  # steps: the truth's course is taken at each half second
_QUICK_S = 10.0
_MOVED_M = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What was flown, sampled each step: arrays (n,). observation_rad: from the side's normal, wrapped."""

    time_s: FloatArray
    east_m: FloatArray
    north_m: FloatArray
    target_east_m: FloatArray
    target_north_m: FloatArray
    range_m: FloatArray
    observation_rad: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """Fractions are 0..1, not a number where nothing could be judged: the target never moved.

    time_on_side: by the course of a random target's leg, or by the course that a recorded one made good in 30 s;
    time_on_side_5s by that of 5 s, for both. quick_changes_per_hour: changes of plan within 10 s of the last.
    time_in_sight, that of the time in which any place of side and band sees the target, and min_clearance_m, the
    least height over the ground, are no numbers over flat ground. observation_histogram counts steps in bins of 5
    degrees from -180.
    """

    time_in_band: float
    time_on_side: float
    time_on_side_5s: float
    min_range_m: float
    max_range_m: float
    moves_per_hour: float
    quick_changes_per_hour: float
    observation_spread_deg: float
    duration_s: float
    time_in_sight: float
    time_in_sight_where_possible: float
    min_clearance_m: float
    observation_histogram: npt.NDArray[np.int64]
    decision_s: npt.NDArray[np.float32]
    track: Track | None


def judged(
    settings: StudySettings,
    log: FloatArray,
    changed_s: Sequence[float],
    decision_s: Sequence[float],
    keep_track: bool,
    over_ground: tuple[float, float, float] = (math.nan, math.nan, math.nan),
) -> RunResult:
    """Sum up a run. changed_s: when each plan was departed to.

    log (n, 6): time, aircraft (east, north), target (east, north), target's course. over_ground: time in sight, the
    same where that is possible, and the least clearance.
    """
    time_s, east_m, north_m, target_east_m, target_north_m, _ = log.T
    range_m = np.hypot(east_m - target_east_m, north_m - target_north_m)
    moved, short, observation_rad, half_width_rad = _observed(settings, log)
    in_band = (range_m >= settings.range_min_m) & (range_m <= settings.range_max_m)
    per_hour = 3600.0 / (STEP_S * len(log))
    return RunResult(
        float(in_band.mean()),
        _share_within(half_width_rad, observation_rad[moved] if settings.tracks else observation_rad),
        _share_within(half_width_rad, short[moved]),
        float(range_m.min()),
        float(range_m.max()),
        len(changed_s) * per_hour,
        int((np.diff(changed_s) < _QUICK_S - 1e-6).sum()) * per_hour,
        float(np.degrees(observation_rad).std()),
        STEP_S * len(log),
        *over_ground,
        np.histogram(np.degrees(observation_rad), bins=72, range=(-180.0, 180.0))[0],
        np.asarray(decision_s, np.float32),
        Track(time_s, east_m, north_m, target_east_m, target_north_m, range_m, observation_rad)
        if keep_track
        else None,
    )


def shares_of_any(settings: StudySettings, logs: FloatArray) -> tuple[float, float, float]:
    """Return the shares of time on the side, on it by the course of 5 s, and in the band, by at least one aircraft.

    logs (aircraft, n, 6): each as :func:`judged` takes it.
    """
    moved, width_rad = np.zeros(logs.shape[1], bool), math.pi
    on_side, on_side_5s, in_band = (np.zeros(logs.shape[1], bool) for _ in range(3))
    for log in logs:
        moved, short, observation_rad, width_rad = _observed(settings, log)
        range_m = np.hypot(log[:, 1] - log[:, 3], log[:, 2] - log[:, 4])
        within = (range_m >= settings.range_min_m) & (range_m <= settings.range_max_m)
        on_side |= (np.abs(observation_rad) <= width_rad) & within
        on_side_5s |= (np.abs(short) <= width_rad) & within
        in_band |= within
    counted = moved if settings.tracks else np.ones_like(moved)
    return _share(on_side[counted]), _share(on_side_5s[moved]), _share(in_band)


def _observed(
    settings: StudySettings, log: FloatArray
) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray, float]:
    """Return since when the target has moved, both observation angles (n,), and how wide the asked side is."""
    _, east_m, north_m, target_east_m, target_north_m, course_rad = log.T
    bearing_rad = np.arctan2(east_m - target_east_m, north_m - target_north_m)
    short_rad = _truth_course_rad(target_east_m, target_north_m, *SHORT)
    long_rad = _truth_course_rad(target_east_m, target_north_m, *LONG) if settings.tracks else course_rad
    moved = np.hypot(target_east_m - target_east_m[0], target_north_m - target_north_m[0]) > _MOVED_M
    moved = np.logical_or.accumulate(moved)
    requirement = settings.requirement()
    half_width_rad, sector = math.pi / 2, requirement.sector
    if sector is not None:
        half_width_rad = sector.half_width_rad
        short = observation_rad = _wrapped(bearing_rad - sector.middle_rad)
    else:
        turn_rad = requirement.side.normal_turn_rad
        short, observation_rad = (_wrapped(bearing_rad - course - turn_rad) for course in (short_rad, long_rad))
    if requirement.either_side:
        half_width_rad = math.pi
    return moved, short, observation_rad, half_width_rad


def _truth_course_rad(east_m: FloatArray, north_m: FloatArray, window_s: float, min_way_m: float) -> FloatArray:
    east_m, north_m, n = east_m[::_JUDGED_EVERY], north_m[::_JUDGED_EVERY], east_m.size
    course_rad = course_made_good_rad(east_m, north_m, _JUDGED_EVERY * STEP_S, window_s, min_way_m)
    return np.repeat(course_rad, _JUDGED_EVERY)[:n]


def _wrapped(angle_rad: FloatArray) -> FloatArray:
    return np.asarray((angle_rad + math.pi) % (2.0 * math.pi) - math.pi)


def _share_within(half_width_rad: float, observation_rad: FloatArray) -> float:
    return float((np.abs(observation_rad) <= half_width_rad).mean()) if observation_rad.size else math.nan


def _share(flags: npt.NDArray[np.bool_]) -> float:
    return float(flags.mean()) if flags.size else math.nan
