"""The target's progress along a route: a filter with several hypotheses of where on the route it is, or off it.

Each hypothesis is a one-dimensional Kalman filter of the position along the route and the speed along it (negative:
backward). A route may pass the same point several times, so every part of the route near the target starts a
hypothesis. The hypotheses compete with each other, and with "off the route", by the likelihood of the lateral offset
and of the course. A hypothesis keeps its direction: a target that turns back is one more hypothesis. So the end of a
row of a field, where the route doubles back, is not mistaken for turning back.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sidelong.estimators.compiled import compiled, inlined
from sidelong.mission.core.path import FloatArray
from sidelong.mission.viewpoint.viewpoint_kernel import Known

HYPOTHESES = 8
# Columns of a hypothesis: position and speed along the route, their covariance, direction (1, -1) and probability.
ALONG_M, SPEED_M_S, VARIANCE_M2, COVARIANCE, VARIANCE_SPEED, DIRECTION, CHANCE = range(7)
# The memory: time of the last update, probability of "off", usual speed, whether reported as on the route, then the
# hypotheses.
LAST_S, OFF_CHANCE, USUAL_M_S, ON_ROUTE = range(4)
_FIRST = 4
PROGRESS_SIZE = _FIRST + 7 * HYPOTHESES

_ACCELERATION_M_S2 = 0.5
_LEAVES_AFTER_S = 150.0
# Share of the probability that new hypotheses receive each second: from "off", and from all others.
_JOINS_PER_S, _JUMPS_PER_S, _BACKWARD = 0.02, 0.002, 0.15
# A target may cut a corner, or turn before the end of a row: the next part of the route starts with more.
_SHORT_CUT_M, _SHORT_CUT = 60.0, 10.0
# Errors of lateral offset and course are correlated from second to second: their likelihoods count in part.
_SHARE_PER_S = 0.45
_OFF_WIDTH_M = 100.0  # lateral offsets of a target off the route are spread over this width
_COURSE_SIGMA_RAD, _ANY_COURSE = 0.45, 0.1
_SLOW_M_S = 0.7  # the course of a slower target is not compared
_ALONG_SIGMA_M, _SPEED_SIGMA_M_S = 4.0, 0.4  # errors of the projection to the route, beyond the estimate's
_TANGENT_M = 8.0  # the route's course is that of a chord this far to both sides
_NEAR_M = 25.0  # hypotheses this near, in the same direction, are one
_GATE = 3.0
_MIN_CHANCE = 1e-4
_ON_ABOVE, _OFF_BELOW = 0.7, 0.5
_USUAL_S = 40.0


class Way(NamedTuple):
    """A route as the loops see it: points (n, 2), east and north, evenly spaced; n = 0 for no route.

    speed_m_s: expected speed, NaN for unknown. direction: 1 forward, -1 backward, 0 either.
    """

    points: FloatArray
    spacing_m: float
    lap: bool
    tolerance_m: float
    speed_m_s: float
    direction: float


@compiled
def fresh_progress() -> FloatArray:
    """Return the memory before the first update."""
    memory = np.zeros(PROGRESS_SIZE)
    memory[LAST_S], memory[OFF_CHANCE], memory[USUAL_M_S] = np.nan, 1.0, np.nan
    return memory


@compiled
def hypotheses(memory: FloatArray) -> FloatArray:
    """Return the hypotheses (HYPOTHESES, 7), a view of the memory."""
    return memory[_FIRST:].reshape(HYPOTHESES, 7)


@inlined
def length_m(way: Way) -> float:
    """Return the length of the route, of one lap if it is one."""
    n = len(way.points)
    return way.spacing_m * (n if way.lap else n - 1)


@inlined
def point_along(way: Way, along_m: float) -> tuple[float, float]:
    """Return the point (east, north) at a position along the route; beyond its ends, straight on."""
    n, place = len(way.points), along_m / way.spacing_m
    if way.lap:
        place -= n * math.floor(place / n)
        i = min(int(place), n - 1)
        j = i + 1 if i + 1 < n else 0
    else:
        i = min(max(int(place), 0), n - 2)
        j = i + 1
    past = place - i
    return (
        way.points[i, 0] + past * (way.points[j, 0] - way.points[i, 0]),
        way.points[i, 1] + past * (way.points[j, 1] - way.points[i, 1]),
    )


@inlined
def _tangent(way: Way, along_m: float) -> tuple[float, float]:
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


@compiled
def _nearest(way: Way, east_m: float, north_m: float, near_m: float, within_m: float) -> tuple[float, float]:
    """Return the position along the route nearest to a point, and the distance; sought within_m around near_m."""
    n = len(way.points)
    first, last = math.floor((near_m - within_m) / way.spacing_m), math.ceil((near_m + within_m) / way.spacing_m)
    if not way.lap:
        first, last = min(max(first, 0), n - 2), min(max(last, 1), n - 1)
    elif last - first > n:
        last = first + n
    found_m, least2 = near_m, np.inf
    for k in range(first, last):
        i, j = k % n, (k + 1) % n
        e, north = way.points[i, 0], way.points[i, 1]
        de, dn = way.points[j, 0] - e, way.points[j, 1] - north
        span2 = max(de * de + dn * dn, 1e-9)
        share = min(max(((east_m - e) * de + (north_m - north) * dn) / span2, 0.0), 1.0)
        off_e, off_n = east_m - e - share * de, north_m - north - share * dn
        away2 = off_e * off_e + off_n * off_n
        if away2 < least2:
            found_m, least2 = (k + share) * way.spacing_m, away2
    return found_m, math.sqrt(least2)


@inlined
def _evidence(lateral_m: float, sigma_m: float, agreement: float, speed_m_s: float) -> float:
    """Return the log of the likelihood of a lateral offset and a course on the route, over that off the route.

    agreement: cosine of the angle between the target's course and that along the route.
    """
    offset = lateral_m / sigma_m
    log = math.log(_OFF_WIDTH_M / (sigma_m * math.sqrt(2.0 * math.pi))) - 0.5 * offset * offset
    if speed_m_s > _SLOW_M_S:
        angle = math.acos(min(max(agreement, -1.0), 1.0)) / _COURSE_SIGMA_RAD
        like = math.exp(-0.5 * angle * angle) * math.sqrt(2.0 * math.pi) / _COURSE_SIGMA_RAD
        log += math.log((1.0 - _ANY_COURSE) * like + _ANY_COURSE)
    return max(log, -12.0)


@compiled
def _carried_on(way: Way, one: FloatArray, dt_s: float) -> None:
    """Predict a hypothesis."""
    q = _ACCELERATION_M_S2 * _ACCELERATION_M_S2
    one[ALONG_M] += one[SPEED_M_S] * dt_s
    one[VARIANCE_M2] += 2.0 * dt_s * one[COVARIANCE] + dt_s * dt_s * one[VARIANCE_SPEED] + 0.25 * q * dt_s**4
    one[COVARIANCE] += dt_s * one[VARIANCE_SPEED] + 0.5 * q * dt_s**3
    one[VARIANCE_SPEED] += q * dt_s * dt_s
    if not way.lap:
        one[ALONG_M] = min(max(one[ALONG_M], 0.0), length_m(way))


@compiled
def _corrected(one: FloatArray, along_m: float, along_speed_m_s: float, variance_m2: float, variance: float) -> None:
    """Correct a hypothesis by a measured position and speed along the route, one after the other."""
    for i in range(2):
        p = one[VARIANCE_M2] if i == 0 else one[VARIANCE_SPEED]
        gain = 1.0 / (p + (variance_m2 if i == 0 else variance))
        error = along_m - one[ALONG_M] if i == 0 else along_speed_m_s - one[SPEED_M_S]
        to_m = one[VARIANCE_M2] if i == 0 else one[COVARIANCE]
        to_speed = one[COVARIANCE] if i == 0 else one[VARIANCE_SPEED]
        one[ALONG_M] += gain * to_m * error
        one[SPEED_M_S] += gain * to_speed * error
        one[VARIANCE_M2] -= gain * to_m * to_m
        one[COVARIANCE] -= gain * to_m * to_speed
        one[VARIANCE_SPEED] -= gain * to_speed * to_speed


@compiled
def update_progress(way: Way, target: Known, memory: FloatArray) -> None:
    """Process an estimate of the target, in order of time."""
    dt_s = target.time_s - memory[LAST_S]
    if dt_s < 0.05:
        return
    first = math.isnan(dt_s)
    dt_s = 1.0 if first else min(dt_s, 10.0)
    memory[LAST_S] = target.time_s
    held, p = hypotheses(memory), target.covariance
    ve, vn = target.velocity_east_m_s, target.velocity_north_m_s
    speed_m_s = math.hypot(ve, vn)
    if speed_m_s > _SLOW_M_S:
        usual = memory[USUAL_M_S]
        share = 1.0 if math.isnan(usual) else 1.0 - math.exp(-dt_s / _USUAL_S)
        memory[USUAL_M_S] = speed_m_s if math.isnan(usual) else usual + share * (speed_m_s - usual)
    position2 = max(0.5 * (p[0, 0] + p[1, 1]), 0.0)
    velocity2 = max(0.5 * (p[2, 2] + p[3, 3]), 0.0)
    sigma_m, exponent = math.sqrt(way.tolerance_m**2 + position2), _SHARE_PER_S * dt_s
    leaves = 1.0 - math.exp(-dt_s / _LEAVES_AFTER_S)
    for h in range(HYPOTHESES):
        one = held[h]
        if one[CHANCE] <= 0.0:
            continue
        _carried_on(way, one, dt_s)
        within_m = 3.0 * math.sqrt(one[VARIANCE_M2]) + 12.0
        along_m, lateral_m = _nearest(way, target.east_m, target.north_m, one[ALONG_M], within_m)
        tangent_e, tangent_n = _tangent(way, along_m)
        along_speed = ve * tangent_e + vn * tangent_n
        onward_speed = one[DIRECTION] * max(one[DIRECTION] * along_speed, 0.0)
        _corrected(one, along_m, onward_speed, position2 + _ALONG_SIGMA_M**2, velocity2 + _SPEED_SIGMA_M_S**2)
        if way.lap:
            one[ALONG_M] -= length_m(way) * math.floor(one[ALONG_M] / length_m(way))
        agreement = one[DIRECTION] * along_speed / max(speed_m_s, 1e-6)
        memory[OFF_CHANCE] += leaves * one[CHANCE]
        one[CHANCE] *= (1.0 - leaves) * math.exp(exponent * _evidence(lateral_m, sigma_m, agreement, speed_m_s))
    _start(way, target, speed_m_s, sigma_m, 1.0 if first else dt_s, first, held, memory)
    _settle(way, held, memory)


@compiled
def _start(
    way: Way,
    target: Known,
    speed_m_s: float,
    sigma_m: float,
    dt_s: float,
    first: bool,
    held: FloatArray,
    memory: FloatArray,
) -> None:
    """Start a hypothesis on each part of the route near the target that has none."""
    n, gate_m = len(way.points), _GATE * sigma_m
    total = memory[OFF_CHANCE]
    for h in range(HYPOTHESES):
        total += held[h, CHANCE]
    share = (1.0 - math.exp(-_JOINS_PER_S * dt_s)) * memory[OFF_CHANCE]
    share += (1.0 - math.exp(-_JUMPS_PER_S * dt_s)) * (total - memory[OFF_CHANCE])
    share = 0.5 * total if first else share
    for i in range(n):
        here2 = (way.points[i, 0] - target.east_m) ** 2 + (way.points[i, 1] - target.north_m) ** 2
        if here2 > gate_m * gate_m:
            continue
        before, after = i - 1, i + 1
        if way.lap:
            before, after = before % n, after % n
        least = True
        for other in (before, after):
            if 0 <= other < n:
                away2 = (way.points[other, 0] - target.east_m) ** 2 + (way.points[other, 1] - target.north_m) ** 2
                least &= here2 < away2 or (here2 == away2 and other > i)
        if not least:
            continue
        along_m, lateral_m = _nearest(way, target.east_m, target.north_m, i * way.spacing_m, 1.5 * way.spacing_m)
        tangent_e, tangent_n = _tangent(way, along_m)
        along_speed = target.velocity_east_m_s * tangent_e + target.velocity_north_m_s * tangent_n
        direction = 1.0 if along_speed > 0.0 or speed_m_s < _SLOW_M_S else -1.0
        if direction * way.direction < 0.0:
            continue
        agreement = direction * along_speed / max(speed_m_s, 1e-6)
        log = _SHARE_PER_S * _evidence(lateral_m, sigma_m, agreement, speed_m_s)
        chance = share * math.exp(log) * (_BACKWARD if direction < 0.0 and way.direction == 0.0 else 1.0)
        lowest, known, ahead = 0, False, 0.0
        for h in range(HYPOTHESES):
            known |= held[h, CHANCE] > 0.0 and _same(way, held[h], along_m, direction, _NEAR_M)
            if held[h, DIRECTION] == direction and 0.0 < direction * (along_m - held[h, ALONG_M]) < _SHORT_CUT_M:
                ahead = max(ahead, held[h, CHANCE])
            if held[h, CHANCE] < held[lowest, CHANCE]:
                lowest = h
        chance *= 1.0 + _SHORT_CUT * ahead
        if known or chance <= held[lowest, CHANCE]:
            continue
        one = held[lowest]
        one[ALONG_M], one[SPEED_M_S] = along_m, along_speed
        one[VARIANCE_M2], one[COVARIANCE], one[VARIANCE_SPEED] = 100.0, 0.0, 1.0
        one[DIRECTION], one[CHANCE] = direction, chance


@inlined
def _same(way: Way, one: FloatArray, along_m: float, direction: float, near_m: float) -> bool:
    """Return whether a hypothesis is at a position, in the same direction and on the same leg."""
    apart_m = abs(one[ALONG_M] - along_m)
    if way.lap:
        apart_m = min(apart_m, length_m(way) - apart_m)
    if one[DIRECTION] != direction or apart_m > near_m:
        return False
    own_e, own_n = _tangent(way, one[ALONG_M])
    other_e, other_n = _tangent(way, along_m)
    return bool(own_e * other_e + own_n * other_n > 0.5)


@compiled
def _settle(way: Way, held: FloatArray, memory: FloatArray) -> None:
    """Join equal hypotheses, drop improbable ones, normalise, and decide whether the target is on the route."""
    for a in range(HYPOTHESES):
        for b in range(a):
            one, other = held[a], held[b]
            if one[CHANCE] <= 0.0 or other[CHANCE] <= 0.0:
                continue
            if _same(way, one, other[ALONG_M], other[DIRECTION], 0.5 * _NEAR_M):
                kept, dropped = (one, other) if one[CHANCE] > other[CHANCE] else (other, one)
                kept[CHANCE] += dropped[CHANCE]
                dropped[CHANCE] = 0.0
    total = memory[OFF_CHANCE]
    for h in range(HYPOTHESES):
        total += held[h, CHANCE]
    memory[OFF_CHANCE] = max(memory[OFF_CHANCE] / total, _MIN_CHANCE)
    for h in range(HYPOTHESES):
        held[h, CHANCE] /= total
        if held[h, CHANCE] < _MIN_CHANCE:
            held[h, CHANCE] = 0.0
    on = 1.0 - memory[OFF_CHANCE]
    if on > _ON_ABOVE:
        memory[ON_ROUTE] = 1.0
    elif on < _OFF_BELOW:
        memory[ON_ROUTE] = 0.0


@compiled
def likeliest(memory: FloatArray) -> int:
    """Return the most probable hypothesis; -1 if there is none."""
    held, best = hypotheses(memory), -1
    for h in range(HYPOTHESES):
        if held[h, CHANCE] > 0.0 and (best < 0 or held[h, CHANCE] > held[best, CHANCE]):
            best = h
    return best


@compiled
def forecast(
    way: Way, memory: FloatArray, one: FloatArray, time_s: float, settles_s: float, found: FloatArray
) -> None:
    """Fill in points (k, 2) of the route, one each second from a time on, that the target is expected to pass.

    Its speed changes from the present one to the expected or usual one with the time constant ``settles_s``.
    """
    now_m_s = abs(one[SPEED_M_S])
    usual = way.speed_m_s if not math.isnan(way.speed_m_s) else memory[USUAL_M_S]
    usual = 0.5 * (now_m_s + usual) if not math.isnan(usual) else now_m_s
    along_m = one[ALONG_M] + one[SPEED_M_S] * (time_s - memory[LAST_S])
    for i in range(len(found)):
        found[i, 0], found[i, 1] = point_along(way, along_m)
        speed_m_s = max(usual + (now_m_s - usual) * math.exp(-(i + 0.5) / settles_s), 0.1)
        along_m += one[DIRECTION] * speed_m_s
