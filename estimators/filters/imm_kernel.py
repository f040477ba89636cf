"""The interacting multiple model filter as compiled functions on one array.

The state is an array (models, 1 + n + n * n). A row is one motion model: its probability, its mean (n,) and its
covariance (n, n). The first TARGET numbers of a mean describe the target: position in the local plane, velocity,
height of its ground, and turn rate (clockwise). Then come the constant errors of each payload: yaw, pitch and range,
and, in a filter of several payloads, by how much the payload's clock is ahead. An error without variance keeps its
value.

Each motion touches few numbers of the covariance; these are written out instead of multiplying by matrices.

A target stands on the ground as far as that is known. Its height is off the elevation data by an offset: the data's
own error, and what they do not resolve. Along the target's path the offset is a Gauss-Markov process of the data's
standard deviation. Sightings with a range determine it. From one sighting to the next it stays while the height
follows the ground; without a laser the line of sight alone then determines the position. The filter's own arithmetic
does not change: its Gaussians are turned into offset and back around each prediction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled, inner
from sidelong.estimators.terrain.ground_kernel import Grid, height_and_slope, height_sigma_m

FloatArray = npt.NDArray[np.float64]

STANDING, CRUISING, TURNING, MANOEUVRING = MODELS = range(4)
EAST, NORTH, VELOCITY_E, VELOCITY_N, HEIGHT, TURN = range(6)
TARGET = 6
ERRORS, ERRORS_AND_CLOCK = 3, 4  # numbers of one payload

HEIGHT_DENSITY_M2_S = 0.02  # the ground under a target that drives up and down gentle hills
SHUFFLE_SIGMA_M_S = 0.05
TURN_SIGMA_RAD_S = 0.25
TURN_DRIFT_RAD2_S3 = 1e-4
# A calibration that may drift never closes for good. A motion that no model describes is attributed to the payload,
# mostly to its yaw: without a drift of 0.25 degrees in 1,000 s the calibration would be sure of that.
ERROR_DRIFT_PER_S = (2e-8, 1e-10, 1e-7)  # variance that yaw, pitch and range errors gain

# How often one kind of motion gives way to another, 1/s, from row to column. At half as many manoeuvres, recorded
# cyclists' small swerves passed for errors of the gimbal.
_SWITCH_RATES_PER_S = np.array(
    [
        [0.0, 0.005, 0.002, 0.08],
        [0.002, 0.0, 0.003, 0.04],
        [0.002, 0.005, 0.0, 0.02],
        [0.1, 0.15, 0.1, 0.0],
    ]
)
GENERATOR = _SWITCH_RATES_PER_S - np.diag(_SWITCH_RATES_PER_S.sum(axis=1))
GENERATOR_SQUARED = GENERATOR @ GENERATOR
_MODELS = len(MODELS)
# Where the position is known worse than this part of the range, a bearing's curvature shows: 0.3 m at three sigma.
_CURVED_BEYOND = 0.015
# How far the target goes until little is left of what was learnt of the offset. Errors of elevation data change
# sooner. But if the offset may change that quickly, its changes are attributed to the target's motion when the laser
# is out: after a minute the 95 % ellipse then contains 87 %.
_CORRELATION_M = 1000.0


class Seen(NamedTuple):
    """A sighting: its three numbers with their variances. The first two numbers of a fix are (east, north)."""

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
def compared(
    seen: Seen, east_m: float, north_m: float, height_m: float, residual: FloatArray, jacobian: FloatArray
) -> None:
    """Fill in measured minus expected (3,) of a target at a position, and the derivative (3, 6) of the expected.

    That is by (east, north, height, yaw error, pitch error, range error).
    """
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
    residual[1] = off_rad - math.tau * math.floor((off_rad + math.pi) / math.tau)
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


@inner
def linearized(
    seen: Seen,
    position: tuple[float, float, float],
    errors: tuple[float, float, float],
    position_variance_m2: float,
    residual: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Fill in residual (3,) and derivative (3, 6), see :func:`compared`, for a filter's mean.

    The derivative is taken where the filter expects the target. Taken at the noisy measurement it would correlate
    with the noise and pull the estimated errors away. Only where the filter knows far less than the sighting, it is
    taken where the sighting puts the target. position: (east, north, height), with the variance of east plus that of
    north; errors: yaw, pitch, range.
    """
    yaw, pitch, offset = errors
    curved_m = _CURVED_BEYOND * seen.slant_range_m
    if not seen.is_fix and position_variance_m2 > max(curved_m * curved_m, seen.range_variance_m2):
        bearing, depression, slant = seen.bearing_rad - yaw, seen.depression_rad + pitch, seen.slant_range_m - offset
        east = seen.aircraft_east_m + slant * math.cos(depression) * math.sin(bearing)
        north = seen.aircraft_north_m + slant * math.cos(depression) * math.cos(bearing)
        height = seen.aircraft_height_m - slant * math.sin(depression)
        compared(seen, east, north, height, residual, jacobian)
        for i in range(3):
            residual[i] += (
                jacobian[i, 0] * (east - position[0])
                + jacobian[i, 1] * (north - position[1])
                + jacobian[i, 2] * (height - position[2])
            )
    else:
        compared(seen, position[0], position[1], position[2], residual, jacobian)
    if not seen.is_fix:
        residual[0] -= offset
        residual[1] -= yaw
        residual[2] += pitch


class Densities(NamedTuple):
    """Process noise: white acceleration cruising and manoeuvring, random walk standing and of the height."""

    cruise_m2_s3: float
    manoeuvre_m2_s3: float
    shuffle_m2_s: float
    height_m2_s: float = HEIGHT_DENSITY_M2_S


@compiled
def numbers_of(state: FloatArray) -> int:
    """Return n, the length of each model's mean."""
    return int((math.sqrt(4.0 * state.shape[1] - 3.0) - 1.0) / 2.0 + 0.5)


@compiled
def errors_of(payload: int, n: int) -> tuple[int, int]:
    """Return where the errors of a payload begin in a mean of n numbers, and how many there are."""
    block = ERRORS if n == TARGET + ERRORS else ERRORS_AND_CLOCK
    return TARGET + block * payload, block


@inner
def mean_of(state: FloatArray, n: int) -> tuple[FloatArray, float]:
    """Return the common mean (n,), and the models' mean variance of the position, both axes together."""
    middle, variance_m2 = np.zeros(n), 0.0
    for model in range(len(state)):
        chance = state[model, 0]
        for a in range(n):
            middle[a] += chance * state[model, 1 + a]
        variance_m2 += chance * (state[model, 1 + n] + state[model, 1 + n + n + 1])
    return middle, variance_m2


@inner
def switch_probability(step_s: float, before: int, after: int) -> float:
    """Return the chance of being in one motion ``step_s`` after another; step <= 1 s."""
    same = 1.0 if before == after else 0.0
    return float(
        same + GENERATOR[before, after] * step_s + GENERATOR_SQUARED[before, after] * (0.5 * step_s * step_s)
    )


@inner
def mix(state: FloatArray, n: int, step_s: float, found: FloatArray) -> None:
    """Do the IMM's mixing: fill in each model's initial state for the step, and predict the models' probabilities."""
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
        for a in range(n):
            a0, a1, a2, a3 = w0 * apart[0, a], w1 * apart[1, a], w2 * apart[2, a], w3 * apart[3, a]
            row = 1 + n + a * n
            for b in range(n):
                found[model, row + b] += a0 * apart[0, b] + a1 * apart[1, b] + a2 * apart[2, b] + a3 * apart[3, b]


@compiled
def move(model: int, mean: FloatArray, p: FloatArray, step_s: float, densities: Densities) -> None:
    """Predict a model's mean (n,) and covariance (n, n) by ``step_s``, in place."""
    n = len(mean)
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
    p[HEIGHT, HEIGHT] += densities.height_m2_s * step_s
    p[TURN, TURN] += TURN_DRIFT_RAD2_S3 * step_s if model == TURNING else TURN_SIGMA_RAD_S**2
    if model == STANDING:
        for place, velocity in ((EAST, VELOCITY_E), (NORTH, VELOCITY_N)):
            p[place, place] += densities.shuffle_m2_s * step_s
            p[velocity, velocity] += SHUFFLE_SIGMA_M_S**2
    else:
        density = densities.manoeuvre_m2_s3 if model == MANOEUVRING else densities.cruise_m2_s3
        for place, velocity in ((EAST, VELOCITY_E), (NORTH, VELOCITY_N)):
            p[place, place] += density * step_s * step_s * step_s / 3.0
            p[place, velocity] += density * step_s * step_s / 2.0
            p[velocity, place] += density * step_s * step_s / 2.0
            p[velocity, velocity] += density * step_s


@inner
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
    _turn_rows(p, ahead, aside, cos_a, sin_a, by_rate)
    _turn_rows(p.T, ahead, aside, cos_a, sin_a, by_rate)


@inner
def _turn_rows(
    p: FloatArray, ahead: float, aside: float, cos_a: float, sin_a: float, by_rate: tuple[float, float, float, float]
) -> None:
    for k in range(len(p)):
        e, v, r = p[VELOCITY_E, k], p[VELOCITY_N, k], p[TURN, k]
        p[EAST, k] += ahead * e + aside * v + by_rate[0] * r
        p[NORTH, k] += ahead * v - aside * e + by_rate[1] * r
        p[VELOCITY_E, k] = cos_a * e + sin_a * v + by_rate[2] * r
        p[VELOCITY_N, k] = cos_a * v - sin_a * e + by_rate[3] * r


@inner
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


@inner
def _squared(residual: FloatArray, inverse: FloatArray) -> float:
    total = 0.0
    for i in range(3):
        for k in range(3):
            total += residual[i] * inverse[i, k] * residual[k]
    return total


@compiled
def take_in(
    state: FloatArray,
    middle: FloatArray,
    residual: FloatArray,
    jacobian: FloatArray,
    columns: tuple[int, ...],
    noise: tuple[float, float, float],
    gate_nis: float,
    soft_nis: float,
) -> float:
    """Take a measurement of three numbers into the state unless it lies beyond the gate; return its NIS.

    residual (3,), jacobian (3, c): measured minus expected at ``middle``, and the derivative by the state's numbers
    ``columns``; the models share it. noise: variances. Between soft_nis and the gate it weighs less the farther it
    lies (Huber).
    """
    n = len(middle)
    residuals, cross = np.empty((len(state), 3)), np.zeros((len(state), 3, n))
    expected, spread, inverse = np.empty((len(state), 3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    for model in range(len(state)):
        p, chance = state[model, 1 + n :].reshape(n, n), state[model, 0]
        for i in range(3):
            off = 0.0
            for k in range(len(columns)):
                by = jacobian[i, k]
                off += by * (state[model, 1 + columns[k]] - middle[columns[k]])
                if by != 0.0:
                    for a in range(n):
                        cross[model, i, a] += by * p[columns[k], a]
            residuals[model, i] = residual[i] - off
        for i in range(3):
            for k in range(i, 3):
                value = 0.0
                for s in range(len(columns)):
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
    distances, likelihoods = np.empty(len(state)), np.empty(len(state))
    for model in range(len(state)):
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
    nearest, total = np.inf, 0.0
    for model in range(len(state)):
        nearest = min(nearest, distances[model])
    for model in range(len(state)):
        state[model, 0] *= math.exp(-0.5 * (distances[model] - nearest)) * likelihoods[model]
        total += state[model, 0]
    for model in range(len(state)):
        state[model, 0] /= total
    return nis


@compiled
def combine(state: FloatArray, mean: FloatArray, covariance: FloatArray) -> None:
    """Fill in the mean (k,) and covariance (k, k) of all models together, of the first k <= n numbers."""
    n, size = numbers_of(state), len(mean)
    mean[:] = 0.0
    covariance[:] = 0.0
    for model in range(len(state)):
        for a in range(size):
            mean[a] += state[model, 0] * state[model, 1 + a]
    for model in range(len(state)):
        chance = state[model, 0]
        for a in range(size):
            apart = state[model, 1 + a] - mean[a]
            for b in range(size):
                other = state[model, 1 + b] - mean[b]
                covariance[a, b] += chance * (state[model, 1 + n + a * n + b] + apart * other)


@compiled
def predict(state: FloatArray, step_s: float, densities: Densities, found: FloatArray) -> None:
    """Fill in the state ``step_s`` later."""
    n = numbers_of(state)
    mix(state, n, step_s, found)
    for model in range(len(found)):
        p = found[model, 1 + n :].reshape(n, n)
        move(model, found[model, 1 : 1 + n], p, step_s, densities)
        first, block = errors_of(0, n)
        for error in range(first, n, block):
            for i in range(ERRORS):
                if p[error + i, error + i] > 0.0:
                    p[error + i, error + i] += ERROR_DRIFT_PER_S[i] * step_s


@compiled
def innovation(state: FloatArray, payload: int, seen: Seen) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the common mean (n,), and residual (3,) and derivative (3, 7) of a payload's sighting there.

    The derivative is by east, north, height, the payload's errors and its clock. A payload whose clock is ahead
    stamps a sighting too late: the target was where it comes from.
    """
    n = numbers_of(state)
    middle, variance_m2 = mean_of(state, n)
    first, block = errors_of(payload, n)
    east_m, north_m = middle[EAST], middle[NORTH]
    if block == ERRORS_AND_CLOCK:
        ahead_s = middle[first + ERRORS]
        east_m, north_m = east_m - ahead_s * middle[VELOCITY_E], north_m - ahead_s * middle[VELOCITY_N]
    errors = (middle[first], middle[first + 1], middle[first + 2])
    residual, jacobian = np.empty(3), np.empty((3, 7))
    linearized(seen, (east_m, north_m, middle[HEIGHT]), errors, variance_m2, residual, jacobian)
    for i in range(3):
        jacobian[i, 6] = -(jacobian[i, 0] * middle[VELOCITY_E] + jacobian[i, 1] * middle[VELOCITY_N])
    return middle, residual, jacobian


@compiled
def update(state: FloatArray, payload: int, seen: Seen, gate_nis: float, soft_nis: float) -> float:
    """Take a payload's sighting into the state unless it lies beyond the gate; return its NIS."""
    middle, residual, jacobian = innovation(state, payload, seen)
    first, block = errors_of(payload, len(middle))
    noise = (seen.range_variance_m2, seen.bearing_variance_rad2, seen.depression_variance_rad2)
    columns = (EAST, NORTH, HEIGHT, first, first + 1, first + 2)
    if block == ERRORS:
        return take_in(state, middle, residual, jacobian, columns, noise, gate_nis, soft_nis)
    columns_and_clock = (EAST, NORTH, HEIGHT, first, first + 1, first + 2, first + ERRORS)
    return take_in(state, middle, residual, jacobian, columns_and_clock, noise, gate_nis, soft_nis)


@compiled
def begin_standing(mean: FloatArray, covariance: FloatArray, grid: Grid, sigma_m: float) -> None:
    """Let a first mean (n,) and covariance (n, n) stand on the ground, in place, if that is known there."""
    ground_m, slope_east, slope_north = height_and_slope(grid, mean[EAST], mean[NORTH])
    if math.isnan(ground_m):
        return
    n, sigma_m = len(mean), height_sigma_m(sigma_m, min(grid[3], grid[4]), slope_east, slope_north)
    cross = np.empty(n)
    for k in range(n):
        cross[k] = covariance[k, HEIGHT] - slope_east * covariance[k, EAST] - slope_north * covariance[k, NORTH]
    spread = cross[HEIGHT] - slope_east * cross[EAST] - slope_north * cross[NORTH] + sigma_m * sigma_m
    residual = ground_m - mean[HEIGHT]
    for i in range(n):
        mean[i] += cross[i] * residual / spread
        for k in range(n):
            covariance[i, k] -= cross[i] * cross[k] / spread


@compiled
def kept_offset(mean: FloatArray, covariance: FloatArray, step_s: float) -> float:
    """Return the share 0..1 of the ground's height offset that a step keeps; moments of the target (4,), (4, 4)."""
    e, n = VELOCITY_E, VELOCITY_N
    speed_m_s = math.sqrt(mean[e] * mean[e] + mean[n] * mean[n] + covariance[e, e] + covariance[n, n])
    return math.exp(-speed_m_s * step_s / _CORRELATION_M)


@compiled
def _lean(
    state: FloatArray, slope_east: float, slope_north: float, kept: float, shift_m: float, variance_m2: float
) -> None:
    """Turn each model's height h into kept h + slopes times the place + shift, with a variance added."""
    n = numbers_of(state)
    for model in range(len(state)):
        mean, p = state[model, 1 : 1 + n], state[model, 1 + n :].reshape(n, n)
        mean[HEIGHT] = kept * mean[HEIGHT] + slope_east * mean[EAST] + slope_north * mean[NORTH] + shift_m
        for k in range(n):
            p[HEIGHT, k] = kept * p[HEIGHT, k] + slope_east * p[EAST, k] + slope_north * p[NORTH, k]
        for k in range(n):
            p[k, HEIGHT] = kept * p[k, HEIGHT] + slope_east * p[k, EAST] + slope_north * p[k, NORTH]
        p[HEIGHT, HEIGHT] += variance_m2


@compiled
def predict_standing(
    state: FloatArray,
    step_s: float,
    densities: Densities,
    grid: Grid,
    sigma_m: float,
    found: FloatArray,
) -> None:
    """Fill in the state ``step_s`` later. sigma_m: standard deviation of the heights of the grid."""
    mean, covariance = np.empty(4), np.zeros((4, 4))
    combine(state, mean, covariance)
    east_m, north_m = mean[EAST], mean[NORTH]
    ground_m, slope_east, slope_north = height_and_slope(grid, east_m, north_m)
    if math.isnan(ground_m):
        predict(state, step_s, densities, found)
        return
    offset = state.copy()
    shift_m = slope_east * east_m + slope_north * north_m - ground_m
    _lean(offset, -slope_east, -slope_north, 1.0, shift_m, 0.0)
    still = Densities(densities.cruise_m2_s3, densities.manoeuvre_m2_s3, densities.shuffle_m2_s, 0.0)
    predict(offset, step_s, still, found)
    kept = kept_offset(mean, covariance, step_s)
    combine(found, mean, covariance)
    after_m, east, north = height_and_slope(grid, mean[EAST], mean[NORTH])
    if not math.isnan(after_m):
        ground_m, slope_east, slope_north, east_m, north_m = after_m, east, north, mean[EAST], mean[NORTH]
    sigma_m = height_sigma_m(sigma_m, min(grid[3], grid[4]), slope_east, slope_north)
    shift_m = ground_m - slope_east * east_m - slope_north * north_m
    _lean(found, slope_east, slope_north, kept, shift_m, (1.0 - kept * kept) * sigma_m * sigma_m)
