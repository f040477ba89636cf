"""From where the target is watched: its held course, its course made good and the side."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sidelong.estimators.compiled import Record, compiled, inner, inner_inlined, new_record, record_type
from sidelong.mission.core.path import FloatArray

_STOPPED_BELOW_M_S = 0.9
_MOVING_ABOVE_M_S = 1.0
_SIGMAS = 2.0  # a speed below this many of its standard deviations is no motion either
_BEFORE_STOP_S = 3.0
MIN_WAY_M = 10.0  # a shorter path has no course
# Nor has one of a standing target that is shorter than this many standard deviations of the position: while it is
# out of sight, its estimate wanders.
_WAY_SIGMAS = 3.0
COURSE_SIGMA_MAX_RAD = 0.8
# An estimate that is further than this from where its velocity led has jumped: a target that is found again after
# coasting. Half of MIN_WAY_M, so that a smaller step alone makes no course.
_JUMP_M = 5.0

_RECENT_MAX = 200  # courses: more than at any rate that decisions are made at
_PLACES_MAX, _PLACE_EVERY_S = 72, 0.95
MEMORY = record_type(
    standing="?",
    course_rad="f8",  # held through a stop; NaN until the target has moved
    presumed_course_rad="f8",  # counts until then; NaN for none
    side="f8",  # 1 left, -1 right
    made_good_rad="f8",  # course made good; NaN before
    airspeed_share="f8",  # flown over commanded airspeed
    airspeed_s="f8",  # when it was updated last
    # Courses of the last seconds of motion, oldest first.
    courses="i8",
    course_at_s=("f8", (_RECENT_MAX,)),
    recent_course_rad=("f8", (_RECENT_MAX,)),
    # Positions of the last minute, oldest first: time, east, north.
    places="i8",
    place=("f8", (_PLACES_MAX, 3)),
    # The last estimate.
    last_s="f8",
    last_east_m="f8",
    last_north_m="f8",
    last_velocity_east_m_s="f8",
    last_velocity_north_m_s="f8",
)
"""What is remembered of one target and of the aircraft's airspeed; a record whose fields change."""


class TargetState(NamedTuple):
    """An estimate of the target: see :class:`sidelong.estimators.estimate.TargetEstimate`; covariance (4, 4)."""

    time_s: float
    east_m: float
    north_m: float
    velocity_east_m_s: float
    velocity_north_m_s: float
    covariance: FloatArray


class Estimates(NamedTuple):
    """The target now, and as it was last seen. They differ where the payload is late: the rest is a prediction."""

    now: TargetState
    seen: TargetState


class SideRule(NamedTuple):
    """From where to watch: a side (SIDE of the memory), either side, or a fixed course, NaN for none.

    course_horizon_s: the sides are those of the course made good over this time, s; 0: of the present course.
    """

    either_side: bool
    hysteresis_m: float
    fixed_course_rad: float
    course_horizon_s: float = 0.0


class WatchCourse(NamedTuple):
    """The course whose side counts, the side (1 left, -1 right), and how well the course is known."""

    course_rad: float
    side: float
    course_sigma_rad: float


def fresh_memory(side: float) -> Any:
    """Return an array of one record of ``MEMORY`` before the first estimate; side: 1 left, -1 right."""
    memories = new_record(MEMORY)
    memory = memories[0]
    memory.standing, memory.side, memory.airspeed_share = True, side, 1.0
    memory.course_rad = memory.presumed_course_rad = memory.made_good_rad = memory.airspeed_s = math.nan
    return memories


@inner
def velocity_sigma_m_s(target: TargetState) -> float:
    """Return one standard deviation of the velocity on its worse axis."""
    return math.sqrt(max(target.covariance[2, 2], target.covariance[3, 3], 0.0))


@compiled
def course_sigma_rad(target: TargetState) -> float:
    """Return one standard deviation of a moving target's course: the velocity's across it, over the speed."""
    speed_m_s = math.hypot(target.velocity_east_m_s, target.velocity_north_m_s)
    course_rad = math.atan2(target.velocity_east_m_s, target.velocity_north_m_s)
    east, north = math.cos(course_rad), -math.sin(course_rad)
    p = target.covariance
    variance = east * east * p[2, 2] + 2.0 * east * north * p[2, 3] + north * north * p[3, 3]
    return math.sqrt(max(variance, 0.0)) / max(speed_m_s, _STOPPED_BELOW_M_S)


@inner
def held_course_rad(target: TargetState, memory: Record) -> float:
    """Process an estimate, in order of time; return the course to watch from, rad, NaN until the target has moved."""
    speed_m_s = math.hypot(target.velocity_east_m_s, target.velocity_north_m_s)
    threshold_m_s = _MOVING_ABOVE_M_S if memory.standing else _STOPPED_BELOW_M_S
    at_s, course_rad, count = memory.course_at_s, memory.recent_course_rad, memory.courses
    if speed_m_s >= max(threshold_m_s, _SIGMAS * velocity_sigma_m_s(target)):
        memory.standing = False
        memory.course_rad = math.atan2(target.velocity_east_m_s, target.velocity_north_m_s)
        gone = 1 if count == _RECENT_MAX else 0
        while gone + 1 < count and at_s[gone + 1] <= target.time_s - _BEFORE_STOP_S:
            gone += 1
        for i in range(gone, count):
            at_s[i - gone], course_rad[i - gone] = at_s[i], course_rad[i]
        count -= gone
        at_s[count], course_rad[count] = target.time_s, memory.course_rad
        memory.courses = count + 1
    elif not memory.standing:
        memory.standing, memory.course_rad, memory.courses = True, course_rad[0], 0
    return float(memory.course_rad)


@inner
def _follow_jump(target: TargetState, memory: Record, gap_max_s: float) -> None:
    """Shift the remembered positions by the part of the last displacement that the velocities do not explain.

    After more than gap_max_s they explain nothing: the target counts as standing in between.
    """
    step_s = target.time_s - memory.last_s
    half_s = 0.5 * step_s if step_s <= gap_max_s else 0.0
    before_east_m_s, before_north_m_s = memory.last_velocity_east_m_s, memory.last_velocity_north_m_s
    east_m = target.east_m - memory.last_east_m - half_s * (target.velocity_east_m_s + before_east_m_s)
    north_m = target.north_m - memory.last_north_m - half_s * (target.velocity_north_m_s + before_north_m_s)
    turned_m_s = math.hypot(target.velocity_east_m_s - before_east_m_s, target.velocity_north_m_s - before_north_m_s)
    if step_s > gap_max_s or math.hypot(east_m, north_m) > _JUMP_M + abs(half_s) * turned_m_s:
        memory.place[: memory.places, 1] += east_m
        memory.place[: memory.places, 2] += north_m


@compiled
def remember_place(target: TargetState, memory: Record, gap_max_s: float) -> None:
    """Remember a position for the course made good, about one each second.

    If the estimate has jumped, the remembered positions jump along: the target did not move.
    """
    place = memory.place
    if memory.places > 0:
        _follow_jump(target, memory, gap_max_s)
    memory.last_s, memory.last_east_m, memory.last_north_m = target.time_s, target.east_m, target.north_m
    memory.last_velocity_east_m_s = target.velocity_east_m_s
    memory.last_velocity_north_m_s = target.velocity_north_m_s
    if memory.places > 0 and target.time_s < place[memory.places - 1, 0] + _PLACE_EVERY_S:
        return
    if memory.places == _PLACES_MAX:
        place[:-1] = place[1:]
        memory.places -= 1
    k = memory.places
    place[k, 0], place[k, 1], place[k, 2] = target.time_s, target.east_m, target.north_m
    memory.places = k + 1


@inner_inlined
def place_at(memory: Record, time_s: float) -> tuple[float, float]:
    """Return where the target was (east, north): before the first position that one, after the last the last."""
    place, k = memory.place, memory.places - 1
    while k > 0 and place[k, 0] > time_s:
        k -= 1
    if k + 1 >= memory.places or place[k, 0] > time_s:
        return place[k, 1], place[k, 2]
    here, then = place[k], place[k + 1]
    past = (time_s - here[0]) / (then[0] - here[0])
    return here[1] + past * (then[1] - here[1]), here[2] + past * (then[2] - here[2])


@inner
def made_good_sigma_rad(sigma_m: float, way_m: float) -> float:
    """Return one standard deviation of a course made good on a way that is known across to sigma_m."""
    return min(sigma_m / max(way_m, MIN_WAY_M), COURSE_SIGMA_MAX_RAD)


@inner
def position_sigma_m(target: TargetState) -> float:
    """Return one standard deviation of the position on its worse axis."""
    return math.sqrt(max(target.covariance[0, 0], target.covariance[1, 1], 0.0))


@inner
def made_good(estimates: Estimates, horizon_s: float, memory: Record, gap_max_s: float) -> tuple[float, float]:
    """Process an estimate; return the course made good, held while the way is short, and its sigma, rad; NaN before.

    The motion between two estimates further apart than gap_max_s is unknown and counts as none.
    """
    target = estimates.now
    remember_place(estimates.seen, memory, gap_max_s)
    east_m, north_m = place_at(memory, target.time_s - horizon_s)
    east_m, north_m = target.east_m - east_m, target.north_m - north_m
    way_m = math.hypot(east_m, north_m)
    wanders_m = _WAY_SIGMAS * position_sigma_m(estimates.seen) if memory.standing else 0.0
    if way_m > max(MIN_WAY_M, wanders_m):
        memory.made_good_rad = math.atan2(east_m, north_m)
    return float(memory.made_good_rad), made_good_sigma_rad(position_sigma_m(target), way_m)


@compiled
def courses_of(estimates: Estimates, horizon_s: float, memories: Record) -> tuple[float, float]:
    """Process an estimate; return the held course and the course made good, rad; memories: an array of one."""
    memory = memories[0]
    held_rad = held_course_rad(estimates.seen, memory)
    return held_rad, made_good(estimates, horizon_s, memory, math.inf)[0]


@compiled
def courses_made_good(
    time_s: FloatArray,
    place_m: FloatArray,
    velocity_m_s: FloatArray,
    horizon_s: FloatArray,
    gap_max_s: float,
    memories: Record,
) -> FloatArray:
    """See :func:`sidelong.mission.viewpoint.watch_course.courses_made_good_rad`; memories: (1,)."""
    exact, courses_rad, memory = np.zeros((4, 4)), np.empty(time_s.size), memories[0]
    for i in range(time_s.size):
        east_m_s, north_m_s = velocity_m_s[i, 0], velocity_m_s[i, 1]
        target = TargetState(time_s[i], place_m[i, 0], place_m[i, 1], east_m_s, north_m_s, exact)
        courses_rad[i] = made_good(Estimates(target, target), horizon_s[i], memory, gap_max_s)[0]
    return courses_rad


@compiled
def viewpoint(east_m: float, north_m: float, estimates: Estimates, wish: SideRule, memory: Record) -> WatchCourse:
    """See :meth:`sidelong.mission.viewpoint.watch_course.SidePolicy.viewpoint`."""
    if not math.isnan(wish.fixed_course_rad):
        return WatchCourse(wish.fixed_course_rad, memory.side, 0.0)
    target = estimates.now
    course_rad = held_course_rad(estimates.seen, memory)
    sigma_rad = 0.0 if memory.standing else course_sigma_rad(target)
    if wish.course_horizon_s > 0.0:
        course_rad, sigma_rad = made_good(estimates, wish.course_horizon_s, memory, math.inf)
    away_rad = math.atan2(east_m - target.east_m, north_m - target.north_m)
    if math.isnan(course_rad):
        if math.isnan(memory.presumed_course_rad):
            memory.presumed_course_rad = away_rad + 0.5 * math.pi * memory.side
        return WatchCourse(memory.presumed_course_rad, memory.side, 0.0)
    if wish.either_side:
        range_m = math.hypot(east_m - target.east_m, north_m - target.north_m)
        aside_m = range_m * math.cos(away_rad - course_rad + 0.5 * math.pi * memory.side)
        if aside_m < -wish.hysteresis_m:
            memory.side = -memory.side
    return WatchCourse(course_rad, memory.side, sigma_rad)
