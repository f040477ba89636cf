"""SRTM tiles: a degree squared of big-endian 16-bit heights, rows from north to south, -32768 where void.

The name gives the south-west corner: N36W085.hgt.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sidelong.app.errors import InputError
from sidelong.app.terrain.tile import HIGHEST_M, LOWEST_M, HeightArray, Posts, at_posts, needed

_NAME = re.compile(r"([NS])(\d{2})([EW])(\d{3})", re.IGNORECASE)
_SIDES = (1201, 3601)


class SrtmTile:
    """See :class:`sidelong.app.terrain.tile.Tile`. The file is mapped, not read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        match = _NAME.fullmatch(path.stem)
        if match is None:
            raise InputError(f"{path}: is not named after its south-west corner, like N36W085.hgt; rename it.")
        latitude_deg = int(match[2]) * (1 if match[1].upper() == "N" else -1)
        longitude_deg = int(match[4]) * (1 if match[3].upper() == "E" else -1)
        if not (-90 <= latitude_deg < 90 and -180 <= longitude_deg < 180):
            raise InputError(f"{path}: no place on earth has the corner {path.stem}; rename it.")
        side = self._side()
        step_deg = 1.0 / (side - 1)
        self.posts = Posts(latitude_deg, longitude_deg, step_deg, step_deg, side, side)
        try:
            self._stored: npt.NDArray[np.int16] = np.memmap(path, ">i2", "r", shape=(side, side))
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot be read ({error}); replace it.") from error

    def _side(self) -> int:
        try:
            size = self.path.stat().st_size
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read ({error.strerror}); replace it.") from error
        side = math.isqrt(size // 2)
        if side not in _SIDES or 2 * side * side != size:
            sizes = " or ".join(f"{2 * one * one:,}" for one in _SIDES)
            raise InputError(
                f"{self.path}: has {size:,} bytes where an SRTM tile has {sizes}; it is damaged: replace it."
            )
        return side

    def read(self, wanted: Posts) -> HeightArray:
        """See :class:`sidelong.app.terrain.tile.Tile`."""
        own, side = self.posts, self.posts.rows
        south, north, west, east = needed(wanted, own)
        if south == north or west == east:
            return np.full((wanted.rows, wanted.columns), np.nan, np.float32)
        # The first row of the file is the northernmost.
        heights = self._stored[side - north : side - south, west:east][::-1].astype(np.float32)
        heights[(heights < LOWEST_M) | (heights > HIGHEST_M)] = np.nan
        return at_posts(wanted, own, heights, south, west)
