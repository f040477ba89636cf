"""The inner loops of :mod:`sidelong.mission.predictive.value_table`.

Loops over the last axis go over plain rows of single precision, at most three arrays at a time: so they become
vector instructions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled, inner
from sidelong.mission.core.path import FloatArray
from sidelong.mission.geometry.line_kernel import Air, nose_rad, speed_m_s

Float32 = npt.NDArray[np.float32]
Int32 = npt.NDArray[np.int32]

NODES = 4  # of each move: three where a turn of the target counts, and its end


@inner
def _at(values: FloatArray, share: float) -> float:
    """Interpolate between evenly spaced values at a share 0..1 of the way."""
    place = share * (len(values) - 1)
    i = min(int(place), len(values) - 2)
    return float(values[i] + (place - i) * (values[i + 1] - values[i]))


class MoveSamples(NamedTuple):
    """Moves as flown from heading 0, at evenly spaced arcs; every other sample is the middle of a step.

    Move m is samples[:, first[m]:first[m + 1]], rows arc, east, north and course turned; price (moves,): its cost.
    nodes (NODES,): where turns of the target count, and the end, as shares of its length; node_weights: of the turns.
    """

    first: npt.NDArray[np.int64]
    price: FloatArray
    samples: FloatArray
    nodes: FloatArray
    node_weights: FloatArray


class FlightConditions(NamedTuple):
    """What the moves are flown in: velocity of the target and wind in each class, m/s, (classes, 2) each.

    rate_per_s: of the discount. mean_leg_s: mean time between two turns of the target.
    """

    targets: FloatArray
    winds: FloatArray
    airspeed_m_s: float
    heading_step_rad: float
    rate_per_s: float
    mean_leg_s: float


class CostGrid(NamedTuple):
    """The running cost about the target.

    rates (directions, per_cell, per_cell, k, k): at each offset within a cell of the table, where the nose points in
    even directions; one direction if they do not matter. pad: cells beyond the edge of the table.
    """

    rates: Float32
    cell_m: float
    per_cell: int
    pad: int


class Transitions(NamedTuple):
    """Where each move leads from each class and heading, at each node, and what it costs.

    to_x, to_y (classes, headings, moves, NODES): cells to the right and ahead; weight, of the same shape: what the
    value there counts. to_heading (headings, moves, NODES): steps. own (classes, headings, moves, n, n): discounted
    running cost with the price.
    """

    to_x: FloatArray
    to_y: FloatArray
    to_heading: FloatArray
    weight: FloatArray
    own: Float32


@compiled
def lay_out(flown: MoveSamples, s: FlightConditions, cost: CostGrid, found: Transitions) -> None:
    """Fill in the end of each move, the discounts on its way, and its discounted running cost with its price, s."""
    to_x, to_y, to_heading, weight, own = found
    first, price, line, nodes, node_weights = flown
    targets, winds, airspeed_m_s, heading_step_rad, rate_per_s, mean_leg_s = s
    grids, cell_m, per_cell, pad = cost
    classes, headings, moves, n, _ = own.shape
    longest = 0
    for m in range(moves):
        longest = max(longest, first[m + 1] - first[m])
    time_s, slowness_s_m = np.empty(longest), np.empty(longest)
    x, y, counts = np.empty(longest), np.empty(longest), np.empty(longest)
    finer = per_cell / cell_m
    for h in range(headings):
        sin_h, cos_h = math.sin(h * heading_step_rad), math.cos(h * heading_step_rad)
        for m in range(moves):
            arc, east, north, turned = line[0], line[1], line[2], line[3]
            begin, size = first[m], first[m + 1] - first[m]
            length_m = arc[begin + size - 1]
            for node in range(NODES):
                to_heading[h, m, node] = h + _at(turned[begin : begin + size], nodes[node]) / heading_step_rad
            for v in range(classes):
                time_s[0] = 0.0
                air = Air(airspeed_m_s, winds[v, 0], winds[v, 1])
                for k in range(size):
                    slowness_s_m[k] = 1.0 / speed_m_s(h * heading_step_rad + turned[begin + k], air)
                    if k > 0:
                        step_m = arc[begin + k] - arc[begin + k - 1]
                        time_s[k] = time_s[k - 1] + step_m * 0.5 * (slowness_s_m[k] + slowness_s_m[k - 1])
                    x[k] = east[begin + k] * cos_h + north[begin + k] * sin_h - targets[v, 0] * time_s[k]
                    y[k] = north[begin + k] * cos_h - east[begin + k] * sin_h - targets[v, 1] * time_s[k]
                    counts[k] = math.exp(-rate_per_s * time_s[k])
                for node in range(NODES):
                    to_x[v, h, m, node] = _at(x[:size], nodes[node]) / cell_m
                    to_y[v, h, m, node] = _at(y[:size], nodes[node]) / cell_m
                    weight[v, h, m, node] = _at(counts[:size], nodes[node])
                    if node < NODES - 1:
                        node_s = node_weights[node] * length_m * _at(slowness_s_m[:size], nodes[node])
                        weight[v, h, m, node] *= node_s / mean_leg_s
                total = own[v, h, m]
                total[:] = np.float32(price[m])
                for k in range(1, size, 2):
                    share = np.float32((time_s[k + 1] - time_s[k - 1]) * counts[k])
                    fine_i, fine_j = round(x[k] * finer) + per_cell * pad, round(y[k] * finer) + per_cell * pad
                    i, j = fine_i // per_cell, fine_j // per_cell
                    nose = 0
                    if len(grids) > 1:
                        to_rad = nose_rad(h * heading_step_rad + turned[begin + k], air)
                        nose = round(to_rad * (len(grids) / math.tau)) % len(grids)
                    grid = grids[nose, fine_i - per_cell * i, fine_j - per_cell * j]
                    for row in range(n):
                        _add(total[row], grid[i + row, j : j + n], share)


@inner
def _add(total: Float32, values: Float32, weight: np.float32) -> None:
    for c in range(len(total)):
        total[c] += weight * values[c]


@inner
def _add_four(
    total: Float32, low: Float32, high: Float32, a: np.float32, b: np.float32, c: np.float32, d: np.float32
) -> None:
    """Add two neighbouring rows, each twice: at the column itself and at the next one."""
    for k in range(len(total)):
        total[k] += a * low[k] + b * low[k + 1] + c * high[k] + d * high[k + 1]


@inner
def _padded(wide: Float32, plane: Float32, pad: int) -> None:
    """Fill in a plane with its edges carried on outwards."""
    n = len(plane)
    for i in range(len(wide)):
        row = plane[min(max(i - pad, 0), n - 1)]
        wide[i, :pad], wide[i, pad : pad + n], wide[i, pad + n :] = row[0], row, row[n - 1]


@compiled
def improve(values: Float32, after: Float32, transitions: Transitions, pad: int, policy: Int32) -> None:
    """Take the best move everywhere: update ``values`` in place and fill in the moves' indices, as ``values``.

    A move displaces all places alike, so its backup is a shifted copy of the table.
    """
    to_x, to_y, to_heading, weight, own = transitions
    classes, headings, moves, n, _ = own.shape
    padded = np.empty((headings, n + 2 * pad, n + 2 * pad), np.float32)
    padded_after = np.empty_like(padded)
    best, total = np.empty((n, n), np.float32), np.empty(n, np.float32)
    for v in range(classes):
        for h in range(headings):
            _padded(padded[h], values[v, h], pad)
            _padded(padded_after[h], after[v, h], pad)
        for h in range(headings):
            best[:] = np.inf
            best_move = policy[v, h]
            for m in range(moves):
                x, y, turn = to_x[v, h, m, NODES - 1], to_y[v, h, m, NODES - 1], to_heading[h, m, NODES - 1]
                i, j, k = math.floor(x), math.floor(y), math.floor(turn)
                across, along, turn = x - i, y - j, turn - k
                i, j, end = i + pad, j + pad, weight[v, h, m, NODES - 1]
                sides = (
                    (k % headings, (1.0 - turn) * (1.0 - across) * end, (1.0 - turn) * across * end),
                    ((k + 1) % headings, turn * (1.0 - across) * end, turn * across * end),
                )
                for row in range(n):
                    total[:] = own[v, h, m, row]
                    for node in range(NODES - 1):  # the nearest place will do for a small, smooth term
                        p, q = round(to_x[v, h, m, node]) + pad, round(to_y[v, h, m, node]) + pad
                        plane = padded_after[round(to_heading[h, m, node]) % headings]
                        _add(total, plane[p + row, q : q + n], np.float32(weight[v, h, m, node]))
                    for side, a, b in sides:
                        _add_four(
                            total,
                            padded[side, i + row, j : j + n + 1],
                            padded[side, i + row + 1, j : j + n + 1],
                            np.float32(a * (1.0 - along)),
                            np.float32(a * along),
                            np.float32(b * (1.0 - along)),
                            np.float32(b * along),
                        )
                    _take_less(best[row], best_move[row], total, np.int32(m))
            values[v, h] = best
            _padded(padded[h], best, pad)


@inner
def _take_less(best: Float32, best_move: Int32, total: Float32, move: np.int32) -> None:
    for c in range(len(total)):
        less = total[c] < best[c]
        best[c] = total[c] if less else best[c]
        best_move[c] = move if less else best_move[c]


@compiled
def follow(policy: Int32, transitions: Transitions, led_to: Int32, parts: Float32, cost: Float32) -> None:
    """Fill in where the policy leads from each place, arrays of one row a place.

    led_to (places, 5): the flat indices, within the class, of three nodes and of the end's first corner on the plane
    of either heading. parts (places, 7): weights of the nodes; of the end; its shares of turn, across and along.
    cost (places,): of the move itself.
    """
    to_x, to_y, to_heading, weight, own = transitions
    classes, headings, _, n, _ = own.shape
    place, half = 0, (n - 1) / 2
    for v in range(classes):
        for h in range(headings):
            for i in range(n):
                for j in range(n):
                    m = policy[v, h, i, j]
                    cost[place] = own[v, h, m, i, j]
                    for node in range(NODES - 1):
                        x = min(max(round(to_x[v, h, m, node] + i - half + half), 0), n - 1)
                        y = min(max(round(to_y[v, h, m, node] + j - half + half), 0), n - 1)
                        led_to[place, node] = (round(to_heading[h, m, node]) % headings * n + x) * n + y
                        parts[place, node] = weight[v, h, m, node]
                    x_end = min(max(to_x[v, h, m, NODES - 1] + i, 0.0), n - 1.001)
                    y_end = min(max(to_y[v, h, m, NODES - 1] + j, 0.0), n - 1.001)
                    turn = to_heading[h, m, NODES - 1]
                    k, column, row = math.floor(turn), int(x_end), int(y_end)
                    led_to[place, 3] = (k % headings * n + column) * n + row
                    led_to[place, 4] = ((k + 1) % headings * n + column) * n + row
                    parts[place, 3] = weight[v, h, m, NODES - 1]
                    parts[place, 4], parts[place, 5], parts[place, 6] = turn - k, x_end - column, y_end - row
                    place += 1


@compiled
def turns_cost(after: Float32, led_to: Int32, parts: Float32, cost: Float32, fixed: Float32) -> None:
    """Fill in the cost, s, of a move before its end's value: its own, and that of the target's turns on the way."""
    classes, size = after.shape
    for v in range(classes):
        for p in range(size):
            q = v * size + p
            total = cost[q]
            for node in range(NODES - 1):
                total += parts[q, node] * after[v, led_to[q, node]]
            fixed[q] = total


@compiled
def evaluate(values: Float32, n: int, led_to: Int32, parts: Float32, fixed: Float32, found: Float32) -> None:
    """Follow the policy for one more move: from ``values`` (classes, places of one class) to ``found``."""
    classes, size = values.shape
    one = np.float32(1.0)
    for v in range(classes):
        flat = values[v]
        for p in range(size):
            q = v * size + p
            a, b = led_to[q, 3], led_to[q, 4]
            turn, across, along = parts[q, 4], parts[q, 5], parts[q, 6]
            near = (one - across) * ((one - along) * flat[a] + along * flat[a + 1]) + across * (
                (one - along) * flat[a + n] + along * flat[a + n + 1]
            )
            far = (one - across) * ((one - along) * flat[b] + along * flat[b + 1]) + across * (
                (one - along) * flat[b + n] + along * flat[b + n + 1]
            )
            found[v, p] = fixed[q] + parts[q, 3] * ((one - turn) * near + turn * far)


@compiled
def add_turned(total: Float32, seen: Float32, chance: float, turn_rad: float, heading_step_rad: float) -> None:
    """Add ``seen`` (headings, n, n), weighted, as a frame turned clockwise about the middle sees it.

    Places beyond the grid are those of its edge.
    """
    headings, n, _ = total.shape
    sin_t, cos_t, half = math.sin(turn_rad), math.cos(turn_rad), (n - 1) / 2
    base, corner = np.empty((n, n), np.int32), np.empty((4, n, n), np.float32)
    for i in range(n):
        for j in range(n):
            x = min(max((i - half) * cos_t - (j - half) * sin_t + half, 0.0), n - 1.001)
            y = min(max((i - half) * sin_t + (j - half) * cos_t + half, 0.0), n - 1.001)
            column, row = int(x), int(y)
            across, along = x - column, y - row
            base[i, j] = column * n + row
            corner[0, i, j], corner[1, i, j] = (1.0 - across) * (1.0 - along), (1.0 - across) * along
            corner[2, i, j], corner[3, i, j] = across * (1.0 - along), across * along
    steps = -turn_rad / heading_step_rad
    whole = math.floor(steps + 1e-9)
    past = max(steps - whole, 0.0)
    for h in range(headings):
        for k in range(2):
            weight = np.float32(chance * (past if k else 1.0 - past))
            if weight < 1e-9:
                continue
            flat = seen[(h + whole + k) % headings].reshape(n * n)
            for i in range(n):
                for j in range(n):
                    b = base[i, j]
                    total[h, i, j] += weight * (
                        corner[0, i, j] * flat[b]
                        + corner[1, i, j] * flat[b + 1]
                        + corner[2, i, j] * flat[b + n]
                        + corner[3, i, j] * flat[b + n + 1]
                    )
