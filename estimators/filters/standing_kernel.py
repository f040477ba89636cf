"""A target that stands on the ground, as far as the ground is known.

The state's height is that of the target's ground. It is off the elevation data by an offset: the data's own error,
and what they do not resolve. Along the target's path the offset is a Gauss-Markov process of the data's standard
deviation: sightings with a range determine it, and after a kilometre little of that is left. From one sighting to the
next the offset stays while the height follows the ground; without a laser the line of sight alone then determines the
position.

The filter's own arithmetic does not change: its Gaussians are turned into offset and back around each prediction.
"""

from __future__ import annotations

import math

import numpy as np

from sidelong.estimators.compiled import compiled
from sidelong.estimators.filters.imm_kernel import (
    EAST,
    HEIGHT,
    NORTH,
    VELOCITY_E,
    VELOCITY_N,
    Densities,
    combine,
    numbers_of,
    predict,
)
from sidelong.estimators.filters.measurement_kernel import FloatArray
from sidelong.estimators.terrain.ground_kernel import Grid, height_and_slope, height_sigma_m

# How far the target goes until little is left of what was learnt of the offset. Errors of elevation data change
# sooner. But if the offset may change that quickly, its changes are attributed to the target's motion when the laser
# is out: after a minute the 95 % ellipse then contains 87 %.
_CORRELATION_M = 1000.0


@compiled
def begin_standing(mean: FloatArray, covariance: FloatArray, grid: Grid, sigma_m: float) -> None:
    """Let a first mean (n,) and covariance (n, n) stand on the ground, in place, if it is known there."""
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
    """Return the part of the offset that is left after a step of a target with moments (4,), (4, 4)."""
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
