"""ArduPlane's terrain database: requests heights from the ground station, stores them, and reports the height below.

Heights come in blocks of 8 x 7 squares, each of 4 x 4 posts 100 m apart. Here blocks overlap by one row of posts, so
that every position is between four posts of one block.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import all as mavlink

_SPACING_M = 100
_ACROSS, _UP, _SQUARE = 8, 7, 4
_METRES_PER_DEG = 111_318.84502145034  # ArduPilot's LATLON_TO_M, in degrees


class TerrainDatabase:
    """Terrain heights (AMSL) around a position, as far as they have been received."""

    def __init__(self, latitude_deg: float, longitude_deg: float) -> None:
        self._origin_deg = latitude_deg, longitude_deg
        self._step_deg = _SPACING_M / _METRES_PER_DEG
        self._blocks: dict[tuple[int, int], npt.NDArray[np.float64]] = {}

    def request(self, latitude_deg: float, longitude_deg: float) -> Any:
        """Return the TERRAIN_REQUEST for what is missing of the block about a place; None where nothing is."""
        corner, heights, _, _ = self._block(latitude_deg, longitude_deg)
        mask = sum(1 << bit for bit in range(_ACROSS * _UP) if np.isnan(_square(heights, bit)).any())
        return mavlink.MAVLink_terrain_request_message(*corner, _SPACING_M, mask) if mask else None

    def take(self, data: Any) -> None:
        """Take a TERRAIN_DATA that answers a request."""
        for (row, column), heights in self._blocks.items():
            if (data.lat, data.lon) == self._corner_e7(row, column) and data.grid_spacing == _SPACING_M:
                _square(heights, data.gridbit)[:] = np.reshape(data.data, (_SQUARE, _SQUARE))

    def report(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Any:
        """Return the TERRAIN_REPORT of a place; its spacing is 0 where the height is not known."""
        _, heights, x, y = self._block(latitude_deg, longitude_deg)
        column, row = int(x), int(y)
        u, v = x - column, y - row
        (sw, se), (nw, ne) = heights[row : row + 2, column : column + 2].tolist()
        ground_m = (1 - v) * ((1 - u) * sw + u * se) + v * ((1 - u) * nw + u * ne)
        known = not math.isnan(ground_m)
        pending = sum(int(np.isnan(block).sum()) for block in self._blocks.values()) // _SQUARE**2
        return mavlink.MAVLink_terrain_report_message(
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            _SPACING_M if known else 0,
            ground_m if known else 0.0,
            altitude_m - ground_m if known else 0.0,
            pending,
            len(self._blocks) * _ACROSS * _UP - pending,
        )

    def _block(
        self, latitude_deg: float, longitude_deg: float
    ) -> tuple[tuple[int, int], npt.NDArray[np.float64], float, float]:
        """Return corner (1e-7 degrees) and posts of the block about a place, and where among the posts that is."""
        rows, columns = _UP * _SQUARE - 1, _ACROSS * _SQUARE - 1
        y = (latitude_deg - self._origin_deg[0]) / self._step_deg
        row = math.floor(y / rows)
        shrunk = math.cos(math.radians(self._corner_e7(row, 0)[0] * 1e-7))
        x = (longitude_deg - self._origin_deg[1]) / (self._step_deg / shrunk)
        column = math.floor(x / columns)
        heights = self._blocks.setdefault((row, column), np.full((rows + 1, columns + 1), np.nan))
        return self._corner_e7(row, column), heights, x - column * columns, y - row * rows

    def _corner_e7(self, row: int, column: int) -> tuple[int, int]:
        south_deg = self._origin_deg[0] + row * (_UP * _SQUARE - 1) * self._step_deg
        step_east_deg = self._step_deg / math.cos(math.radians(round(south_deg * 1e7) * 1e-7))
        west_deg = self._origin_deg[1] + column * (_ACROSS * _SQUARE - 1) * step_east_deg
        return round(south_deg * 1e7), round(west_deg * 1e7)


def _square(heights: npt.NDArray[np.float64], bit: int) -> npt.NDArray[np.float64]:
    row, column = _SQUARE * (bit // _ACROSS), _SQUARE * (bit % _ACROSS)
    return heights[row : row + _SQUARE, column : column + _SQUARE]
