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

from sidelong.estimators.compiled import compiled, inlined
from sidelong.mission.core.path import FloatArray
from sidelong.mission.geometry.line_kernel import (
    ARC,
    Circling,
    Craft,
    curvature_per_m,
    ground_speed_m_s,
    moved_m,
    point_at,
    turned_rad,
    with_last_ramp,
)
from sidelong.mission.predictive.cost_kernel import (
    CostTerms,
    Float32,
    IntArray,
    Table,
    cost_rate,
    fading_per_s,
    table_value,
)
from sidelong.mission.predictive.moves_kernel import STEP_S, move_from, ramp_on
from sidelong.mission.predictive.rollout_kernel import Air, Doubt, Futures, Pose
from sidelong.mission.predictive.scene_kernel import Scene, in_frame
from sidelong.mission.predictive.second_moves_kernel import (
    LEVELS,
    SAMPLES,
    SECONDS,
    BoolArray,
    Fan,
    Seconds,
    lay,
    placed_at,
    speeds_over_ground,
    stretch,
)

MOVE_BRANCHES = np.array([4, 8, 14])
STAY_BRANCHES = np.array([1, 2, 4, 6, 9, 12])
# A circle that is flown on may be valued after one of these durations, s.
_VALUED = np.array([15, 22, 30])
_STRIDE = 4  # of looking at what a turn of the target would cost

# Rows of the prediction, each at whole seconds.
_X, _Y, _SIN, _COS, _BESIDE, _TABLE_SIN, _TABLE_COS, _TABLE_RAD = range(8)


class Foretold(NamedTuple):
    """Futures (f,), row by row: rows (f, 8, k). sigma_m, weight (k,): of the target's place, of the discount.

    min_value (f, k), min_turn_cost_per_s: no place costs less.
    """

    futures: Futures
    rows: FloatArray
    sigma_m: FloatArray
    weight: FloatArray
    min_value: FloatArray
    min_turn_cost_per_s: float


class Room(NamedTuple):
    """Arrays to work in, made once a decision; speeds: see :func:`speeds_over_ground`, none in still air.

    rows (3, k + SAMPLES); before (f, 4 * SAMPLES); best, first (f,); of second moves laid, last, ends (SECONDS,).
    """

    rows: FloatArray
    before: FloatArray
    best: FloatArray
    first: FloatArray
    laid: BoolArray
    last: IntArray
    ends: FloatArray
    speeds: FloatArray


class Second(NamedTuple):
    """What second moves are judged by. leave, change: what one costs from the circle, and before it."""

    foretold: Foretold
    terms: CostTerms
    table: Table
    moves: Seconds
    leave: float
    change: float
    horizon_s: float
    room: Room


@compiled
def foretold_of(f: Futures, d: Doubt, table: Table, min_values: FloatArray, min_after_turn: float) -> Foretold:
    """Return futures as this look needs them. min_values (classes,): of the table; min_after_turn: of all classes."""
    count, k = f.place.shape[:2]
    found = Foretold(
        f,
        np.empty((count, 8, k)),
        np.empty(k),
        np.empty(k),
        np.zeros((count, k)),
        min_after_turn / table.mean_leg_s,
    )
    _foretell(found, d, fading_per_s(table), min_values)
    return found


@compiled
def _foretell(found: Foretold, d: Doubt, rate_per_s: float, min_values: FloatArray) -> None:
    """Fill in the rows. rate_per_s: of the discount."""
    f, rows, min_value = found.futures, found.rows, found.min_value
    place2, velocity2 = d.position_m * d.position_m, d.velocity_m_s * d.velocity_m_s
    for i in range(rows.shape[2]):
        since_s = i * STEP_S
        found.sigma_m[i] = math.sqrt(place2 + velocity2 * since_s * since_s)
        found.weight[i] = math.exp(-rate_per_s * since_s)
        for one in range(len(rows)):
            rows[one, _X, i], rows[one, _Y, i] = f.place[one, i, 0], f.place[one, i, 1]
            for j in range(3):
                rows[one, _SIN + j, i], rows[one, _TABLE_SIN + j, i] = f.facing[one, i, j], f.course[one, i, j]
            for c in range(4):
                min_value[one, i] += f.share[one, i, c] * min_values[f.classes[one, i, c]]


@compiled
def room_for(f: Futures, air: Air) -> Room:
    """Return arrays to work in."""
    count, foretold = f.place.shape[:2]
    calm = air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0
    return Room(
        np.empty((3, foretold + SAMPLES)),
        np.empty((count, 4 * SAMPLES)),
        np.empty(count),
        np.empty(count),
        np.empty(SECONDS, np.bool_),
        np.empty(SECONDS, np.int64),
        np.empty(SECONDS),
        np.empty(0) if calm else speeds_over_ground(air),
    )


@compiled
def staying_ahead(scene: Scene, under_way: bool) -> tuple[FloatArray, int]:
    """Return the present plan (x, y, heading, curvature) (4, k), and the second from which it is on its circle.

    The circle is flown from where the aircraft departs, also if that is not on it.
    """
    line, circle = scene.line, scene.circle
    length_m, arc_m, from_east_m, from_north_m = 0.0, 0.0, scene.start.east_m, scene.start.north_m
    if under_way:
        length_m, arc_m, from_east_m, from_north_m = (
            line[ARC, line.shape[1] - 1],
            scene.arc_m,
            scene.aircraft_east_m,
            scene.aircraft_north_m,
        )
    else:
        course_rad, radius_m = scene.start.course_rad, circle.radius_m
        line = line[:, :0]
        circle = Circling(
            from_east_m + radius_m * math.cos(course_rad), from_north_m - radius_m * math.sin(course_rad), radius_m
        )
    ahead, end, k = np.empty((4, 4 * SAMPLES)), -1, 0
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
    ramp, start_per_m = ramp_on(heading_rad, air, craft), scene.mirror * scene.start.curvature_per_m
    one = move_from(start_per_m, move, scene.radius_m, scene.turn_radius_m, ramp)
    one = with_last_ramp(one, ramp_on(heading_rad + turned_rad(one, one[4]), air, craft))
    ahead, end = np.empty((4, 4 * SAMPLES)), -1
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


@inlined
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


@inlined
def _asked(
    values: Float32,
    cell_m: float,
    rows: FloatArray,
    classes: IntArray,
    share: FloatArray,
    one: int,
    k: int,
    x_m: float,
    y_m: float,
    heading_rad: float,
) -> float:
    """Return what the table says at second k of a future; rows (8, k): its own."""
    x_m, y_m = x_m - rows[_X, k], y_m - rows[_Y, k]
    sin_t, cos_t = rows[_TABLE_SIN, k], rows[_TABLE_COS, k]
    across, along = x_m * cos_t - y_m * sin_t, x_m * sin_t + y_m * cos_t
    return table_value(values, cell_m, across, along, heading_rad - rows[_TABLE_RAD, k], classes, share, one, k)


@inlined
def _cheapest(s: Seconds, fan: Fan, at: int, one: int, second: Second, bound: float) -> float:
    """Return what the cheapest of lines that begin at second ``at`` costs in one future, if it is below a bound.

    What the table says of a line's end bounds its cost from below: few lines have to be followed.
    """
    f, c, table = second.foretold, second.terms, second.table
    rows, sigma, weight, min_value = f.rows[one], f.sigma_m[at:], f.weight[at:], f.min_value[one, at:]
    to_x, to_y, sin_f, cos_f, beside = (
        rows[_X, at:],
        rows[_Y, at:],
        rows[_SIN, at:],
        rows[_COS, at:],
        rows[_BESIDE, at:],
    )
    values, after_turn, cell_m, mean_leg_s = table.values, table.after_turn, table.cell_m, table.mean_leg_s
    classes, share, turn_share = f.futures.classes, f.futures.share, f.futures.turn_share
    x, y, heading, laid, lasts = fan.placed[0], fan.placed[1], fan.placed[2], fan.laid, fan.last
    room, ends = second.room.rows, second.room.ends
    turn_cost_per_s, best, most = f.min_turn_cost_per_s, 0, np.inf
    for j in range(SECONDS):
        last = lasts[j]
        ends[j] = np.inf
        least = turn_cost_per_s * weight[last] * last * STEP_S
        if last == 0 or weight[last] * min_value[last] + least >= bound:
            continue
        place = x[j, last], y[j, last], heading[j, last]
        end = _asked(values, cell_m, rows, classes, share, one, at + last, place[0], place[1], place[2])
        ends[j] = weight[last] * end
        if ends[j] + least < most:
            best, most = j, ends[j] + least
    if most >= bound:
        return bound
    for i in range(-1, SECONDS):
        j = best if i < 0 else i
        last = lasts[j]
        least = turn_cost_per_s * weight[last] * last * STEP_S
        if i == best or ends[j] + least >= bound:
            continue
        if not laid[j]:
            lay(s, fan, j, last)
            laid[j] = True
        _running(x, y, j, last + 1, to_x, to_y, sin_f, cos_f, beside, sigma, weight, c, room)
        cost = -0.5 * (room[2, 0] + room[2, last])
        for k in range(last + 1):
            cost += room[2, k]
        cost = cost * STEP_S + ends[j]
        if cost + least >= bound:
            continue
        turns = 0.0
        for k in range(0, last, _STRIDE):
            length = min(_STRIDE, last - k)
            m = k + length // 2
            after = _asked(
                after_turn, cell_m, rows, classes, turn_share, one, at + m, x[j, m], y[j, m], heading[j, m]
            )
            turns += length * STEP_S / mean_leg_s * weight[m] * after
            if turns > bound - cost:
                break
        bound = min(bound, cost + turns)
    return bound


@inlined
def _lasts(s: Seconds, curvature: float, at: int, horizon: int, foretold: int, last: IntArray) -> tuple[int, int]:
    """Fill in how many seconds of each second move count that begins at a curvature, in 1 / radius, 0 for none.

    Return the level of curvature that is nearest, and the most seconds.
    """
    level, longest = 0, 0
    for i in range(len(LEVELS)):
        if abs(LEVELS[i] - curvature) < abs(LEVELS[level] - curvature):
            level = i
    for j in range(SECONDS):
        end = s.end[level, j]
        last[j] = min(max(end, horizon - at), SAMPLES - 1)
        last[j] = 0 if end == 0 or at + last[j] >= foretold else last[j]
        longest = max(longest, last[j])
    return level, longest


@inlined
def _least_from(f: Foretold, one: int, at: int, last: IntArray) -> float:
    """Return what second moves cost at least in one future: from the end on the least of the table's classes."""
    least = np.inf
    for j in range(SECONDS):
        k = at + last[j]
        if last[j] > 0:
            least = min(least, f.weight[k] * (f.min_value[one, k] + f.min_turn_cost_per_s * last[j] * STEP_S))
    return least


@inlined
def _expected(f: Foretold, costs: FloatArray) -> float:
    """Return the mean of what futures cost (f,)."""
    total = 0.0
    for one in range(len(f.rows)):
        total += f.futures.weight[one] * costs[one]
    return total


@compiled
def deep_cost(ahead: FloatArray, end: int, branches: IntArray, scene: Scene, second: Second, bar: float) -> float:
    """Return the expected cost of a line (4, k) that is on its circle from second ``end`` on.

    Where it is the bar or more, something between the bar and it may be returned: then few second moves are followed.
    """
    f, table, seconds, radius_m = second.foretold, second.table, second.moves, scene.radius_m
    count, foretold, terms = f.rows.shape[0], f.rows.shape[2], second.terms
    size, horizon = min(ahead.shape[1], foretold), int(second.horizon_s / STEP_S)
    x, y, heading = ahead[0], ahead[1], ahead[2]
    values, after_turn, cell_m = table.values, table.after_turn, table.cell_m
    classes, share, turn_share = f.futures.classes, f.futures.share, f.futures.turn_share
    room = second.room
    before, best, found = room.before, room.best, room.rows[2]
    for one in range(count):
        rows = f.rows[one]
        to_x, to_y, sin_f, cos_f, beside = rows[_X], rows[_Y], rows[_SIN], rows[_COS], rows[_BESIDE]
        _running(
            ahead[0:1], ahead[1:2], 0, size, to_x, to_y, sin_f, cos_f, beside, f.sigma_m, f.weight, terms, room.rows
        )
        before[one, 0] = turned = 0.0
        for k in range(1, size):
            if (k - 1) % _STRIDE == 0:
                m = min(k + 1, size - 1)
                after = _asked(after_turn, cell_m, rows, classes, turn_share, one, m, x[m], y[m], heading[m])
                turned = STEP_S / table.mean_leg_s * f.weight[m] * after
            before[one, k] = before[one, k - 1] + 0.5 * STEP_S * (found[k - 1] + found[k]) + turned
        best[one] = np.inf
        for valued in _VALUED:
            k = min(max(end, valued), size - 1)
            cost = before[one, k] + f.weight[k] * _asked(
                values, cell_m, rows, classes, share, one, k, x[k], y[k], heading[k]
            )
            best[one] = min(best[one], cost)
            if end > 0:
                break
    first, laid, n, calm = room.first, room.laid, room.last, len(room.speeds) == 0
    flown, placed = seconds.flown[:0] if calm else seconds.flown, seconds.placed
    if bar < np.inf:
        for one in range(count):
            first[one] = best[one]
        for at in branches:
            if at >= size or at >= horizon:
                break
            _lasts(seconds, ahead[3, at] * radius_m, at, horizon, foretold, n)
            for one in range(count):
                paid = before[one, at] + f.weight[at] * (second.leave if at >= end else second.change)
                first[one] = min(first[one], paid + _least_from(f, one, at, n))
        least = _expected(f, first)
        if least >= bar:
            return least
    for at in branches:
        if at >= size or at >= horizon:
            break
        level, longest = _lasts(seconds, ahead[3, at] * radius_m, at, horizon, foretold, n)
        promising = False
        for one in range(count):
            first[one] = before[one, at] + f.weight[at] * (second.leave if at >= end else second.change)
            promising |= first[one] + _least_from(f, one, at, n) < best[one]
        if not promising:
            continue
        start = Pose(x[at], y[at], heading[at])
        if not calm:
            stretch(seconds, level, start.heading_rad, room.speeds, longest, flown)
        fan = Fan(start, math.sin(start.heading_rad), math.cos(start.heading_rad), level, flown, placed, laid, n)
        laid[:] = False
        for j in range(SECONDS):
            if n[j] > 0:
                placed[0, j, n[j]], placed[1, j, n[j]], placed[2, j, n[j]] = placed_at(seconds, fan, j, n[j])
        for one in range(count):
            if first[one] < best[one]:
                best[one] = first[one] + _cheapest(seconds, fan, at, one, second, best[one] - first[one])
    return _expected(f, best)
