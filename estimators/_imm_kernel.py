"""The inner loops of :mod:`estimators.imm`.

The state of the filter is one array (models, SIZE): of each model its probability, its mean (N,) and its covariance
(N, N). N holds all three biases: one that is not estimated has no variance, and keeps its value. Each model's motion
touches few numbers of its covariance; these are written out instead of multiplying by matrices.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from estimators.compiled import compiled

FloatArray = npt.NDArray[np.float64]

STANDING, CRUISING, TURNING, MANOEUVRING = MODELS = range(4)
_MODELS = 4
EAST, NORTH, VELOCITY_E, VELOCITY_N, HEIGHT, YAW, PITCH, RANGE, TURN = range(9)
N = 9
PROBABILITY, MEAN, COVARIANCE, SIZE = 0, 1, 1 + N, 1 + N + N * N

HEIGHT_DENSITY_M2_S = 0.02  # the ground under a target that drives up and down gentle hills
SHUFFLE_SIGMA_M_S = 0.05
TURN_SIGMA_RAD_S = 0.25
TURN_DRIFT_RAD2_S3 = 1e-4

# How often one kind of motion gives way to another, 1/s, from row to column.
_SWITCH_RATES_PER_S = np.array(
    [
        [0.0, 0.005, 0.002, 0.04],
        [0.002, 0.0, 0.003, 0.02],
        [0.002, 0.005, 0.0, 0.01],
        [0.1, 0.15, 0.1, 0.0],
    ]
)
GENERATOR = _SWITCH_RATES_PER_S - np.diag(_SWITCH_RATES_PER_S.sum(axis=1))
GENERATOR_SQUARED = GENERATOR @ GENERATOR

# Where the place is known worse than this part of the range, a bearing's curvature shows: 0.3 m at three sigma.
_CURVED_BEYOND = 0.015
_TWO_PI = 2.0 * math.pi
# The state's numbers that a sighting measures.
_SEEN = (EAST, NORTH, HEIGHT, YAW, PITCH, RANGE)


class Densities(NamedTuple):
    """Of the noise: white acceleration of what holds its course, of what manoeuvres, and the place of what stands."""

    cruise_m2_s3: float
    manoeuvre_m2_s3: float
    shuffle_m2_s: float


class Seen(NamedTuple):
    """A sighting, its three numbers with their variances; of a fix the first two are (east, north)."""

    is_fix: bool
    slant_range_m: float
    bearing_rad: float
    depression_rad: float
    range_variance_m2: float
    bearing_variance_rad2: float
    depression_variance_rad2: float
    aircraft_east_m: float
    aircraft_north_m: float
    aircraft_height_m: float


@compiled
def switch_probability(step_s: float, before: int, after: int) -> float:
    """Return the chance of being in one motion ``step_s`` after another; step <= 1 s."""
    same = 1.0 if before == after else 0.0
    return float(
        same + GENERATOR[before, after] * step_s + GENERATOR_SQUARED[before, after] * (0.5 * step_s * step_s)
    )


@compiled
def predict(
    state: FloatArray,
    step_s: float,
    densities: Densities,
    drift_per_s: tuple[float, float, float],
    found: FloatArray,
) -> None:
    """Fill in the state ``step_s`` later. drift_per_s: what the variances of the biases gain."""
    _mix(state, step_s, found)
    for model in range(_MODELS):
        mean = found[model, MEAN:COVARIANCE]
        p = found[model, COVARIANCE:].reshape(N, N)
        if model == TURNING:
            _turn(mean, p, step_s)
        else:
            mean[TURN] = 0.0
            p[TURN, :] = 0.0
            p[:, TURN] = 0.0
            if model == STANDING:
                mean[VELOCITY_E] = mean[VELOCITY_N] = 0.0
                p[VELOCITY_E, :] = 0.0
                p[VELOCITY_N, :] = 0.0
                p[:, VELOCITY_E] = 0.0
                p[:, VELOCITY_N] = 0.0
            else:
                mean[EAST] += step_s * mean[VELOCITY_E]
                mean[NORTH] += step_s * mean[VELOCITY_N]
                for k in range(N):
                    p[EAST, k] += step_s * p[VELOCITY_E, k]
                    p[NORTH, k] += step_s * p[VELOCITY_N, k]
                for k in range(N):
                    p[k, EAST] += step_s * p[k, VELOCITY_E]
                    p[k, NORTH] += step_s * p[k, VELOCITY_N]
        p[HEIGHT, HEIGHT] += HEIGHT_DENSITY_M2_S * step_s
        for bias in range(3):
            p[YAW + bias, YAW + bias] += drift_per_s[bias] * step_s
        p[TURN, TURN] += TURN_DRIFT_RAD2_S3 * step_s if model == TURNING else TURN_SIGMA_RAD_S**2
        if model == STANDING:
            p[EAST, EAST] += densities.shuffle_m2_s * step_s
            p[NORTH, NORTH] += densities.shuffle_m2_s * step_s
            p[VELOCITY_E, VELOCITY_E] += SHUFFLE_SIGMA_M_S**2
            p[VELOCITY_N, VELOCITY_N] += SHUFFLE_SIGMA_M_S**2
        else:
            density = densities.manoeuvre_m2_s3 if model == MANOEUVRING else densities.cruise_m2_s3
            for axis in range(2):
                place, velocity = EAST + axis, VELOCITY_E + axis
                p[place, place] += density * step_s * step_s * step_s / 3.0
                p[place, velocity] += density * step_s * step_s / 2.0
                p[velocity, place] += density * step_s * step_s / 2.0
                p[velocity, velocity] += density * step_s


@compiled
def _mix(state: FloatArray, step_s: float, found: FloatArray) -> None:
    """Fill in what each model starts the step from, and move the probabilities on."""
    weights = np.empty(_MODELS)
    apart = np.empty((_MODELS, N))
    for model in range(_MODELS):
        probability = 0.0
        for before in range(_MODELS):
            weights[before] = state[before, PROBABILITY] * switch_probability(step_s, before, model)
            probability += weights[before]
        for before in range(_MODELS):
            weights[before] /= probability
        w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
        for k in range(1, SIZE):
            found[model, k] = w0 * state[0, k] + w1 * state[1, k] + w2 * state[2, k] + w3 * state[3, k]
        found[model, PROBABILITY] = probability
        for before in range(_MODELS):
            for a in range(N):
                apart[before, a] = state[before, MEAN + a] - found[model, MEAN + a]
        p = found[model, COVARIANCE:].reshape(N, N)
        for a in range(N):
            a0, a1, a2, a3 = w0 * apart[0, a], w1 * apart[1, a], w2 * apart[2, a], w3 * apart[3, a]
            for b in range(N):
                p[a, b] += a0 * apart[0, b] + a1 * apart[1, b] + a2 * apart[2, b] + a3 * apart[3, b]


@compiled
def _turn(mean: FloatArray, p: FloatArray, step_s: float) -> None:
    """Turn a target at its rate. The derivative by the rate is to first order in the angle turned."""
    rate = mean[TURN]
    angle = rate * step_s
    sin_a, cos_a = math.sin(angle), math.cos(angle)
    if abs(angle) < 1e-4:
        ahead, aside = step_s, 0.5 * angle * step_s
    else:
        ahead, aside = sin_a / rate, (1.0 - cos_a) / rate
    velocity_e, velocity_n = mean[VELOCITY_E], mean[VELOCITY_N]
    east, north = cos_a * velocity_e + sin_a * velocity_n, cos_a * velocity_n - sin_a * velocity_e
    half = 0.5 * step_s * step_s
    by_rate_0, by_rate_1, by_rate_2, by_rate_3 = half * north, -half * east, step_s * north, -step_s * east
    mean[EAST] += ahead * velocity_e + aside * velocity_n
    mean[NORTH] += ahead * velocity_n - aside * velocity_e
    mean[VELOCITY_E], mean[VELOCITY_N] = east, north
    for k in range(N):
        e, n, rate = p[VELOCITY_E, k], p[VELOCITY_N, k], p[TURN, k]
        p[EAST, k] += ahead * e + aside * n + by_rate_0 * rate
        p[NORTH, k] += ahead * n - aside * e + by_rate_1 * rate
        p[VELOCITY_E, k] = cos_a * e + sin_a * n + by_rate_2 * rate
        p[VELOCITY_N, k] = cos_a * n - sin_a * e + by_rate_3 * rate
    for k in range(N):
        e, n, rate = p[k, VELOCITY_E], p[k, VELOCITY_N], p[k, TURN]
        p[k, EAST] += ahead * e + aside * n + by_rate_0 * rate
        p[k, NORTH] += ahead * n - aside * e + by_rate_1 * rate
        p[k, VELOCITY_E] = cos_a * e + sin_a * n + by_rate_2 * rate
        p[k, VELOCITY_N] = cos_a * n - sin_a * e + by_rate_3 * rate


@compiled
def _compared(
    seen: Seen, east_m: float, north_m: float, height_m: float, residual: FloatArray, jacobian: FloatArray
) -> None:
    """Fill in measured minus expected (3,) of a target at a place, and the derivative (3, 6) by it."""
    jacobian[:] = 0.0
    if seen.is_fix:
        residual[0], residual[1], residual[2] = seen.slant_range_m - east_m, seen.bearing_rad - north_m, 0.0
        jacobian[0, 0] = jacobian[1, 1] = 1.0
        return
    east, north = east_m - seen.aircraft_east_m, north_m - seen.aircraft_north_m
    drop = seen.aircraft_height_m - height_m
    horizontal = math.sqrt(east * east + north * north)
    residual[0] = seen.slant_range_m - math.sqrt(horizontal * horizontal + drop * drop)
    off_rad = seen.bearing_rad - math.atan2(east, north)
    residual[1] = off_rad - _TWO_PI * math.floor((off_rad + math.pi) / _TWO_PI)
    residual[2] = seen.depression_rad - math.atan2(drop, horizontal)
    # Within a metre of straight below the aircraft, where the bearing turns over, it is that of one metre off.
    horizontal = max(horizontal, 1.0)
    slant2 = horizontal * horizontal + drop * drop
    slant = math.sqrt(slant2)
    per_horizontal2 = 1.0 / (horizontal * horizontal)
    steepening = drop / horizontal / slant2
    jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = east / slant, north / slant, -drop / slant
    jacobian[1, 0], jacobian[1, 1] = north * per_horizontal2, -east * per_horizontal2
    jacobian[2, 0], jacobian[2, 1] = -east * steepening, -north * steepening
    jacobian[2, 2] = -horizontal / slant2
    jacobian[0, 5] = jacobian[1, 3] = 1.0
    jacobian[2, 4] = -1.0  # a positive pitch error looks too high, so the measured depression is too small


@compiled
def _linearized(
    seen: Seen, middle: FloatArray, place_variance_m2: float, residual: FloatArray, jacobian: FloatArray
) -> None:
    """Hold a sighting against the common mean (N,): fill in residual (3,) and derivative (3, 6).

    The derivative is taken where the filter expects the target, because taken at the noisy measurement it would
    correlate with the noise and pull the biases away; but where the filter knows far less than the sighting, it is
    taken where the sighting puts the target.
    """
    yaw, pitch, offset = middle[YAW], middle[PITCH], middle[RANGE]
    curved_m = _CURVED_BEYOND * seen.slant_range_m
    if not seen.is_fix and place_variance_m2 > curved_m * curved_m:
        sin_b, cos_b = math.sin(seen.bearing_rad), math.cos(seen.bearing_rad)
        sin_d, cos_d = math.sin(seen.depression_rad), math.cos(seen.depression_rad)
        slant = seen.slant_range_m
        across, down = slant * cos_d * yaw, slant * sin_d * pitch
        east = seen.aircraft_east_m + (slant - offset) * cos_d * sin_b - across * cos_b - down * sin_b
        north = seen.aircraft_north_m + (slant - offset) * cos_d * cos_b + across * sin_b - down * cos_b
        height = seen.aircraft_height_m - (slant - offset) * sin_d - slant * cos_d * pitch
        _compared(seen, east, north, height, residual, jacobian)
        for i in range(3):
            residual[i] += (
                jacobian[i, 0] * (east - middle[EAST])
                + jacobian[i, 1] * (north - middle[NORTH])
                + jacobian[i, 2] * (height - middle[HEIGHT])
            )
    else:
        _compared(seen, middle[EAST], middle[NORTH], middle[HEIGHT], residual, jacobian)
    if not seen.is_fix:
        residual[0] -= offset
        residual[1] -= yaw
        residual[2] += pitch


@compiled
def _inverted(a: FloatArray, found: FloatArray) -> float:
    """Fill in the inverse of a symmetric (3, 3) and return the determinant."""
    c0, c1, c2 = (
        a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2],
        a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2],
        a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1],
    )
    determinant = a[0, 0] * c0 + a[0, 1] * c1 + a[0, 2] * c2
    found[0, 0] = c0 / determinant
    found[0, 1] = found[1, 0] = c1 / determinant
    found[0, 2] = found[2, 0] = c2 / determinant
    found[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]) / determinant
    found[1, 2] = found[2, 1] = (a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]) / determinant
    found[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]) / determinant
    return float(determinant)


@compiled
def _squared(residual: FloatArray, inverse: FloatArray) -> float:
    total = 0.0
    for i in range(3):
        for k in range(3):
            total += residual[i] * inverse[i, k] * residual[k]
    return total


@compiled
def update(state: FloatArray, seen: Seen, gate_nis: float, soft_nis: float) -> float:
    """Take a sighting into the state, in place, unless it lies beyond the gate; return its NIS.

    Between ``soft_nis`` and the gate it weighs less the farther it lies (Huber).
    """
    middle = np.zeros(N)
    place_variance_m2 = 0.0
    for model in range(_MODELS):
        chance = state[model, PROBABILITY]
        for a in range(N):
            middle[a] += chance * state[model, MEAN + a]
        place_variance_m2 += chance * (state[model, COVARIANCE] + state[model, COVARIANCE + N + 1])
    residual, jacobian = np.empty(3), np.empty((3, 6))
    _linearized(seen, middle, place_variance_m2, residual, jacobian)

    noise = (seen.range_variance_m2, seen.bearing_variance_rad2, seen.depression_variance_rad2)
    residuals, cross = np.empty((_MODELS, 3)), np.empty((_MODELS, 3, N))
    expected, spread, inverse = np.empty((_MODELS, 3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    for model in range(_MODELS):
        p = state[model, COVARIANCE:].reshape(N, N)
        for i in range(3):
            off = 0.0
            for k in range(6):
                off += jacobian[i, k] * (state[model, MEAN + _SEEN[k]] - middle[_SEEN[k]])
            residuals[model, i] = residual[i] - off
            j0, j1, j2, j3, j4, j5 = (
                jacobian[i, 0],
                jacobian[i, 1],
                jacobian[i, 2],
                jacobian[i, 3],
                jacobian[i, 4],
                jacobian[i, 5],
            )
            for a in range(N):
                cross[model, i, a] = (
                    j0 * p[EAST, a]
                    + j1 * p[NORTH, a]
                    + j2 * p[HEIGHT, a]
                    + j3 * p[YAW, a]
                    + j4 * p[PITCH, a]
                    + j5 * p[RANGE, a]
                )
        chance = state[model, PROBABILITY]
        for i in range(3):
            for k in range(i, 3):
                value = 0.0
                for s in range(6):
                    value += jacobian[i, s] * cross[model, k, _SEEN[s]]
                expected[model, i, k] = expected[model, k, i] = value
                apart = (residuals[model, i] - residual[i]) * (residuals[model, k] - residual[k])
                spread[i, k] += chance * (value + apart)
                spread[k, i] = spread[i, k]
    for i in range(3):
        spread[i, i] += noise[i]
    _inverted(spread, inverse)
    nis = _squared(residual, inverse)
    if nis > gate_nis:
        return nis

    softening = max(1.0, math.sqrt(nis / soft_nis))
    distances, likelihoods = np.empty(_MODELS), np.empty(_MODELS)
    for model in range(_MODELS):
        for i in range(3):
            expected[model, i, i] += softening * noise[i]
        determinant = _inverted(expected[model], inverse)
        distances[model] = _squared(residuals[model], inverse)
        likelihoods[model] = 1.0 / math.sqrt(determinant)
        p = state[model, COVARIANCE:].reshape(N, N)
        c = cross[model]
        for a in range(N):
            g0 = c[0, a] * inverse[0, 0] + c[1, a] * inverse[0, 1] + c[2, a] * inverse[0, 2]
            g1 = c[0, a] * inverse[0, 1] + c[1, a] * inverse[1, 1] + c[2, a] * inverse[1, 2]
            g2 = c[0, a] * inverse[0, 2] + c[1, a] * inverse[1, 2] + c[2, a] * inverse[2, 2]
            state[model, MEAN + a] += g0 * residuals[model, 0] + g1 * residuals[model, 1] + g2 * residuals[model, 2]
            for b in range(N):
                p[a, b] -= g0 * c[0, b] + g1 * c[1, b] + g2 * c[2, b]
        for a in range(N):
            for b in range(a):
                p[a, b] = p[b, a] = 0.5 * (p[a, b] + p[b, a])
    nearest, total = distances.min(), 0.0
    for model in range(_MODELS):
        state[model, PROBABILITY] *= math.exp(-0.5 * (distances[model] - nearest)) * likelihoods[model]
        total += state[model, PROBABILITY]
    for model in range(_MODELS):
        state[model, PROBABILITY] /= total
    return nis


@compiled
def combine(state: FloatArray, mean: FloatArray, covariance: FloatArray) -> None:
    """Fill in the mean (n,) and covariance (n, n) of all models together, of the first n <= N numbers."""
    n = len(mean)
    mean[:] = 0.0
    covariance[:] = 0.0
    for model in range(_MODELS):
        for a in range(n):
            mean[a] += state[model, PROBABILITY] * state[model, MEAN + a]
    for model in range(_MODELS):
        chance = state[model, PROBABILITY]
        for a in range(n):
            apart = state[model, MEAN + a] - mean[a]
            for b in range(n):
                other = state[model, MEAN + b] - mean[b]
                covariance[a, b] += chance * (state[model, COVARIANCE + a * N + b] + apart * other)
