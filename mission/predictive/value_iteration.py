"""Value iteration for the value table: improve the policy, then evaluate it several times, cheaply.

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

from mission.core.path import FloatArray
from mission.core.requirement import Wind
from mission.geometry.wind import ground_speeds_m_s
from mission.predictive.moves import moves_from, staying_on
from mission.predictive.value_table import (
    HEADING_STEP_RAD,
    HEADINGS,
    Float32,
    TableConfiguration,
    ValueTable,
    completed,
    corners,
    expected_after_turn,
)

Progress = Callable[[float], None]

_EVALUATIONS = 9  # after each improvement
_TURN_EVERY = 3  # evaluations between two updates of the expectation after a turn
_COST_PER_CELL = 4  # the running cost has a finer grid of its own
_SAMPLES_PER_CELL = 2  # of a move's running cost
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
    """A move from the circle, as flown from heading 0: ends and middles (2 k + 1,) of k samples."""

    price: float
    arc_m: FloatArray
    east_m: FloatArray
    north_m: FloatArray
    turned_rad: FloatArray


def _moves(c: TableConfiguration, step_m: float) -> list[_Move]:
    curvature_per_m = 1.0 / c.radius_m
    ramp = c.sharpness_per_m2
    moves = []
    # "Back to the circle at once", the last of the moves, is none when flown from the circle.
    leaving = moves_from(curvature_per_m, c.radius_m, ramp).subset(slice(None, -1))
    for family, price in ((leaving, c.leave_cost), (staying_on(curvature_per_m, c.radius_m, ramp), 0.0)):
        for k in range(family.last_end_m.size):
            one = family.subset(slice(k, k + 1))
            length_m = float(one.last_end_m[0])
            samples = max(1, round(length_m / step_m))
            arc = np.linspace(0.0, length_m, 2 * samples + 1)[None, :]
            east, north = one.displaced_m(arc, 0.0)
            moves.append(_Move(price, arc[0], east[0], north[0], one.turned_rad(arc)[0]))
    return moves


class _Solver:
    """Value iteration on one grid of n x n places, ``cell_m`` apart, centred on the target."""

    def __init__(self, configuration: TableConfiguration, cell_m: float, n: int) -> None:
        self._c, self._cell_m, self._n = configuration, cell_m, n
        moves = _moves(configuration, cell_m / _SAMPLES_PER_CELL)
        targets, winds = configuration.classes()
        self.shape = (len(targets), HEADINGS, n, n)
        places = (*self.shape[:2], len(moves))
        # Where each move leads, in cells and steps of heading, and what counts there: at three nodes and at its end.
        self._to_x, self._to_y, self._weight = (np.empty((*places, 4)) for _ in range(3))
        self._to_heading = np.empty((*places[1:], 4))
        self._own = np.empty((*places, n, n), np.float32)
        reach_m = max(float(m.arc_m[-1]) for m in moves) * (
            1.0 + configuration.target_speed_max_m_s / (configuration.airspeed_m_s - configuration.wind_speed_m_s)
        )
        self._pad = math.ceil(reach_m / cell_m) + 2
        self._lay_out(moves, targets, [Wind(*wind) for wind in winds.tolist()])

    def solve(self, values: Float32, improvements: int, progress: Progress) -> None:
        """Iterate ``values`` in place."""
        for k in range(improvements):
            progress((k + 1.0) / (improvements + 2.0))
            policy = self._improve(values)
            self._evaluate(values, policy)

    def _lay_out(self, moves: list[_Move], targets: FloatArray, winds: list[Wind]) -> None:
        """Fill in where each move leads, and its discounted running cost with its price."""
        grids = self._cost_grids()
        for h in range(HEADINGS):
            sin_h, cos_h = math.sin(h * HEADING_STEP_RAD), math.cos(h * HEADING_STEP_RAD)
            for m, move in enumerate(moves):
                x_m, y_m = move.east_m * cos_h + move.north_m * sin_h, move.north_m * cos_h - move.east_m * sin_h
                nodes = np.append(_NODES, 1.0) * move.arc_m[-1]
                self._to_heading[h, m] = h + np.interp(nodes, move.arc_m, move.turned_rad) / HEADING_STEP_RAD
                heading_rad = h * HEADING_STEP_RAD + move.turned_rad
                times = {wind: self._times(heading_rad, move.arc_m, wind) for wind in dict.fromkeys(winds)}
                for v, wind in enumerate(winds):
                    time_s, slowness_s_m = times[wind]
                    to_x, to_y = x_m - targets[v, 0] * time_s, y_m - targets[v, 1] * time_s
                    self._to_x[v, h, m] = np.interp(nodes, move.arc_m, to_x) / self._cell_m
                    self._to_y[v, h, m] = np.interp(nodes, move.arc_m, to_y) / self._cell_m
                    counts = np.exp(-self._rate_per_s * time_s)
                    self._weight[v, h, m] = np.interp(nodes, move.arc_m, counts)
                    node_s = _NODE_WEIGHTS * move.arc_m[-1] * np.interp(nodes[:3], move.arc_m, slowness_s_m)
                    self._weight[v, h, m, :3] *= node_s / self._c.habits.mean_leg_s
                    weights = np.diff(time_s[::2]) * counts[1::2]
                    self._add_up(self._own[v, h, m], move.price, grids, (to_x[1::2], to_y[1::2]), weights)

    @property
    def _rate_per_s(self) -> float:
        return self._c.discount_per_s + 1.0 / self._c.habits.mean_leg_s

    def _times(self, heading_rad: FloatArray, arc_m: FloatArray, wind: Wind) -> tuple[FloatArray, FloatArray]:
        """Return the time at each arc, and the time for each metre there."""
        slowness_s_m = 1.0 / ground_speeds_m_s(heading_rad, self._c.airspeed_m_s, wind)
        steps_s = np.diff(arc_m) * 0.5 * (slowness_s_m[1:] + slowness_s_m[:-1])
        return np.concatenate(([0.0], np.cumsum(steps_s))), slowness_s_m

    def _cost_grids(self) -> list[list[Float32]]:
        """Return the running cost on its finer grid, a contiguous part for each offset within a cell."""
        per_cell = _COST_PER_CELL
        half = per_cell * ((self._n - 1) // 2 + self._pad)
        axis = np.arange(-half, half + 1) * (self._cell_m / per_cell)
        rate = self._c.cost.rate(axis[:, None], axis[None, :], 0.0, 0.5 * self._cell_m).astype(np.float32)
        offsets = range(per_cell)
        return [[np.ascontiguousarray(rate[a::per_cell, b::per_cell]) for b in offsets] for a in offsets]

    def _add_up(
        self,
        total: Float32,
        price: float,
        grids: list[list[Float32]],
        places_m: tuple[FloatArray, FloatArray],
        weights: FloatArray,
    ) -> None:
        """Fill in the sum of the running cost's grids, each moved by a place."""
        n, per_cell = self._n, _COST_PER_CELL
        columns, rows = (
            (np.rint(a / (self._cell_m / per_cell)).astype(int) + per_cell * self._pad).tolist() for a in places_m
        )
        total[:] = price
        for fine_i, fine_j, weight in zip(columns, rows, weights.tolist(), strict=True):
            i, j = fine_i // per_cell, fine_j // per_cell
            grid = grids[fine_i % per_cell][fine_j % per_cell]
            total += np.float32(weight) * grid[i : i + n, j : j + n]

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
        weight = self._weight[v, h, m].tolist()
        for node in range(3):  # the nearest node of the grid will do for a small, smooth term
            i, j = round(to_x[node]) + pad, round(to_y[node]) + pad
            plane = after[round(to_heading[node]) % HEADINGS]
            total += np.float32(weight[node]) * plane[i : i + n, j : j + n]
        i, j, k = math.floor(to_x[3]), math.floor(to_y[3]), math.floor(to_heading[3])
        across, along, turn = to_x[3] - i, to_y[3] - j, to_heading[3] - k
        i, j = i + pad, j + pad
        for plane, part in ((padded[k % HEADINGS], 1.0 - turn), (padded[(k + 1) % HEADINGS], turn)):
            for near, across_part in ((plane[i : i + n], 1.0 - across), (plane[i + 1 : i + 1 + n], across)):
                share = part * across_part * weight[3]
                total += np.float32(share * (1.0 - along)) * near[:, j : j + n]
                total += np.float32(share * along) * near[:, j + 1 : j + 1 + n]
        return total

    def _evaluate(self, values: Float32, policy: npt.NDArray[np.intp]) -> None:
        """Follow the policy for some more moves: update ``values`` in place."""
        n = self._n
        headings = np.arange(HEADINGS)[:, None, None]
        axis = np.arange(n) - (n - 1) / 2
        follow = []
        for v in range(self.shape[0]):
            chosen = policy[v]
            x, y, heading, weight = (
                a[headings, chosen] for a in (self._to_x[v], self._to_y[v], self._to_heading, self._weight[v])
            )
            x, y = x + axis[:, None, None], y + axis[:, None]
            ends = corners(heading[..., 3], x[..., 3], y[..., 3], n)
            nodes = [
                (_nearest(heading[..., k], x[..., k], y[..., k], n), weight[..., k].astype(np.float32))
                for k in range(3)
            ]
            own = np.take_along_axis(self._own[v], chosen[:, None], axis=1)[:, 0]
            end_weight = weight[..., 3].astype(np.float32)
            follow.append((own, nodes, [(index, part * end_weight) for index, part in ends]))
        for k in range(_EVALUATIONS):
            if k % _TURN_EVERY == 0:
                after = expected_after_turn(self._c, values)
                fixed = [
                    own + sum(weight * after[v].ravel()[index] for index, weight in nodes)
                    for v, (own, nodes, _) in enumerate(follow)
                ]
            for v, (_, _, led_to) in enumerate(follow):
                flat = values[v].ravel()
                values[v] = fixed[v] + sum(weight * flat[index] for index, weight in led_to)


def _nearest(heading: FloatArray, x: FloatArray, y: FloatArray, n: int) -> npt.NDArray[np.intp]:
    """Return the flat index, in a table (headings, n, n), of the node nearest to each point; as :func:`corners`."""
    i, j = (np.clip(np.rint(a + (n - 1) / 2), 0, n - 1).astype(np.intp) for a in (x, y))
    return (np.rint(heading).astype(np.intp) % HEADINGS * n + i) * n + j
