"""A dynamic program along an expected path of the target: the cost to go from each position, heading and time.

It runs backward from the value table at the end of the expected path. A state is a position relative to the target
on a coarse grid, one of 16 headings, and the manner of turning: on the circle, straight, or the other way round. A
step lasts as long as the circle takes for 45 degrees, so that no heading is interpolated. Leaving the circle, or
changing the manner of turning, costs what the planner's own moves cost. The target may also leave the path: the
program counts the expected value after a turn at the same hazard as the value table does.

Neglected: roll dynamics (a change of curvature is a shift in time), and the change of ground speed around a circle in
wind. All layers lie in the local plane, east mirrored where the right side is required: they stay valid as the
target, and with it the frame of a decision, turns.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled, inlined, record_type
from sidelong.mission.core.path import FloatArray
from sidelong.mission.geometry.line_kernel import crab_rad
from sidelong.mission.predictive.cost_kernel import (
    CostTerms,
    Float32,
    IntArray,
    Table,
    blind_rates,
    cost_rate,
    table_value,
)
from sidelong.mission.predictive.rollout_kernel import Air, Scenarios, Uncertainty
from sidelong.mission.predictive.scene_kernel import Scene
from sidelong.mission.route.progress_kernel import Progress, RouteArrays

FloatRow = npt.NDArray[np.float32]

HEADINGS = 16
CELLS = 22  # from the target to the edge of the grid
SIZE = 2 * CELLS + 1
_PAD = 8  # cells beyond the edge, equal to it: more than aircraft and target move apart in a step
_TURN = 2  # headings of a step on the circle
_MODES = 3  # on the circle, straight, the other way round
HORIZON_S = 45.0
LAYERS = record_type(
    computed_s="f8",  # when the layers were computed, for which mirror, part of the route and direction of the wind
    mirror="f8",
    part="i8",
    wind_rad="f8",
    known=("i1", (HEADINGS,)),  # 1 or 0: for which courses the values after a turn are computed
)


class RouteValues(NamedTuple):
    """A route and the layers of the value table along it; without points, no route.

    values: classes of the value table on the program's grid, then the layers. after_turn: the same classes, then one
    for each of HEADINGS courses. least (classes + layers,): of ``values``. state: one record of ``LAYERS``, (1,).
    """

    way: RouteArrays
    progress: Progress
    values: Float32
    after_turn: Float32
    cell_m: float
    least: FloatArray
    state: Any


@compiled
def layer_s(airspeed_m_s: float, radius_m: float) -> float:
    """Return the duration of a step: that of 45 degrees of the circle."""
    return _TURN * 2.0 * math.pi / HEADINGS * radius_m / airspeed_m_s


@inlined
def course_index(f: Scenarios, one: int, k: int, turn_rad: float) -> int:
    """Return which of HEADINGS directions of the plane the target moves in at a sample; turn_rad: of the plane."""
    motion_rad = math.atan2(f.place[one, k, 2], f.place[one, k, 3])
    return round((motion_rad - turn_rad) / (2.0 * math.pi) * HEADINGS) % HEADINGS


@compiled
def resample(
    values: Float32,
    from_cell_m: float,
    classes: IntArray,
    share: FloatArray,
    one: int,
    k: int,
    cell_m: float,
    turn_rad: float,
    found: Float32,
) -> None:
    """Fill in a mixture of a table's classes on the coarse grid of the program, in a frame turned back.

    Args:
        values: The table (classes, headings, n, n).
        from_cell_m: Its cell.
        classes: Which classes are mixed (f, k, 4).
        share: What each counts (f, k, 4).
        one: Row of ``classes`` and ``share``.
        turn_rad: Course of the table's frame in the frame of the result.
        found: Result (HEADINGS, SIZE, SIZE).
    """
    sin_t, cos_t = math.sin(turn_rad), math.cos(turn_rad)
    for h in range(HEADINGS):
        heading_rad = h * 2.0 * math.pi / HEADINGS - turn_rad
        for i in range(SIZE):
            for j in range(SIZE):
                x, y = (i - CELLS) * cell_m, (j - CELLS) * cell_m
                across, along = x * cos_t - y * sin_t, x * sin_t + y * cos_t
                found[h, i, j] = np.float32(
                    table_value(values, from_cell_m, across, along, heading_rad, classes, share, one, k)
                )


@compiled
def _fill_rates(
    f: Scenarios,
    one: int,
    k: int,
    since_s: float,
    turn_rad: float,
    cell_m: float,
    d: Uncertainty,
    c: CostTerms,
    found: Float32,
) -> None:
    """Fill in the running cost (SIZE, SIZE) about the target at sample k. turn_rad: of the plane in the frame."""
    sin_w, cos_w, sigma_rad = f.facing[one, k, 0], f.facing[one, k, 1], f.facing[one, k, 2]
    sin_t, cos_t = math.sin(turn_rad), math.cos(turn_rad)
    # Of the watch course in the plane: its angle in the frame less that of the plane.
    sin_f, cos_f = sin_w * cos_t - cos_w * sin_t, cos_w * cos_t + sin_w * sin_t
    sigma_m = math.sqrt(d.position_m * d.position_m + (d.velocity_m_s * since_s) ** 2)
    for i in range(SIZE):
        for j in range(SIZE):
            x, y = (i - CELLS) * cell_m, (j - CELLS) * cell_m
            across, along = x * cos_f - y * sin_f, x * sin_f + y * cos_f
            aside_m = sigma_rad * along
            blur_m = max(1.0 + math.sqrt(sigma_m * sigma_m + aside_m * aside_m), 0.5 * cell_m)
            found[i, j] = np.float32(cost_rate(across, along, sigma_m, blur_m, c))


@compiled
def _fill_blind(air: Air, wind_x_m_s: float, wind_y_m_s: float, cell_m: float, c: CostTerms, found: Float32) -> None:
    """Fill in the cost (HEADINGS, SIZE, SIZE) of where the gimbal cannot look; the wind is that in the plane."""
    axis_m, rates = (np.arange(SIZE, dtype=np.float64) - CELLS) * cell_m, np.empty((SIZE, SIZE))
    for h in range(HEADINGS):
        course_rad = h * 2.0 * math.pi / HEADINGS
        blind_rates(axis_m, course_rad - crab_rad(course_rad, air.airspeed_m_s, wind_x_m_s, wind_y_m_s), c, rates)
        for i in range(SIZE):
            for j in range(SIZE):
                found[h, i, j] = np.float32(rates[i, j])


@compiled
def _add_rows(blind: Float32, found: Float32) -> None:
    for i in range(len(blind)):
        for j in range(len(blind)):
            found[i, j] += blind[i, j]


@compiled
def _add_row(rate: FloatRow, turned: FloatRow, hazard: np.float32, found: FloatRow) -> None:
    for q in range(len(found)):
        found[q] = rate[q] + hazard * turned[q]


@compiled
def _blend_row(
    low: FloatRow,
    high: FloatRow,
    own: FloatRow,
    a: np.float32,
    b: np.float32,
    c: np.float32,
    d: np.float32,
    half: np.float32,
    found: FloatRow,
) -> None:
    for q in range(len(found)):
        found[q] = half * own[q] + a * low[q] + b * low[q + 1] + c * high[q] + d * high[q + 1]


@compiled
def _choose_row(
    values: tuple[FloatRow, FloatRow, FloatRow],
    paid: FloatRow,
    leave: np.float32,
    change: np.float32,
    half: np.float32,
    found: FloatRow,
    best: tuple[FloatRow, FloatRow, FloatRow],
) -> None:
    """Fill in the cost to go on the circle, and that in each mode with half a step's cost before it."""
    circle, straight, other = values
    on, ahead, back = best
    for q in range(len(found)):
        c, s, o = circle[q], straight[q], other[q]
        away = s if s < o else o
        here = c if c < away + leave else away + leave
        changed = (away if away < c else c) + change
        s = c if c < s else s
        o = c if c < o else o
        before = half * paid[q]
        found[q] = here
        on[q] = here + before
        ahead[q] = (s if s < changed else changed) + before
        back[q] = (o if o < changed else changed) + before


@compiled
def _extend_edges(padded: Float32) -> None:
    """Give the cells beyond the grid the values of its edge."""
    n = len(padded)
    for i in range(_PAD, n - _PAD):
        row = padded[i]
        for q in range(_PAD):
            row[q], row[n - 1 - q] = row[_PAD], row[n - 1 - _PAD]
    for i in range(_PAD):
        for q in range(n):
            padded[i, q], padded[n - 1 - i, q] = padded[_PAD, q], padded[n - 1 - _PAD, q]


@compiled
def fill_layers(
    f: Scenarios,
    one: int,
    turn_rad: float,
    scene: Scene,
    terms: CostTerms,
    table: Table,
    leave: float,
    change: float,
    s: RouteValues,
) -> None:
    """Fill in the cost to go on the circle, in layers of :func:`layer_s` from the departure on.

    Args:
        turn_rad: Angle of the (mirrored) plane's north in that frame.
        table: Value table: the cost to go at the end, and the hazard of turns.
        s: Route; its layers are filled in.
    """
    d, air, radius_m, cell_m, classes = scene.doubt, scene.air, scene.radius_m, s.cell_m, len(table.values)
    after_turn, found = s.after_turn[classes:], s.values[classes:]
    layers, n = len(found), SIZE + 2 * _PAD
    dt_s, turn_step_rad = layer_s(air.airspeed_m_s, radius_m), 2.0 * math.pi / HEADINGS
    rate, table_values = np.empty((SIZE, SIZE), np.float32), np.empty((HEADINGS, SIZE, SIZE), np.float32)
    # Planes of the padded grid. Their rows are processed as one long row, in which the padding is computed in vain.
    paid, here = np.zeros((HEADINGS, n, n), np.float32), np.empty(n * n, np.float32)
    values, best = np.zeros((_MODES, HEADINGS, n * n), np.float32), np.zeros((_MODES, HEADINGS, n * n), np.float32)
    first, count = _PAD * n, SIZE * n
    hazard_per_s = 1.0 / table.mean_leg_s
    fading, half = math.exp(-(table.discount_per_s + hazard_per_s) * dt_s), np.float32(0.5 * dt_s)
    sin_p, cos_p, last_k = math.sin(turn_rad), math.cos(turn_rad), f.place.shape[1] - 1
    wind_x = air.wind_x_m_s * cos_p - air.wind_y_m_s * sin_p
    wind_y = air.wind_x_m_s * sin_p + air.wind_y_m_s * cos_p
    chord_m = 2.0 * radius_m * math.sin(0.5 * _TURN * turn_step_rad)
    limit = _PAD - 1.01
    blind = np.empty((HEADINGS if terms.blind > 0.0 else 0, SIZE, SIZE), np.float32)
    if terms.blind > 0.0:
        _fill_blind(air, wind_x, wind_y, cell_m, terms, blind)
    for layer in range(layers - 1, -1, -1):
        time_s = layer * dt_s
        k = min(int(time_s / f.step_s + 0.5), last_k)
        _fill_rates(f, one, k, time_s, turn_rad, cell_m, d, terms, rate)
        course = course_index(f, one, k, turn_rad)
        for h in range(HEADINGS):
            for i in range(SIZE):
                _add_row(
                    rate[i], after_turn[course, h, i], np.float32(hazard_per_s), paid[h, i + _PAD, _PAD : _PAD + SIZE]
                )
            if len(blind) > 0:
                _add_rows(blind[h], paid[h, _PAD : _PAD + SIZE, _PAD : _PAD + SIZE])
        if layer == layers - 1:
            table_rad = f.course[one, k, 2] - turn_rad
            resample(table.values, table.cell_m, f.classes, f.share, one, k, cell_m, table_rad, table_values)
            for mode in range(_MODES):
                for h in range(HEADINGS):
                    values[mode, h].reshape(n, n)[_PAD : _PAD + SIZE, _PAD : _PAD + SIZE] = table_values[h]
        else:
            k, m = min(int(time_s / f.step_s), last_k), min(int((time_s + dt_s) / f.step_s), last_k)
            from_s, to_s = time_s - k * f.step_s, time_s + dt_s - m * f.step_s
            gone_x = f.place[one, m, 0] + f.place[one, m, 2] * to_s - f.place[one, k, 0] - f.place[one, k, 2] * from_s
            gone_y = f.place[one, m, 1] + f.place[one, m, 3] * to_s - f.place[one, k, 1] - f.place[one, k, 3] * from_s
            gone_x, gone_y = gone_x * cos_p - gone_y * sin_p, gone_x * sin_p + gone_y * cos_p
            for mode in range(_MODES):
                turn = (1 - mode) * _TURN
                for h in range(HEADINGS):
                    middle_rad = (h + 0.5 * turn) * turn_step_rad
                    flown_x, flown_y = chord_m * math.sin(middle_rad), chord_m * math.cos(middle_rad)
                    if turn == 0:
                        flown_x, flown_y = (
                            air.airspeed_m_s * math.sin(middle_rad),
                            air.airspeed_m_s * math.cos(middle_rad),
                        )
                        flown_x, flown_y = (flown_x + wind_x) * dt_s, (flown_y + wind_y) * dt_s
                    x = min(max((flown_x - gone_x) / cell_m, -limit), limit)
                    y = min(max((flown_y - gone_y) / cell_m, -limit), limit)
                    i, j = math.floor(x), math.floor(y)
                    a, b = x - i, y - j
                    one_a, one_b = np.float32(fading * (1.0 - a) * (1.0 - b)), np.float32(fading * (1.0 - a) * b)
                    one_c, one_d = np.float32(fading * a * (1.0 - b)), np.float32(fading * a * b)
                    after, at = best[mode, (h + turn) % HEADINGS], first + i * n + j
                    _blend_row(
                        after[at : at + count + 1],
                        after[at + n : at + n + count + 1],
                        paid[h].ravel()[first : first + count],
                        one_a,
                        one_b,
                        one_c,
                        one_d,
                        half,
                        values[mode, h, first : first + count],
                    )
        for h in range(HEADINGS):
            last = first + count
            _choose_row(
                (values[0, h, first:last], values[1, h, first:last], values[2, h, first:last]),
                paid[h].ravel()[first:last],
                np.float32(leave),
                np.float32(change),
                half,
                here[first:last],
                (best[0, h, first:last], best[1, h, first:last], best[2, h, first:last]),
            )
            found[layer, h] = here.reshape(n, n)[_PAD : _PAD + SIZE, _PAD : _PAD + SIZE]
            for mode in range(_MODES):
                _extend_edges(best[mode, h].reshape(n, n))


@compiled
def _keep_less(values: FloatRow, least: FloatRow) -> None:
    for q in range(len(least)):
        least[q] = values[q] if values[q] < least[q] else least[q]


@compiled
def least_of(values: Float32, found: FloatArray) -> None:
    """Fill in the least value of each class (classes,)."""
    least = np.empty(SIZE * SIZE, np.float32)
    for v in range(len(values)):
        least[:] = values[v, 0].ravel()
        for h in range(1, HEADINGS):
            _keep_less(values[v, h].ravel(), least)
        found[v] = least.min()
