"""The target's progress along a route: a Bayes filter over all points of the route, in both directions, or off it.

A route may pass the same position more than once, and its parts may lie close together. The filter therefore keeps a
probability for each point and direction. They move along the route at the target's speed, and are weighted by the
distance of the point from the target and by the target's course. So the order of the route decides between parallel
rows, and where the route doubles back, a target that turns is not mistaken for one that turns back.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sidelong.estimators.compiled import Record, compiled, inlined, inner, inner_inlined, new_record, record_type
from sidelong.mission.core.path import FloatArray
from sidelong.mission.viewpoint.viewpoint_kernel import TargetState

# A forecast is made each second, and compared after this many seconds; it has this many points, 1 s apart.
_AHEAD_S, _FORECAST = 10, 21

_LEAVES_AFTER_S = 150.0
# Share of the probability that is moved each second: from "off" to points near the target, from all points to those,
# to the opposite direction, and to points ahead or behind, at exponentially distributed distances: a target may cut a
# corner, or turn before the end of a row.
_JOINS_PER_S, _JUMPS_PER_S, _TURNS_BACK_PER_S, _SKIPS_PER_S, _SKIP_M = 0.02, 1e-4, 0.001, 0.01, 25.0
_SKIPS_AHEAD = 0.7  # the rest of them falls back
_SPREAD = 0.08  # of a moving target's probability, to the cell before and to the one behind
_BACKWARD = 0.15
# A target is expected to join the route again where it left it, or ahead of that: elsewhere counts less.
_REJOINS_FROM_M, _REJOINS_TO_M, _ELSEWHERE = -60.0, 200.0, 0.1
# Errors of offset and course are correlated from second to second: their likelihoods count in part, and those of a
# target that stands less again, as it shows the same offset all the time.
_SHARE_PER_S, _STILL = 0.45, 0.1
_OFF_WIDTH_M = 100.0  # offsets of a target off the route are spread over this width
_LEAST_EVIDENCE = -12.0
_COURSE_SIGMA_RAD, _ANY_COURSE = 0.45, 0.1
_SLOW_M_S, _MOVING_M_S = 0.7, 0.3  # the course of a slower target is not compared; a slower one does not move
_TANGENT_M = 8.0  # the route's course is that of a chord this far to both sides
_PART_M = 24.0  # points this near to the most probable one are one part of the route
_OTHER_PART_M = 25.0
_GATE = 3.0
_MIN_CHANCE, _NO_CHANCE = 1e-4, 1e-9
_ON_ABOVE, _OFF_BELOW = 0.7, 0.5
# A route is displaced by this standard deviation (each axis), which changes over this distance. The target is seen
# once a second, and what it keeps aside of its own accord lasts for many seconds: hence so large a deviation of that.
_DISPLACED_SIGMA_M, _DISPLACED_OVER_M, _ASIDE_SIGMA_M = 6.0, 400.0, 10.0
_SPEED_S, _PRESENT_S, _USUAL_S = 2.0, 0.7, 40.0
_SETTLES_S = 8.0
# Forecasts are compared by the target's distance from their lines: over this time, up to this distance, and initially
# with these mean squares. The route is of use below the first ratio of them, and of none above the second.
_COMPARED_S, _WORST_M, _FIRST_ROUTE_M2, _FIRST_STRAIGHT_M2 = 120.0, 30.0, 35.0, 50.0
_OF_USE_BELOW, _OF_NO_USE_ABOVE, _ROUNDING_M2 = 0.75, 0.85, 1.0


PROGRESS = record_type(
    last_s="f8",  # time of the last update; NaN before
    off_chance="f8",  # probability of "off the route"
    on_route="?",  # whether "on the route" is reported
    # The most probable part of the route: position, speed (negative: backward), direction (1, -1) and probability.
    along_m="f8",  # NaN before
    speed_m_s="f8",
    direction="f8",
    chance="f8",
    part="i8",  # how often that part has changed
    usual_m_s="f8",  # speed over the ground; NaN before
    present_m_s="f8",  # speed along the route, less smoothed than speed_m_s
    # Whether forecasts along the route are of use; mean squared errors of those, and of forecasts straight on.
    of_use="?",
    route_error_m2="f8",
    straight_error_m2="f8",
    # Displacement of the target's path from the route (east, north), and its covariance (ee, en, nn).
    displaced_m=("f8", (2,)),
    displaced_m2=("f8", (3,)),
    # Forecasts that are not due yet: when they were made (NaN for none), velocity then, and predicted positions.
    forecast_s=("f8", (_AHEAD_S,)),
    forecast_m_s=("f8", (_AHEAD_S, 2)),
    forecast_m=("f8", (_AHEAD_S, _FORECAST, 2)),
)


class Progress(NamedTuple):
    """The filter's state, which changes: one record of ``PROGRESS``, (1,), and the probability of each point.

    chances (2, n): the second row is in reverse order, for the backward direction.
    """

    state: Any
    chances: FloatArray


class RouteArrays(NamedTuple):
    """A route as the loops see it: points (n, 2), east and north, evenly spaced; n = 0 for no route.

    speed_m_s: expected speed, NaN for unknown. direction: 1 forward, -1 backward, 0 either.
    """

    points: FloatArray
    spacing_m: float
    lap: bool
    tolerance_m: float
    speed_m_s: float
    direction: float


def fresh_progress(points: int) -> Progress:
    """Return the progress before the first update, for a route of n points."""
    progress = Progress(new_record(PROGRESS), np.zeros((2, points)))
    reset(progress)
    return progress


def reset(progress: Progress) -> None:
    """Forget all updates."""
    state = progress.state[0]
    state.last_s = state.along_m = state.usual_m_s = math.nan
    state.speed_m_s = state.direction = state.chance = state.present_m_s = 0.0
    state.off_chance, state.on_route, state.part, state.of_use = 1.0, False, 0, True
    state.route_error_m2, state.straight_error_m2 = _FIRST_ROUTE_M2, _FIRST_STRAIGHT_M2
    state.displaced_m[:], state.displaced_m2[:] = 0.0, (_DISPLACED_SIGMA_M**2, 0.0, _DISPLACED_SIGMA_M**2)
    state.forecast_s[:] = math.nan
    progress.chances[:] = 0.0


@inlined
def length_m(way: RouteArrays) -> float:
    """Return the length of the route, of one lap if it is one."""
    n = len(way.points)
    return way.spacing_m * (n if way.lap else n - 1)


@inner_inlined
def point_along(way: RouteArrays, along_m: float) -> tuple[float, float]:
    """Return the point (east, north) at a position along the route; beyond its ends, straight on."""
    n, place = len(way.points), along_m / way.spacing_m
    if way.lap:
        place -= n * math.floor(place / n)
        i = min(int(place), n - 1)
        j = i + 1 if i + 1 < n else 0
    else:
        i = min(max(int(place), 0), n - 2)
        j = i + 1
    past, p = place - i, way.points
    return p[i, 0] + past * (p[j, 0] - p[i, 0]), p[i, 1] + past * (p[j, 1] - p[i, 1])


@inner_inlined
def _tangent(way: RouteArrays, along_m: float) -> tuple[float, float]:
    """Return the unit vector (east, north) of the route's course at a position."""
    reach_m = _TANGENT_M
    from_m, to_m = along_m - reach_m, along_m + reach_m
    if not way.lap:
        from_m, to_m = max(from_m, 0.0), min(to_m, length_m(way))
    if to_m <= from_m:
        from_m, to_m = along_m - reach_m, along_m + reach_m
    from_e, from_n = point_along(way, from_m)
    to_e, to_n = point_along(way, to_m)
    away_m = math.hypot(to_e - from_e, to_n - from_n)
    if away_m < 1e-6:
        return 0.0, 1.0
    return (to_e - from_e) / away_m, (to_n - from_n) / away_m


@inner_inlined
def _evidence(offset_m: float, sigma_m: float, agreement: float, speed_m_s: float) -> float:
    """Return the log of the likelihood of an offset and a course at a point of the route, over that off the route.

    agreement: cosine of the angle between the target's course and that along the route.
    """
    offset = offset_m / sigma_m
    log = math.log(_OFF_WIDTH_M / (sigma_m * math.sqrt(2.0 * math.pi))) - 0.5 * offset * offset
    if speed_m_s > _SLOW_M_S:
        angle = math.acos(min(max(agreement, -1.0), 1.0)) / _COURSE_SIGMA_RAD
        like = math.exp(-0.5 * angle * angle) * math.sqrt(2.0 * math.pi) / _COURSE_SIGMA_RAD
        log += math.log((1.0 - _ANY_COURSE) * like + _ANY_COURSE)
    return max(log, _LEAST_EVIDENCE)


@inner
def _move(way: RouteArrays, chance: FloatArray, travelled_m: float, skips: float, found: FloatArray) -> None:
    """Fill in the probabilities (n,) of one direction after the target has travelled. skips: share that skips."""
    n, cells = len(chance), travelled_m / way.spacing_m
    whole = math.floor(cells)
    past, spread = cells - whole, _SPREAD if travelled_m > 0.0 else 0.0
    found[:] = 0.0
    for i in range(n):
        if chance[i] < _NO_CHANCE:
            continue
        for k in range(-1, 3):
            share = (1.0 - 2.0 * spread if k == 0 else spread if k < 2 else 0.0) * (1.0 - past)
            share += (1.0 - 2.0 * spread if k == 1 else spread if k > -1 else 0.0) * past
            to = i + whole + k
            to = to % n if way.lap else min(max(to, 0), n - 1)
            found[to] += share * chance[i]
    if skips <= 0.0:
        return
    fading, ahead, behind = math.exp(-way.spacing_m / _SKIP_M), 0.0, 0.0
    for i in range(n):
        skipping = skips * found[i]
        found[i] += ahead * (1.0 - fading) - skipping
        ahead = ahead * fading + _SKIPS_AHEAD * skipping
    for i in range(n - 1, -1, -1):
        skipping = skips * found[i]
        found[i] += behind * (1.0 - fading)
        behind = behind * fading + (1.0 - _SKIPS_AHEAD) * skipping


@inlined
def _share(per_s: float, dt_s: float) -> float:
    return 1.0 - math.exp(-per_s * dt_s)


@compiled
def update_progress(way: RouteArrays, target: TargetState, progress: Progress) -> None:
    """Process an estimate of the target, in order of time."""
    state = progress.state[0]
    dt_s = target.time_s - state.last_s
    if dt_s < 0.05:
        return
    first = math.isnan(dt_s)
    dt_s = 1.0 if first else min(dt_s, 10.0)
    state.last_s = target.time_s
    n = len(way.points)
    chance, moved = progress.chances, np.empty((2, n))
    speed_m_s = math.hypot(target.velocity_east_m_s, target.velocity_north_m_s)
    travelled_m = speed_m_s * dt_s if speed_m_s > _MOVING_M_S else 0.0
    shown_s = dt_s if travelled_m > 0.0 else _STILL * dt_s
    for d in range(2):
        _move(way, chance[d], travelled_m, _share(_SKIPS_PER_S, dt_s) if travelled_m > 0.0 else 0.0, moved[d])
    if travelled_m > 0.0 and way.direction == 0.0:
        turning = _share(_TURNS_BACK_PER_S, dt_s)
        for i in range(n):
            forward, backward = moved[0, i], moved[1, n - 1 - i]
            moved[0, i] += turning * (backward - forward)
            moved[1, n - 1 - i] += turning * (forward - backward)
    off, leaves = state.off_chance, _share(1.0 / _LEAVES_AFTER_S, shown_s)
    joins, jumps = 0.5 if first else _share(_JOINS_PER_S, dt_s), _share(_JUMPS_PER_S, dt_s)
    moved *= 1.0 - leaves - jumps
    _weigh(way, target, joins * off + jumps * (1.0 - off), shown_s, state, moved)
    off = off * (1.0 - joins) + (1.0 - off) * leaves
    total = off
    for d in range(2):
        for i in range(n):
            total += moved[d, i]
    state.off_chance = max(off / total, _MIN_CHANCE)
    chance[:] = moved / total
    if state.off_chance < 1.0 - _ON_ABOVE:
        state.on_route = True
    elif state.off_chance > 1.0 - _OFF_BELOW:
        state.on_route = False
    _summarise(way, target, dt_s, state, chance)
    _compare(way, target, state)


@inner
def _weigh(
    way: RouteArrays, target: TargetState, joining: float, dt_s: float, state: Record, chance: FloatArray
) -> None:
    """Weigh the probabilities (2, n) of the points by the estimate; ``joining`` is first shared by those near it."""
    n, exponent, p = len(way.points), _SHARE_PER_S * dt_s, target.covariance
    ve, vn = target.velocity_east_m_s, target.velocity_north_m_s
    speed_m_s = math.hypot(ve, vn)
    sigma_m = math.sqrt(way.tolerance_m**2 + max(0.5 * (p[0, 0] + p[1, 1]), 0.0))
    gate2, beyond, near = (_GATE * sigma_m) ** 2, math.exp(_LEAST_EVIDENCE * exponent), 0
    away2 = np.empty(n)
    for i in range(n):
        away2[i] = (way.points[i, 0] - target.east_m) ** 2 + (way.points[i, 1] - target.north_m) ** 2
        near += 1 if away2[i] < gate2 else 0
    for i in range(n):
        if away2[i] >= gate2:
            chance[0, i] *= beyond
            chance[1, n - 1 - i] *= beyond
            continue
        joins, ahead_m = joining / near, state.direction * (i * way.spacing_m - state.along_m)
        if not math.isnan(ahead_m) and not _REJOINS_FROM_M < ahead_m < _REJOINS_TO_M:
            joins *= _ELSEWHERE
        tangent_e, tangent_n = _tangent(way, i * way.spacing_m)
        agreement = (ve * tangent_e + vn * tangent_n) / max(speed_m_s, 1e-6)
        for d in range(2):
            at, direction = (i, 1.0) if d == 0 else (n - 1 - i, -1.0)
            if direction * way.direction < 0.0:
                chance[d, at] = 0.0
                continue
            prior = _BACKWARD if direction < 0.0 and way.direction == 0.0 else 1.0
            evidence = _evidence(math.sqrt(away2[i]), sigma_m, direction * agreement, speed_m_s)
            chance[d, at] = (chance[d, at] + prior * joins) * math.exp(exponent * evidence)


@inner
def _register(
    way: RouteArrays, target: TargetState, tangent_e: float, tangent_n: float, gone_m: float, state: Record
) -> None:
    """Estimate the route's displacement from the target's distance aside of a tangent: a Kalman filter.

    What was aside before a turn is along the course after it: the position along the route is corrected by that.
    """
    d, p = state.displaced_m, state.displaced_m2
    kept = math.exp(-gone_m / _DISPLACED_OVER_M)
    new_m2 = (1.0 - kept * kept) * _DISPLACED_SIGMA_M**2
    d *= kept
    p *= kept * kept
    p[0] += new_m2
    p[2] += new_m2
    point_e, point_n = point_along(way, state.along_m)
    right_e, right_n = tangent_n, -tangent_e
    aside_m = right_e * (target.east_m - point_e - d[0]) + right_n * (target.north_m - point_n - d[1])
    east_m2, north_m2 = p[0] * right_e + p[1] * right_n, p[1] * right_e + p[2] * right_n
    variance_m2 = right_e * east_m2 + right_n * north_m2 + _ASIDE_SIGMA_M**2
    gain_e, gain_n = east_m2 / variance_m2, north_m2 / variance_m2
    d[0] += gain_e * aside_m
    d[1] += gain_n * aside_m
    p[0] -= gain_e * east_m2
    p[1] -= gain_e * north_m2
    p[2] -= gain_n * north_m2


@inner
def _summarise(way: RouteArrays, target: TargetState, dt_s: float, state: Record, chance: FloatArray) -> None:
    """Fill in the most probable part of the route, the speed along it, and the usual speed."""
    n = len(way.points)
    best_d, best_i = divmod(np.argmax(chance), n)
    reach, part, off_mean = int(_PART_M / way.spacing_m) + 1, 0.0, 0.0
    for k in range(-reach, reach + 1):
        at = best_i + k
        at = at % n if way.lap else at
        if 0 <= at < n:
            part += chance[best_d, at]
            off_mean += k * chance[best_d, at]
    middle, direction = best_i + off_mean / max(part, _NO_CHANCE), 1.0 - 2.0 * best_d
    along_m = way.spacing_m * (middle if best_d == 0 else n - 1 - middle)
    tangent_e, tangent_n = _tangent(way, along_m)
    along_m -= state.displaced_m[0] * tangent_e + state.displaced_m[1] * tangent_n
    if way.lap:
        along_m -= length_m(way) * math.floor(along_m / length_m(way))
    else:
        along_m = min(max(along_m, 0.0), length_m(way))
    state.chance = part
    if not state.on_route and not math.isnan(state.along_m):
        return
    went_m = along_m - state.along_m - state.speed_m_s * dt_s
    if way.lap:
        went_m -= length_m(way) * math.floor(went_m / length_m(way) + 0.5)
    same = state.direction == direction and abs(went_m) < _OTHER_PART_M
    tangent_e, tangent_n = _tangent(way, along_m)
    speed_m_s = target.velocity_east_m_s * tangent_e + target.velocity_north_m_s * tangent_n
    speed_m_s = direction * max(direction * speed_m_s, 0.0)
    state.part += 0 if same else 1
    state.along_m, state.direction = along_m, direction
    state.speed_m_s += (_share(1.0 / _SPEED_S, dt_s) if same else 1.0) * (speed_m_s - state.speed_m_s)
    state.present_m_s += (_share(1.0 / _PRESENT_S, dt_s) if same else 1.0) * (speed_m_s - state.present_m_s)
    over_ground_m_s = math.hypot(target.velocity_east_m_s, target.velocity_north_m_s)
    if state.on_route and over_ground_m_s > _MOVING_M_S:
        _register(way, target, tangent_e, tangent_n, over_ground_m_s * dt_s, state)
    if over_ground_m_s > _SLOW_M_S:
        usual_m_s = state.usual_m_s
        new_m_s = _share(1.0 / _USUAL_S, dt_s) * (over_ground_m_s - usual_m_s)
        state.usual_m_s = over_ground_m_s if math.isnan(usual_m_s) else usual_m_s + new_m_s


@compiled
def forecast(way: RouteArrays, state: Record, time_s: float, found: FloatArray) -> None:
    """Fill in points (k, 2) of the route, one each second from a time on, that the target is expected to pass.

    Its speed rises from the present one to the mean of that and the expected or usual one. It does not fall: a target
    that has become faster would be nearer to the aircraft than predicted.
    """
    now_m_s = abs(state.present_m_s)
    usual_m_s = state.usual_m_s if math.isnan(way.speed_m_s) else way.speed_m_s
    settled_m_s = 0.5 * (now_m_s + usual_m_s) if usual_m_s > now_m_s else now_m_s
    along_m = state.along_m + state.present_m_s * (time_s - state.last_s)
    for i in range(len(found)):
        found[i, 0], found[i, 1] = point_along(way, along_m)
        speed_m_s = settled_m_s + (now_m_s - settled_m_s) * math.exp(-(i + 0.5) / _SETTLES_S)
        along_m += state.direction * max(speed_m_s, 0.1)


@inner_inlined
def _from_line_m(east_m: float, north_m: float, from_e: float, from_n: float, to_e: float, to_n: float) -> float:
    """Return the distance of a place from the line between two points."""
    line_e, line_n, off_e, off_n = to_e - from_e, to_n - from_n, east_m - from_e, north_m - from_n
    along = (off_e * line_e + off_n * line_n) / max(line_e * line_e + line_n * line_n, 1e-9)
    along = min(max(along, 0.0), 1.0)
    return math.hypot(off_e - along * line_e, off_n - along * line_n)


@inner
def _compare(way: RouteArrays, target: TargetState, state: Record) -> None:
    """Compare the forecast that is due with where the target is, decide whether the route is of use, and forecast."""
    e, n = target.east_m, target.north_m
    due = math.floor(target.time_s) % _AHEAD_S
    points, velocity_m_s = state.forecast_m[due], state.forecast_m_s[due]
    if abs(target.time_s - state.forecast_s[due] - _AHEAD_S) < 0.6:
        from_e, from_n, reach_s = points[0, 0], points[0, 1], _FORECAST - 1
        straight_m = _from_line_m(
            e, n, from_e, from_n, from_e + reach_s * velocity_m_s[0], from_n + reach_s * velocity_m_s[1]
        )
        route_m = _WORST_M
        for i in range(reach_s):
            line_m = _from_line_m(e, n, points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1])
            route_m = min(route_m, line_m)
        state.route_error_m2 += (route_m**2 - state.route_error_m2) / _COMPARED_S
        state.straight_error_m2 += (min(straight_m, _WORST_M) ** 2 - state.straight_error_m2) / _COMPARED_S
        ratio = _OF_NO_USE_ABOVE if state.of_use else _OF_USE_BELOW
        limit_m2 = ratio * state.straight_error_m2 + _ROUNDING_M2
        state.of_use = state.route_error_m2 < limit_m2
    state.forecast_s[due] = np.nan
    if not state.on_route:
        return
    state.forecast_s[due] = target.time_s
    velocity_m_s[0], velocity_m_s[1] = target.velocity_east_m_s, target.velocity_north_m_s
    forecast(way, state, target.time_s, points)
    off_e, off_n = e - points[0, 0], n - points[0, 1]
    for i in range(_FORECAST):
        points[i, 0] += off_e
        points[i, 1] += off_n
