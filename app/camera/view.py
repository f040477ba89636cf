"""Where a picture was taken from and which way, and what that makes of its pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.estimators.rotations import rotate
from sidelong.estimators.terrain.ground import Ground

_DEPRESSION_MIN_RAD = math.radians(2.0)
_FAR_M = 5_000.0


@dataclass(frozen=True, slots=True)
class View:
    """A pinhole camera in the local plane.

    Attributes:
        position_m: east, north and height above home.
        ned_from_sight: attitude of the optical axis, (w, x, y, z); x looks along it, y to the right, z down.
        focal_px: focal length.
        size_px: width and height of the picture.
        terrain: the ground; where it is None or void, the ground is level at the height of home.
    """

    position_m: tuple[float, float, float]
    ned_from_sight: tuple[float, float, float, float]
    focal_px: float
    size_px: tuple[int, int]
    terrain: Ground | None

    def ground_m(self, east_m: float, north_m: float) -> float:
        """Return the height of the ground above home; 0 where it is not known."""
        height_m = math.nan if self.terrain is None else self.terrain.height_m(east_m, north_m)
        return height_m if math.isfinite(height_m) else 0.0

    def pixel(self, east_m: float, north_m: float) -> tuple[float, float] | None:
        """Return where a point on the ground is seen, also outside the picture; None behind the camera."""
        east0_m, north0_m, height_m = self.position_m
        down_m = height_m - self.ground_m(east_m, north_m)
        w, x, y, z = self.ned_from_sight
        ahead_m, right_m, below_m = rotate((w, -x, -y, -z), (north_m - north0_m, east_m - east0_m, down_m))
        if ahead_m <= 1.0:
            return None
        scale = self.focal_px / ahead_m
        return 0.5 * self.size_px[0] + scale * right_m, 0.5 * self.size_px[1] + scale * below_m

    def direction(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return bearing and depression of a pixel, rad."""
        right, down = x_px - 0.5 * self.size_px[0], y_px - 0.5 * self.size_px[1]
        north, east, below = rotate(self.ned_from_sight, (self.focal_px, right, down))
        return math.atan2(east, north), math.atan2(below, math.hypot(north, east))

    def ground(self, x_px: float, y_px: float) -> tuple[float, float] | None:
        """Return where the ground is seen in a pixel (east, north); None at and above the horizon."""
        bearing_rad, depression_rad = self.direction(x_px, y_px)
        if depression_rad < _DEPRESSION_MIN_RAD:
            return None
        east_m, north_m, height_m = self.position_m
        level_m = height_m / math.tan(depression_rad)
        if self.terrain is not None:  # the first hill that hides what is behind it
            level_m = self.terrain.cut_m(*self.position_m, bearing_rad, depression_rad, _FAR_M) or level_m
        return east_m + level_m * math.sin(bearing_rad), north_m + level_m * math.cos(bearing_rad)

    def scale_px_m(self, east_m: float, north_m: float) -> float:
        """Return the size in the picture of a metre at a point on the ground."""
        down_m = self.position_m[2] - self.ground_m(east_m, north_m)
        away_m = math.hypot(east_m - self.position_m[0], north_m - self.position_m[1], down_m)
        return self.focal_px / max(away_m, 1.0)
