"""The inner loops over lines above the ground.

``highest`` (rows, columns) is the highest ground about each cell of an elevation grid, infinite where not known;
``grid`` is as in :mod:`sidelong.estimators.terrain.ground_kernel`.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled
from sidelong.estimators.terrain.ground_kernel import FloatArray, Grid, height_and_slope

Raster = npt.NDArray[np.float32]

_STEP_MAX_M = 10.0


@compiled
def highest_at(highest: Raster, grid: Grid, east_m: float, north_m: float) -> float:
    """Return the highest ground about a place."""
    _, west_m, south_m, step_east_m, step_north_m = grid
    x, y = (east_m - west_m) / step_east_m, (north_m - south_m) / step_north_m
    rows, columns = highest.shape
    if not (0.0 <= x < columns and 0.0 <= y < rows):
        return math.inf
    return float(highest[int(y), int(x)])


@compiled
def highest_along(highest: Raster, grid: Grid, east_m: FloatArray, north_m: FloatArray) -> float:
    """Return the highest ground about a line (n,)."""
    found_m = highest_at(highest, grid, east_m[0], north_m[0])
    for i in range(1, east_m.size):
        east_step_m, north_step_m = east_m[i] - east_m[i - 1], north_m[i] - north_m[i - 1]
        steps = max(1, math.ceil(math.hypot(east_step_m, north_step_m) / _STEP_MAX_M))
        for k in range(1, steps + 1):
            u = k / steps
            there_m = highest_at(highest, grid, east_m[i - 1] + u * east_step_m, north_m[i - 1] + u * north_step_m)
            found_m = max(found_m, there_m)
    return found_m


@compiled
def climbing_clearance_m(
    highest: Raster,
    grid: Grid,
    east_m: FloatArray,
    north_m: FloatArray,
    arc_m: FloatArray,
    from_m: float,
    to_m: float,
    slope: float,
) -> float:
    """Return the least height above the ground about a line (n,) that is climbed along, until all is climbed."""
    clearance_m = math.inf
    for i in range(east_m.size):
        # The autopilot may begin its climb late by a sample; before the line it has not begun.
        height_m = min(from_m + slope * arc_m[max(i - 1, 0)], to_m)
        clearance_m = min(clearance_m, height_m - highest_at(highest, grid, east_m[i], north_m[i]))
        if height_m >= to_m:
            break
    return clearance_m


@compiled
def mean_height(grid: Grid, east_m: FloatArray, north_m: FloatArray) -> float:
    """Return the mean height of the ground at places (n,); NaN if any is not known."""
    total_m = 0.0
    for i in range(east_m.size):
        total_m += height_and_slope(grid, east_m[i], north_m[i])[0]
    return total_m / east_m.size
