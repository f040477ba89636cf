"""The ground about one place, as tests compute with it."""

from __future__ import annotations

import math
from typing import NamedTuple

from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.terrain.ground_kernel import height_and_slope, height_sigma_m


class Patch(NamedTuple):
    """A plane, its height above home, and the standard deviation of that height."""

    east_m: float
    north_m: float
    height_m: float
    slope_east: float
    slope_north: float
    sigma_m: float


def patch_of(ground: Ground, east_m: float, north_m: float) -> Patch | None:
    """Return the ground around a position; None where it is unknown."""
    height_m, *slope = height_and_slope(ground.grid, east_m, north_m)
    if math.isnan(height_m):
        return None
    step_m = min(ground.step_east_m, ground.step_north_m)
    return Patch(east_m, north_m, height_m, *slope, height_sigma_m(ground.sigma_m, step_m, *slope))
