"""The inner loops of the course hold and the side policy: from where the target is watched."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sidelong.estimators.compiled import compiled, inlined
from sidelong.mission.core.path import FloatArray
from sidelong.mission.viewpoint.trail_kernel import TRAIL_SIZE, remember

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

# The memory, an array: what it holds, the aircraft's own airspeed as a share of the wanted one, and when that was
# looked at, then the times and courses of the last seconds of motion, oldest first, then times and places of the last
# minute, the last estimate (time, place and velocity), and the trail.
STANDING, COURSE, PRESUMED, SIDE, MADE_GOOD, AIRSPEED_SHARE, AIRSPEED_S, RECENT = range(8)
_RECENT_MAX = 200  # of them: more than at any rate that decisions are made at
_PLACES = RECENT + 1 + 2 * _RECENT_MAX
_PLACES_MAX, _PLACE_EVERY_S = 72, 0.95
_LAST = _PLACES + 1 + 3 * _PLACES_MAX
TRAIL = _LAST + 5
MEMORY_SIZE = TRAIL + TRAIL_SIZE


class Known(NamedTuple):
    """An estimate of the target: see :class:`sidelong.estimators.estimate.TargetEstimate`; covariance (4, 4)."""

    time_s: float
    east_m: float
    north_m: float
    velocity_east_m_s: float
    velocity_north_m_s: float
    covariance: FloatArray


class Estimates(NamedTuple):
    """The target now, and as it was last seen. They differ where the payload is late: the rest is a prediction."""

    now: Known
    seen: Known


class Wish(NamedTuple):
    """From where to watch: a side (SIDE of the memory), either side, or a fixed course, NaN for none.

    course_horizon_s: the sides are those of the course made good over this time, s; 0: of the present course.
    """

    either_side: bool
    hysteresis_m: float
    fixed_course_rad: float
    course_horizon_s: float = 0.0


class View(NamedTuple):
    """The course whose side counts, the side (1 left, -1 right), and how well the course is known."""

    course_rad: float
    side: float
    course_sigma_rad: float


@compiled
def fresh_memory(side: float) -> FloatArray:
    """Return the memory before the first estimate of the target. side: 1 left, -1 right."""
    memory = np.zeros(MEMORY_SIZE)
    memory[STANDING], memory[COURSE], memory[PRESUMED], memory[SIDE] = 1.0, np.nan, np.nan, side
    memory[MADE_GOOD], memory[AIRSPEED_SHARE], memory[AIRSPEED_S] = np.nan, 1.0, np.nan
    return memory


@compiled
def velocity_sigma_m_s(target: Known) -> float:
    """Return one standard deviation of the velocity on its worse axis."""
    return math.sqrt(max(target.covariance[2, 2], target.covariance[3, 3], 0.0))


@compiled
def course_sigma_rad(target: Known) -> float:
    """Return one standard deviation of a moving target's course: the velocity's across it, over the speed."""
    speed_m_s = math.hypot(target.velocity_east_m_s, target.velocity_north_m_s)
    course_rad = math.atan2(target.velocity_east_m_s, target.velocity_north_m_s)
    east, north = math.cos(course_rad), -math.sin(course_rad)
    p = target.covariance
    variance = east * east * p[2, 2] + 2.0 * east * north * p[2, 3] + north * north * p[3, 3]
    return math.sqrt(max(variance, 0.0)) / max(speed_m_s, _STOPPED_BELOW_M_S)


@compiled
def held_course_rad(target: Known, memory: FloatArray) -> float:
    """Take an estimate, in the order of time, and return the course to watch from; NaN until the target has moved."""
    speed_m_s = math.hypot(target.velocity_east_m_s, target.velocity_north_m_s)
    standing = memory[STANDING] > 0.0
    threshold_m_s = max(_MOVING_ABOVE_M_S if standing else _STOPPED_BELOW_M_S, _SIGMAS * velocity_sigma_m_s(target))
    recent, count = memory[RECENT + 1 :], int(memory[RECENT])
    if speed_m_s >= threshold_m_s:
        memory[STANDING] = 0.0
        memory[COURSE] = math.atan2(target.velocity_east_m_s, target.velocity_north_m_s)
        gone = 1 if count == _RECENT_MAX else 0
        while gone + 1 < count and recent[2 * (gone + 1)] <= target.time_s - _BEFORE_STOP_S:
            gone += 1
        for i in range(2 * gone, 2 * count):
            recent[i - 2 * gone] = recent[i]
        count -= gone
        recent[2 * count], recent[2 * count + 1] = target.time_s, memory[COURSE]
        memory[RECENT] = count + 1
    elif not standing:
        memory[STANDING], memory[COURSE], memory[RECENT] = 1.0, recent[1], 0.0
    return float(memory[COURSE])


@compiled
def _follow_jump(target: Known, memory: FloatArray, places: FloatArray, count: int) -> None:
    """Shift the kept places by the part of the way since the last estimate that its velocities do not explain."""
    last = memory[_LAST:]
    half_s = 0.5 * (target.time_s - last[0])
    east_m = target.east_m - last[1] - half_s * (target.velocity_east_m_s + last[3])
    north_m = target.north_m - last[2] - half_s * (target.velocity_north_m_s + last[4])
    turned_m_s = math.hypot(target.velocity_east_m_s - last[3], target.velocity_north_m_s - last[4])
    if math.hypot(east_m, north_m) > _JUMP_M + abs(half_s) * turned_m_s:
        for i in range(count):
            places[3 * i + 1] += east_m
            places[3 * i + 2] += north_m


@compiled
def remember_place(target: Known, memory: FloatArray) -> None:
    """Keep a place for the course made good, about one each second, and for the trail.

    If the estimate has jumped, the kept places jump along: the jump corrects the estimate, the target did not move.
    """
    places, count = memory[_PLACES + 1 :], int(memory[_PLACES])
    if count > 0:
        _follow_jump(target, memory, places, count)
    last = memory[_LAST:]
    last[0], last[1], last[2] = target.time_s, target.east_m, target.north_m
    last[3], last[4] = target.velocity_east_m_s, target.velocity_north_m_s
    if count > 0 and target.time_s < places[3 * count - 3] + _PLACE_EVERY_S:
        return
    if count == _PLACES_MAX:
        for i in range(3 * (count - 1)):
            places[i] = places[i + 3]
        count -= 1
    places[3 * count], places[3 * count + 1], places[3 * count + 2] = target.time_s, target.east_m, target.north_m
    memory[_PLACES] = count + 1
    remember(memory[TRAIL:], target.east_m, target.north_m)


@inlined
def place_at(memory: FloatArray, time_s: float) -> tuple[float, float]:
    """Return where the target was (east, north): before the first kept place that one, after the last the last."""
    places, k = memory[_PLACES + 1 :], int(memory[_PLACES]) - 1
    while k > 0 and places[3 * k] > time_s:
        k -= 1
    if k + 1 >= int(memory[_PLACES]) or places[3 * k] > time_s:
        return places[3 * k + 1], places[3 * k + 2]
    past = (time_s - places[3 * k]) / (places[3 * k + 3] - places[3 * k])
    return (
        places[3 * k + 1] + past * (places[3 * k + 4] - places[3 * k + 1]),
        places[3 * k + 2] + past * (places[3 * k + 5] - places[3 * k + 2]),
    )


@compiled
def made_good_sigma_rad(sigma_m: float, way_m: float) -> float:
    """Return one standard deviation of a course made good on a way that is known across to sigma_m."""
    return min(sigma_m / max(way_m, MIN_WAY_M), COURSE_SIGMA_MAX_RAD)


@compiled
def position_sigma_m(target: Known) -> float:
    """Return one standard deviation of the position on its worse axis."""
    return math.sqrt(max(target.covariance[0, 0], target.covariance[1, 1], 0.0))


@compiled
def least_way_m(target: Known, memory: FloatArray) -> float:
    """Return the least way that has a course."""
    return max(MIN_WAY_M, _WAY_SIGMAS * position_sigma_m(target)) if memory[STANDING] > 0.0 else MIN_WAY_M


@compiled
def _made_good(estimates: Estimates, horizon_s: float, memory: FloatArray) -> tuple[float, float]:
    """Take an estimate and return the course made good, held while the way is short, and its sigma; NaN before."""
    target = estimates.now
    remember_place(estimates.seen, memory)
    east_m, north_m = place_at(memory, target.time_s - horizon_s)
    east_m, north_m = target.east_m - east_m, target.north_m - north_m
    way_m = math.hypot(east_m, north_m)
    if way_m > least_way_m(estimates.seen, memory):
        memory[MADE_GOOD] = math.atan2(east_m, north_m)
    return memory[MADE_GOOD], made_good_sigma_rad(position_sigma_m(target), way_m)


@compiled
def viewpoint(east_m: float, north_m: float, estimates: Estimates, wish: Wish, memory: FloatArray) -> View:
    """See :meth:`sidelong.mission.viewpoint.side_policy.SidePolicy.viewpoint`."""
    if not math.isnan(wish.fixed_course_rad):
        return View(wish.fixed_course_rad, memory[SIDE], 0.0)
    target = estimates.now
    course_rad = held_course_rad(estimates.seen, memory)
    sigma_rad = 0.0 if memory[STANDING] > 0.0 else course_sigma_rad(target)
    if wish.course_horizon_s > 0.0:
        course_rad, sigma_rad = _made_good(estimates, wish.course_horizon_s, memory)
    away_rad = math.atan2(east_m - target.east_m, north_m - target.north_m)
    if math.isnan(course_rad):
        if math.isnan(memory[PRESUMED]):
            memory[PRESUMED] = away_rad + 0.5 * math.pi * memory[SIDE]
        return View(memory[PRESUMED], memory[SIDE], 0.0)
    if wish.either_side:
        range_m = math.hypot(east_m - target.east_m, north_m - target.north_m)
        aside_m = range_m * math.cos(away_rad - course_rad + 0.5 * math.pi * memory[SIDE])
        if aside_m < -wish.hysteresis_m:
            memory[SIDE] = -memory[SIDE]
    return View(course_rad, memory[SIDE], sigma_rad)
