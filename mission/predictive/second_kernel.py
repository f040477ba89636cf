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

from sidelong.estimators.compiled import compiled, inlined
from sidelong.mission.core.path import FloatArray
from sidelong.mission.geometry.line_kernel import (
    ARC,
    Circling,
    Craft,
    curvature_per_m,
    moved_m,
    point_at,
    trapezoid,
    turned_rad,
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
from sidelong.mission.predictive.moves_kernel import HOLD_CURVATURES, HOLD_LENGTHS, shape_of, unit_m
from sidelong.mission.predictive.rollout_kernel import STEP_S, Air, Pose, Scenarios, Uncertainty, speed_m_s
from sidelong.mission.predictive.scene_kernel import Scene, in_frame

BoolArray = npt.NDArray[np.bool_]

LEVELS = np.array([-2.0, -1.5, -1.0, -0.75, -0.5, -0.25, 0.0, 0.165, 0.33, 0.5, 0.66, 0.83, 1.0])
SECOND_LENGTHS = HOLD_LENGTHS[::3].copy()
SECONDS = HOLD_CURVATURES.size * SECOND_LENGTHS.size + 1
SAMPLES = 64  # of a second move; longer ones are left out
_HEADINGS = 48


class SecondMoves(NamedTuple):
    """Second moves from each level of curvature, from the origin along y: arrays (levels, lines, samples).

    key (4,): radius, tightest turn's radius, ramp and step that they were laid out for. end (levels, lines): the
    sample from which they are on the circle, 0 for a line that is too long. placed (3, lines, samples), flown
    (samples, lines): room to work in.
    """

    key: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    turned_rad: FloatArray
    end: IntArray
    placed: FloatArray
    flown: FloatArray


def new_second_moves() -> SecondMoves:
    """Return room for second moves."""
    shape = len(LEVELS), SECONDS, SAMPLES
    laid_out = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape[:2], np.int64)
    return SecondMoves(np.zeros(4), *laid_out, np.zeros((3, SECONDS, SAMPLES)), np.zeros((SAMPLES, SECONDS)))


@compiled
def lay_out_second_moves(s: SecondMoves, radius_m: float, turn_radius_m: float, ramp: float, step_m: float) -> None:
    """Fill in the second moves, unless they are there."""
    if s.key[0] == radius_m and s.key[1] == turn_radius_m and s.key[2] == ramp and s.key[3] == step_m:
        return
    s.key[0], s.key[1], s.key[2], s.key[3] = radius_m, turn_radius_m, ramp, step_m
    lengths = len(SECOND_LENGTHS)
    for level in range(len(LEVELS)):
        start_per_m = LEVELS[level] / radius_m
        for j in range(SECONDS):
            hold_per_m, length_m = start_per_m, 0.0
            if j < SECONDS - 1:
                unit = unit_m(j // lengths, radius_m, turn_radius_m)
                hold_per_m, length_m = HOLD_CURVATURES[j // lengths] / unit, SECOND_LENGTHS[j % lengths] * unit
            shape = trapezoid(start_per_m, hold_per_m, length_m, 1.0 / radius_m, ramp)
            end = max(1, math.ceil(shape.end_m / step_m - 1e-9))
            s.end[level, j] = end if end < SAMPLES else 0
            for k in range(1, SAMPLES):
                across_m, along_m = moved_m(shape, 0.0, step_m * (k - 1), step_m * k)
                s.x_m[level, j, k] = s.x_m[level, j, k - 1] + across_m
                s.y_m[level, j, k] = s.y_m[level, j, k - 1] + along_m
                s.turned_rad[level, j, k] = turned_rad(shape, step_m * k)


@compiled
def speeds_over_ground(air: Air) -> FloatArray:
    """Return the speed over the ground on evenly spaced headings from 0 to a whole turn, in airspeeds.

    The wind triangle takes too long for each sample.
    """
    speeds = np.empty(_HEADINGS + 1)
    for h in range(_HEADINGS + 1):
        speeds[h] = speed_m_s(h * 2.0 * math.pi / _HEADINGS, air) / air.airspeed_m_s
    return speeds


class PlacedMoves(NamedTuple):
    """Second moves from one start, of a level of curvature; sin_h, cos_h: of the heading there.

    flown (k, lines): as :func:`stretch` has it, of no length in still air. placed (3, lines, k): x, y, heading: all
    of a line that is laid (lines,), else its end alone. last (lines,): number of seconds of each, 0 for none.
    """

    start: Pose
    sin_h: float
    cos_h: float
    level: int
    flown: FloatArray
    placed: FloatArray
    laid: BoolArray
    last: IntArray


@compiled
def stretch(s: SecondMoves, level: int, heading_rad: float, speeds: FloatArray, last: int, flown: FloatArray) -> None:
    """Fill in how far along each second move (k, lines) the aircraft is in wind, in samples, each second up to last.

    speeds: see speeds_over_ground. A line is stretched along itself.
    """
    turned, count = s.turned_rad[level], flown.shape[1]
    for j in range(count):
        flown[0, j] = 0.0
    for k in range(last):
        for j in range(count):
            i = min(int(flown[k, j]), SAMPLES - 2)
            past = flown[k, j] - i
            at = heading_rad + (turned[j, i] + past * (turned[j, i + 1] - turned[j, i]))
            at *= _HEADINGS / (2.0 * math.pi)
            at -= _HEADINGS * math.floor(at / _HEADINGS)
            h = min(int(at), _HEADINGS - 1)
            flown[k + 1, j] = flown[k, j] + speeds[h] + (at - h) * (speeds[h + 1] - speeds[h])


@inlined
def placed_at(s: SecondMoves, fan: PlacedMoves, j: int, k: int) -> tuple[float, float, float]:
    """Return place and heading (x, y, heading) of second move j of a fan at second k of it."""
    own_x, own_y, turned, level, flown = s.x_m, s.y_m, s.turned_rad, fan.level, fan.flown
    if len(flown) == 0:
        across_m, along_m, turned_rad = own_x[level, j, k], own_y[level, j, k], turned[level, j, k]
    else:
        i = min(int(flown[k, j]), SAMPLES - 2)
        past = flown[k, j] - i
        across_m = own_x[level, j, i] + past * (own_x[level, j, i + 1] - own_x[level, j, i])
        along_m = own_y[level, j, i] + past * (own_y[level, j, i + 1] - own_y[level, j, i])
        turned_rad = turned[level, j, i] + past * (turned[level, j, i + 1] - turned[level, j, i])
    return (
        fan.start.x_m + across_m * fan.cos_h + along_m * fan.sin_h,
        fan.start.y_m - across_m * fan.sin_h + along_m * fan.cos_h,
        fan.start.heading_rad + turned_rad,
    )


@inlined
def lay(s: SecondMoves, fan: PlacedMoves, j: int, last: int) -> None:
    """Fill in second move j of a fan, up to second ``last`` of it."""
    placed = fan.placed
    for k in range(last + 1):
        placed[0, j, k], placed[1, j, k], placed[2, j, k] = placed_at(s, fan, j, k)


MOVE_BRANCHES = np.array([4, 8, 14])
STAY_BRANCHES = np.array([1, 2, 4, 6, 9, 12])
# A circle that is flown on may be valued after one of these durations, s.
_VALUED = np.array([15, 22, 30])
_STRIDE = 4  # of looking at what a turn of the target would cost

# Rows of the prediction, each at whole seconds.
_X, _Y, _SIN, _COS, _FACING_RAD, _TABLE_SIN, _TABLE_COS, _TABLE_RAD = range(8)


class ScenarioRows(NamedTuple):
    """Scenarios (f,), row by row: rows (f, 8, k). sigma_m, weight (k,): of the target's place, of the discount.

    min_value (f, k), min_turn_cost_per_s: no place costs less.
    """

    futures: Scenarios
    rows: FloatArray
    sigma_m: FloatArray
    weight: FloatArray
    min_value: FloatArray
    min_turn_cost_per_s: float


class Workspace(NamedTuple):
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

    scenarios: ScenarioRows
    terms: CostTerms
    table: Table
    moves: SecondMoves
    leave: float
    change: float
    horizon_s: float
    room: Workspace


@compiled
def scenario_rows(
    f: Scenarios, d: Uncertainty, table: Table, min_values: FloatArray, min_after_turn: float
) -> ScenarioRows:
    """Return futures as this look needs them. min_values (classes,): of the table; min_after_turn: of all classes."""
    count, k = f.place.shape[:2]
    rows, sigma_m, weight = np.empty((count, 8, k)), np.empty(k), np.empty(k)
    by_row = ScenarioRows(f, rows, sigma_m, weight, np.zeros((count, k)), min_after_turn / table.mean_leg_s)
    _fill_rows(by_row, d, fading_per_s(table), min_values)
    return by_row


@compiled
def _fill_rows(by_row: ScenarioRows, d: Uncertainty, rate_per_s: float, min_values: FloatArray) -> None:
    """Fill in the rows. rate_per_s: of the discount."""
    f, rows, min_value = by_row.futures, by_row.rows, by_row.min_value
    place2, velocity2 = d.position_m * d.position_m, d.velocity_m_s * d.velocity_m_s
    for i in range(rows.shape[2]):
        since_s = i * STEP_S
        by_row.sigma_m[i] = math.sqrt(place2 + velocity2 * since_s * since_s)
        by_row.weight[i] = math.exp(-rate_per_s * since_s)
        for one in range(len(rows)):
            rows[one, _X, i], rows[one, _Y, i] = f.place[one, i, 0], f.place[one, i, 1]
            for j in range(3):
                rows[one, _SIN + j, i], rows[one, _TABLE_SIN + j, i] = f.facing[one, i, j], f.course[one, i, j]
            for c in range(4):
                min_value[one, i] += f.share[one, i, c] * min_values[f.classes[one, i, c]]


@compiled
def workspace_for(f: Scenarios, air: Air) -> Workspace:
    """Return arrays to work in."""
    count, steps = f.place.shape[:2]
    calm = air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0
    return Workspace(
        np.empty((3, steps + SAMPLES)),
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
        arc_m += STEP_S * speed_m_s(ahead[2, k], scene.air)
        k += 1
    return ahead[:, :k], end if end >= 0 else k - 1


@compiled
def moving_ahead(scene: Scene, craft: Craft, move: int) -> tuple[FloatArray, int]:
    """Return a move (x, y, heading, curvature) (4, k), and the second from which it is on its circle."""
    air, shape = scene.air, shape_of(scene, craft, move)
    heading_rad = scene.mirror * (scene.start.course_rad - scene.course_rad)
    ahead, end = np.empty((4, 4 * SAMPLES)), -1
    x_m, y_m = in_frame(scene, scene.start.east_m, scene.start.north_m)
    arc_m, k = 0.0, 0
    while k < _VALUED[0] + 2 or (end < 0 and k < ahead.shape[1]):
        course_rad = heading_rad + turned_rad(shape, arc_m)
        ahead[0, k], ahead[1, k], ahead[2, k] = x_m, y_m, course_rad
        ahead[3, k] = curvature_per_m(shape, arc_m)
        if end < 0 and arc_m >= shape.end_m - 1e-6:
            end = k
        to_m = arc_m + STEP_S * speed_m_s(course_rad, air)
        across_m, along_m = moved_m(shape, heading_rad, arc_m, to_m)
        x_m, y_m, arc_m, k = x_m + across_m, y_m + along_m, to_m, k + 1
    return ahead[:, :k], end if end >= 0 else k - 1


class Ahead(NamedTuple):
    """Rows of one future from the second on at which a line begins, arrays (k,): see ScenarioRows."""

    x_m: FloatArray
    y_m: FloatArray
    sin_f: FloatArray
    cos_f: FloatArray
    sigma_rad: FloatArray
    sigma_m: FloatArray
    weight: FloatArray


@inlined
def _ahead(f: ScenarioRows, one: int, at: int) -> Ahead:
    """Return the rows of scenario ``one`` from second ``at`` on."""
    rows, sigma_m, weight = f.rows[one], f.sigma_m[at:], f.weight[at:]
    facing = rows[_SIN, at:], rows[_COS, at:], rows[_FACING_RAD, at:]
    return Ahead(rows[_X, at:], rows[_Y, at:], facing[0], facing[1], facing[2], sigma_m, weight)


@inlined
def _running(x: FloatArray, y: FloatArray, j: int, n: int, ahead: Ahead, c: CostTerms, room: FloatArray) -> None:
    """Fill in the discounted running cost at n places of line j, as the last of three rows of room."""
    # Loops of one row each, over arrays that begin where the line does: so the compiler makes vectors of them.
    to_x, to_y, sin_f, cos_f, sigma_rad, sigma, weight = ahead
    for k in range(n):
        room[0, k] = (x[j, k] - to_x[k]) * cos_f[k] - (y[j, k] - to_y[k]) * sin_f[k]
    for k in range(n):
        room[1, k] = (x[j, k] - to_x[k]) * sin_f[k] + (y[j, k] - to_y[k]) * cos_f[k]
    for k in range(n):
        aside_m = sigma_rad[k] * room[1, k]
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
    at: tuple[float, float, float],
) -> float:
    """Return what the table says at second k of a future for x, y and heading; rows (8, k): its own."""
    x_m, y_m, heading_rad = at
    x_m, y_m = x_m - rows[_X, k], y_m - rows[_Y, k]
    sin_t, cos_t = rows[_TABLE_SIN, k], rows[_TABLE_COS, k]
    across, along = x_m * cos_t - y_m * sin_t, x_m * sin_t + y_m * cos_t
    return table_value(values, cell_m, across, along, heading_rad - rows[_TABLE_RAD, k], classes, share, one, k)


@inlined
def _cheapest(s: SecondMoves, fan: PlacedMoves, at: int, one: int, second: Second, bound: float) -> float:
    """Return what the cheapest of lines that begin at second ``at`` costs in one future, if it is below a bound.

    What the table says of a line's end bounds its cost from below: few lines have to be followed.
    """
    f, c, table = second.scenarios, second.terms, second.table
    rows, weight, min_value = f.rows[one], f.weight[at:], f.min_value[one, at:]
    ahead = _ahead(f, one, at)
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
        end = _asked(values, cell_m, rows, classes, share, one, at + last, place)
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
        _running(x, y, j, last + 1, ahead, c, room)
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
                after_turn, cell_m, rows, classes, turn_share, one, at + m, (x[j, m], y[j, m], heading[j, m])
            )
            turns += length * STEP_S / mean_leg_s * weight[m] * after
            if turns > bound - cost:
                break
        bound = min(bound, cost + turns)
    return bound


@inlined
def _lasts(s: SecondMoves, curvature: float, at: int, horizon: int, steps: int, last: IntArray) -> tuple[int, int]:
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
        last[j] = 0 if end == 0 or at + last[j] >= steps else last[j]
        longest = max(longest, last[j])
    return level, longest


@inlined
def _least_from(f: ScenarioRows, one: int, at: int, last: IntArray) -> float:
    """Return what second moves cost at least in one future: from the end on the least of the table's classes."""
    least = np.inf
    for j in range(SECONDS):
        k = at + last[j]
        if last[j] > 0:
            least = min(least, f.weight[k] * (f.min_value[one, k] + f.min_turn_cost_per_s * last[j] * STEP_S))
    return least


@inlined
def _expected(f: ScenarioRows, costs: FloatArray) -> float:
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
    f, table, seconds, radius_m = second.scenarios, second.table, second.moves, scene.radius_m
    count, steps, terms = f.rows.shape[0], f.rows.shape[2], second.terms
    size, horizon = min(ahead.shape[1], steps), int(second.horizon_s / STEP_S)
    x, y, heading = ahead[0], ahead[1], ahead[2]
    values, after_turn, cell_m = table.values, table.after_turn, table.cell_m
    classes, share, turn_share = f.futures.classes, f.futures.share, f.futures.turn_share
    room = second.room
    before, best, running = room.before, room.best, room.rows[2]
    for one in range(count):
        rows = f.rows[one]
        _running(ahead[0:1], ahead[1:2], 0, size, _ahead(f, one, 0), terms, room.rows)
        before[one, 0] = turned = 0.0
        for k in range(1, size):
            if (k - 1) % _STRIDE == 0:
                m = min(k + 1, size - 1)
                after = _asked(after_turn, cell_m, rows, classes, turn_share, one, m, (x[m], y[m], heading[m]))
                turned = STEP_S / table.mean_leg_s * f.weight[m] * after
            before[one, k] = before[one, k - 1] + 0.5 * STEP_S * (running[k - 1] + running[k]) + turned
        best[one] = np.inf
        for valued in _VALUED:
            k = min(max(end, valued), size - 1)
            cost = before[one, k] + f.weight[k] * _asked(
                values, cell_m, rows, classes, share, one, k, (x[k], y[k], heading[k])
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
            _lasts(seconds, ahead[3, at] * radius_m, at, horizon, steps, n)
            for one in range(count):
                paid = before[one, at] + f.weight[at] * (second.leave if at >= end else second.change)
                first[one] = min(first[one], paid + _least_from(f, one, at, n))
        least = _expected(f, first)
        if least >= bar:
            return least
    for at in branches:
        if at >= size or at >= horizon:
            break
        level, longest = _lasts(seconds, ahead[3, at] * radius_m, at, horizon, steps, n)
        promising = False
        for one in range(count):
            first[one] = before[one, at] + f.weight[at] * (second.leave if at >= end else second.change)
            promising |= first[one] + _least_from(f, one, at, n) < best[one]
        if not promising:
            continue
        start = Pose(x[at], y[at], heading[at])
        if not calm:
            stretch(seconds, level, start.heading_rad, room.speeds, longest, flown)
        fan = PlacedMoves(
            start, math.sin(start.heading_rad), math.cos(start.heading_rad), level, flown, placed, laid, n
        )
        laid[:] = False
        for j in range(SECONDS):
            if n[j] > 0:
                placed[0, j, n[j]], placed[1, j, n[j]], placed[2, j, n[j]] = placed_at(seconds, fan, j, n[j])
        for one in range(count):
            if first[one] < best[one]:
                best[one] = first[one] + _cheapest(seconds, fan, at, one, second, best[one] - first[one])
    return _expected(f, best)
