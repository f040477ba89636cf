"""Value iteration for the value table: improve the policy, then evaluate it several times, cheaply.

On a grid of places every move displaces all places alike, so its backup is a shifted copy of the table: one
improvement costs a few slices for each (class, heading, move). Between improvements the policy stands, and an
evaluation is one gather. A coarse grid first, then the fine one. The loops are in ``value_kernel``.

Source: Puterman and Shin, "Modified policy iteration algorithms for discounted Markov decision problems", Management
Science 24(11), 1978; Chow and Tsitsiklis, "An optimal one-way multigrid algorithm for discrete-time stochastic
control", IEEE Transactions on Automatic Control 36(8), 1991.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.line_kernel import ARC, LinePoint, circle_after, displaced_m, line_at, trapezoid
from sidelong.mission.geometry.wind import ground_speeds_m_s
from sidelong.mission.predictive import value_kernel as kernel
from sidelong.mission.predictive.cost_kernel import blind_rates
from sidelong.mission.predictive.moves_kernel import EIGHTS, MOVES, STAY_LENGTHS, eight_line, move_from
from sidelong.mission.predictive.value_table import (
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
_COST_HEADINGS = 36  # of the running cost, where it depends on them
_SAMPLES_PER_CELL = 2  # of a move's running cost
# Turns of the target on the way count at the Gauss nodes of each move.
_NODES, _NODE_WEIGHTS = (
    np.array([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)]),
    np.array([5.0, 8.0, 5.0]) / 18.0,
)


def compute(configuration: TableConfiguration, progress: Progress = lambda _share: None) -> ValueTable:
    """Return the table.

    Args:
        progress: Called with the share 0..1 of the work that is done.
    """
    half_m, cells = configuration.half_width_m, configuration.cells
    coarse_improvements, fine_improvements = configuration.improvements
    shares = np.array([coarse_improvements + 2.0, 5.0 * (fine_improvements + 2.0)])
    shares = np.cumsum(shares) / shares.sum()
    coarse = _Solver(configuration, half_m / (cells // 2), cells + 1)
    values = np.zeros(coarse.shape, np.float32)
    values = coarse.solve(values, coarse_improvements, lambda part: progress(part * shares[0]))
    values = _halved_cells(values)
    fine = _Solver(configuration, half_m / cells, 2 * cells + 1)
    values = fine.solve(values, fine_improvements, lambda part: progress(shares[0] + part * (shares[1] - shares[0])))
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
    leaving = [move_from(curvature_per_m, k, c.radius_m, c.turn_radius_m, ramp) for k in range(MOVES - 1)]
    lengths_m = (STAY_LENGTHS * c.radius_m).tolist()
    staying = [trapezoid(curvature_per_m, curvature_per_m, m, curvature_per_m, ramp) for m in lengths_m]
    for shapes, price in ((leaving, c.leave_cost), (staying, 0.0)):
        for shape in shapes:
            samples = max(1, round(shape.end_m / step_m))
            arc = np.linspace(0.0, shape.end_m, 2 * samples + 1)
            moves.append(_Move(price, arc, *displaced_m(shape, arc)))
    if c.cost.terms.blind > 0.0:
        for eight in range(EIGHTS):
            line = eight_line(LinePoint(0.0, 0.0, 0.0, curvature_per_m), eight, c.radius_m, ramp)
            length_m = float(line[ARC, -1])
            arc = np.linspace(0.0, length_m, 2 * max(1, round(length_m / step_m)) + 1)
            found = np.empty((3, arc.size))
            line_at(line, circle_after(line, c.radius_m), arc, 0.0, 0.0, found)
            moves.append(_Move(c.leave_cost, arc, *found))
    return moves


class _Solver:
    """Value iteration on one grid of n x n places, ``cell_m`` apart, centred on the target."""

    def __init__(self, configuration: TableConfiguration, cell_m: float, n: int) -> None:
        self._c, self._cell_m, self._n = configuration, cell_m, n
        moves = _moves(configuration, cell_m / _SAMPLES_PER_CELL)
        targets, winds = configuration.classes()
        self.shape = (len(targets), HEADINGS, n, n)
        for wind in winds:  # reports it where the wind is too strong
            ground_speeds_m_s(
                HEADING_STEP_RAD * np.arange(HEADINGS, dtype=np.float64), configuration.airspeed_m_s, Wind(*wind)
            )
        reach_m = max(float(m.arc_m[-1]) for m in moves) * (
            1.0 + configuration.target_speed_max_m_s / (configuration.airspeed_m_s - configuration.wind_speed_m_s)
        )
        self._pad = math.ceil(reach_m / cell_m) + 2
        # Where each move leads, in cells and steps of heading, and what counts there: at three nodes and at its end.
        places = (*self.shape[:2], len(moves))
        self._transitions = kernel.Transitions(
            np.empty((*places, kernel.NODES)),
            np.empty((*places, kernel.NODES)),
            np.empty((*places[1:], kernel.NODES)),
            np.empty((*places, kernel.NODES)),
            np.empty((*places, n, n), np.float32),
        )
        mean_leg_s = configuration.habits.mean_leg_s
        rate_per_s = configuration.discount_per_s + 1.0 / mean_leg_s
        kernel.lay_out(
            kernel.MoveSamples(
                np.cumsum([0, *(m.arc_m.size for m in moves)]),
                np.array([m.price for m in moves]),
                np.concatenate([(m.arc_m, m.east_m, m.north_m, m.turned_rad) for m in moves], axis=1),
                np.append(_NODES, 1.0),
                _NODE_WEIGHTS,
            ),
            kernel.FlightConditions(
                targets, winds, configuration.airspeed_m_s, HEADING_STEP_RAD, rate_per_s, mean_leg_s
            ),
            kernel.CostGrid(self._cost_grids(), cell_m, _COST_PER_CELL, self._pad),
            self._transitions,
        )

    def solve(self, values: Float32, improvements: int, progress: Progress) -> Float32:
        """Iterate from ``values`` and return what comes of it."""
        policy = np.empty(self.shape, np.int32)
        for k in range(improvements):
            progress((k + 1.0) / (improvements + 2.0))
            after = expected_after_turn(self._c, values)
            kernel.improve(values, after, self._transitions, self._pad, policy)
            values = self._evaluated(values, policy)
        return values

    def _cost_grids(self) -> Float32:
        """Return the running cost on its finer grid, a part (k, k) for each heading and offset within a cell."""
        per_cell = _COST_PER_CELL
        half = per_cell * ((self._n - 1) // 2 + self._pad)
        axis = np.arange(-half, half + per_cell, dtype=np.float64) * (self._cell_m / per_cell)
        rate = self._c.cost.rate(axis[:, None], axis[None, :], 0.0, 0.5 * self._cell_m).astype(np.float32)
        rates, terms, offsets = [rate], self._c.cost.terms, range(per_cell)
        if terms.blind > 0.0:
            blind = np.empty((_COST_HEADINGS, *rate.shape))
            for k in range(_COST_HEADINGS):
                blind_rates(axis, math.tau / _COST_HEADINGS * k, terms, blind[k])
            rates = list(rate + blind.astype(np.float32))
        return np.array([[[one[a::per_cell, b::per_cell] for b in offsets] for a in offsets] for one in rates])

    def _evaluated(self, values: Float32, policy: npt.NDArray[np.int32]) -> Float32:
        """Return the values after following the policy for some more moves."""
        led_to, parts = np.empty((values.size, 5), np.int32), np.empty((values.size, 7), np.float32)
        cost, fixed = np.empty(values.size, np.float32), np.empty(values.size, np.float32)
        kernel.follow(policy, self._transitions, led_to, parts, cost)
        found = np.empty_like(values)
        classes = len(values)
        for k in range(_EVALUATIONS):
            if k % _TURN_EVERY == 0:
                after = expected_after_turn(self._c, values)
                kernel.turns_cost(after.reshape(classes, -1), led_to, parts, cost, fixed)
            flat, flat_found = values.reshape(classes, -1), found.reshape(classes, -1)
            kernel.evaluate(flat, self._n, led_to, parts, fixed, flat_found)
            values, found = found, values
        return values
