"""The moves that a planner chooses among: 70 trapezoids, going back to the circle at once, and figures of eight.

Figures of eight are for a gimbal that cannot pan all around. On a circle the heading turns through all directions,
and a target outside it is beyond the limits for a part of each lap. An aircraft that flies past the target and
turns towards it at both ends always has it within about 120 degrees of the nose: a figure of eight with its long
axis across the line of sight. Its legs are bent around the target: on a straight one the target falls back. A move
is a half of it: a leg away from the circle, a turn the other way round, and a leg back onto a circle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sidelong.estimators.compiled import compiled
from sidelong.mission.core.path import FloatArray
from sidelong.mission.geometry.line_kernel import (
    ARC,
    COURSE,
    EAST,
    NORTH,
    Craft,
    LinePoint,
    Trapezoid,
    laid_out,
    moved_m,
    sharpness_per_m2,
    trapezoid,
    turned_rad,
    with_last_ramp,
)
from sidelong.mission.predictive.cost_kernel import IntArray
from sidelong.mission.predictive.rollout_kernel import (
    STEP_S,
    Air,
    Lines,
    Sampling,
    Shapes,
    speed_m_s,
    spread,
    times_s,
)
from sidelong.mission.predictive.scene_kernel import Scene

# The length of the legs, in radii of the circle; their curvature towards the target, as a share of the circle's; and
# the turn between them, in radians.
OUTWARD, BACK, BEND = np.array([1.5, 3.5, 5.5, 7.5]), np.array([1.5, 3.5, 5.5, 7.5]), np.array([0.13, 0.27])
TURNED = np.array([2.2, 2.7, 3.2])
EIGHTS = OUTWARD.size * BACK.size * BEND.size * TURNED.size


@compiled
def shapes_of(
    start_per_m: float, eight: int, signed_radius_m: float, ramp: float
) -> tuple[Trapezoid, Trapezoid, Trapezoid]:
    """Return leg, turn and leg of an eight; the radius is positive for one that ends on a clockwise circle."""
    turned, rest = TURNED[eight % TURNED.size], eight // TURNED.size
    bend, rest = BEND[rest % BEND.size], rest // BEND.size
    back, outward = BACK[rest % BACK.size], OUTWARD[rest // BACK.size]
    radius_m, circle_per_m = abs(signed_radius_m), 1.0 / signed_radius_m
    return (
        trapezoid(start_per_m, -bend * circle_per_m, outward * radius_m, -circle_per_m, ramp),
        trapezoid(-circle_per_m, -circle_per_m, turned * radius_m, -circle_per_m, ramp),
        trapezoid(-circle_per_m, bend * circle_per_m, back * radius_m, circle_per_m, ramp),
    )


@compiled
def eight_line(start: LinePoint, eight: int, signed_radius_m: float, ramp: float) -> FloatArray:
    """Return the line (5, n) of an eight."""
    leg, turn, leg_back = shapes_of(start.curvature_per_m, eight, signed_radius_m, ramp)
    line = laid_out(leg, start.east_m, start.north_m, start.course_rad)
    for shape in (turn, leg_back):
        part = laid_out(shape, line[EAST, -1], line[NORTH, -1], line[COURSE, -1])
        part[ARC] += line[ARC, -1]
        line = np.concatenate((line, part[:, 1:]), axis=1)
    return line


@compiled
def eights_from(start_per_m: float, radius_m: float, ramp: float, sampling: Sampling) -> Lines:
    """Return the lines of all eights: see :func:`sidelong.mission.predictive.rollout_kernel.spread`."""
    beyond_m, heading_rad, air, rate_per_s = sampling
    step_m = air.airspeed_m_s * STEP_S
    own_first, end_m = np.ones(EIGHTS + 1, np.int64), np.empty(EIGHTS)
    for i in range(EIGHTS):
        leg, turn, leg_back = shapes_of(start_per_m, i, radius_m, ramp)
        end_m[i] = leg.end_m + turn.end_m + leg_back.end_m
        own_first[i + 1] = own_first[i] + math.ceil((end_m[i] + beyond_m) / step_m)
    samples = own_first[EIGHTS]
    x, y, turned = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    time, weight = np.zeros(samples), np.ones(samples)
    for i in range(EIGHTS):
        shapes = shapes_of(start_per_m, i, radius_m, ramp)
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
    return LineCache(
        np.zeros((_SLOTS, 7)),
        np.zeros(_SLOTS + 1, np.int64),
        np.zeros(_SLOTS, np.int64),
        np.zeros((_SLOTS, 5, _SAMPLES_MAX)),
        np.zeros((_SLOTS, HOLD_CURVATURES.size + 2), np.int64),
        np.zeros((_SLOTS, MOVES + 1), np.int64),
        np.zeros((_SLOTS, MOVES), np.int64),
        np.zeros((_SLOTS, MOVES), np.int64),
        np.zeros((_SLOTS, MOVES)),
    )


@compiled
def ramp_on(heading_rad: float, air: Air, craft: Craft) -> float:
    """Return the ramp for the greatest ground speed met on one that begins on a heading."""
    if air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0:
        return sharpness_per_m2(air.airspeed_m_s, craft)
    fastest_m_s = 0.0
    for turn_rad in RAMP_TURNS_RAD:
        fastest_m_s = max(fastest_m_s, speed_m_s(heading_rad + turn_rad, air))
    return sharpness_per_m2(fastest_m_s, craft)


@compiled
def ramp_anywhere(air: Air, craft: Craft) -> float:
    """Return the ramp for the greatest ground speed of all headings."""
    return sharpness_per_m2(air.airspeed_m_s + math.hypot(air.wind_x_m_s, air.wind_y_m_s), craft)


@compiled
def unit_m(hold: int, radius_m: float, turn_radius_m: float) -> float:
    """Return the radius that a hold's curvature and lengths are multiples of."""
    return turn_radius_m if hold == 0 else radius_m


@compiled
def move_from(start_per_m: float, move: int, radius_m: float, turn_radius_m: float, ramp: float) -> Trapezoid:
    """Return one of the moves from a curvature, ending on the clockwise circle."""
    if move == MOVES - 1:
        return trapezoid(start_per_m, start_per_m, 0.0, 1.0 / radius_m, ramp)
    hold, length = move // HOLD_LENGTHS.size, HOLD_LENGTHS[move % HOLD_LENGTHS.size]
    unit = unit_m(hold, radius_m, turn_radius_m)
    return trapezoid(start_per_m, HOLD_CURVATURES[hold] / unit, length * unit, 1.0 / radius_m, ramp)


@compiled
def _made(family: float, scene: Scene, start_per_m: float, ramp: float, sampling: Sampling, craft: Craft) -> Lines:
    """Return the lines of all moves, or stretches of the present circle in the form of moves.

    Such a stretch is a plain arc where the present circle is the clockwise one; from another circle it ramps over at
    its end.
    """
    if family > 0.0:
        holds_per_m, hold = np.full(1, start_per_m), np.zeros(STAY_LENGTHS.size, np.int64)
        lengths_m, last_ramps = STAY_LENGTHS * scene.radius_m, np.full(STAY_LENGTHS.size, ramp)
    else:
        holds_per_m, hold = np.empty(HOLD_CURVATURES.size + 1), np.empty(MOVES, np.int64)
        lengths_m, last_ramps = np.empty(MOVES), np.empty(MOVES)
        for k in range(HOLD_CURVATURES.size):
            holds_per_m[k] = HOLD_CURVATURES[k] / unit_m(k, scene.radius_m, scene.turn_radius_m)
        holds_per_m[-1] = start_per_m
        for move in range(MOVES):
            hold[move] = move // HOLD_LENGTHS.size
            shape = move_from(start_per_m, move, scene.radius_m, scene.turn_radius_m, ramp)
            unit = unit_m(hold[move], scene.radius_m, scene.turn_radius_m)
            lengths_m[move] = HOLD_LENGTHS[move % HOLD_LENGTHS.size] * unit
            last_ramps[move] = ramp_on(sampling.heading_rad + turned_rad(shape, shape.last_start_m), scene.air, craft)
        lengths_m[MOVES - 1] = 0.0
    shapes = Shapes(start_per_m, holds_per_m, hold, lengths_m, 1.0 / scene.radius_m, ramp, last_ramps)
    return spread(shapes, sampling)


@compiled
def _slot(kept: LineCache, wanted: tuple[float, float, float, float, float, float, float]) -> tuple[int, int]:
    """Return the slot with the lines of a key, -1 for none, and the one asked for longest ago."""
    slots, oldest = len(kept.size), 0
    kept.used[slots] += 1
    for i in range(slots):
        same = kept.used[i] > 0
        for k in range(len(wanted)):
            same &= kept.key[i, k] == wanted[k]
        if same:
            kept.used[i] = kept.used[slots]
            return i, oldest
        if kept.used[i] < kept.used[oldest]:
            oldest = i
    return -1, oldest


@compiled
def lines_from(
    family: float, scene: Scene, start_per_m: float, ramp: float, sampling: Sampling, craft: Craft, kept: LineCache
) -> Lines:
    """Return the moves (family 0) or the stays (1) from a curvature, from those kept where they can be."""
    calm = scene.air.wind_x_m_s == 0.0 and scene.air.wind_y_m_s == 0.0
    beyond_m, rate_per_s = sampling.beyond_m, sampling.rate_per_s
    wanted = (family, start_per_m, scene.radius_m, ramp, beyond_m, rate_per_s, scene.air.airspeed_m_s)
    i, oldest = _slot(kept, wanted) if calm else (-1, 0)
    if i >= 0:
        n, lines, trunks, samples = kept.size[i], MOVES, HOLD_CURVATURES.size + 1, kept.samples[i]
        if family > 0.0:
            lines, trunks = STAY_LENGTHS.size, 1
        return Lines(
            samples[0, :n],
            samples[1, :n],
            samples[2, :n],
            samples[3, :n],
            samples[4, :n],
            kept.trunk_first[i, : trunks + 1],
            kept.own_first[i, : lines + 1],
            kept.trunk[i, :lines],
            kept.on_trunk[i, :lines],
            kept.end_m[i, :lines],
        )
    made = _made(family, scene, start_per_m, ramp, sampling, craft)
    n = len(made.x_m)
    if calm and n <= kept.samples.shape[2]:
        for k in range(len(wanted)):
            kept.key[oldest, k] = wanted[k]
        kept.used[oldest], kept.size[oldest] = kept.used[-1], n
        for row, values in enumerate((made.x_m, made.y_m, made.turned_rad, made.time_s, made.weight)):
            kept.samples[oldest, row, :n] = values
        kept.trunk_first[oldest, : len(made.trunk_first)] = made.trunk_first
        kept.own_first[oldest, : len(made.own_first)] = made.own_first
        lines = len(made.trunk)
        kept.trunk[oldest, :lines], kept.on_trunk[oldest, :lines] = made.trunk, made.on_trunk
        kept.end_m[oldest, :lines] = made.end_m
    return made


@compiled
def shape_of(scene: Scene, craft: Craft, move: int) -> Trapezoid:
    """Return the trapezoid of a move in the frame, its ramps for the ground speeds that they are flown at."""
    heading_rad = scene.mirror * (scene.start.course_rad - scene.course_rad)
    ramp, start_per_m = ramp_on(heading_rad, scene.air, craft), scene.mirror * scene.start.curvature_per_m
    shape = move_from(start_per_m, move, scene.radius_m, scene.turn_radius_m, ramp)
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
