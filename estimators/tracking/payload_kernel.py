"""The least-squares fit of the payload's errors: it finds them together with the target's path.

Unknown are the path (knots, with a white acceleration whose size is found with it) and numbers that all readings
share. The normal equations of the path are banded; the shared numbers are a border. Errors follow Student's
distribution, so that outliers of the readings and sudden turns of the target have little weight.

Source: docs/explanation/filter.md#delays; Lange, Little, Taylor, "Robust statistical modeling using the t
distribution", Journal of the American Statistical Association 84(408), 1989.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled, inner

FloatArray = npt.NDArray[np.float64]

SHARED = 6
"""Gimbal delay s, laser delay s, tangent of the yaw error, error of the level range m; growth of the last two."""
EARTH, VEHICLE, BODY = range(3)
MAX_DELAY_S, MIN_DELAY_S = 3.0, -0.1
"""A payload cannot measure after its stamp; clocks of vehicle and payload may differ by a little."""
_EARLY_SIGMA_S = 0.02

_KNOT_S = 2.0
_NEAR_M = 0.01  # no direction is known of a nearer target
_SINE_MIN = 0.02  # of the depression of a line of sight that ends on the ground
_FREEDOM = 4.0  # of Student's distribution
_STIFF_M, _STIFFEST_M, _LOOSENED_M, _STIFF_ITERATIONS = 0.1, 0.02, 0.04, 3
_ITERATIONS_MAX, _SETTLED = 40, 0.3  # of the cost


class Readings(NamedTuple):
    """The readings of one fit, each in the order of its stamps.

    Attributes:
        positions: of the aircraft: time s, east m, north m, velocity east m/s, velocity north m/s.
        attitudes: time s, roll rad, pitch rad, yaw rad without jumps by a turn; not read for ``EARTH``.
        sights: time s, direction of the line of sight in its frame: north or forward, east or right, down; and the
            factor of the growth of the yaw error, s before the end.
        ranges: time s, slant range m; and the factor of the growth of the range error: s before the end, or the
            level range m where ranges are wrong by a share at some bearings only.
        frame: ``EARTH``, ``VEHICLE`` or ``BODY``.
        noise: of a yaw rad, of a laser's range m; of pitch rad and ground m for ranges to the ground, else 0, 0.
        latencies_s: of gimbal and laser, as configured; the stamps are without them.
    """

    positions: FloatArray
    attitudes: FloatArray
    sights: FloatArray
    ranges: FloatArray
    frame: int
    noise: tuple[float, float, float, float]
    latencies_s: tuple[float, float]


@inner
def solve_banded(band: FloatArray, right: FloatArray) -> None:
    """Solve a symmetric, positive definite system in place; NaN where it is not positive definite.

    band: the upper diagonals, (width + 1, n): element (i, j) of the matrix is in row width + i - j, column j.
    """
    width, n = band.shape[0] - 1, band.shape[1]
    for j in range(n):
        first = max(0, j - width)
        for i in range(first, j + 1):
            left = band[width + i - j, j]
            for k in range(first, i):
                left -= band[width + k - i, i] * band[width + k - j, j]
            band[width + i - j, j] = math.sqrt(left) if i == j else left / band[width, i]
        for column in range(right.shape[1]):
            for i in range(first, j):
                right[j, column] -= band[width + i - j, j] * right[i, column]
            right[j, column] /= band[width, j]
    for j in range(n - 1, -1, -1):
        for column in range(right.shape[1]):
            right[j, column] /= band[width, j]
            for i in range(max(0, j - width), j):
                right[i, column] -= band[width + i - j, j] * right[j, column]


@inner
def aircraft_at(positions: FloatArray, after: int, time_s: float) -> tuple[int, float, float, float, float]:
    """Return the row before a time, searched from ``after``, and the cubic's place and velocity there."""
    k = after
    while k < len(positions) - 2 and positions[k + 1, 0] < time_s:
        k += 1
    step_s = positions[k + 1, 0] - positions[k, 0]
    u = (time_s - positions[k, 0]) / step_s
    whole, first, last = u * u * (3 - 2 * u), step_s * u * (1 - u) * (1 - u), step_s * u * u * (1 - u)
    ve, vn = positions[k, 3], positions[k, 4]
    ve_after, vn_after = positions[k + 1, 3], positions[k + 1, 4]
    east_m = positions[k, 1] + whole * (positions[k + 1, 1] - positions[k, 1]) + first * ve - last * ve_after
    north_m = positions[k, 2] + whole * (positions[k + 1, 2] - positions[k, 2]) + first * vn - last * vn_after
    return k, east_m, north_m, ve + u * (ve_after - ve), vn + u * (vn_after - vn)


@compiled
def look(readings: Readings, gimbal_s: float, looks: FloatArray) -> None:
    """Compute bearing rad, depression rad and the frame's turn rate rad/s of the lines of sight, (n, 3)."""
    attitudes, k = readings.attitudes, 0
    for n in range(len(readings.sights)):
        time_s = readings.sights[n, 0] - gimbal_s
        x, y, z, yaw = readings.sights[n, 1], readings.sights[n, 2], readings.sights[n, 3], 0.0
        looks[n, 2] = 0.0
        if readings.frame != EARTH:
            while k < len(attitudes) - 2 and attitudes[k + 1, 0] < time_s:
                k += 1
            step_s = attitudes[k + 1, 0] - attitudes[k, 0]
            u = min(max((time_s - attitudes[k, 0]) / step_s, 0.0), 1.0)
            yaw = (1 - u) * attitudes[k, 3] + u * attitudes[k + 1, 3]
            looks[n, 2] = (attitudes[k + 1, 3] - attitudes[k, 3]) / step_s
            if readings.frame == BODY:
                roll = (1 - u) * attitudes[k, 1] + u * attitudes[k + 1, 1]
                pitch = (1 - u) * attitudes[k, 2] + u * attitudes[k + 1, 2]
                y, z = math.cos(roll) * y - math.sin(roll) * z, math.sin(roll) * y + math.cos(roll) * z
                x, z = math.cos(pitch) * x + math.sin(pitch) * z, math.cos(pitch) * z - math.sin(pitch) * x
        looks[n, 0] = yaw + math.atan2(y, x)
        looks[n, 1] = math.asin(min(max(z, -1.0), 1.0))


@compiled
def fit_readings(
    readings: Readings, sigmas: FloatArray, heavy: npt.NDArray[np.bool_], start: FloatArray, scale_m: float
) -> tuple[FloatArray, float, FloatArray, float, FloatArray]:
    """Return the best fit near a start.

    The shared numbers are those of :data:`SHARED`, (6,), errors of yaw and level range at the end, where their growth
    counts nothing. sigmas: of their priors. Those that are ``heavy`` may be far beyond these, which then follow
    Student's distribution. scale_m: size of the target's turns (second difference of the knots) to start from; 0: not
    known. The path is then held nearly straight at first: a path free to bend would circle with the aircraft and
    leave the delays nothing to explain.

    Returns:
        The shared numbers, the size of the target's turns m, the inverse of the shared numbers' covariance by the
            readings alone (6, 6), the negative logarithm of the likelihood less a constant, and the residual of each
            range m.
    """
    sights, ranges, latencies_s = readings.sights, readings.ranges, readings.latencies_s
    shares = len(start)  # unrolled loops would take long to compile
    begin_s = min(sights[0, 0], ranges[0, 0]) - MAX_DELAY_S
    end_s = max(sights[-1, 0], ranges[-1, 0])
    knots = math.ceil((end_s - MIN_DELAY_S - begin_s) / _KNOT_S) + 2
    path, shared, step = np.zeros((knots, 2)), start.copy(), np.zeros(shares)
    looks, off_m = np.empty((len(sights), 3)), np.empty(len(ranges))
    information = np.zeros((shares, shares))
    scale_m2 = scale_m * scale_m if scale_m > 0.0 else _STIFF_M * _STIFF_M
    by_knots, by_shared, cost, last = np.empty(4), np.zeros(shares), math.inf, math.inf
    for iteration in range(-1, _ITERATIONS_MAX):
        look(readings, shared[0], looks)
        free = iteration >= (1 if scale_m > 0.0 else _STIFF_ITERATIONS)
        if iteration == _STIFF_ITERATIONS and scale_m == 0.0:
            scale_m2 = _LOOSENED_M * _LOOSENED_M
        elif free:
            total = 0.0
            for k in range(knots - 2):
                squared = 0.0
                for axis in range(2):
                    squared += (path[k, axis] - 2.0 * path[k + 1, axis] + path[k + 2, axis]) ** 2
                total += (_FREEDOM + 2) / (_FREEDOM + squared / scale_m2) * squared
            scale_m2 = max(total / (2 * (knots - 2)), _STIFFEST_M**2)
        band, right = np.zeros((5, 2 * knots)), np.zeros((2 * knots, shares + 1))
        corner, right_shared, cost = np.zeros((shares, shares)), np.zeros(shares), 0.0
        prior = np.zeros(shares)
        for s in range(shares):
            squared = (shared[s] / sigmas[s]) ** 2
            prior[s] = 1.0 / sigmas[s] ** 2
            if heavy[s]:
                prior[s] /= 1.0 + squared / _FREEDOM
                squared = _FREEDOM * math.log1p(squared / _FREEDOM)
            cost += 0.5 * squared
            right_shared[s] = -shared[s] * prior[s]
            if s < 2 and shared[s] + latencies_s[s] < 0.0:
                early = shared[s] + latencies_s[s]
                cost += 0.5 * (early / _EARLY_SIGMA_S) ** 2
                prior[s] += _EARLY_SIGMA_S**-2
                right_shared[s] -= early * _EARLY_SIGMA_S**-2
        for device in range(2):
            rows = sights if device == 0 else ranges
            k, sight = 0, 0
            for n in range(len(rows)):
                time_s = rows[n, 0] - shared[device]
                since = rows[n, -1]
                k, own_east_m, own_north_m, own_ve, own_vn = aircraft_at(readings.positions, k, time_s)
                at = (time_s - begin_s) / _KNOT_S
                knot = min(max(int(at), 0), knots - 2)
                past = at - knot
                leg_e, leg_n = path[knot + 1, 0] - path[knot, 0], path[knot + 1, 1] - path[knot, 1]
                way_e, way_n = path[knot, 0] + past * leg_e - own_east_m, path[knot, 1] + past * leg_n - own_north_m
                speed_e, speed_n = leg_e / _KNOT_S - own_ve, leg_n / _KNOT_S - own_vn
                by_shared[:] = 0.0
                if device == 0:
                    east, north = math.sin(looks[n, 0]), math.cos(looks[n, 0])
                    ahead_m = way_e * east + way_n * north
                    tan_yaw = shared[2] + shared[4] * since
                    residual = way_e * north - way_n * east + ahead_m * tan_yaw
                    by_e, by_n = north + east * tan_yaw, north * tan_yaw - east
                    by_shared[0] = speed_n * east - speed_e * north + ahead_m * looks[n, 2]
                    by_shared[2], by_shared[4] = ahead_m, ahead_m * since
                    sigma = readings.noise[0] * max(abs(ahead_m), _NEAR_M) * (1.0 + tan_yaw * tan_yaw)
                else:
                    while sight < len(sights) - 2 and sights[sight + 1, 0] - shared[0] < time_s:
                        sight += 1
                    u = (time_s - sights[sight, 0] + shared[0]) / (sights[sight + 1, 0] - sights[sight, 0])
                    u = min(max(u, 0.0), 1.0)
                    down_rad = (1 - u) * looks[sight, 1] + u * looks[sight + 1, 1]
                    slant_m, sine = rows[n, 1], math.sin(down_rad)
                    level_m = slant_m * math.cos(down_rad)
                    if iteration < 0:  # the first path: through the places that the readings give
                        turn = (looks[sight + 1, 0] - looks[sight, 0] + math.pi) % (2 * math.pi) - math.pi
                        bearing = looks[sight, 0] + u * turn
                        way_e, way_n = level_m * math.sin(bearing), level_m * math.cos(bearing)
                        leg_e, leg_n = own_east_m + way_e, own_north_m + way_n
                        while step[0] < knots and (step[0] * _KNOT_S + begin_s <= time_s or n == len(rows) - 1):
                            share = 1.0
                            if n > 0 and step[0] * _KNOT_S + begin_s < time_s:
                                share = (step[0] * _KNOT_S + begin_s - step[1]) / (time_s - step[1])
                            path[int(step[0]), 0] = step[2] + share * (leg_e - step[2])
                            path[int(step[0]), 1] = step[3] + share * (leg_n - step[3])
                            step[0] += 1
                        step[1], step[2], step[3] = time_s, leg_e, leg_n
                        continue
                    distance_m = math.hypot(way_e, way_n)
                    by_e, by_n = way_e / max(distance_m, _NEAR_M), way_n / max(distance_m, _NEAR_M)
                    residual = off_m[n] = distance_m - level_m + shared[3] + shared[5] * since
                    by_shared[1], by_shared[3], by_shared[5] = -by_e * speed_e - by_n * speed_n, 1.0, since
                    if readings.noise[2] > 0.0:
                        sigma = math.hypot(slant_m * readings.noise[2], readings.noise[3]) / max(sine, _SINE_MIN)
                    else:
                        sigma = math.hypot(readings.noise[1], slant_m * sine * readings.noise[0])
                if iteration < 0:
                    continue
                squared = (residual / sigma) ** 2
                cost += 0.5 * (_FREEDOM + 1) * math.log1p(squared / _FREEDOM)
                weight = (_FREEDOM + 1) / (_FREEDOM + squared) / (sigma * sigma)
                by_knots[0], by_knots[1] = (1 - past) * by_e, (1 - past) * by_n
                by_knots[2], by_knots[3] = past * by_e, past * by_n
                for i in range(4):
                    weighted = weight * by_knots[i]
                    right[2 * knot + i, shares] -= weighted * residual
                    for s in range(device, shares, 2):
                        right[2 * knot + i, s] += weighted * by_shared[s]
                    for j in range(i, 4):
                        band[4 - j + i, 2 * knot + j] += weighted * by_knots[j]
                for s in range(device, shares, 2):
                    weighted = weight * by_shared[s]
                    right_shared[s] -= weighted * residual
                    for other in range(device, shares, 2):
                        corner[s, other] += weighted * by_shared[other]
        if iteration < 0:
            step[:] = 0.0
            continue
        for k in range(knots - 2):
            turn_e = path[k, 0] - 2.0 * path[k + 1, 0] + path[k + 2, 0]
            turn_n = path[k, 1] - 2.0 * path[k + 1, 1] + path[k + 2, 1]
            squared = (turn_e * turn_e + turn_n * turn_n) / scale_m2
            cost += 0.5 * (_FREEDOM + 2) * math.log1p(squared / _FREEDOM)
            weight = ((_FREEDOM + 2) / (_FREEDOM + squared) if free else 1.0) / scale_m2
            for i in range(3):
                bent = weight * (-2.0 if i == 1 else 1.0)
                right[2 * (k + i), shares] -= bent * turn_e
                right[2 * (k + i) + 1, shares] -= bent * turn_n
                for j in range(i, 3):
                    for axis in range(2):
                        band[4 - 2 * (j - i), 2 * (k + j) + axis] += bent * (-2.0 if j == 1 else 1.0)
        cost += (knots - 2) * math.log(scale_m2)
        border = right[:, :shares].copy()
        for i in range(2 * knots):
            band[4, i] += 1e-9
        solve_banded(band, right)
        for i in range(2 * knots):  # the path's own freedom: a straight path is likely at any size of turns
            cost += math.log(band[4, i])
        if free and iteration > 1 and abs(last - cost) < _SETTLED:
            break
        last = cost
        for s in range(shares):
            step[s] = right_shared[s]
            for i in range(2 * knots):
                step[s] -= border[i, s] * right[i, shares]
            for other in range(shares):
                information[s, other] = corner[s, other]
                for i in range(2 * knots):
                    information[s, other] -= border[i, s] * right[i, other]
        full, square = information.copy(), step.reshape(shares, 1)
        for s in range(shares):
            full[s, s] += prior[s]
        upper = np.zeros((shares, shares))  # the same as a band as wide as the matrix
        for i in range(shares):
            for j in range(i, shares):
                upper[shares - 1 + i - j, j] = full[i, j]
        solve_banded(upper, square)
        for k in range(knots):
            for axis in range(2):
                path[k, axis] += right[2 * k + axis, shares]
                for s in range(shares):
                    path[k, axis] -= right[2 * k + axis, s] * step[s]
        for s in range(shares):
            shared[s] += step[s]
            if s < 2:
                shared[s] = min(max(shared[s], MIN_DELAY_S - latencies_s[s]), MAX_DELAY_S)
    return shared, math.sqrt(scale_m2), information, cost, off_m
