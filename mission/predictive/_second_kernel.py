"""The inner loops of a look two moves deep: what a line costs whose course may be changed once more on the way.

Everything stands at whole seconds since the departure, in its frame. At some seconds of a line, the branches, second
moves begin: from the nearest of a few levels of curvature, along lines that are laid out once. Each future takes its
own cheapest second move, because by then the target will have shown what it does; the second move costs what any
move costs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.compiled import compiled
from mission.core.path import FloatArray
from mission.geometry._line_kernel import (
    ARC,
    Circling,
    Craft,
    curvature_per_m,
    ground_speed_m_s,
    moved_m,
    point_at,
    trapezoid,
    turned_rad,
    with_last_ramp,
)
from mission.predictive._cost_kernel import CostTerms, IntArray, Table, cost_rate, fading_per_s, table_value
from mission.predictive._moves_kernel import HOLD_CURVATURES, HOLD_LENGTHS, STEP_S, move_from, ramp_on
from mission.predictive._rollout_kernel import Air, Doubt, Futures
from mission.predictive._scene_kernel import Scene, Situation, in_frame

LEVELS = np.array([-1.0, -0.75, -0.5, -0.25, 0.0, 0.165, 0.33, 0.5, 0.66, 0.83, 1.0])
SECOND_LENGTHS = HOLD_LENGTHS[::3].copy()
SECONDS = HOLD_CURVATURES.size * SECOND_LENGTHS.size + 1
MOVE_BRANCHES = np.array([4, 8, 14])
STAY_BRANCHES = np.array([1, 2, 4, 6, 9, 12])
# A circle that is flown on may be valued after so many seconds.
_VALUED = np.array([15, 22, 30])
_SAMPLES = 64  # of a second move; longer ones are left out
_HEADINGS = 48
_STRIDE = 4  # of looking at what a turn of the target would cost

# Rows of what is foretold, each at whole seconds.
_X, _Y, _SIN, _COS, _BESIDE, _TABLE_SIN, _TABLE_COS, _TABLE_RAD = range(8)


class Seconds(NamedTuple):
    """Second moves from each level of curvature, from the origin along y: arrays (levels, lines, samples).

    key (3,): radius, ramp and step that they were laid out for. end (levels, lines): the sample from which they are
    on the circle, 0 for a line that is too long.
    """

    key: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    turned_rad: FloatArray
    end: IntArray


class Foretold(NamedTuple):
    """Futures (f,), row by row: rows (f, 8, k). sigma_m, weight (k,): of the target's place, of the discount.

    min_value, min_turn_cost_per_s: no place costs less.
    """

    futures: Futures
    rows: FloatArray
    sigma_m: FloatArray
    weight: FloatArray
    min_value: float
    min_turn_cost_per_s: float


class Second(NamedTuple):
    """What second moves are judged by. leave, change: what one costs from the circle, and before it."""

    foretold: Foretold
    terms: CostTerms
    table: Table
    moves: Seconds
    leave: float
    change: float
    horizon_s: float


def no_seconds() -> Seconds:
    """Return room for second moves."""
    shape = len(LEVELS), SECONDS, _SAMPLES
    return Seconds(np.zeros(3), np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape[:2], np.int64))


@compiled
def lay_out_seconds(s: Seconds, radius_m: float, ramp: float, step_m: float) -> None:
    """Fill in the second moves, unless they are there."""
    if s.key[0] == radius_m and s.key[1] == ramp and s.key[2] == step_m:
        return
    s.key[0], s.key[1], s.key[2] = radius_m, ramp, step_m
    lengths = len(SECOND_LENGTHS)
    for level in range(len(LEVELS)):
        start_per_m = LEVELS[level] / radius_m
        for j in range(SECONDS):
            hold_per_m, length_m = start_per_m, 0.0
            if j < SECONDS - 1:
                hold_per_m, length_m = (
                    HOLD_CURVATURES[j // lengths] / radius_m,
                    SECOND_LENGTHS[j % lengths] * radius_m,
                )
            one = trapezoid(start_per_m, hold_per_m, length_m, 1.0 / radius_m, ramp)
            end = max(1, math.ceil(one[5] / step_m - 1e-9))
            s.end[level, j] = end if end < _SAMPLES else 0
            for k in range(1, _SAMPLES):
                across_m, along_m = moved_m(one, 0.0, step_m * (k - 1), step_m * k)
                s.x_m[level, j, k] = s.x_m[level, j, k - 1] + across_m
                s.y_m[level, j, k] = s.y_m[level, j, k - 1] + along_m
                s.turned_rad[level, j, k] = turned_rad(one, step_m * k)


@compiled
def foretold_of(f: Futures, d: Doubt, table: Table, min_value: float, min_after_turn: float) -> Foretold:
    """Return futures as this look needs them."""
    count, k = f.place.shape[:2]
    rows, sigma_m, weight = np.empty((count, 8, k)), np.empty(k), np.empty(k)
    for i in range(k):
        since_s = i * STEP_S
        sigma_m[i] = math.hypot(d.position_m, d.velocity_m_s * since_s)
        weight[i] = math.exp(-fading_per_s(table) * since_s)
        for one in range(count):
            rows[one, 0, i], rows[one, 1, i] = f.place[one, i, 0], f.place[one, i, 1]
            for j in range(3):
                rows[one, 2 + j, i], rows[one, 5 + j, i] = f.facing[one, i, j], f.course[one, i, j]
    return Foretold(f, rows, sigma_m, weight, min_value, min_after_turn / table.mean_leg_s)


@compiled
def staying_ahead(scene: Scene, now: Situation, under_way: bool) -> tuple[FloatArray, int]:
    """Return the present plan (x, y, heading, curvature) (4, k), and the second from which it is on its circle.

    The circle is flown from where the aircraft departs, be it beside it.
    """
    line, circle = now.line, now.circle
    length_m, arc_m, from_east_m, from_north_m = 0.0, 0.0, scene.start.east_m, scene.start.north_m
    if under_way:
        length_m, arc_m, from_east_m, from_north_m = (
            line[ARC, line.shape[1] - 1],
            scene.arc_m,
            now.east_m,
            now.north_m,
        )
    else:
        course_rad, radius_m = scene.start.course_rad, circle.radius_m
        line = line[:, :0]
        circle = Circling(
            from_east_m + radius_m * math.cos(course_rad), from_north_m - radius_m * math.sin(course_rad), radius_m
        )
    ahead, end, k = np.empty((4, 4 * _SAMPLES)), -1, 0
    while k < _VALUED[-1] + 2 or (end < 0 and k < ahead.shape[1]):
        here = point_at(line, circle, arc_m, from_east_m, from_north_m)
        ahead[0, k], ahead[1, k] = in_frame(scene, here.east_m, here.north_m)
        ahead[2, k] = scene.mirror * (here.course_rad - scene.course_rad)
        ahead[3, k] = scene.mirror * here.curvature_per_m
        if end < 0 and arc_m >= length_m:
            end = k
        arc_m += STEP_S * ground_speed_m_s(
            ahead[2, k], scene.air.airspeed_m_s, scene.air.wind_x_m_s, scene.air.wind_y_m_s
        )
        k += 1
    return ahead[:, :k], end if end >= 0 else k - 1


@compiled
def moving_ahead(scene: Scene, craft: Craft, move: int) -> tuple[FloatArray, int]:
    """Return a move (x, y, heading, curvature) (4, k), and the second from which it is on its circle."""
    air = scene.air
    heading_rad = scene.mirror * (scene.start.course_rad - scene.course_rad)
    one = move_from(
        scene.mirror * scene.start.curvature_per_m, move, scene.radius_m, ramp_on(heading_rad, air, craft)
    )
    one = with_last_ramp(one, ramp_on(heading_rad + turned_rad(one, one[4]), air, craft))
    ahead, end = np.empty((4, 4 * _SAMPLES)), -1
    x_m, y_m = in_frame(scene, scene.start.east_m, scene.start.north_m)
    arc_m, k = 0.0, 0
    while k < _VALUED[0] + 2 or (end < 0 and k < ahead.shape[1]):
        course_rad = heading_rad + turned_rad(one, arc_m)
        ahead[0, k], ahead[1, k], ahead[2, k] = x_m, y_m, course_rad
        ahead[3, k] = curvature_per_m(one, arc_m)
        if end < 0 and arc_m >= one[5] - 1e-6:
            end = k
        to_m = arc_m + STEP_S * ground_speed_m_s(course_rad, air.airspeed_m_s, air.wind_x_m_s, air.wind_y_m_s)
        across_m, along_m = moved_m(one, heading_rad, arc_m, to_m)
        x_m, y_m, arc_m, k = x_m + across_m, y_m + along_m, to_m, k + 1
    return ahead[:, :k], end if end >= 0 else k - 1


@compiled
def _running(
    x: FloatArray,
    y: FloatArray,
    j: int,
    n: int,
    to_x: FloatArray,
    to_y: FloatArray,
    sin_f: FloatArray,
    cos_f: FloatArray,
    beside: FloatArray,
    sigma: FloatArray,
    weight: FloatArray,
    c: CostTerms,
    room: FloatArray,
) -> None:
    """Fill in the discounted running cost at n places of line j, as the last of three rows of room."""
    # Loops of one row each, over arrays that begin where the line does: so the compiler makes vectors of them.
    for k in range(n):
        room[0, k] = (x[j, k] - to_x[k]) * cos_f[k] - (y[j, k] - to_y[k]) * sin_f[k]
    for k in range(n):
        room[1, k] = (x[j, k] - to_x[k]) * sin_f[k] + (y[j, k] - to_y[k]) * cos_f[k]
    for k in range(n):
        aside_m = beside[k] * room[1, k]
        blur_m = 1.0 + math.sqrt(sigma[k] * sigma[k] + aside_m * aside_m)
        room[2, k] = weight[k] * cost_rate(room[0, k], room[1, k], sigma[k], blur_m, c)


@compiled
def _asked(
    table: Table, f: Foretold, one: int, k: int, x_m: float, y_m: float, heading_rad: float, after_turn: bool
) -> float:
    """Return what the table says at second k of a future."""
    rows = f.rows[one]
    x_m, y_m = x_m - rows[_X, k], y_m - rows[_Y, k]
    sin_t, cos_t = rows[_TABLE_SIN, k], rows[_TABLE_COS, k]
    across, along = x_m * cos_t - y_m * sin_t, x_m * sin_t + y_m * cos_t
    heading_rad -= rows[_TABLE_RAD, k]
    values, share = table.values, f.futures.share
    if after_turn:
        values, share = table.after_turn, f.futures.turn_share
    return table_value(values, table.cell_m, across, along, heading_rad, f.futures.classes, share, one, k)


@compiled
def _turns_cost(
    x: FloatArray,
    y: FloatArray,
    heading: FloatArray,
    n: int,
    at: int,
    one: int,
    f: Foretold,
    table: Table,
    bound: float,
) -> float:
    """Return what the target's turning within n seconds from second ``at`` on costs; more than bound is enough."""
    total = 0.0
    for k in range(0, n, _STRIDE):
        length = min(_STRIDE, n - k)
        m = k + length // 2
        after = _asked(table, f, one, at + m, x[m], y[m], heading[m], True)
        total += length * STEP_S / table.mean_leg_s * f.weight[at + m] * after
        if total > bound:
            break
    return float(total)


@compiled
def laid_from(
    s: Seconds, level: int, x_m: float, y_m: float, heading_rad: float, air: Air, placed: FloatArray, n: IntArray
) -> None:
    """Fill in (x, y, heading) (3, lines, k) of the second moves, so many seconds of each, from a place."""
    calm = air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0
    sin_h, cos_h = math.sin(heading_rad), math.cos(heading_rad)
    speeds = np.empty(
        _HEADINGS + 1
    )  # over the ground, in airspeeds: the wind triangle takes too long for each sample
    for h in range(0 if calm else _HEADINGS + 1):
        ground_m_s = ground_speed_m_s(h * 2.0 * math.pi / _HEADINGS, air.airspeed_m_s, air.wind_x_m_s, air.wind_y_m_s)
        speeds[h] = ground_m_s / air.airspeed_m_s
    for j in range(SECONDS):
        if n[j] > 0 and calm:
            for k in range(n[j] + 1):
                placed[0, j, k] = x_m + s.x_m[level, j, k] * cos_h + s.y_m[level, j, k] * sin_h
            for k in range(n[j] + 1):
                placed[1, j, k] = y_m - s.x_m[level, j, k] * sin_h + s.y_m[level, j, k] * cos_h
            for k in range(n[j] + 1):
                placed[2, j, k] = heading_rad + s.turned_rad[level, j, k]
        elif n[j] > 0:
            flown = 0.0
            for k in range(n[j] + 1):
                i = min(int(flown), _SAMPLES - 2)
                past = flown - i
                across_m = s.x_m[level, j, i] + past * (s.x_m[level, j, i + 1] - s.x_m[level, j, i])
                along_m = s.y_m[level, j, i] + past * (s.y_m[level, j, i + 1] - s.y_m[level, j, i])
                turned = s.turned_rad[level, j, i] + past * (
                    s.turned_rad[level, j, i + 1] - s.turned_rad[level, j, i]
                )
                placed[0, j, k] = x_m + across_m * cos_h + along_m * sin_h
                placed[1, j, k] = y_m - across_m * sin_h + along_m * cos_h
                placed[2, j, k] = heading_rad + turned
                at = (heading_rad + turned) * (_HEADINGS / (2.0 * math.pi))
                at -= _HEADINGS * math.floor(at / _HEADINGS)
                h = min(int(at), _HEADINGS - 1)
                flown += speeds[h] + (at - h) * (speeds[h + 1] - speeds[h])


@compiled
def _cheapest(
    placed: FloatArray, n: IntArray, at: int, one: int, second: Second, bound: float, room: FloatArray
) -> float:
    """Return what the cheapest of lines that begin at second ``at`` costs in one future, if it is below a bound."""
    f, c, table = second.foretold, second.terms, second.table
    to_x, to_y, sin_f, cos_f = (
        f.rows[one, _X, at:],
        f.rows[one, _Y, at:],
        f.rows[one, _SIN, at:],
        f.rows[one, _COS, at:],
    )
    beside, sigma, weight, x, y = f.rows[one, _BESIDE, at:], f.sigma_m[at:], f.weight[at:], placed[0], placed[1]
    for j in range(SECONDS):
        last = n[j]
        if last == 0:
            continue
        _running(x, y, j, last + 1, to_x, to_y, sin_f, cos_f, beside, sigma, weight, c, room)
        cost = -0.5 * (room[2, 0] + room[2, last])
        for k in range(last + 1):
            cost += room[2, k]
        cost *= STEP_S
        least = f.min_turn_cost_per_s * weight[last] * last * STEP_S
        if cost + weight[last] * f.min_value + least < bound:
            heading = placed[2]
            cost += weight[last] * _asked(table, f, one, at + last, x[j, last], y[j, last], heading[j, last], False)
            if cost + least < bound:
                cost += _turns_cost(x[j], y[j], heading[j], last, at, one, f, table, bound - cost)
                bound = min(bound, cost)
    return bound


@compiled
def deep_cost(ahead: FloatArray, end: int, branches: IntArray, scene: Scene, second: Second) -> float:
    """Return the expected cost of a line (4, k) that is on its circle from second ``end`` on."""
    f, table, seconds, radius_m = second.foretold, second.table, second.moves, scene.radius_m
    count, foretold, terms = f.rows.shape[0], f.rows.shape[2], second.terms
    size, horizon = min(ahead.shape[1], foretold), int(second.horizon_s / STEP_S)
    x, y, heading = ahead[0], ahead[1], ahead[2]
    room = np.empty((3, foretold + _SAMPLES))
    before, best, found = np.zeros((count, size)), np.empty(count), room[2]
    for one in range(count):
        rows = f.rows[one]
        to_x, to_y, sin_f, cos_f, beside = rows[_X], rows[_Y], rows[_SIN], rows[_COS], rows[_BESIDE]
        _running(ahead[0:1], ahead[1:2], 0, size, to_x, to_y, sin_f, cos_f, beside, f.sigma_m, f.weight, terms, room)
        turned = 0.0
        for k in range(1, size):
            if (k - 1) % _STRIDE == 0:
                m = min(k + 1, size - 1)
                after = _asked(table, f, one, m, x[m], y[m], heading[m], True)
                turned = STEP_S / table.mean_leg_s * f.weight[m] * after
            before[one, k] = before[one, k - 1] + 0.5 * STEP_S * (found[k - 1] + found[k]) + turned
        best[one] = np.inf
        for valued in _VALUED:
            k = min(max(end, valued), size - 1)
            cost = before[one, k] + f.weight[k] * _asked(table, f, one, k, x[k], y[k], heading[k], False)
            best[one] = min(best[one], cost)
            if end > 0:
                break
    placed, n = np.empty((3, SECONDS, _SAMPLES)), np.empty(SECONDS, np.int64)
    for at in branches:
        if at >= size or at >= horizon:
            break
        level = 0
        for i in range(len(LEVELS)):
            if abs(LEVELS[i] - ahead[3, at] * radius_m) < abs(LEVELS[level] - ahead[3, at] * radius_m):
                level = i
        for j in range(SECONDS):
            last = seconds.end[level, j]
            n[j] = min(max(last, horizon - at), _SAMPLES - 1)
            n[j] = 0 if last == 0 or at + n[j] >= foretold else n[j]
        laid_from(seconds, level, x[at], y[at], heading[at], scene.air, placed, n)
        for one in range(count):
            first = before[one, at] + f.weight[at] * (second.leave if at >= end else second.change)
            if first < best[one]:
                best[one] = first + _cheapest(placed, n, at, one, second, best[one] - first, room)
    total = 0.0
    for one in range(count):
        total += f.futures.weight[one] * best[one]
    return total
