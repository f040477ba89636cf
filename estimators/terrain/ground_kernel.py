"""The inner loops over an elevation grid.

A grid is (heights, west, south, step_east, step_north): posts (rows, columns), row 0 in the south, column 0 in the
west, NaN where the data is void. Between posts the height is bilinear; beyond the outermost it is NaN. ``highest``
(rows, columns) is the highest ground about each cell, infinite where it is unknown.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled, inner

FloatArray = npt.NDArray[np.float64]
Grid: TypeAlias = tuple[npt.NDArray[np.float32], float, float, float, float]

# Places in the data are off by about this part of a post's spacing; on a slope that is an error of height. Posts that
# are misplaced by 5 m, as those of SRTM, make it 0.17 at 30 m and 0.06 at 90 m; to interpolate between posts of real
# hills adds 0.1 at 90 to 0.2 at 360 m.
_MISPLACED = 0.15
_STEPS_PER_POST = 3.0
_BISECTIONS = 12  # of a step of some tens of metres: to a centimetre


@compiled
def height_and_slope(grid: Grid, east_m: float, north_m: float) -> tuple[float, float, float]:
    """Return height, and slope towards east and towards north; NaN where not known."""
    heights, west_m, south_m, step_east_m, step_north_m = grid
    rows, columns = heights.shape
    x, y = (east_m - west_m) / step_east_m, (north_m - south_m) / step_north_m
    if not (0.0 <= x <= columns - 1 and 0.0 <= y <= rows - 1):
        return math.nan, math.nan, math.nan
    column, row = min(int(x), columns - 2), min(int(y), rows - 2)
    u, v = x - column, y - row
    a, b = float(heights[row, column]), float(heights[row, column + 1])
    c, d = float(heights[row + 1, column]), float(heights[row + 1, column + 1])
    south, north = a + u * (b - a), c + u * (d - c)
    east_slope = ((b - a) + v * ((d - c) - (b - a))) / step_east_m
    return south + v * (north - south), east_slope, (north - south) / step_north_m


@compiled
def height_sigma_m(sigma_m: float, step_m: float, slope_east: float, slope_north: float) -> float:
    """Return one standard deviation of a height of the data: their own, and that of the place on a slope."""
    return math.hypot(sigma_m, _MISPLACED * step_m * math.hypot(slope_east, slope_north))


@compiled
def heights_at(grid: Grid, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
    """Return heights (n,) at places (n,)."""
    found = np.empty(east_m.size)
    for i in range(east_m.size):
        found[i] = height_and_slope(grid, east_m[i], north_m[i])[0]
    return found


@compiled
def ray_cut_m(
    grid: Grid,
    east_m: float,
    north_m: float,
    height_m: float,
    bearing_rad: float,
    depression_rad: float,
    step_m: float,
    max_m: float,
) -> float:
    """Return the horizontal distance at which a ray first meets the ground.

    NaN when it does not within ``max_m``, meets a void before, or begins below the ground.
    """
    sin_b, cos_b, fall = math.sin(bearing_rad), math.cos(bearing_rad), math.tan(depression_rad)
    before_m = 0.0
    if not height_m > height_and_slope(grid, east_m, north_m)[0]:
        return math.nan
    while before_m < max_m:
        at_m = before_m + step_m
        above_m = height_m - fall * at_m - height_and_slope(grid, east_m + at_m * sin_b, north_m + at_m * cos_b)[0]
        if math.isnan(above_m):
            return math.nan
        if above_m <= 0.0:
            low_m, high_m = before_m, at_m
            for _ in range(_BISECTIONS):
                middle_m = 0.5 * (low_m + high_m)
                ground_m = height_and_slope(grid, east_m + middle_m * sin_b, north_m + middle_m * cos_b)[0]
                if height_m - fall * middle_m > ground_m:
                    low_m = middle_m
                else:
                    high_m = middle_m
            return 0.5 * (low_m + high_m)
        before_m = at_m
    return math.nan


@compiled
def sight_step_m(grid: Grid) -> float:
    """Return the steps in which a line over the ground is followed."""
    return min(grid[3], grid[4]) / _STEPS_PER_POST


@compiled
def sight_clearance_m(
    grid: Grid, a_m: tuple[float, float, float], b_m: tuple[float, float, float], step_m: float
) -> float:
    """Return by how much the straight line between two points (east, north, height) clears the ground.

    The ends do not count; voids hide nothing.
    """
    east_m, north_m, rise_m = b_m[0] - a_m[0], b_m[1] - a_m[1], b_m[2] - a_m[2]
    steps = max(2, math.ceil(math.hypot(east_m, north_m) / step_m))
    clearance_m = math.inf
    for k in range(1, steps):
        u = k / steps
        ground_m = height_and_slope(grid, a_m[0] + u * east_m, a_m[1] + u * north_m)[0]
        above_m = a_m[2] + u * rise_m - ground_m
        if above_m < clearance_m:  # noqa: PLR1730  # NaN is to be passed over
            clearance_m = above_m
    return clearance_m


@compiled
def horizon(
    grid: Grid, east_m: float, north_m: float, height_m: float, azimuths: int, rings: int, ring_m: float
) -> npt.NDArray[np.float32]:
    """Return the height (azimuths, rings) from which a point is seen, at distances of 1..rings times ``ring_m``.

    The first azimuth is north, the rest follow clockwise. Voids hide nothing.
    """
    # As height_and_slope has it, written out for rows and columns: a planner asks for this every second.
    heights, west_m, south_m, step_east_m, step_north_m = grid
    rows, columns = heights.shape
    x0, y0 = (east_m - west_m) / step_east_m, (north_m - south_m) / step_north_m
    needed = np.empty((azimuths, rings), np.float32)
    for i in range(azimuths):
        azimuth_rad = 2.0 * math.pi * i / azimuths
        east, north = ring_m * math.sin(azimuth_rad) / step_east_m, ring_m * math.cos(azimuth_rad) / step_north_m
        steepest = -math.inf  # in metres a ring
        for k in range(1, rings + 1):
            x, y = x0 + k * east, y0 + k * north
            if 0.0 <= x <= columns - 1 and 0.0 <= y <= rows - 1:
                column, row = min(int(x), columns - 2), min(int(y), rows - 2)
                u, v = x - column, y - row
                a, b = float(heights[row, column]), float(heights[row, column + 1])
                c, d = float(heights[row + 1, column]), float(heights[row + 1, column + 1])
                low, high = a + u * (b - a), c + u * (d - c)
                rise = (low + v * (high - low) - height_m) / k
                if rise > steepest:  # noqa: PLR1730  # NaN is to be passed over
                    steepest = rise
            needed[i, k - 1] = height_m + steepest * k
    return needed


Raster = npt.NDArray[np.float32]

_STEP_MAX_M = 10.0


@inner
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
