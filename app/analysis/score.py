"""How well the target was watched: time in the band, time on the side, extremes, error of the estimate."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from estimators.frames import wrap_rad
from mission.core.requirement import Requirement

# Below this speed the target keeps its last course (the definition of the requirement).
_STANDING_M_S = 0.3


Asked = Sequence[tuple[float, Requirement]]
"""(since, requirement) in order of time, at least one: a person may change it in flight."""


def asked_at(asked: Asked, time_s: float) -> Requirement:
    """Return the requirement of a time; the first also of before."""
    return next((one for since_s, one in reversed(asked) if since_s <= time_s), asked[0][1])


@dataclass(frozen=True, slots=True)
class Moment:
    """Aircraft and target at one time, in the plane, with the target's velocity."""

    time_s: float
    aircraft_east_m: float
    aircraft_north_m: float
    target_east_m: float
    target_north_m: float
    target_velocity_east_m_s: float
    target_velocity_north_m_s: float


@dataclass(frozen=True, slots=True)
class Score:
    """Fractions are 0..1 of the time scored; None where nothing was scored."""

    duration_s: float
    time_in_band: float | None
    time_on_side: float | None
    min_range_m: float | None
    max_range_m: float | None
    source: Literal["truth", "estimate"]


@dataclass(frozen=True, slots=True)
class Judged:
    """How one moment was: where the target is from the aircraft, and whether the requirement was kept."""

    time_s: float
    range_m: float
    in_band: bool
    on_side: bool


def judge(moments: Iterable[Moment], asked: Asked) -> Iterator[Judged]:
    """Judge moments in order of time.

    Before the target has a course every place is on the side.
    """
    course_rad: float | None = None
    for moment in moments:
        requirement = asked_at(asked, moment.time_s)
        east_m = moment.aircraft_east_m - moment.target_east_m
        north_m = moment.aircraft_north_m - moment.target_north_m
        range_m = math.hypot(east_m, north_m)
        velocity = (moment.target_velocity_east_m_s, moment.target_velocity_north_m_s)
        if math.hypot(*velocity) >= _STANDING_M_S:
            course_rad = math.atan2(*velocity)
        if requirement.sector is not None:
            off_rad = wrap_rad(math.atan2(east_m, north_m) - requirement.sector.middle_rad)
            on_side = abs(off_rad) <= requirement.sector.half_width_rad
        elif requirement.either_side:
            on_side = True  # one of the two sides is always the nearer one
        else:
            normal_rad = None if course_rad is None else course_rad + requirement.side.normal_turn_rad
            on_side = normal_rad is None or east_m * math.sin(normal_rad) + north_m * math.cos(normal_rad) >= 0.0
        in_band = requirement.range_min_m <= range_m <= requirement.range_max_m
        yield Judged(moment.time_s, range_m, in_band, on_side)


def score(moments: Iterable[Moment], asked: Asked, source: Literal["truth", "estimate"]) -> Score:
    """Score the moments as ``judge`` has them, each weighted by the time until the next."""
    in_band_s = on_side_s = total_s = 0.0
    min_m, max_m = math.inf, -math.inf
    last: Judged | None = None
    for judged in judge(moments, asked):
        if last is not None:
            step_s = judged.time_s - last.time_s
            total_s += step_s
            in_band_s += step_s * last.in_band
            on_side_s += step_s * last.on_side
        min_m, max_m = min(min_m, judged.range_m), max(max_m, judged.range_m)
        last = judged
    if total_s <= 0.0:
        return Score(0.0, None, None, None, None, source)
    return Score(total_s, in_band_s / total_s, on_side_s / total_s, min_m, max_m, source)
