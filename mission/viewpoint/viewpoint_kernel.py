"""From where the target is watched: its held course, course made good and side; and its path history.

Real targets repeat parts of their path: laps, the rows of a field, there and back. If the recent path resembles an
earlier part in either direction, at an offset no larger than the distance of two rows, the target is expected to
continue along that part. On recorded tracks this predicted the course 45 s ahead to within 60 degrees in 92 % of the
cases in the same direction (the present course: 63 %), and in 85 % (71 %) in the opposite one.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sidelong.estimators.compiled import Record, compiled, inlined, new_record, record_type
from sidelong.mission.core.path import FloatArray

PATH_POINTS_MAX, _SPACING_M = 4096, 4.0
PATH_HISTORY = record_type(
    count="i8",  # of the points known
    points=("f8", (PATH_POINTS_MAX, 3)),  # east, north, length of the path from the first; oldest first
    # The part repeated last, see Part; its offset from the present path; the path length up to which it is held.
    chance="f8",
    ahead="i8",
    vertex="i8",
    share="f8",
    offset_east_m="f8",
    offset_north_m="f8",
    held_until_m="f8",
)
"""The target's path history, at least ``_SPACING_M`` from point to point."""
# The largest offset from an earlier part, by speed, and the length of the path that must resemble it.
_OFFSET_S, _MIN_OFFSET_M, _MAX_OFFSET_M = 15.0, 8.0, 30.0
_ALIKE_S, _MIN_ALIKE_M, _MAX_ALIKE_M = 6.0, 40.0, 200.0  # a shorter one of a pacing target resembles by chance
_CHECKS, _CHECK_EVERY_M = 5, 10.0
_APART_M = 60.0  # of path, at least: anything nearer belongs to the same bend
_MIN_COS = 0.82  # between the courses of then and now
# The largest difference in shape, and its growth per length of path beyond the shortest.
_SLACK_M, _SLACK = 6.0, 0.1
_BACK_ALIKE_M = 80.0  # in the opposite direction
_FORWARDS, _BACKWARDS = 0.85, 0.7  # probabilities
_MIN_LEAD_S = 30.0  # a part that ends sooner predicts too little
# In a bend the two differ more than before it: the part is kept for this length of path, while they are no further
# apart than this share of the largest offset. The next place on it is sought so far ahead of the last one.
_HELD_M, _STRAYED = 80.0, 0.5
_SOUGHT_S, _SOUGHT_M, _SOUGHT_EVERY_M = 3.0, 16.0, 2.0


class Part(NamedTuple):
    """A part of the path history that the target repeats, from a point between a vertex and the next (share, 0..1).

    chance: probability that the target continues along it, 0: no part. ahead: 1, or -1 in the opposite direction.
    """

    chance: float
    ahead: int
    vertex: int
    share: float


@compiled
def no_part() -> Part:
    """Return the part of a target that repeats none."""
    return Part(0.0, 0, 0, 0.0)


@compiled
def _place(places: FloatArray, part: Part) -> tuple[float, float]:
    """Return where a part begins."""
    begin, end = places[part.vertex], places[part.vertex + 1]
    return begin[0] + part.share * (end[0] - begin[0]), begin[1] + part.share * (end[1] - begin[1])


@compiled
def _along(
    places: FloatArray, vertex: int, ahead: int, east_m: float, north_m: float, way_m: float
) -> tuple[float, float, int, bool]:
    """Return the point way_m along the path history from a point, via a vertex; the next vertex; False at an end."""
    while 0 <= vertex < len(places):
        step_m = math.hypot(places[vertex, 0] - east_m, places[vertex, 1] - north_m)
        if step_m >= way_m:
            share = way_m / max(step_m, 1e-9)
            east_m += share * (places[vertex, 0] - east_m)
            north_m += share * (places[vertex, 1] - north_m)
            return east_m, north_m, vertex, True
        way_m -= step_m
        east_m, north_m, vertex = places[vertex, 0], places[vertex, 1], vertex + ahead
    return east_m, north_m, vertex, False


@compiled
def _next_vertex(part: Part) -> int:
    return part.vertex + 1 if part.ahead > 0 else part.vertex


@compiled
def _max_offset_m(speed_m_s: float) -> float:
    """Return the largest offset from an earlier part at which the target can repeat it, m."""
    return min(max(_OFFSET_S * speed_m_s, _MIN_OFFSET_M), _MAX_OFFSET_M)


@compiled
def remember(path: Record, east_m: float, north_m: float) -> None:
    """Append a position of the target to its path history; a full one drops its older half."""
    points, length_m = path.points, 0.0
    if path.count > 0:
        before = path.count - 1
        step_m = math.hypot(east_m - points[before, 0], north_m - points[before, 1])
        if step_m < _SPACING_M:
            return
        length_m = points[before, 2] + step_m
    if path.count == PATH_POINTS_MAX:
        path.count //= 2
        points[: path.count] = points[path.count : 2 * path.count].copy()
        path.chance = 0.0
    points[path.count, 0], points[path.count, 1], points[path.count, 2] = east_m, north_m, length_m
    path.count += 1


@compiled
def _resemblance(
    places: FloatArray, east_m: float, north_m: float, part: Part, least_m: float, most_m: float
) -> tuple[float, float]:
    """Return over which length the recent path resembles the part, m, and their largest difference, m."""
    now_east_m, now_north_m, now = east_m, north_m, len(places) - 1
    then_east_m, then_north_m = _place(places, part)
    off_east_m, off_north_m = east_m - then_east_m, north_m - then_north_m
    then = part.vertex if part.ahead > 0 else part.vertex + 1
    alike_m, worst_m, step_m = 0.0, 0.0, least_m / _CHECKS
    while alike_m < most_m:
        now_east_m, now_north_m, now, both = _along(places, now, -1, now_east_m, now_north_m, step_m)
        then_east_m, then_north_m, then, known = _along(places, then, -part.ahead, then_east_m, then_north_m, step_m)
        differ_m = math.hypot(now_east_m - then_east_m - off_east_m, now_north_m - then_north_m - off_north_m)
        beyond = alike_m > least_m - 1e-6
        if not (both and known) or differ_m > _SLACK_M + (_SLACK * alike_m if beyond else 0.0):
            break
        alike_m += step_m
        worst_m = worst_m if beyond else max(worst_m, differ_m)
        step_m = _CHECK_EVERY_M if alike_m > least_m - 1e-6 else step_m
    return alike_m, worst_m


@compiled
def _found(places: FloatArray, east_m: float, north_m: float, speed_m_s: float) -> Part:
    """Return the part that the recent path resembles most."""
    count, least_m = len(places), max(_MIN_ALIKE_M, _ALIKE_S * speed_m_s)
    behind_east_m, behind_north_m, _, known = _along(places, count - 1, -1, east_m, north_m, least_m)
    along_m = math.hypot(east_m - behind_east_m, north_m - behind_north_m)
    if not known or along_m < 0.6 * least_m:
        return no_part()
    sin_c, cos_c = (east_m - behind_east_m) / along_m, (north_m - behind_north_m) / along_m
    way_m = places[count - 1, 2] + math.hypot(east_m - places[count - 1, 0], north_m - places[count - 1, 1])
    max_offset_m, best, found = _max_offset_m(speed_m_s), math.inf, no_part()
    for j in range(count - 1):
        since_m = way_m - places[j + 1, 2]
        if since_m < max(_APART_M, 2.0 * least_m):
            break
        x_m, y_m = places[j + 1, 0] - places[j, 0], places[j + 1, 1] - places[j, 1]
        off_x_m, off_y_m = east_m - places[j, 0], north_m - places[j, 1]
        step_m = places[j + 1, 2] - places[j, 2]
        if max(abs(off_x_m), abs(off_y_m)) > max_offset_m + step_m:
            continue
        share = (off_x_m * x_m + off_y_m * y_m) / (step_m * step_m)
        off_m = math.hypot(off_x_m - share * x_m, off_y_m - share * y_m)
        cos_turn = (x_m * sin_c + y_m * cos_c) / step_m
        if share < 0.0 or share >= 1.0 or off_m > max_offset_m or abs(cos_turn) < _MIN_COS:
            continue
        if cos_turn < 0.0 and places[j, 2] - places[0, 2] < _MIN_LEAD_S * speed_m_s:
            continue
        one = Part(_FORWARDS, 1, j, share) if cos_turn > 0.0 else Part(_BACKWARDS, -1, j, share)
        alike_m, worst_m = _resemblance(places, east_m, north_m, one, least_m, min(_MAX_ALIKE_M, 0.5 * since_m))
        # The nearest of the best shape; a long or recent resemblance counts in favour.
        badness = worst_m + 0.15 * off_m - 0.02 * alike_m + 0.002 * since_m
        enough_m = least_m if one.ahead > 0 else max(least_m, _BACK_ALIKE_M)
        if alike_m > enough_m - 1e-6 and badness < best:
            best, found = badness, one
    return found


@compiled
def _held(path: Record, east_m: float, north_m: float, speed_m_s: float) -> Part:
    """Return where the target is on the part that it repeated last, unless it has strayed from it."""
    places, last = path.points[: path.count], Part(path.chance, path.ahead, path.vertex, path.share)
    if last.chance == 0.0 or places[len(places) - 1, 2] > path.held_until_m:
        return no_part()
    east_m, north_m = east_m - path.offset_east_m, north_m - path.offset_north_m
    x_m, y_m = _place(places, last)
    nearest_m, found = math.hypot(x_m - east_m, y_m - north_m), last
    vertex, known, to_m = _next_vertex(last), True, 0.0
    while known and to_m < _SOUGHT_M + _SOUGHT_S * speed_m_s:
        to_m += _SOUGHT_EVERY_M
        x_m, y_m, vertex, known = _along(places, vertex, last.ahead, x_m, y_m, _SOUGHT_EVERY_M)
        away_m = math.hypot(x_m - east_m, y_m - north_m)
        if known and away_m < nearest_m:
            behind = vertex - 1 if last.ahead > 0 else vertex
            share = math.hypot(x_m - places[behind, 0], y_m - places[behind, 1])
            share /= places[behind + 1, 2] - places[behind, 2]
            nearest_m, found = away_m, Part(last.chance, last.ahead, behind, share)
    return found if nearest_m < _STRAYED * _max_offset_m(speed_m_s) else no_part()


@compiled
def repeated_part(path: Record, east_m: float, north_m: float, speed_m_s: float) -> Part:
    """Return the part of its path history that a target at this position repeats, and store it."""
    if path.count < 2:
        return no_part()
    places = path.points[: path.count]
    part = _found(places, east_m, north_m, speed_m_s)
    if part.chance > 0.0:
        x_m, y_m = _place(places, part)
        path.offset_east_m, path.offset_north_m = east_m - x_m, north_m - y_m
        path.held_until_m = places[len(places) - 1, 2] + _HELD_M
    else:
        part = _held(path, east_m, north_m, speed_m_s)
    path.chance, path.ahead, path.vertex, path.share = part
    return part


@compiled
def predict_along(
    path: Record,
    part: Part,
    from_east_m: float,
    from_north_m: float,
    step_m: float,
    east_m: FloatArray,
    north_m: FloatArray,
) -> None:
    """Fill in the predicted places (k,), step_m apart: parallel to a part of the path history, then straight on."""
    places = path.points[: path.count]
    x_m, y_m = _place(places, part)
    off_x_m, off_y_m = from_east_m - x_m, from_north_m - y_m
    vertex = _next_vertex(part)
    east_m[0], north_m[0] = from_east_m, from_north_m
    for i in range(1, len(east_m)):
        x_m, y_m, vertex, known = _along(places, vertex, part.ahead, x_m, y_m, step_m)
        east_m[i], north_m[i] = x_m + off_x_m, y_m + off_y_m
        if not known:
            before = max(i - 2, 0)
            east_m[i] = 2.0 * east_m[i - 1] - east_m[before]
            north_m[i] = 2.0 * north_m[i - 1] - north_m[before]


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
    path=PATH_HISTORY,
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
    """Return an array of one record of ``MEMORY`` before the first estimate of the target.

    Args:
        side: Side to watch from: 1 left, -1 right.
    """
    memories = new_record(MEMORY)
    memory = memories[0]
    memory.standing, memory.side, memory.airspeed_share = True, side, 1.0
    memory.course_rad = memory.presumed_course_rad = memory.made_good_rad = memory.airspeed_s = math.nan
    return memories


@compiled
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


@compiled
def held_course_rad(target: TargetState, memory: Record) -> float:
    """Take an estimate, in the order of time, and return the course to watch from; NaN until the target has moved."""
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


@compiled
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
        for i in range(memory.places):
            memory.place[i, 1] += east_m
            memory.place[i, 2] += north_m


@compiled
def remember_place(target: TargetState, memory: Record, gap_max_s: float) -> None:
    """Remember a position for the course made good, about one each second, and for the path history.

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
        for i in range(_PLACES_MAX - 1):
            place[i, 0], place[i, 1], place[i, 2] = place[i + 1, 0], place[i + 1, 1], place[i + 1, 2]
        memory.places -= 1
    k = memory.places
    place[k, 0], place[k, 1], place[k, 2] = target.time_s, target.east_m, target.north_m
    memory.places = k + 1
    remember(memory.path, target.east_m, target.north_m)


@inlined
def place_at(memory: Record, time_s: float) -> tuple[float, float]:
    """Return where the target was (east, north): before the first position that one, after the last the last."""
    place, k = memory.place, memory.places - 1
    while k > 0 and place[k, 0] > time_s:
        k -= 1
    if k + 1 >= memory.places or place[k, 0] > time_s:
        return place[k, 1], place[k, 2]
    past = (time_s - place[k, 0]) / (place[k + 1, 0] - place[k, 0])
    return (
        place[k, 1] + past * (place[k + 1, 1] - place[k, 1]),
        place[k, 2] + past * (place[k + 1, 2] - place[k, 2]),
    )


@compiled
def made_good_sigma_rad(sigma_m: float, way_m: float) -> float:
    """Return one standard deviation of a course made good on a way that is known across to sigma_m."""
    return min(sigma_m / max(way_m, MIN_WAY_M), COURSE_SIGMA_MAX_RAD)


@compiled
def position_sigma_m(target: TargetState) -> float:
    """Return one standard deviation of the position on its worse axis."""
    return math.sqrt(max(target.covariance[0, 0], target.covariance[1, 1], 0.0))


@compiled
def least_way_m(target: TargetState, memory: Record) -> float:
    """Return the least way that has a course."""
    return max(MIN_WAY_M, _WAY_SIGMAS * position_sigma_m(target)) if memory.standing else MIN_WAY_M


@compiled
def made_good(estimates: Estimates, horizon_s: float, memory: Record, gap_max_s: float) -> tuple[float, float]:
    """Take an estimate and return the course made good, held while the way is short, and its sigma; NaN before.

    The motion between two estimates further apart than gap_max_s is unknown and counts as none.
    """
    target = estimates.now
    remember_place(estimates.seen, memory, gap_max_s)
    east_m, north_m = place_at(memory, target.time_s - horizon_s)
    east_m, north_m = target.east_m - east_m, target.north_m - north_m
    way_m = math.hypot(east_m, north_m)
    if way_m > least_way_m(estimates.seen, memory):
        memory.made_good_rad = math.atan2(east_m, north_m)
    return float(memory.made_good_rad), made_good_sigma_rad(position_sigma_m(target), way_m)


@compiled
def courses_of(estimates: Estimates, horizon_s: float, memories: Record) -> tuple[float, float]:
    """Take an estimate and return the held course and the course made good; memories: an array of one."""
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
    """See :func:`sidelong.mission.viewpoint.course_hold.courses_made_good_rad`; memories: a fresh one in an array."""
    exact, courses_rad, memory = np.zeros((4, 4)), np.empty(time_s.size), memories[0]
    for i in range(time_s.size):
        east_m_s, north_m_s = velocity_m_s[i, 0], velocity_m_s[i, 1]
        target = TargetState(time_s[i], place_m[i, 0], place_m[i, 1], east_m_s, north_m_s, exact)
        courses_rad[i] = made_good(Estimates(target, target), horizon_s[i], memory, gap_max_s)[0]
    return courses_rad


@compiled
def viewpoint(east_m: float, north_m: float, estimates: Estimates, wish: SideRule, memory: Record) -> WatchCourse:
    """See :meth:`sidelong.mission.viewpoint.side_policy.SidePolicy.viewpoint`."""
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
