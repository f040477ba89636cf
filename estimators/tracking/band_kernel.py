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
def add_readings(
    knot: npt.NDArray[np.intp],
    past: FloatArray,
    by_place: FloatArray,
    by_shared: FloatArray,
    residual: FloatArray,
    sigma: FloatArray,
    freedom: float,
    band: FloatArray,
    border: FloatArray,
    right: FloatArray,
    corner: FloatArray,
    right_shared: FloatArray,
) -> float:
    """Add readings of a place between two knots to the normal equations; return what they cost.

    Args:
        knot: the knot before each reading, (n,).
        past: share of the knot after it, (n,).
        by_place: derivative of each reading by the place, (n, 2).
        by_shared: derivatives by numbers that all readings share, (n, m).
        residual: of each reading, (n,).
        sigma: noise of each reading, (n,).
        freedom: of Student's distribution, by which outliers have little weight.
        band: upper diagonals, (5, 2 * knots).
        border: columns of the shared numbers, (2 * knots, m).
        right: right-hand side, (2 * knots,).
        corner: equations of the shared numbers among each other, (m, m).
        right_shared: their right-hand side, (m,).
    """
    by_knots, count, cost = np.empty(4), by_shared.shape[1], 0.0
    for n in range(len(knot)):
        relative = residual[n] / sigma[n]
        squared = relative * relative
        cost += math.log1p(squared / freedom)
        weight = (freedom + 1) / (freedom + squared) / (sigma[n] * sigma[n])
        for axis in range(2):
            by_knots[axis] = (1 - past[n]) * by_place[n, axis]
            by_knots[2 + axis] = past[n] * by_place[n, axis]
        first = 2 * knot[n]
        for i in range(4):
            weighted = weight * by_knots[i]
            right[first + i] -= weighted * residual[n]
            for s in range(count):
                border[first + i, s] += weighted * by_shared[n, s]
            for j in range(i, 4):
                band[4 - (j - i), first + j] += weighted * by_knots[j]
        for s in range(count):
            weighted = weight * by_shared[n, s]
            right_shared[s] -= weighted * residual[n]
            for other in range(count):
                corner[s, other] += weighted * by_shared[n, other]
    return 0.5 * (freedom + 1) * cost


@compiled
def add_turns(
    path: FloatArray, scale_m2: float, freedom: float, robust: bool, band: FloatArray, right: FloatArray
) -> float:
    """Add to the normal equations that the target's velocity seldom changes; return what its changes cost.

    Args:
        path: places of the knots, (n, 2).
        scale_m2: variance of the second differences of the path on each axis.
        freedom: of Student's distribution, by which sudden turns have little weight.
        robust: whether they have; if not, all turns have the same weight.
        band: upper diagonals, (5, 2 * knots).
        right: right-hand side, (2 * knots,).
    """
    bent, cost = (1.0, -2.0, 1.0), 0.0
    for k in range(len(path) - 2):
        turn = path[k] - 2.0 * path[k + 1] + path[k + 2]
        squared = (turn[0] * turn[0] + turn[1] * turn[1]) / scale_m2
        cost += math.log1p(squared / freedom)
        weight = ((freedom + 2) / (freedom + squared) if robust else 1.0) / scale_m2
        for i in range(3):
            for axis in range(2):
                right[2 * (k + i) + axis] -= bent[i] * weight * turn[axis]
                for j in range(i, 3):
                    band[4 - 2 * (j - i), 2 * (k + j) + axis] += bent[i] * bent[j] * weight
    return 0.5 * (freedom + 2) * cost + (len(path) - 2) * math.log(scale_m2)


@compiled
def aircraft_at(positions: FloatArray, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities (n, 2) of the aircraft, by the cubic through positions and velocities.

    Args:
        positions: rows of time s, east m, north m, velocity east m/s, velocity north m/s.
        time_s: at which times, (n,), ascending.
    """
    place, velocity = np.empty((len(time_s), 2)), np.empty((len(time_s), 2))
    k = 0
    for n in range(len(time_s)):
        while k < len(positions) - 2 and positions[k + 1, 0] < time_s[n]:
            k += 1
        a, b = positions[k], positions[k + 1]
        step_s = b[0] - a[0]
        u = (time_s[n] - a[0]) / step_s
        for axis in range(2):
            at, moved, before, after = a[1 + axis], b[1 + axis] - a[1 + axis], a[3 + axis], b[3 + axis]
            slope = step_s * u * (1 - u) * ((1 - u) * before - u * after)
            place[n, axis] = at + u * u * (3 - 2 * u) * moved + slope
            velocity[n, axis] = before + u * (after - before)
    return place, velocity


@compiled
def way_at(
    positions: FloatArray, path: FloatArray, begin_s: float, knot_s: float, time_s: FloatArray
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.intp], FloatArray]:
    """Return the target's place and velocity from the aircraft (n, 2) each, the knot before, and the share past it.

    Args:
        positions: as in :func:`aircraft_at`.
        path: places of the target's knots, (knots, 2).
        begin_s: time of the first knot.
        knot_s: time from knot to knot.
        time_s: at which times, (n,), ascending.
    """
    way, speed = aircraft_at(positions, time_s)
    knot, past = np.empty(len(time_s), np.intp), np.empty(len(time_s))
    for n in range(len(time_s)):
        at = (time_s[n] - begin_s) / knot_s
        k = min(max(int(at), 0), len(path) - 2)
        knot[n], past[n] = k, at - k
        for axis in range(2):
            leg_m = path[k + 1, axis] - path[k, axis]
            way[n, axis] = path[k, axis] + past[n] * leg_m - way[n, axis]
            speed[n, axis] = leg_m / knot_s - speed[n, axis]
    return way, speed, knot, past
