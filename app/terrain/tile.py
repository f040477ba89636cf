"""What all files of elevation data have in common: an outline, a spacing, and posts that are read by windows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

HeightArray = npt.NDArray[np.float32]

# Metres above sea level; what lies beyond is a fault of the data and counts as void.
LOWEST_M, HIGHEST_M = -500.0, 9000.0
_SLIVER_DEG = 1e-9


@dataclass(frozen=True, slots=True)
class Bounds:
    """Degrees; none crosses the date line."""

    south_deg: float
    west_deg: float
    north_deg: float
    east_deg: float

    def overlap(self, other: Bounds) -> Bounds | None:
        """Return what both have in common, None for nothing or a line."""
        south, west = max(self.south_deg, other.south_deg), max(self.west_deg, other.west_deg)
        north, east = min(self.north_deg, other.north_deg), min(self.east_deg, other.east_deg)
        if north - south <= _SLIVER_DEG or east - west <= _SLIVER_DEG:
            return None
        return Bounds(south, west, north, east)

    @property
    def area_deg2(self) -> float:
        return (self.north_deg - self.south_deg) * (self.east_deg - self.west_deg)


@dataclass(frozen=True, slots=True)
class Posts:
    """A raster of posts: the first in the south-west, then ``rows`` to the north and ``columns`` to the east."""

    south_deg: float
    west_deg: float
    step_north_deg: float
    step_east_deg: float
    rows: int
    columns: int

    @property
    def bounds(self) -> Bounds:
        return Bounds(
            self.south_deg,
            self.west_deg,
            self.south_deg + (self.rows - 1) * self.step_north_deg,
            self.west_deg + (self.columns - 1) * self.step_east_deg,
        )

    def part(self, first_row: int, rows: int) -> Posts:
        """Return some rows of them."""
        south_deg = self.south_deg + first_row * self.step_north_deg
        return Posts(south_deg, self.west_deg, self.step_north_deg, self.step_east_deg, rows, self.columns)


class Tile(Protocol):
    """One file. Opening it reads nothing but its outline."""

    path: Path
    posts: Posts

    def read(self, wanted: Posts) -> HeightArray:
        """Return heights above sea level (rows, columns) at posts, NaN where void or beyond the tile.

        Memory grows with the posts wanted, never with the file. Raises InputError naming a file that cannot be read.
        """


def at_posts(wanted: Posts, own: Posts, stored: HeightArray, first_row: int, first_column: int) -> HeightArray:
    """Return heights at wanted posts, bilinear between those stored; void next to a void, and beyond the tile.

    stored (rows, columns) is the part of a tile's own posts that begins at first_row and first_column.
    """
    y = (wanted.south_deg + np.arange(wanted.rows) * wanted.step_north_deg - own.south_deg) / own.step_north_deg
    x = (wanted.west_deg + np.arange(wanted.columns) * wanted.step_east_deg - own.west_deg) / own.step_east_deg
    row, v, row_known = _between(y, first_row, stored.shape[0], own.rows)
    column, u, column_known = _between(x, first_column, stored.shape[1], own.columns)
    south = _along(stored[row], column, u)
    north = _along(stored[np.minimum(row + 1, stored.shape[0] - 1)], column, u)
    weight = v[:, None].astype(np.float32)
    # A post of weight 0 is left out, void or not: posts that fall together are copied as they are.
    heights = np.where(weight == 0.0, south, south + weight * (north - south)).astype(np.float32)
    heights[~row_known] = np.nan
    heights[:, ~column_known] = np.nan
    return heights


def _along(rows: HeightArray, column: npt.NDArray[np.intp], u: npt.NDArray[np.floating]) -> HeightArray:
    west, east = rows[:, column], rows[:, np.minimum(column + 1, rows.shape[1] - 1)]
    weight = u.astype(np.float32)
    along: HeightArray = np.where(weight == 0.0, west, west + weight * (east - west))
    return along


def _between(
    x: npt.NDArray[np.floating], first: int, stored: int, own: int
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.floating], npt.NDArray[np.bool_]]:
    """Return the stored post before, the share of the way to the next, and whether it lies within the tile."""
    rounded = np.round(x)
    x = np.where(np.abs(x - rounded) < 1e-4, rounded, x)  # posts of one raster, but for what degrees cannot say
    known = (x >= 0.0) & (x <= own - 1)
    before = np.clip(np.floor(x).astype(np.intp), first, first + stored - 1)
    return before - first, np.where(known, x - before, 0.0), known


def needed(wanted: Posts, own: Posts) -> tuple[int, int, int, int]:
    """Return which of a tile's own posts are needed: first and end of rows, then of columns; equal for none."""
    rows = _span(wanted.south_deg, wanted.step_north_deg, wanted.rows, own.south_deg, own.step_north_deg, own.rows)
    return (
        *rows,
        *_span(wanted.west_deg, wanted.step_east_deg, wanted.columns, own.west_deg, own.step_east_deg, own.columns),
    )


def _span(low: float, step: float, posts: int, own_low: float, own_step: float, own_posts: int) -> tuple[int, int]:
    first = math.floor((low - own_low) / own_step + 1e-4)
    end = math.ceil((low + (posts - 1) * step - own_low) / own_step - 1e-4) + 1
    first, end = min(max(first, 0), own_posts), min(max(end, 0), own_posts)
    return first, max(first, end)
