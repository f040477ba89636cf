"""The inner loops of :mod:`estimators.joint`: one target, several payloads, each with constant errors of its own.

The state is one array (models, 1 + n + n * n) as in :mod:`estimators._imm_kernel`: of each model its probability, its
mean (n,) and its covariance (n, n). The first NUMBERS of the n are the target's; then come BLOCK for each payload:
its yaw, pitch and range errors, and by how much its clock is ahead. An error without variance keeps its value.
"""

from __future__ import annotations

import math

import numpy as np

from estimators._imm_kernel import (
    HEIGHT_DENSITY_M2_S,
    MANOEUVRING,
    SHUFFLE_SIGMA_M_S,
    STANDING,
    TURN_DRIFT_RAD2_S3,
    TURN_SIGMA_RAD_S,
    TURNING,
    Densities,
    FloatArray,
    Seen,
    _inverted,
    _linearized,
    _squared,
    switch_probability,
)
from estimators._imm_kernel import N as _SINGLE
from estimators.compiled import compiled

EAST, NORTH, VELOCITY_E, VELOCITY_N, HEIGHT, TURN = range(6)
NUMBERS, BLOCK = 6, 4
_MODELS = 4


@compiled
def numbers_of(state: FloatArray) -> int:
    """Return n, how many numbers each model's mean has."""
    return int((math.sqrt(4.0 * state.shape[1] - 3.0) - 1.0) / 2.0 + 0.5)


@compiled
def predict(
    state: FloatArray, step_s: float, densities: Densities, drift_per_s: tuple[float, float, float], found: FloatArray
) -> None:
    """Fill in the state step_s (<= 1) later. drift_per_s: what the variances of yaw, pitch and range errors gain."""
    n = numbers_of(state)
    _mix(state, n, step_s, found)
    for model in range(_MODELS):
        mean, p = found[model, 1 : 1 + n], found[model, 1 + n :].reshape(n, n)
        if model == TURNING:
            _turn(mean, p, step_s)
        else:
            mean[TURN] = 0.0
            p[TURN, :] = 0.0
            p[:, TURN] = 0.0
            if model == STANDING:
                for axis in (VELOCITY_E, VELOCITY_N):
                    mean[axis] = 0.0
                    p[axis, :] = 0.0
                    p[:, axis] = 0.0
            else:
                for place, velocity in ((EAST, VELOCITY_E), (NORTH, VELOCITY_N)):
                    mean[place] += step_s * mean[velocity]
                    for k in range(n):
                        p[place, k] += step_s * p[velocity, k]
                for place, velocity in ((EAST, VELOCITY_E), (NORTH, VELOCITY_N)):
                    for k in range(n):
                        p[k, place] += step_s * p[k, velocity]
        p[HEIGHT, HEIGHT] += HEIGHT_DENSITY_M2_S * step_s
        p[TURN, TURN] += TURN_DRIFT_RAD2_S3 * step_s if model == TURNING else TURN_SIGMA_RAD_S**2
        for first in range(NUMBERS, n, BLOCK):
            for i in range(3):
                if p[first + i, first + i] > 0.0:
                    p[first + i, first + i] += drift_per_s[i] * step_s
        if model == STANDING:
            p[EAST, EAST] += densities.shuffle_m2_s * step_s
            p[NORTH, NORTH] += densities.shuffle_m2_s * step_s
            p[VELOCITY_E, VELOCITY_E] += SHUFFLE_SIGMA_M_S**2
            p[VELOCITY_N, VELOCITY_N] += SHUFFLE_SIGMA_M_S**2
        else:
            density = densities.manoeuvre_m2_s3 if model == MANOEUVRING else densities.cruise_m2_s3
            for place, velocity in ((EAST, VELOCITY_E), (NORTH, VELOCITY_N)):
                p[place, place] += density * step_s * step_s * step_s / 3.0
                p[place, velocity] += density * step_s * step_s / 2.0
                p[velocity, place] += density * step_s * step_s / 2.0
                p[velocity, velocity] += density * step_s


@compiled
def _mix(state: FloatArray, n: int, step_s: float, found: FloatArray) -> None:
    """Fill in what each model starts the step from, and move the probabilities on."""
    weights, apart = np.empty(_MODELS), np.empty((_MODELS, n))
    for model in range(_MODELS):
        probability = 0.0
        for before in range(_MODELS):
            weights[before] = state[before, 0] * switch_probability(step_s, before, model)
            probability += weights[before]
        weights /= probability
        w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
        for k in range(1, state.shape[1]):
            found[model, k] = w0 * state[0, k] + w1 * state[1, k] + w2 * state[2, k] + w3 * state[3, k]
        found[model, 0] = probability
        for before in range(_MODELS):
            for a in range(n):
                apart[before, a] = state[before, 1 + a] - found[model, 1 + a]
        p = found[model, 1 + n :].reshape(n, n)
        for a in range(n):
            a0, a1, a2, a3 = w0 * apart[0, a], w1 * apart[1, a], w2 * apart[2, a], w3 * apart[3, a]
            for b in range(n):
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
    by_rate = (half * north, -half * east, step_s * north, -step_s * east)
    mean[EAST] += ahead * velocity_e + aside * velocity_n
    mean[NORTH] += ahead * velocity_n - aside * velocity_e
    mean[VELOCITY_E], mean[VELOCITY_N] = east, north
    n = len(mean)
    for k in range(n):
        e, v, r = p[VELOCITY_E, k], p[VELOCITY_N, k], p[TURN, k]
        p[EAST, k] += ahead * e + aside * v + by_rate[0] * r
        p[NORTH, k] += ahead * v - aside * e + by_rate[1] * r
        p[VELOCITY_E, k] = cos_a * e + sin_a * v + by_rate[2] * r
        p[VELOCITY_N, k] = cos_a * v - sin_a * e + by_rate[3] * r
    for k in range(n):
        e, v, r = p[k, VELOCITY_E], p[k, VELOCITY_N], p[k, TURN]
        p[k, EAST] += ahead * e + aside * v + by_rate[0] * r
        p[k, NORTH] += ahead * v - aside * e + by_rate[1] * r
        p[k, VELOCITY_E] = cos_a * e + sin_a * v + by_rate[2] * r
        p[k, VELOCITY_N] = cos_a * v - sin_a * e + by_rate[3] * r


@compiled
def update(state: FloatArray, payload: int, seen: Seen, gate_nis: float, soft_nis: float) -> float:
    """Take a payload's sighting into the state, in place, unless it lies beyond the gate; return its NIS.

    Between soft_nis and the gate it weighs less the farther it lies (Huber).
    """
    n = numbers_of(state)
    first = NUMBERS + BLOCK * payload
    middle, place_variance_m2 = np.zeros(n), 0.0
    for model in range(_MODELS):
        chance = state[model, 0]
        for a in range(n):
            middle[a] += chance * state[model, 1 + a]
        place_variance_m2 += chance * (state[model, 1 + n] + state[model, 1 + n + n + 1])
    residual, jacobian = _held_against(seen, middle, first, place_variance_m2)
    columns = (EAST, NORTH, HEIGHT, first, first + 1, first + 2, first + 3)

    noise = (seen.range_variance_m2, seen.bearing_variance_rad2, seen.depression_variance_rad2)
    residuals, cross = np.empty((_MODELS, 3)), np.zeros((_MODELS, 3, n))
    expected, spread, inverse = np.empty((_MODELS, 3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    for model in range(_MODELS):
        p, chance = state[model, 1 + n :].reshape(n, n), state[model, 0]
        for i in range(3):
            off = 0.0
            for k in range(7):
                by = jacobian[i, k]
                off += by * (state[model, 1 + columns[k]] - middle[columns[k]])
                if by != 0.0:
                    for a in range(n):
                        cross[model, i, a] += by * p[columns[k], a]
            residuals[model, i] = residual[i] - off
        for i in range(3):
            for k in range(i, 3):
                value = 0.0
                for s in range(7):
                    value += jacobian[i, s] * cross[model, k, columns[s]]
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
        p, c = state[model, 1 + n :].reshape(n, n), cross[model]
        for a in range(n):
            g0 = c[0, a] * inverse[0, 0] + c[1, a] * inverse[0, 1] + c[2, a] * inverse[0, 2]
            g1 = c[0, a] * inverse[0, 1] + c[1, a] * inverse[1, 1] + c[2, a] * inverse[1, 2]
            g2 = c[0, a] * inverse[0, 2] + c[1, a] * inverse[1, 2] + c[2, a] * inverse[2, 2]
            state[model, 1 + a] += g0 * residuals[model, 0] + g1 * residuals[model, 1] + g2 * residuals[model, 2]
            for b in range(n):
                p[a, b] -= g0 * c[0, b] + g1 * c[1, b] + g2 * c[2, b]
        for a in range(n):
            for b in range(a):
                p[a, b] = p[b, a] = 0.5 * (p[a, b] + p[b, a])
    nearest, total = distances.min(), 0.0
    for model in range(_MODELS):
        state[model, 0] *= math.exp(-0.5 * (distances[model] - nearest)) * likelihoods[model]
        total += state[model, 0]
    for model in range(_MODELS):
        state[model, 0] /= total
    return nis


@compiled
def _held_against(
    seen: Seen, middle: FloatArray, first: int, place_variance_m2: float
) -> tuple[FloatArray, FloatArray]:
    """Return measured minus expected (3,) and the derivative (3, 7) by place, errors and clock of the payload.

    A payload whose clock is ahead stamps a sighting later than it was: the target was where it comes from.
    """
    ahead_s = middle[first + 3]
    one = np.zeros(_SINGLE)
    one[0] = middle[EAST] - ahead_s * middle[VELOCITY_E]
    one[1] = middle[NORTH] - ahead_s * middle[VELOCITY_N]
    one[2], one[3], one[4] = middle[VELOCITY_E], middle[VELOCITY_N], middle[HEIGHT]
    for i in range(3):
        one[5 + i] = middle[first + i]
    residual, six, jacobian = np.empty(3), np.empty((3, 6)), np.zeros((3, 7))
    _linearized(seen, one, place_variance_m2, residual, six)
    for i in range(3):
        for k in range(6):
            jacobian[i, k] = six[i, k]
        jacobian[i, 6] = -(six[i, 0] * middle[VELOCITY_E] + six[i, 1] * middle[VELOCITY_N])
    return residual, jacobian


@compiled
def combine(state: FloatArray, mean: FloatArray, covariance: FloatArray) -> None:
    """Fill in the mean (k,) and covariance (k, k) of all models together, of the first k <= n numbers."""
    n, size = numbers_of(state), len(mean)
    mean[:] = 0.0
    covariance[:] = 0.0
    for model in range(_MODELS):
        for a in range(size):
            mean[a] += state[model, 0] * state[model, 1 + a]
    for model in range(_MODELS):
        chance = state[model, 0]
        for a in range(size):
            apart = state[model, 1 + a] - mean[a]
            for b in range(size):
                other = state[model, 1 + b] - mean[b]
                covariance[a, b] += chance * (state[model, 1 + n + a * n + b] + apart * other)
