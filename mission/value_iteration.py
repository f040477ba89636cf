"""Value iteration for :mod:`mission.value_table`: improve the policy, then evaluate it several times, cheaply.

On a grid of places every move displaces all places alike, so its backup is a shifted copy of the table: one
improvement costs a few slices for each (class, heading, move). Between improvements the policy stands, and an
evaluation is one gather. A coarse grid first, then the fine one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mission.moves import moves_from, staying_on
from mission.path import FloatArray
from mission.value_table import (
    HEADING_STEP_RAD,
    HEADINGS,
    Float32,
    TableConfiguration,
    ValueTable,
    completed,
    expected_after_turn,
)

Progress = Callable[[float], None]

_EVALUATIONS = 9  # after each improvement
_TURN_EVERY = 3  # evaluations between two updates of the expectation after a turn
_COST_PER_CELL = 4  # the running cost has a finer grid of its own
_COST_STEP_S = 1.0
# Turns of the target on the way count at the Gauss nodes of each move.
_NODES, _NODE_WEIGHTS = (
    np.array([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)]),
    np.array([5.0, 8.0, 5.0]) / 18.0,
)


def compute(configuration: TableConfiguration, progress: Progress = lambda _share: None) -> ValueTable:
    """Return the table. ``progress`` is called with the share 0..1 of the work that is done."""
    half_m, cells = configuration.half_width_m, configuration.cells
    coarse_improvements, fine_improvements = configuration.improvements
    shares = np.array([coarse_improvements + 2.0, 5.0 * (fine_improvements + 2.0)])
    shares = np.cumsum(shares) / shares.sum()
    coarse = _Solver(configuration, half_m / (cells // 2), cells + 1)
    values = np.zeros(coarse.shape, np.float32)
    coarse.solve(values, coarse_improvements, lambda part: progress(part * shares[0]))
    values = _halved_cells(values)
    fine = _Solver(configuration, half_m / cells, 2 * cells + 1)
    fine.solve(values, fine_improvements, lambda part: progress(shares[0] + part * (shares[1] - shares[0])))
    return completed(configuration, values)


def _halved_cells(values: Float32) -> Float32:
    """Interpolate linearly onto a grid of half the cell size."""
    for axis in (2, 3):
        middle = 0.5 * (
            values.take(range(values.shape[axis] - 1), axis) + values.take(range(1, values.shape[axis]), axis)
        )
        values = np.insert(values, range(1, values.shape[axis]), middle, axis=axis)
    return values


@dataclass(frozen=True, slots=True, eq=False)
class _Move:
    """A move from the circle, as flown from heading 0."""

    price: float
    end_s: float
    # Middles of the running cost's samples, then the Gauss nodes, then the end.
    time_s: FloatArray
    east_m: FloatArray
    north_m: FloatArray
    turned_rad: FloatArray


def _moves(c: TableConfiguration) -> list[_Move]:
    curvature_1_m = 1.0 / c.radius_m
    moves = []
    # "Back to the circle at once", the last of the moves, is none when flown from the circle.
    leaving = moves_from(curvature_1_m, c.radius_m, c.ramp_1_m2).subset(slice(None, -1))
    for family, price in ((leaving, c.leave_cost), (staying_on(curvature_1_m, c.radius_m, c.ramp_1_m2), 0.0)):
        for k in range(family.last_end_m.shape[0]):
            one = family.subset(slice(k, k + 1))
            end_s = float(one.last_end_m[0]) / c.airspeed_m_s
            count = max(1, round(end_s / _COST_STEP_S))
            times = np.concatenate(((np.arange(count) + 0.5) / count, _NODES, [1.0])) * end_s
            order = np.argsort(times)
            arc = np.append(0.0, times[order] * c.airspeed_m_s)[None, :]
            east, north = one.displaced_m(arc, 0.0)
            back = np.empty_like(order)
            back[order] = np.arange(order.size)
            turned = one.turned_rad(arc)
            moves.append(_Move(price, end_s, times, *(a[0, 1:][back] for a in (east, north, turned))))
    return moves


class _Solver:
    """Value iteration on one grid of n x n places, ``cell_m`` apart, centred on the target."""

    def __init__(self, configuration: TableConfiguration, cell_m: float, n: int) -> None:
        self._c, self._cell_m, self._n = configuration, cell_m, n
        self._velocities = configuration.velocities_m_s()
        self._rate_1_s = configuration.discount_1_s + 1.0 / configuration.habits.mean_leg_s
        moves = _moves(configuration)
        reach_m = max(m.end_s for m in moves) * (configuration.airspeed_m_s + configuration.target_speed_max_m_s)
        self._pad = math.ceil(reach_m / cell_m) + 2
        self.shape = (len(self._velocities), HEADINGS, n, n)
        self._own = np.empty((*self.shape[:2], len(moves), n, n), np.float32)
        # Where each move leads, in cells: last axis three nodes and the end.
        places = (*self.shape[:2], len(moves), 4)
        self._to_x, self._to_y = np.empty(places), np.empty(places)
        self._to_heading = np.empty(places[1:])
        ends_s = np.array([m.end_s for m in moves])
        node_s = ends_s[:, None] * _NODES
        self._end_weight = np.exp(-self._rate_1_s * ends_s)
        self._node_weight = (
            ends_s[:, None] * _NODE_WEIGHTS * np.exp(-self._rate_1_s * node_s) / configuration.habits.mean_leg_s
        )
        self._add_up_own_costs(moves)

    def solve(self, values: Float32, improvements: int, progress: Progress) -> None:
        """Iterate ``values`` in place."""
        for k in range(improvements):
            progress((k + 1.0) / (improvements + 2.0))
            policy = self._improve(values)
            self._evaluate(values, policy)

    def _add_up_own_costs(self, moves: list[_Move]) -> None:
        """Fill in each move's discounted running cost, with its price, and where it leads."""
        n, per_cell, step_m = self._n, _COST_PER_CELL, self._cell_m / _COST_PER_CELL
        margin = per_cell * self._pad
        axis = (np.arange(per_cell * (n - 1) + 1 + 2 * margin) - per_cell * (n - 1) / 2 - margin) * step_m
        rate = self._c.cost.rate(axis[:, None], axis[None, :], 0.0, 0.5 * self._cell_m).astype(np.float32)
        # Contiguous for each offset within a cell: a move's samples are then plain slices.
        grids = [
            [np.ascontiguousarray(rate[a::per_cell, b::per_cell]) for b in range(per_cell)] for a in range(per_cell)
        ]
        for h in range(HEADINGS):
            sin_h, cos_h = math.sin(h * HEADING_STEP_RAD), math.cos(h * HEADING_STEP_RAD)
            for m, move in enumerate(moves):
                x_m, y_m = move.east_m * cos_h + move.north_m * sin_h, move.north_m * cos_h - move.east_m * sin_h
                self._to_heading[h, m] = h + move.turned_rad[-4:] / HEADING_STEP_RAD
                samples = move.time_s.size - 4
                weights = move.end_s / samples * np.exp(-self._rate_1_s * move.time_s[:samples])
                for v, velocity in enumerate(self._velocities):
                    to_x, to_y = x_m - velocity[0] * move.time_s, y_m - velocity[1] * move.time_s
                    self._to_x[v, h, m], self._to_y[v, h, m] = to_x[-4:] / self._cell_m, to_y[-4:] / self._cell_m
                    column = (np.rint(to_x[:samples] / step_m).astype(int) + margin).tolist()
                    row = (np.rint(to_y[:samples] / step_m).astype(int) + margin).tolist()
                    total = self._own[v, h, m]
                    total[:] = move.price
                    for i, j, weight in zip(column, row, weights.tolist(), strict=True):
                        grid = grids[i % per_cell][j % per_cell]
                        total += (
                            np.float32(weight)
                            * grid[i // per_cell : i // per_cell + n, j // per_cell : j // per_cell + n]
                        )

    def _improve(self, values: Float32) -> npt.NDArray[np.intp]:
        """Take the best move everywhere: update ``values`` in place and return the moves' indices, as ``values``."""
        n, pad = self._n, self._pad
        edges = ((0, 0), (0, 0), (pad, pad), (pad, pad))
        padded = np.pad(values, edges, mode="edge")
        after = np.pad(expected_after_turn(self._c, values), edges, mode="edge")
        policy = np.empty(self.shape, np.intp)
        for v in range(self.shape[0]):
            for h in range(HEADINGS):
                best = np.full((n, n), np.inf, np.float32)
                best_move = policy[v, h]
                for m in range(self._own.shape[2]):
                    total = self._backup(padded[v], after[v], v, h, m)
                    better = total < best
                    best_move[better] = m
                    np.minimum(best, total, out=best)
                values[v, h] = best
                padded[v, h, pad : pad + n, pad : pad + n] = best
        return policy

    def _backup(self, padded: Float32, after: Float32, v: int, h: int, m: int) -> Float32:
        n, pad = self._n, self._pad
        total: Float32 = self._own[v, h, m].copy()
        to_x, to_y, to_heading = (
            self._to_x[v, h, m].tolist(),
            self._to_y[v, h, m].tolist(),
            self._to_heading[h, m].tolist(),
        )
        for node in range(3):  # the nearest node of the grid will do for a small, smooth term
            i, j = round(to_x[node]) + pad, round(to_y[node]) + pad
            plane = after[round(to_heading[node]) % HEADINGS]
            total += np.float32(self._node_weight[m, node]) * plane[i : i + n, j : j + n]
        i, j, k = math.floor(to_x[3]), math.floor(to_y[3]), math.floor(to_heading[3])
        across, along, turn = to_x[3] - i, to_y[3] - j, to_heading[3] - k
        i, j = i + pad, j + pad
        for plane, plane_weight in ((padded[k % HEADINGS], 1.0 - turn), (padded[(k + 1) % HEADINGS], turn)):
            weight = plane_weight * self._end_weight[m]
            total += np.float32(weight * (1.0 - across) * (1.0 - along)) * plane[i : i + n, j : j + n]
            total += np.float32(weight * (1.0 - across) * along) * plane[i : i + n, j + 1 : j + 1 + n]
            total += np.float32(weight * across * (1.0 - along)) * plane[i + 1 : i + 1 + n, j : j + n]
            total += np.float32(weight * across * along) * plane[i + 1 : i + 1 + n, j + 1 : j + 1 + n]
        return total

    def _evaluate(self, values: Float32, policy: npt.NDArray[np.intp]) -> None:
        """Follow the policy for some more moves: update ``values`` in place."""
        own = np.take_along_axis(self._own, policy[:, :, None], axis=2)[:, :, 0]
        v, h = np.indices(self.shape[:2])
        v, h = v[:, :, None, None], h[:, :, None, None]
        x = np.arange(self._n)[:, None, None] + self._to_x[v, h, policy]
        y = np.arange(self._n)[:, None] + self._to_y[v, h, policy]
        heading = self._to_heading[h, policy]
        ends = _corners(v, heading[..., 3], x[..., 3], y[..., 3], self._n)
        ends = [(index, (weight * self._end_weight[policy]).astype(np.float32)) for index, weight in ends]
        nodes = [
            (
                _flat(
                    v,
                    np.rint(heading[..., k]).astype(int),
                    np.clip(np.rint(x[..., k]), 0, self._n - 1).astype(int),
                    np.clip(np.rint(y[..., k]), 0, self._n - 1).astype(int),
                    self._n,
                ),
                self._node_weight[policy, k].astype(np.float32),
            )
            for k in range(3)
        ]
        fixed = own
        for k in range(_EVALUATIONS):
            if k % _TURN_EVERY == 0:
                after = expected_after_turn(self._c, values).ravel()
                fixed = own.copy()
                for index, weight in nodes:
                    fixed += weight * after[index]
            flat = values.ravel()
            total = fixed.copy()
            for index, weight in ends:
                total += weight * flat[index]
            values[:] = total


def _flat(
    v: npt.NDArray[np.intp], heading: npt.NDArray[np.intp], i: npt.NDArray[np.intp], j: npt.NDArray[np.intp], n: int
) -> npt.NDArray[np.intp]:
    return ((v * HEADINGS + heading % HEADINGS) * n + i) * n + j


def _corners(
    v: npt.NDArray[np.intp], heading: FloatArray, x: FloatArray, y: FloatArray, n: int
) -> list[tuple[npt.NDArray[np.intp], FloatArray]]:
    """Return flat indices and weights of the eight nodes about each point; points beyond the grid go to its edge."""
    x, y = np.clip(x, 0.0, n - 1.001), np.clip(y, 0.0, n - 1.001)
    k, i, j = np.floor(heading).astype(int), x.astype(int), y.astype(int)
    turn, across, along = heading - k, x - i, y - j
    return [
        (
            _flat(v, k + a, i + b, j + c, n),
            (turn if a else 1.0 - turn) * (across if b else 1.0 - across) * (along if c else 1.0 - along),
        )
        for a in (0, 1)
        for b in (0, 1)
        for c in (0, 1)
    ]
