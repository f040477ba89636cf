"""The moves that a planner chooses among: 70 trapezoids, going back to the circle at once, and figures of eight.

Figures of eight are for a gimbal that cannot pan all around. On a circle the heading turns through all directions,
and a target outside it is beyond the limits for a part of each lap. An aircraft that flies past the target and
turns towards it at both ends always has it within about 120 degrees of the nose: a figure of eight with its long
axis across the line of sight. Its legs are bent around the target: on a straight one the target falls back. A move
is a half of it: a leg away from the circle, a turn the other way round, and a leg back onto a circle.

A look two moves deep: at some whole seconds of a line, the branches, second moves begin, from the nearest of a few
levels of curvature, along lines that are laid out once. Each future takes its own cheapest second move, because by
then the target will have shown what it does; the second move costs what any move costs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled, inlined, inner, inner_inlined
from sidelong.mission.core.path import FloatArray
from sidelong.mission.geometry.line_kernel import (
    ARC,
    COURSE,
    EAST,
    NORTH,
    Air,
    Craft,
    LinePoint,
    Trapezoid,
    circle_touching,
    curvature_per_m,
    laid_out,
    moved_m,
    point_at,
    sharpness_per_m2,
    speed_m_s,
    trapezoid,
    turned_rad,
    with_last_ramp,
)
from sidelong.mission.predictive.rollout_kernel import (
    STEP_S,
    CostTerms,
    Float32,
    IntArray,
    Lines,
    Pose,
    Sampling,
    Scenarios,
    Shapes,
    Table,
    Uncertainty,
    cost_rate,
    fading_per_s,
    spread,
    table_value,
    times_s,
)
from sidelong.mission.predictive.scene_kernel import Scene, in_frame

BoolArray = npt.NDArray[np.bool_]

# The length of the legs, in radii of the circle; their curvature towards the target, as a share of the circle's; and
# the turn between them, in radians.
OUTWARD, BACK, BEND = np.array([1.5, 3.5, 5.5, 7.5]), np.array([1.5, 3.5, 5.5, 7.5]), np.array([0.13, 0.27])
TURNED = np.array([2.2, 2.7, 3.2])
EIGHTS = OUTWARD.size * BACK.size * BEND.size * TURNED.size


@inner
def shapes_of(
    start_per_m: float, eight: int, signed_radius_m: float, ramp_per_m2: float
) -> tuple[Trapezoid, Trapezoid, Trapezoid]:
    """Return leg, turn and leg of a figure of eight, by its number; positive radius: it ends clockwise."""
    turned, rest = TURNED[eight % TURNED.size], eight // TURNED.size
    bend, rest = BEND[rest % BEND.size], rest // BEND.size
    back, outward = BACK[rest % BACK.size], OUTWARD[rest // BACK.size]
    radius_m, circle_per_m = abs(signed_radius_m), 1.0 / signed_radius_m
    return (
        trapezoid(start_per_m, -bend * circle_per_m, outward * radius_m, -circle_per_m, ramp_per_m2),
        trapezoid(-circle_per_m, -circle_per_m, turned * radius_m, -circle_per_m, ramp_per_m2),
        trapezoid(-circle_per_m, bend * circle_per_m, back * radius_m, circle_per_m, ramp_per_m2),
    )


@compiled
def eight_line(start: LinePoint, eight: int, signed_radius_m: float, ramp_per_m2: float) -> FloatArray:
    """Return the line (5, n) of a figure of eight, by its number, from a point of the plane."""
    leg, turn, leg_back = shapes_of(start.curvature_per_m, eight, signed_radius_m, ramp_per_m2)
    line = laid_out(leg, start.east_m, start.north_m, start.course_rad)
    for shape in (turn, leg_back):
        part = laid_out(shape, line[EAST, -1], line[NORTH, -1], line[COURSE, -1])
        part[ARC] += line[ARC, -1]
        line = np.concatenate((line, part[:, 1:]), axis=1)
    return line


@compiled
def eights_from(start_per_m: float, radius_m: float, ramp_per_m2: float, sampling: Sampling) -> Lines:
    """Return the lines of all eights: see :func:`sidelong.mission.predictive.rollout_kernel.spread`."""
    beyond_m, heading_rad, air, rate_per_s = sampling
    step_m = air.airspeed_m_s * STEP_S
    own_first, end_m = np.ones(EIGHTS + 1, np.int64), np.empty(EIGHTS)
    for i in range(EIGHTS):
        leg, turn, leg_back = shapes_of(start_per_m, i, radius_m, ramp_per_m2)
        end_m[i] = leg.end_m + turn.end_m + leg_back.end_m
        own_first[i + 1] = own_first[i] + math.ceil((end_m[i] + beyond_m) / step_m)
    samples = own_first[EIGHTS]
    x, y, turned = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    time, weight = np.zeros(samples), np.ones(samples)
    for i in range(EIGHTS):
        shapes = shapes_of(start_per_m, i, radius_m, ramp_per_m2)
        first, last, part = own_first[i], own_first[i + 1] - 1, 0
        x_m, y_m, arc_m, begun_m, begun_rad = 0.0, 0.0, 0.0, 0.0, 0.0
        arc, course = np.zeros(last - first + 2), np.full(last - first + 2, heading_rad)
        for s in range(first, last + 1):
            to_m = end_m[i] + beyond_m if s == last else arc_m + step_m
            while True:
                until_m = to_m if part == 2 else min(to_m, begun_m + shapes[part].end_m)
                across_m, along_m = moved_m(shapes[part], begun_rad, arc_m - begun_m, until_m - begun_m)
                x_m, y_m, arc_m = x_m + across_m, y_m + along_m, until_m
                if until_m == to_m:
                    break
                begun_rad += turned_rad(shapes[part], shapes[part].end_m)
                begun_m, part = until_m, part + 1
            x[s], y[s], turned[s] = x_m, y_m, begun_rad + turned_rad(shapes[part], arc_m - begun_m)
            arc[s - first + 1], course[s - first + 1] = arc_m, heading_rad + turned[s]
        time[first : last + 1] = times_s(course, arc, air)[1:]
        weight[first : last + 1] = np.exp(-rate_per_s * time[first : last + 1])
    trunk = np.zeros(EIGHTS, np.int64)
    return Lines(x, y, turned, time, weight, np.array([0, 1]), own_first, trunk, trunk + 1, end_m)


# A ramp turns the aircraft by less than this either way.
RAMP_TURNS_RAD = (-0.5, -0.25, 0.0, 0.25, 0.5)

# The moves, in units of the circle's radius, for a circle flown clockwise; mirrored for the other way round. Holds of
# curvature -1 turn the other way: that is how the aircraft gets round a target that turned back. They are as tight as
# a transition may be, in units of that turn's radius. "Back to the circle at once" is the last.
HOLD_CURVATURES = np.array([-1.0, -0.5, 0.0, 0.33, 0.66])
HOLD_LENGTHS = np.array([0.0, 0.2, 0.4, 0.6, 0.9, 1.2, 1.6, 2.1, 2.7, 3.4, 4.2, 5.2, 6.4, 8.0])
# How long the circle may be flown on before the next move.
STAY_LENGTHS = np.array([0.2, 0.6, 1.2, 2.0, 3.2, 4.8, 2.0 * math.pi])
MOVES = HOLD_CURVATURES.size * HOLD_LENGTHS.size + 1

_SLOTS, _SAMPLES_MAX = 12, 4096


class LineCache(NamedTuple):
    """Sets of lines for still air, as many as there are slots, by what they depend on.

    used (slots + 1,): when each was asked for last, then the clock. Arrays (slots, ...) of the fields of Lines.
    """

    key: FloatArray
    used: IntArray
    size: IntArray
    samples: FloatArray
    trunk_first: IntArray
    own_first: IntArray
    trunk: IntArray
    on_trunk: IntArray
    end_m: FloatArray


def new_line_cache() -> LineCache:
    """Return empty slots."""
    used, size = np.zeros(_SLOTS + 1, np.int64), np.zeros(_SLOTS, np.int64)
    counts = HOLD_CURVATURES.size + 2, MOVES + 1, MOVES, MOVES
    trunk_first, own_first, trunk, on_trunk = (np.zeros((_SLOTS, n), np.int64) for n in counts)
    key, samples, end_m = np.zeros((_SLOTS, 7)), np.zeros((_SLOTS, 5, _SAMPLES_MAX)), np.zeros((_SLOTS, MOVES))
    return LineCache(key, used, size, samples, trunk_first, own_first, trunk, on_trunk, end_m)


@inner
def ramp_on(heading_rad: float, air: Air, craft: Craft) -> float:
    """Return the rate of curvature, 1/m^2, for the greatest ground speed met on a ramp that begins on a heading."""
    if air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0:
        return sharpness_per_m2(air.airspeed_m_s, craft)
    fastest_m_s = 0.0
    for turn_rad in RAMP_TURNS_RAD:
        fastest_m_s = max(fastest_m_s, speed_m_s(heading_rad + turn_rad, air))
    return sharpness_per_m2(fastest_m_s, craft)


@inner
def ramp_anywhere(air: Air, craft: Craft) -> float:
    """Return the rate of curvature, 1/m^2, for the greatest ground speed of all headings."""
    return sharpness_per_m2(air.airspeed_m_s + math.hypot(air.wind_x_m_s, air.wind_y_m_s), craft)


@inner
def unit_m(hold: int, radius_m: float, turn_radius_m: float) -> float:
    """Return the radius, m, of which a hold's curvature and lengths are multiples; hold 0 is the tightest turn."""
    return turn_radius_m if hold == 0 else radius_m


@compiled
def move_from(start_per_m: float, move: int, radius_m: float, turn_radius_m: float, ramp_per_m2: float) -> Trapezoid:
    """Return a move, by its number, as a trapezoid from a curvature to the clockwise circle."""
    if move == MOVES - 1:
        return trapezoid(start_per_m, start_per_m, 0.0, 1.0 / radius_m, ramp_per_m2)
    hold, length = move // HOLD_LENGTHS.size, HOLD_LENGTHS[move % HOLD_LENGTHS.size]
    unit = unit_m(hold, radius_m, turn_radius_m)
    return trapezoid(start_per_m, HOLD_CURVATURES[hold] / unit, length * unit, 1.0 / radius_m, ramp_per_m2)


@inner
def _made(
    family: float, scene: Scene, start_per_m: float, ramp_per_m2: float, sampling: Sampling, craft: Craft
) -> Lines:
    """Return the lines of all moves, or stretches of the present circle in the form of moves.

    Such a stretch is a plain arc where the present circle is the clockwise one; from another circle it ramps over at
    its end.
    """
    if family > 0.0:
        holds_per_m, hold = np.full(1, start_per_m), np.zeros(STAY_LENGTHS.size, np.int64)
        lengths_m, last_ramps = STAY_LENGTHS * scene.radius_m, np.full(STAY_LENGTHS.size, ramp_per_m2)
    else:
        holds_per_m, hold = np.empty(HOLD_CURVATURES.size + 1), np.empty(MOVES, np.int64)
        lengths_m, last_ramps = np.empty(MOVES), np.empty(MOVES)
        for k in range(HOLD_CURVATURES.size):
            holds_per_m[k] = HOLD_CURVATURES[k] / unit_m(k, scene.radius_m, scene.turn_radius_m)
        holds_per_m[-1] = start_per_m
        for move in range(MOVES):
            hold[move] = move // HOLD_LENGTHS.size
            shape = move_from(start_per_m, move, scene.radius_m, scene.turn_radius_m, ramp_per_m2)
            unit = unit_m(hold[move], scene.radius_m, scene.turn_radius_m)
            lengths_m[move] = HOLD_LENGTHS[move % HOLD_LENGTHS.size] * unit
            last_ramps[move] = ramp_on(sampling.heading_rad + turned_rad(shape, shape.last_start_m), scene.air, craft)
    shapes = Shapes(start_per_m, holds_per_m, hold, lengths_m, 1.0 / scene.radius_m, ramp_per_m2, last_ramps)
    return spread(shapes, sampling)


@inner
def _slot(kept: LineCache, wanted: FloatArray) -> tuple[int, int]:
    """Return the slot with the lines of a key, -1 for none, and the one asked for longest ago."""
    slots, oldest = len(kept.size), 0
    kept.used[slots] += 1
    for i in range(slots):
        if kept.used[i] > 0 and (kept.key[i] == wanted).all():
            kept.used[i] = kept.used[slots]
            return i, oldest
        if kept.used[i] < kept.used[oldest]:
            oldest = i
    return -1, oldest


@inner
def lines_from(
    family: float,
    scene: Scene,
    start_per_m: float,
    ramp_per_m2: float,
    sampling: Sampling,
    craft: Craft,
    kept: LineCache,
) -> Lines:
    """Return the lines of all moves (family 0) or stays (1) from a curvature; in still air by the cache."""
    calm = scene.air.wind_x_m_s == 0.0 and scene.air.wind_y_m_s == 0.0
    beyond_m, rate_per_s = sampling.beyond_m, sampling.rate_per_s
    wanted = np.array(
        (family, start_per_m, scene.radius_m, ramp_per_m2, beyond_m, rate_per_s, scene.air.airspeed_m_s)
    )
    i, oldest = _slot(kept, wanted) if calm else (-1, 0)
    if i >= 0:
        n, lines, trunks, s = kept.size[i], MOVES, HOLD_CURVATURES.size + 1, kept.samples[i]
        if family > 0.0:
            lines, trunks = STAY_LENGTHS.size, 1
        rows, firsts = (s[0, :n], s[1, :n], s[2, :n], s[3, :n], s[4, :n]), kept.trunk_first[i, : trunks + 1]
        of_lines = kept.trunk[i, :lines], kept.on_trunk[i, :lines], kept.end_m[i, :lines]
        return Lines(*rows, firsts, kept.own_first[i, : lines + 1], *of_lines)
    made = _made(family, scene, start_per_m, ramp_per_m2, sampling, craft)
    n = len(made.x_m)
    if calm and n <= kept.samples.shape[2]:
        kept.key[oldest] = wanted
        kept.used[oldest], kept.size[oldest] = kept.used[-1], n
        for row, values in enumerate((made.x_m, made.y_m, made.turned_rad, made.time_s, made.weight)):
            kept.samples[oldest, row, :n] = values
        kept.trunk_first[oldest, : len(made.trunk_first)] = made.trunk_first
        kept.own_first[oldest, : len(made.own_first)] = made.own_first
        lines = len(made.trunk)
        kept.trunk[oldest, :lines], kept.on_trunk[oldest, :lines] = made.trunk, made.on_trunk
        kept.end_m[oldest, :lines] = made.end_m
    return made


@inner
def shape_of(scene: Scene, craft: Craft, move: int) -> Trapezoid:
    """Return a move, by its number, as a trapezoid in the scene's frame, with ramps for their ground speeds."""
    heading_rad = scene.mirror * (scene.start.course_rad - scene.course_rad)
    ramp_per_m2, start_per_m = ramp_on(heading_rad, scene.air, craft), scene.mirror * scene.start.curvature_per_m
    shape = move_from(start_per_m, move, scene.radius_m, scene.turn_radius_m, ramp_per_m2)
    last_rad = heading_rad + turned_rad(shape, shape.last_start_m)
    return with_last_ramp(shape, ramp_on(last_rad, scene.air, craft))


@compiled
def move_line(scene: Scene, craft: Craft, move: int) -> FloatArray:
    """Return the line (5, n) of a move, from MOVES on of a figure of eight, in the plane."""
    start, m = scene.start, scene.mirror
    if move >= MOVES:
        return eight_line(start, move - MOVES, m * scene.radius_m, ramp_anywhere(scene.air, craft))
    start_per_m, first_per_m2, first_end_m, last_per_m2, last_start_m, end_m = shape_of(scene, craft, move)
    shape = Trapezoid(m * start_per_m, m * first_per_m2, first_end_m, m * last_per_m2, last_start_m, end_m)
    return laid_out(shape, start.east_m, start.north_m, start.course_rad)


LEVELS = np.array([-2.0, -1.5, -1.0, -0.75, -0.5, -0.25, 0.0, 0.165, 0.33, 0.5, 0.66, 0.83, 1.0])
_SECOND_STRIDE = 3
SECOND_LENGTHS = HOLD_LENGTHS[::_SECOND_STRIDE].copy()
SECONDS = HOLD_CURVATURES.size * SECOND_LENGTHS.size + 1
SAMPLES = 64  # of a second move; longer ones are left out
_HEADINGS = 48


class SecondMoves(NamedTuple):
    """Second moves from each level of curvature, from the origin along y: arrays (levels, lines, samples).

    key (4,): what they were laid out for. end (levels, lines): the sample from which they are on the circle, 0 for a
    line that is too long. placed (3, lines, samples), flown (samples, lines): room to work in.
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
def lay_out_second_moves(
    s: SecondMoves, radius_m: float, turn_radius_m: float, ramp_per_m2: float, step_m: float
) -> None:
    """Compute the second moves for a circle and a sampling step, unless they are those computed last."""
    key = np.array((radius_m, turn_radius_m, ramp_per_m2, step_m))
    if (s.key == key).all():
        return
    s.key[:] = key
    for level in range(len(LEVELS)):
        for j in range(SECONDS):
            hold, length = j // len(SECOND_LENGTHS), _SECOND_STRIDE * (j % len(SECOND_LENGTHS))
            move = MOVES - 1 if j == SECONDS - 1 else hold * HOLD_LENGTHS.size + length
            shape = move_from(LEVELS[level] / radius_m, move, radius_m, turn_radius_m, ramp_per_m2)
            end = max(1, math.ceil(shape.end_m / step_m - 1e-9))
            s.end[level, j] = end if end < SAMPLES else 0
            for k in range(1, SAMPLES):
                across_m, along_m = moved_m(shape, 0.0, step_m * (k - 1), step_m * k)
                s.x_m[level, j, k] = s.x_m[level, j, k - 1] + across_m
                s.y_m[level, j, k] = s.y_m[level, j, k - 1] + along_m
                s.turned_rad[level, j, k] = turned_rad(shape, step_m * k)


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
    """Fill in how far along each second move (k, lines) it is in wind, in samples, at each second up to last.

    speeds: ground speed over airspeed by heading. A line is stretched along itself.
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


@inner_inlined
def placed_at(s: SecondMoves, fan: PlacedMoves, j: int, k: int) -> tuple[float, float, float]:
    """Return (x, y, heading) of second move j at its second k, in the frame of the fan's start."""
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
    """Fill in ``fan.placed`` for second move j, up to its second ``last``."""
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
    """Arrays to work in, made once a decision.

    rows (3, k + SAMPLES); before (f, 4 * SAMPLES); best, first (f,); of second moves laid, last, ends (SECONDS,).
    speeds: over the ground on even headings from 0 to a whole turn, in airspeeds; none in still air.
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
    """Return futures rearranged row by row.

    min_values (classes,): least value of each class of the table; min_after_turn: least of all after a turn.
    """
    count, k = f.place.shape[:2]
    rows, min_value, since_s = np.empty((count, 8, k)), np.zeros((count, k)), STEP_S * np.arange(k)
    place2, velocity2 = d.position_m * d.position_m, d.velocity_m_s * d.velocity_m_s
    sigma_m, weight = np.sqrt(place2 + velocity2 * since_s * since_s), np.exp(-fading_per_s(table) * since_s)
    for i in range(k):
        for one in range(count):
            rows[one, _X, i], rows[one, _Y, i] = f.place[one, i, 0], f.place[one, i, 1]
            for j in range(3):
                rows[one, _SIN + j, i], rows[one, _TABLE_SIN + j, i] = f.facing[one, i, j], f.course[one, i, j]
            for c in range(4):
                min_value[one, i] += f.share[one, i, c] * min_values[f.classes[one, i, c]]
    return ScenarioRows(f, rows, sigma_m, weight, min_value, min_after_turn / table.mean_leg_s)


@compiled
def workspace_for(f: Scenarios, air: Air) -> Workspace:
    """Return the arrays that :func:`deep_cost` works in, with the ground speeds in the wind."""
    count, steps = f.place.shape[:2]
    speeds = np.empty(0 if air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0 else _HEADINGS + 1)
    for h in range(len(speeds)):  # the wind triangle takes too long for each sample
        speeds[h] = speed_m_s(h * 2.0 * math.pi / _HEADINGS, air) / air.airspeed_m_s
    rows, before = np.empty((3, steps + SAMPLES)), np.empty((count, 4 * SAMPLES))
    second = np.empty(SECONDS, np.bool_), np.empty(SECONDS, np.int64), np.empty(SECONDS)
    return Workspace(rows, before, np.empty(count), np.empty(count), *second, speeds)


@compiled
def staying_ahead(scene: Scene, under_way: bool) -> tuple[FloatArray, int]:
    """Return the present plan each second (x, y, heading, curvature) (4, k), and the second that begins its circle.

    The circle is flown from where the aircraft departs, also if that is not on it.
    """
    (line, circle, _), start = scene.present, scene.start
    length_m, arc_m, from_east_m, from_north_m = 0.0, 0.0, start.east_m, start.north_m
    if under_way:
        length_m, arc_m = line[ARC, line.shape[1] - 1], scene.arc_m
        from_east_m, from_north_m = scene.aircraft.east_m, scene.aircraft.north_m
    else:
        circle = circle_touching(start.east_m, start.north_m, start.course_rad, circle.radius_m)
        line = line[:, :0]
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
    """Return a move each second (x, y, heading, curvature) (4, k), and the second that begins its circle."""
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


@inner_inlined
def _ahead(f: ScenarioRows, one: int, at: int) -> tuple[FloatArray, ...]:
    """Return place, watch course, sigma of the place and discount of a future from second ``at`` on, rows (k,)."""
    rows = f.rows[one]
    facing = rows[_SIN, at:], rows[_COS, at:], rows[_FACING_RAD, at:]
    return rows[_X, at:], rows[_Y, at:], *facing, f.sigma_m[at:], f.weight[at:]


@inner_inlined
def _running(
    x: FloatArray, y: FloatArray, j: int, n: int, ahead: tuple[FloatArray, ...], c: CostTerms, room: FloatArray
) -> None:
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


@inner_inlined
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


@inner_inlined
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


@inner_inlined
def _lasts(s: SecondMoves, curvature: float, at: int, horizon: int, steps: int, last: IntArray) -> tuple[int, int]:
    """Return the level nearest to a curvature, in 1 / radius, and the most seconds that a second move from it counts.

    Fills in how many seconds each counts, 0 for none.
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


@inner_inlined
def _least_from(f: ScenarioRows, one: int, at: int, last: IntArray) -> float:
    """Return what second moves cost at least in one future: from the end on the least of the table's classes."""
    least = np.inf
    for j in range(SECONDS):
        k = at + last[j]
        if last[j] > 0:
            least = min(least, f.weight[k] * (f.min_value[one, k] + f.min_turn_cost_per_s * last[j] * STEP_S))
    return least


@inner_inlined
def _expected(f: ScenarioRows, costs: FloatArray) -> float:
    """Return the mean of what futures cost (f,)."""
    total = 0.0
    for one in range(len(f.rows)):
        total += f.futures.weight[one] * costs[one]
    return total


@compiled
def deep_cost(ahead: FloatArray, end: int, branches: IntArray, scene: Scene, second: Second, bar: float) -> float:
    """Return the expected cost, s off side, of a line (4, k) that is on its circle from second ``end`` on.

    A second move may begin at the seconds ``branches``. Where the cost is the bar or more, something between the bar
    and it may be returned: then few second moves are followed.
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
        start, sin_h, cos_h = Pose(x[at], y[at], heading[at]), math.sin(heading[at]), math.cos(heading[at])
        if not calm:
            stretch(seconds, level, heading[at], room.speeds, longest, flown)
        fan = PlacedMoves(start, sin_h, cos_h, level, flown, placed, laid, n)
        laid[:] = False
        for j in range(SECONDS):
            if n[j] > 0:
                placed[0, j, n[j]], placed[1, j, n[j]], placed[2, j, n[j]] = placed_at(seconds, fan, j, n[j])
        for one in range(count):
            if first[one] < best[one]:
                best[one] = first[one] + _cheapest(seconds, fan, at, one, second, best[one] - first[one])
    return _expected(f, best)
