"""The ground as an elevation grid in the local plane.

Source: bilinear interpolation and bisection, Press et al., *Numerical Recipes*, 2007, sections 3.6 and 9.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sidelong.estimators.terrain.ground_kernel import (
    FloatArray,
    Grid,
    height_and_slope,
    heights_at,
    horizon,
    ray_cut_m,
    sight_clearance_m,
    sight_step_m,
)


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Heights (rows, columns) at posts, above home; row 0 in the south, column 0 in the west; NaN where void.

    west_m and south_m place the first post in the plane. sigma_m is one standard deviation of a height against the
    height at home. A grid has two posts each way at least.
    """

    heights_m: npt.NDArray[np.float32]
    west_m: float
    south_m: float
    step_east_m: float
    step_north_m: float
    sigma_m: float = 4.0

    @property
    def grid(self) -> Grid:
        """The ground as the compiled functions take it."""
        return self.heights_m, self.west_m, self.south_m, self.step_east_m, self.step_north_m

    def height_m(self, east_m: float, north_m: float) -> float:
        """Return the height at a place, NaN where it is not known."""
        return height_and_slope(self.grid, east_m, north_m)[0]

    def heights_at_m(self, east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> FloatArray:
        """Return the heights at places, arrays of one shape, in that shape; NaN where unknown."""
        east, north = np.asarray(east_m, np.float64), np.asarray(north_m, np.float64)
        return heights_at(self.grid, east.ravel(), north.ravel()).reshape(east.shape)

    def cut_m(
        self, east_m: float, north_m: float, height_m: float, bearing_rad: float, depression_rad: float, max_m: float
    ) -> float | None:
        """Return the horizontal distance at which a ray meets the ground; None if it does not, or crosses a void."""
        step_m = sight_step_m(self.grid)
        found_m = ray_cut_m(self.grid, east_m, north_m, height_m, bearing_rad, depression_rad, step_m, max_m)
        return None if math.isnan(found_m) else found_m

    def sees(self, a_m: tuple[float, float, float], b_m: tuple[float, float, float]) -> bool:
        """Return whether the line between two points (east, north, height) clears the ground. Voids hide nothing."""
        return sight_clearance_m(self.grid, a_m, b_m, sight_step_m(self.grid)) >= 0.0

    def horizon_m(
        self, east_m: float, north_m: float, height_m: float, azimuths: int, rings: int, ring_m: float
    ) -> npt.NDArray[np.float32]:
        """Return the heights (azimuths, rings) from which a point is visible. Voids hide nothing.

        The first azimuth is north, the others follow clockwise; ``ring_m`` is the first distance and the step.
        """
        return horizon(self.grid, east_m, north_m, height_m, azimuths, rings, ring_m)


def flat_ground(sigma_m: float) -> Ground:
    """Return flat ground at the height of home, for 40 km around the origin: for flights without elevation data."""
    reach_m, step_m = 40_000.0, 400.0
    posts = round(2.0 * reach_m / step_m) + 1
    return Ground(np.zeros((posts, posts), np.float32), -reach_m, -reach_m, step_m, step_m, sigma_m)
