"""What a place beside the target costs: the planner's one measure. Unit: seconds off the chosen side.

Watch frame: origin at the target, x to the right of the watch course, y ahead. The watch course is the target's
(held through stops), mirrored for the right side, so that the side to be on is always the left one, x < 0. For
a compass sector it is the course whose left normal is the middle of the sector.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

# Outside the band one second costs as much as this many off the side, and more the further out.
_OUTSIDE, _OUTSIDE_PER_M = 20.0, 0.5
# Inside the band the cost rises towards its edges over this width, to _WALL at the edge.
_WALL_WIDTH_M, _WALL = 20.0, 2.0
# The planner keeps this far inside the required band: the aircraft's own error and what it learns too late.
_MARGIN_M = 15.0

Values = npt.NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class WatchCost:
    """near_m..far_m: the band to keep. half_width_rad: of the watched sector about the normal; pi/2 is a side."""

    near_m: float
    far_m: float
    half_width_rad: float = math.pi / 2

    @staticmethod
    def inside(range_min_m: float, range_max_m: float, half_width_rad: float = math.pi / 2) -> WatchCost:
        """Return the cost of a required band, with the planner's margin."""
        return WatchCost(range_min_m + _MARGIN_M, range_max_m - _MARGIN_M, half_width_rad)

    def rate(
        self, x_m: Values, y_m: Values, widened_m: npt.ArrayLike = 0.0, side_blur_m: npt.ArrayLike = 1.0
    ) -> Values:
        """Return the cost per second at places of the watch frame.

        widened_m moves both edges of the band inwards; the sides' border is blurred over +-side_blur_m (> 0).
        """
        range_m = np.hypot(x_m, y_m)
        return self.off_side(x_m, range_m, side_blur_m) + self.off_band(range_m, widened_m)

    def off_side(self, x_m: Values, range_m: Values, side_blur_m: npt.ArrayLike) -> Values:
        """Return the chance of being off the side, 0..1."""
        margin_m = -x_m - math.cos(self.half_width_rad) * range_m
        chance: Values = np.clip(0.5 - 0.5 * margin_m / np.asarray(side_blur_m), 0.0, 1.0)
        return chance

    def off_band(self, range_m: Values, widened_m: npt.ArrayLike) -> Values:
        """Return the walls' share of the rate. The band is never narrowed beyond a half of its width."""
        widened = np.minimum(np.asarray(widened_m), 0.25 * (self.far_m - self.near_m))
        inside_m = np.minimum(range_m - (self.near_m + widened), (self.far_m - widened) - range_m)
        wall = _WALL * np.clip(1.0 - inside_m / _WALL_WIDTH_M, 0.0, 1.0) ** 2
        rate: Values = wall + np.where(inside_m < 0.0, _OUTSIDE - _WALL - _OUTSIDE_PER_M * inside_m, 0.0)
        return rate
