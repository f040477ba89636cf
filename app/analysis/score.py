"""The judge: how well the target was watched. Flights, replays, reports, the page and studies use this module alone.

- **Band**: the horizontal range is within ``range_min_m`` to ``range_max_m`` of the requirement.
- **Side**: the aircraft is within 90 degrees of the normal of the target's course, on the required side. The course
  is the one made good over ``requirement.course_horizon_s``, 20 s by default; see
  :mod:`sidelong.mission.viewpoint.watch_course`. Only the time after the target has made good a course counts. A
  required sector replaces the course; with either side allowed every direction is right.
- **Observation angle**: from that normal, or from the middle of the sector, to the line from target to aircraft.
- **Within the pan limits**: the target is no further from the nose than the gimbal pans.
- **Move**: a departure to another circle. **Reversal**: a move within 10 s of the last one.
- **Unknown**: a moment in which an input was missing or contradicted the others, by the flight's own estimate; and
  what a moment lasts, until the next, beyond ``GAP_MAX_S``. It counts neither as in band nor as on side.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import Requirement
from sidelong.mission.viewpoint.watch_course import STANDING_M_S, courses_made_good_rad

BoolArray = npt.NDArray[np.bool_]

_REVERSAL_S = 10.0
GAP_MAX_S = 3.0
_COURSE_GAP_MAX_S = 5.0  # the motion between two samples further apart is unknown and counts as none

Asked = Sequence[tuple[float, Requirement]]
"""(since, requirement) in order of time, at least one: an operator may change it in flight."""


@dataclass(frozen=True, slots=True)
class Moment:
    """Aircraft and target, by its name in a fleet, at one time in the plane.

    known: whether the inputs were sound; always by a truth. within: whether the aircraft was within its envelope;
    otherwise neither band nor side is fulfilled.
    """

    time_s: float
    aircraft_east_m: float
    aircraft_north_m: float
    target_east_m: float
    target_north_m: float
    target_velocity_east_m_s: float
    target_velocity_north_m_s: float
    target: str = ""
    known: bool = True
    within: bool = True

    @staticmethod
    def by_estimate(
        east_m: float, north_m: float, estimate: TargetEstimate, target: str, known: bool = True
    ) -> Moment:
        """Return an aircraft's position and its target as estimated, at the estimate's time."""
        target_m = estimate.east_m, estimate.north_m
        velocity_m_s = estimate.velocity_east_m_s, estimate.velocity_north_m_s
        return Moment(estimate.time_s, east_m, north_m, *target_m, *velocity_m_s, target, known)


class Breaches:
    """When the aircraft itself was out of its envelope."""

    def __init__(self) -> None:
        self._since = [(-math.inf, False)]

    def note(self, time_s: float, breached: bool) -> None:
        """Store whether the aircraft is outside its envelope from ``time_s`` on."""
        if self._since[-1][1] != breached:
            self._since.append((time_s, breached))

    def applied(self, moments: Sequence[Moment]) -> Sequence[Moment]:
        """Return the moments with ``within`` false while the aircraft was outside its envelope."""
        if len(self._since) == 1:
            return moments
        times_s = [time_s for time_s, _ in self._since]
        breached = (self._since[bisect.bisect(times_s, moment.time_s) - 1][1] for moment in moments)
        return tuple(replace(one, within=not off) for one, off in zip(moments, breached, strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Aircraft and one target in the plane, in order of time (n,): east and north, shapes (n, 2)."""

    time_s: FloatArray
    aircraft_m: FloatArray
    target_m: FloatArray
    target_velocity_m_s: FloatArray

    @staticmethod
    def of(moments: Sequence[Moment]) -> Samples:
        names = [field.name for field in fields(Moment)][:7]
        rows = np.array([[getattr(moment, name) for name in names] for moment in moments]).reshape(-1, 7)
        return Samples(rows[:, 0], rows[:, 1:3], rows[:, 3:5], rows[:, 5:7])


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """How each moment was: arrays of shape (n,).

    Attributes:
        on_side: whether the side is the required one; True where it is not known.
        on_side_now: the same by the target's present course.
        side_known: whether the target has made good a course.
        course_rad: the target's course that defines the sides, NaN where it is not known.
        observation_rad: observation angle in [-pi, pi), NaN where the side is not known.
    """

    time_s: FloatArray
    range_m: FloatArray
    in_band: BoolArray
    on_side: BoolArray
    on_side_now: BoolArray
    side_known: BoolArray
    course_rad: FloatArray
    observation_rad: FloatArray

    def where(self, within: BoolArray) -> Judgement:
        """Return it with band and side not kept where ``within`` (n,), in the aircraft's envelope, is false."""
        held = (self.in_band, self.on_side, self.on_side_now)
        in_band, on_side, now = (each & within for each in held)
        return replace(self, in_band=in_band, on_side=on_side, on_side_now=now)

    @staticmethod
    def joined(parts: Sequence[Judgement]) -> Judgement:
        """Return the judgements of several aircraft as one, in the order of time."""
        whole = [np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Judgement)]
        order = np.argsort(whole[0], kind="stable")
        return Judgement(*(values[order] for values in whole))


@dataclass(frozen=True, slots=True)
class Score:
    """What a flight or a run came to. Fractions are 0..1 of the judged time; None where nothing could be judged.

    time_on_side: of the time in which the side is known; time_on_side_now: the same by the target's present course.
    """

    duration_s: float
    time_in_band: float | None
    time_on_side: float | None
    min_range_m: float | None
    max_range_m: float | None
    source: Literal["truth", "estimate"]
    time_on_side_now: float | None = None
    moves: int = 0
    reversals: int = 0
    time_unknown: float | None = None


def judge(samples: Samples, asked: Asked) -> Judgement:
    """Judge each sample by the requirement that was in force at its time."""
    time_s, velocity_m_s = samples.time_s, samples.target_velocity_m_s
    east_m, north_m = (samples.aircraft_m - samples.target_m).T
    range_m, sight_rad = np.hypot(east_m, north_m), np.arctan2(east_m, north_m)
    which = np.maximum(np.searchsorted([since_s for since_s, _ in asked], time_s, side="right") - 1, 0)
    requirements = [requirement for _, requirement in asked]
    horizon_s = np.array([requirement.course_horizon_s for requirement in requirements])[which]
    present = _present_rad(velocity_m_s)
    made_good = courses_made_good_rad(time_s, samples.target_m, velocity_m_s, horizon_s, _COURSE_GAP_MAX_S)
    made_good = np.where(horizon_s > 0.0, made_good, present)
    in_band, on_side, now, known = (np.ones(time_s.size, bool) for _ in range(4))
    observation_rad = np.full(time_s.size, math.nan)
    for k, requirement in enumerate(requirements):
        here = which == k
        in_band[here] = (range_m[here] >= requirement.range_min_m) & (range_m[here] <= requirement.range_max_m)
        off_rad, off_now_rad = (
            _wrapped(sight_rad[here] - requirement.middle_rad(course_rad[here]))
            for course_rad in (made_good, present)
        )
        observation_rad[here] = off_rad
        on_side[here], now[here] = (~(np.abs(angle) > requirement.allowed_rad) for angle in (off_rad, off_now_rad))
        known[here] = requirement.either_side | ~np.isnan(off_rad)
    return Judgement(time_s, range_m, in_band, on_side, now, known, made_good, observation_rad)


def judge_moments(moments: Sequence[Moment], asked: Asked) -> Judgement:
    """Judge moments in order of time; where the target changes, its course starts again."""
    runs = [list(run) for _, run in itertools.groupby(moments, key=lambda moment: moment.target)]
    judged = Judgement.joined([judge(Samples.of(run), asked) for run in runs or [[]]])
    return judged.where(np.array([moment.within for moment in moments], bool))


def within_pan_limits(
    aircraft_m: FloatArray, target_m: FloatArray, heading_rad: FloatArray, limit_rad: float
) -> BoolArray:
    """Return whether the gimbal can look at the target (n,); places: east and north (n, 2), heading: of the nose."""
    east_m, north_m = (target_m - aircraft_m).T
    return np.asarray(np.abs(_wrapped(np.arctan2(east_m, north_m) - heading_rad)) <= limit_rad)


def score(
    judged: Judgement,
    source: Literal["truth", "estimate"],
    departures_s: Sequence[float] = (),
    end_s: float | None = None,
    known: BoolArray | None = None,
) -> Score:
    """Sum up a judgement.

    Args:
        departures_s: when plans departed to another circle, ascending.
        end_s: until when the last moment counts; None: it does not count.
        known: whether each moment's inputs were sound, shape (n,); None: the truth is known.
    """
    if not judged.time_s.size:
        return Score(0.0, None, None, None, None, source)
    begin_s = judged.time_s[0]
    step_s = np.diff(judged.time_s, append=judged.time_s[-1] if end_s is None else end_s)
    total_s, known_s = step_s.sum(), step_s[judged.side_known].sum()
    if total_s <= 0.0:
        return Score(0.0, None, None, None, None, source)
    sure_s = step_s if known is None else np.where(known, np.minimum(step_s, GAP_MAX_S), 0.0)
    gaps_s = np.diff([time_s for time_s in departures_s if time_s >= begin_s], prepend=-math.inf)
    on_side, now = (
        float(sure_s[judged.side_known & held].sum() / known_s) if known_s > 0.0 else None
        for held in (judged.on_side, judged.on_side_now)
    )
    return Score(
        float(total_s),
        float(sure_s[judged.in_band].sum() / total_s),
        on_side,
        float(judged.range_m.min()),
        float(judged.range_m.max()),
        source,
        now,
        gaps_s.size,
        int((gaps_s < _REVERSAL_S - 1e-6).sum()),
        float(1.0 - sure_s.sum() / total_s),
    )


def from_band(moments: Sequence[Moment], asked: Asked) -> Sequence[Moment]:
    """Return the moments from the first one in the band, where judging begins; all where none is."""
    inside = np.flatnonzero(judge_moments(moments, asked).in_band)
    return moments[int(inside[0]) :] if inside.size else moments


def _present_rad(velocity_m_s: FloatArray) -> FloatArray:
    """Return the present courses of a target, shape (n,), held while it stands; NaN until it has moved."""
    east_m_s, north_m_s = velocity_m_s.T
    moves = np.hypot(east_m_s, north_m_s) >= STANDING_M_S
    last = np.maximum.accumulate(np.where(moves, np.arange(moves.size), -1))
    return np.where(last < 0, math.nan, np.arctan2(east_m_s, north_m_s)[last])


def _wrapped(angle_rad: FloatArray) -> FloatArray:
    return np.asarray((angle_rad + math.pi) % (2.0 * math.pi) - math.pi)
