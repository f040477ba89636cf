"""How well the target was watched: time in the band, time on the side, extremes, error of the estimate."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from sidelong.app.analysis.target_course import TargetCourse
from sidelong.estimators.frames import wrap_rad
from sidelong.mission.core.requirement import Requirement

STANDING_M_S = 0.3  # the truth's

Asked = Sequence[tuple[float, Requirement]]
"""(since, requirement) in order of time, at least one: a person may change it in flight."""


def asked_at(asked: Asked, time_s: float) -> Requirement:
    """Return the requirement of a time; the first also of before."""
    return next((one for since_s, one in reversed(asked) if since_s <= time_s), asked[0][1])


@dataclass(frozen=True, slots=True)
class Moment:
    """Aircraft and target at one time, in the plane, with the target's velocity. target: its name in a fleet."""

    time_s: float
    aircraft_east_m: float
    aircraft_north_m: float
    target_east_m: float
    target_north_m: float
    target_velocity_east_m_s: float
    target_velocity_north_m_s: float
    target: str = ""


@dataclass(frozen=True, slots=True)
class Score:
    """Fractions are 0..1 of the time scored; None where nothing was scored.

    time_on_side: of the time after the target has moved, by its course made good over the requirement's horizon;
    time_on_side_now: by its present course.
    """

    duration_s: float
    time_in_band: float | None
    time_on_side: float | None
    min_range_m: float | None
    max_range_m: float | None
    source: Literal["truth", "estimate"]
    time_on_side_now: float | None = None


@dataclass(frozen=True, slots=True)
class Judged:
    """How one moment was: where the target is from the aircraft, and whether the requirement was kept.

    on_side: as :class:`Score` has it; on_side_now: by the present course. Both hold, and side_known does not, while
    the target has made good no course.
    """

    time_s: float
    range_m: float
    in_band: bool
    on_side: bool
    on_side_now: bool = True
    side_known: bool = True


def judge(moments: Iterable[Moment], asked: Asked) -> Iterator[Judged]:
    """Judge moments in order of time."""
    course, watched = TargetCourse(STANDING_M_S), ""
    for moment in moments:
        if moment.target != watched:
            course, watched = TargetCourse(STANDING_M_S), moment.target
        requirement = asked_at(asked, moment.time_s)
        east_m = moment.aircraft_east_m - moment.target_east_m
        north_m = moment.aircraft_north_m - moment.target_north_m
        range_m = math.hypot(east_m, north_m)
        in_band = requirement.range_min_m <= range_m <= requirement.range_max_m
        velocity = (moment.target_velocity_east_m_s, moment.target_velocity_north_m_s)
        place = moment.target_east_m, moment.target_north_m
        course.take(moment.time_s, place, velocity, requirement.course_horizon_s)
        if requirement.sector is not None:
            off_rad = wrap_rad(math.atan2(east_m, north_m) - requirement.sector.middle_rad)
            within = abs(off_rad) <= requirement.sector.half_width_rad
            yield Judged(moment.time_s, range_m, in_band, within, within)
        elif requirement.either_side:  # one of the two sides is always the nearer one
            yield Judged(moment.time_s, range_m, in_band, on_side=True)
        else:
            turn_rad = requirement.side.normal_turn_rad
            beside = _beside(east_m, north_m, course.made_good_rad, turn_rad)
            now = _beside(east_m, north_m, course.present_rad, turn_rad)
            yield Judged(moment.time_s, range_m, in_band, beside, now, course.made_good_rad is not None)


def _beside(east_m: float, north_m: float, course_rad: float | None, turn_rad: float) -> bool:
    if course_rad is None:
        return True
    return east_m * math.sin(course_rad + turn_rad) + north_m * math.cos(course_rad + turn_rad) >= 0.0


def score(moments: Iterable[Moment], asked: Asked, source: Literal["truth", "estimate"]) -> Score:
    """Score the moments as ``judge`` has them, each weighted by the time until the next."""
    in_band_s = on_side_s = on_side_now_s = known_s = total_s = 0.0
    min_m, max_m = math.inf, -math.inf
    last: Judged | None = None
    for judged in judge(moments, asked):
        if last is not None:
            step_s = judged.time_s - last.time_s
            total_s += step_s
            in_band_s += step_s * last.in_band
            known_s += step_s * last.side_known
            on_side_s += step_s * (last.side_known and last.on_side)
            on_side_now_s += step_s * (last.side_known and last.on_side_now)
        min_m, max_m = min(min_m, judged.range_m), max(max_m, judged.range_m)
        last = judged
    if total_s <= 0.0:
        return Score(0.0, None, None, None, None, source)
    on_side, now = (on_side_s / known_s, on_side_now_s / known_s) if known_s > 0.0 else (None, None)
    return Score(total_s, in_band_s / total_s, on_side, min_m, max_m, source, now)
