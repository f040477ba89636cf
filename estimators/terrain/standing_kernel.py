"""The inner loops of :mod:`sidelong.estimators.terrain.standing` for the interacting multiple model filter."""

from __future__ import annotations

import math

import numpy as np

from sidelong.estimators.compiled import compiled
from sidelong.estimators.filters.imm_kernel import COVARIANCE, MEAN, N, predict
from sidelong.estimators.filters.mixture_kernel import (
    EAST,
    HEIGHT,
    NORTH,
    VELOCITY_E,
    VELOCITY_N,
    Densities,
    FloatArray,
    combine,
)
from sidelong.estimators.terrain.ground_kernel import Grid, height_and_slope, height_sigma_m

# How far the target goes until little is left of what was learnt of the offset. Errors of elevation data change
# sooner, but where the offset may change so quickly, a line of sight alone is taken for motion that is none: with the
# laser out for a minute the ellipse then holds 87 %.
_CORRELATION_M = 1000.0


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
    for model in range(len(state)):
        mean, p = state[model, MEAN:COVARIANCE], state[model, COVARIANCE:].reshape(N, N)
        mean[HEIGHT] = kept * mean[HEIGHT] + slope_east * mean[EAST] + slope_north * mean[NORTH] + shift_m
        for k in range(N):
            p[HEIGHT, k] = kept * p[HEIGHT, k] + slope_east * p[EAST, k] + slope_north * p[NORTH, k]
        for k in range(N):
            p[k, HEIGHT] = kept * p[k, HEIGHT] + slope_east * p[k, EAST] + slope_north * p[k, NORTH]
        p[HEIGHT, HEIGHT] += variance_m2


@compiled
def predict_standing(
    state: FloatArray,
    step_s: float,
    densities: Densities,
    drift_per_s: tuple[float, float, float],
    grid: Grid,
    sigma_m: float,
    found: FloatArray,
) -> None:
    """Fill in the state ``step_s`` later, as :meth:`estimators.terrain.standing.GroundedFilter.predict` has it.

    sigma_m: of the heights of the grid.
    """
    mean, covariance = np.empty(4), np.zeros((4, 4))
    combine(state, mean, covariance)
    east_m, north_m = mean[EAST], mean[NORTH]
    ground_m, slope_east, slope_north = height_and_slope(grid, east_m, north_m)
    if math.isnan(ground_m):
        predict(state, step_s, densities, drift_per_s, found)
        return
    offset = state.copy()
    shift_m = slope_east * east_m + slope_north * north_m - ground_m
    _lean(offset, -slope_east, -slope_north, 1.0, shift_m, 0.0)
    predict(offset, step_s, densities, drift_per_s, found)
    kept = kept_offset(mean, covariance, step_s)
    combine(found, mean, covariance)
    after_m, east, north = height_and_slope(grid, mean[EAST], mean[NORTH])
    if not math.isnan(after_m):
        ground_m, slope_east, slope_north, east_m, north_m = after_m, east, north, mean[EAST], mean[NORTH]
    sigma_m = height_sigma_m(sigma_m, min(grid[3], grid[4]), slope_east, slope_north)
    shift_m = ground_m - slope_east * east_m - slope_north * north_m
    _lean(found, slope_east, slope_north, kept, shift_m, (1.0 - kept * kept) * sigma_m * sigma_m)
