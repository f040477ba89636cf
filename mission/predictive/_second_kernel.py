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
import numpy.typing as npt

from estimators.compiled import compiled, inlined
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
from mission.predictive._cost_kernel import CostTerms, Float32, IntArray, Table, cost_rate, fading_per_s, table_value
from mission.predictive._moves_kernel import HOLD_CURVATURES, HOLD_LENGTHS, STEP_S, move_from, ramp_on
from mission.predictive._rollout_kernel import Air, Doubt, Futures, Pose
from mission.predictive._scene_kernel import Scene, Situation, in_frame

BoolArray = npt.NDArray[np.bool_]

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


@compiled
def speeds_over_ground(air: Air) -> FloatArray:
    """Return the speed over the ground on so many headings from 0 to a whole turn, in airspeeds.

    The wind triangle takes too long for each sample.
    """
    speeds = np.empty(_HEADINGS + 1)
    for h in range(_HEADINGS + 1):
        ground_m_s = ground_speed_m_s(h * 2.0 * math.pi / _HEADINGS, air.airspeed_m_s, air.wind_x_m_s, air.wind_y_m_s)
        speeds[h] = ground_m_s / air.airspeed_m_s
    return speeds


class Fan(NamedTuple):
    """Second moves from one start, of a level of curvature; sin_h, cos_h: of the heading there.

    flown (k, lines): as :func:`stretch` has it, of no length in still air. placed (3, lines, k): x, y, heading: all
    of a line that is laid (lines,), else its end alone. last (lines,): so many seconds of each, 0 for none.
    """

    start: Pose
    sin_h: float
    cos_h: float
    level: int
    flown: FloatArray
    placed: FloatArray
    laid: BoolArray
    last: IntArray


@inlined
def stretch(s: Seconds, level: int, heading_rad: float, speeds: FloatArray, last: int, flown: FloatArray) -> None:
    """Fill in how far along each second move (k, lines) the aircraft is in wind, in samples, each second up to last.

    speeds: see speeds_over_ground. A line is stretched along itself.
    """
    turned, count = s.turned_rad[level], flown.shape[1]
    for j in range(count):
        flown[0, j] = 0.0
    for k in range(last):
        for j in range(count):
            i = min(int(flown[k, j]), _SAMPLES - 2)
            past = flown[k, j] - i
            at = heading_rad + (turned[j, i] + past * (turned[j, i + 1] - turned[j, i]))
            at *= _HEADINGS / (2.0 * math.pi)
            at -= _HEADINGS * math.floor(at / _HEADINGS)
            h = min(int(at), _HEADINGS - 1)
            flown[k + 1, j] = flown[k, j] + speeds[h] + (at - h) * (speeds[h + 1] - speeds[h])


@inlined
def lay(s: Seconds, fan: Fan, j: int, first: int, last: int) -> None:
    """Fill in second move j of a fan, seconds first..last of it."""
    sin_h, cos_h, x_m, y_m, heading_rad = fan.sin_h, fan.cos_h, fan.start.x_m, fan.start.y_m, fan.start.heading_rad
    own_x, own_y, turned = s.x_m[fan.level, j], s.y_m[fan.level, j], s.turned_rad[fan.level, j]
    x, y, heading, flown = fan.placed[0, j], fan.placed[1, j], fan.placed[2, j], fan.flown
    if len(flown) == 0:
        for k in range(first, last + 1):
            x[k] = x_m + own_x[k] * cos_h + own_y[k] * sin_h
        for k in range(first, last + 1):
            y[k] = y_m - own_x[k] * sin_h + own_y[k] * cos_h
        for k in range(first, last + 1):
            heading[k] = heading_rad + turned[k]
        return
    for k in range(first, last + 1):
        i = min(int(flown[k, j]), _SAMPLES - 2)
        past = flown[k, j] - i
        across_m, along_m = own_x[i] + past * (own_x[i + 1] - own_x[i]), own_y[i] + past * (own_y[i + 1] - own_y[i])
        x[k] = x_m + across_m * cos_h + along_m * sin_h
        y[k] = y_m - across_m * sin_h + along_m * cos_h
        heading[k] = heading_rad + (turned[i] + past * (turned[i + 1] - turned[i]))


@inlined
def _cheapest(
    s: Seconds, fan: Fan, at: int, one: int, second: Second, bound: float, room: FloatArray, ends: FloatArray
) -> float:
    """Return what the cheapest of lines that begin at second ``at`` costs in one future, if it is below a bound.

    What the table says of a line's end bounds its cost from below: few lines have to be followed.
    """
    # Parts of tuples are taken out once: in a loop each access would count its references.
    f, c, table = second.foretold, second.terms, second.table
    rows, sigma, weight = f.rows[one], f.sigma_m[at:], f.weight[at:]
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
    turn_cost_per_s, best, most = f.min_turn_cost_per_s, 0, np.inf
    for j in range(SECONDS):
        last = lasts[j]
        ends[j] = np.inf
        if last > 0:
            place = x[j, last], y[j, last], heading[j, last]
            end = _asked(values, cell_m, rows, classes, share, one, at + last, place[0], place[1], place[2])
            ends[j] = weight[last] * end
            least = ends[j] + turn_cost_per_s * weight[last] * last * STEP_S
            if least < most:
                best, most = j, least
    for i in range(-1, SECONDS):
        j = best if i < 0 else i
        last = lasts[j]
        least = turn_cost_per_s * weight[last] * last * STEP_S
        if i == best or ends[j] + least >= bound:
            continue
        if not laid[j]:
            lay(s, fan, j, 0, last)
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


@compiled
def deep_cost(ahead: FloatArray, end: int, branches: IntArray, scene: Scene, second: Second) -> float:
    """Return the expected cost of a line (4, k) that is on its circle from second ``end`` on."""
    f, table, seconds, radius_m = second.foretold, second.table, second.moves, scene.radius_m
    count, foretold, terms = f.rows.shape[0], f.rows.shape[2], second.terms
    size, horizon = min(ahead.shape[1], foretold), int(second.horizon_s / STEP_S)
    x, y, heading = ahead[0], ahead[1], ahead[2]
    values, after_turn, cell_m = table.values, table.after_turn, table.cell_m
    classes, share, turn_share = f.futures.classes, f.futures.share, f.futures.turn_share
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
    placed, n, ends = np.empty((3, SECONDS, _SAMPLES)), np.empty(SECONDS, np.int64), np.empty(SECONDS)
    laid, calm = np.empty(SECONDS, np.bool_), scene.air.wind_x_m_s == 0.0 and scene.air.wind_y_m_s == 0.0
    speeds, flown = np.empty(0), np.empty((0, SECONDS))
    if not calm:
        speeds, flown = speeds_over_ground(scene.air), np.empty((_SAMPLES, SECONDS))
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
        start = Pose(x[at], y[at], heading[at])
        if not calm:
            stretch(seconds, level, start.heading_rad, speeds, n.max(), flown)
        fan = Fan(start, math.sin(start.heading_rad), math.cos(start.heading_rad), level, flown, placed, laid, n)
        laid[:] = False
        for j in range(SECONDS):
            if n[j] > 0:
                lay(seconds, fan, j, n[j], n[j])
        for one in range(count):
            first = before[one, at] + f.weight[at] * (second.leave if at >= end else second.change)
            if first < best[one]:
                best[one] = first + _cheapest(seconds, fan, at, one, second, best[one] - first, room, ends)
    total = 0.0
    for one in range(count):
        total += f.futures.weight[one] * best[one]
    return total
