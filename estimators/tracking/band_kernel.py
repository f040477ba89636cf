"""The inner loops of :mod:`sidelong.estimators.tracking.delay_scene`."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled

FloatArray = npt.NDArray[np.float64]


@compiled
def solve_banded(band: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solution of a symmetric, positive definite system; NaN where it is not positive definite.

    Args:
        band: the upper diagonals, (width + 1, n): element (i, j) of the matrix is in row width + i - j, column j.
        right: right-hand sides, (n, m).
    """
    width, n = band.shape[0] - 1, band.shape[1]
    factor, x = band.copy(), right.copy()
    for j in range(n):
        for i in range(max(0, j - width), j + 1):
            left = factor[width + i - j, j]
            for k in range(max(0, j - width), i):
                left -= factor[width + k - i, i] * factor[width + k - j, j]
            factor[width + i - j, j] = math.sqrt(left) if i == j else left / factor[width, i]
    for column in range(x.shape[1]):
        for j in range(n):
            for i in range(max(0, j - width), j):
                x[j, column] -= factor[width + i - j, j] * x[i, column]
            x[j, column] /= factor[width, j]
        for j in range(n - 1, -1, -1):
            x[j, column] /= factor[width, j]
            for i in range(max(0, j - width), j):
                x[i, column] -= factor[width + i - j, j] * x[j, column]
    return x


@compiled
def _binned(first: npt.NDArray[np.intp], a: FloatArray, b: FloatArray, size: int) -> FloatArray:
    """Return the sums (size,) of products, each added where its index says."""
    sums = np.zeros(size)
    for n in range(len(first)):
        sums[first[n]] += a[n] * b[n]
    return sums


@compiled
def add_readings(
    knot: npt.NDArray[np.intp],
    past: FloatArray,
    by_place: FloatArray,
    by_shared: FloatArray,
    weight: FloatArray,
    residual: FloatArray,
    band: FloatArray,
    border: FloatArray,
    right: FloatArray,
) -> None:
    """Add readings of a place between two knots to the normal equations.

    Args:
        knot: the knot before each reading, (n,).
        past: share of the knot after it, (n,).
        by_place: derivative of each reading by the place, (n, 2).
        by_shared: derivatives by numbers that all readings share, (m, n).
        weight: of each reading, (n,).
        residual: of each reading, (n,).
        band: upper diagonals, (5, 2 * knots).
        border: columns of the shared numbers, (2 * knots, m).
        right: right-hand side, (2 * knots,).
    """
    size, by_knots = len(right), np.empty((4, len(knot)))
    for axis in range(2):
        by_knots[axis] = (1 - past) * by_place[:, axis]
        by_knots[2 + axis] = past * by_place[:, axis]
    for i in range(4):
        first, weighted = 2 * knot + i, weight * by_knots[i]
        right -= _binned(first, weighted, residual, size)
        for s in range(len(by_shared)):
            border[:, s] += _binned(first, weighted, by_shared[s], size)
        for j in range(i, 4):
            band[4 - (j - i)] += _binned(2 * knot + j, weighted, by_knots[j], size)


@compiled
def aircraft_at(positions: FloatArray, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities (n, 2) of the aircraft, by the cubic through positions and velocities.

    Args:
        positions: rows of time s, east m, north m, velocity east m/s, velocity north m/s.
        time_s: at which times, (n,).
    """
    place, velocity = np.empty((len(time_s), 2)), np.empty((len(time_s), 2))
    for n in range(len(time_s)):
        k = min(max(np.searchsorted(positions[:, 0], time_s[n]) - 1, 0), len(positions) - 2)
        a, b = positions[k], positions[k + 1]
        step_s = b[0] - a[0]
        u = (time_s[n] - a[0]) / step_s
        for axis in range(2):
            at, moved, before, after = a[1 + axis], b[1 + axis] - a[1 + axis], a[3 + axis], b[3 + axis]
            slope = step_s * u * (1 - u) * ((1 - u) * before - u * after)
            place[n, axis] = at + u * u * (3 - 2 * u) * moved + slope
            velocity[n, axis] = before + u * (after - before)
    return place, velocity
