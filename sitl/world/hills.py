"""The ground of a simulation: SRTM tiles, and what they hide."""

from __future__ import annotations

import math
import zipfile
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sidelong.sitl.world.geodesy import HomePlane

_VOID = -32768
_SIDES = {2 * side * side: side for side in (1201, 3601)}
_LOOK_EVERY_M = 15.0
_EYE_M = 1.0  # of the target over its ground: what is to be seen of it


class HillsError(Exception):
    """There is no elevation data; the message gives the reason."""


class Hills:
    """Ground from a folder of .hgt tiles, or flat without one. Heights are above the ground at home.

    Where the data is void, the height is NaN and nothing is hidden. Raises HillsError.
    """

    def __init__(self, folder: Path | None, plane: HomePlane) -> None:
        self._folder, self._plane = folder, plane
        self._tiles: dict[tuple[int, int], npt.NDArray[np.int16] | None] = {}
        self.home_altitude_m = 0.0
        if folder is None:
            return
        if not folder.is_dir():
            raise HillsError(f"{folder} is no folder of .hgt tiles")
        self.home_altitude_m = float(self._above_sea_m(np.zeros(1), np.zeros(1))[0])
        if math.isnan(self.home_altitude_m):
            raise HillsError(
                f"{folder} has no height of home, {plane.latitude_deg:.4f}, {plane.longitude_deg:.4f}; "
                "add the .hgt tile, or set another home"
            )

    def height_m(self, east_m: float, north_m: float) -> float:
        """Return the height of the ground above home; 0 without elevation data."""
        if self._folder is None:
            return 0.0
        return float(self._above_sea_m(np.array([east_m]), np.array([north_m]))[0]) - self.home_altitude_m

    def reported(self, aircraft_m: tuple[float, float, float], in_sight: bool) -> tuple[float | None, bool | None]:
        """Return the clearance over the ground and whether the target is in sight; None where no ground is known."""
        if self._folder is None:
            return None, None
        return aircraft_m[2] - self.height_m(*aircraft_m[:2]), in_sight

    def see(self, one_m: tuple[float, float, float], other_m: tuple[float, float, float]) -> bool:
        """Return whether no hill is between two points (east, north, height)."""
        if self._folder is None:
            return True
        distance_m = math.hypot(other_m[0] - one_m[0], other_m[1] - one_m[1])
        shares = np.linspace(0.0, 1.0, max(3, math.ceil(distance_m / _LOOK_EVERY_M) + 1))[1:-1]
        east_m, north_m, height_m = (a + shares * (b - a) for a, b in zip(one_m, other_m, strict=True))
        return not (self._above_sea_m(east_m, north_m) - self.home_altitude_m > height_m).any()

    def standing(self, target_m: tuple[float, float]) -> tuple[float, float, float]:
        """Return a target of the plane on its ground; at the height of home where that is void."""
        height_m = self.height_m(*target_m)
        return (*target_m, 0.0 if math.isnan(height_m) else height_m)

    def sees_target(self, craft_m: tuple[float, float, float], standing_m: tuple[float, float, float]) -> bool:
        """Whether the line from the aircraft to a standing target's eyes is free of ground; (east, north, up) m."""
        return self.see(craft_m, (standing_m[0], standing_m[1], standing_m[2] + _EYE_M))

    def _above_sea_m(
        self, east_m: npt.NDArray[np.float64], north_m: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        places = [self._plane.latitude_longitude_deg(e, n) for e, n in zip(east_m, north_m, strict=True)]
        return np.array([self._bilinear_m(latitude_deg, longitude_deg) for latitude_deg, longitude_deg in places])

    def _bilinear_m(self, latitude_deg: float, longitude_deg: float) -> float:
        south, west = math.floor(latitude_deg), math.floor(longitude_deg)
        tile = self._tile(south, west)
        if tile is None:
            return math.nan
        last = tile.shape[0] - 1
        down, right = (south + 1 - latitude_deg) * last, (longitude_deg - west) * last
        row, column = min(int(down), last - 1), min(int(right), last - 1)
        corners = tile[row : row + 2, column : column + 2].astype(float)
        if (corners == _VOID).any():
            return math.nan
        (nw, ne), (sw, se) = corners.tolist()
        u, v = right - column, down - row
        return float((1 - v) * ((1 - u) * nw + u * ne) + v * ((1 - u) * sw + u * se))

    def _tile(self, south: int, west: int) -> npt.NDArray[np.int16] | None:
        if (south, west) not in self._tiles:
            assert self._folder is not None
            name = f"{'S' if south < 0 else 'N'}{abs(south):02d}{'W' if west < 0 else 'E'}{abs(west):03d}.hgt"
            path = self._folder / name
            tile: npt.NDArray[np.int16] | None = None
            if path.is_file():
                tile = np.memmap(path, ">i2", "r", shape=_shape(path, path.stat().st_size))
            elif (path := path.with_name(f"{name}.zip")).is_file():
                try:
                    with zipfile.ZipFile(path) as archive:
                        shape = _shape(path, archive.getinfo(name).file_size)
                        tile = np.frombuffer(archive.read(name), ">i2").reshape(shape)
                except (OSError, zipfile.BadZipFile, zlib.error, LookupError, ValueError) as error:
                    raise HillsError(f"{path} is damaged: {error}") from error
            self._tiles[south, west] = tile
        return self._tiles[south, west]


def _shape(path: Path, size: int) -> tuple[int, int]:
    if size not in _SIDES:
        raise HillsError(f"{path} is damaged: no SRTM tile has {size} bytes")
    return _SIDES[size], _SIDES[size]
