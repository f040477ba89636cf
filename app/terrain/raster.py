"""Files of elevation data, SRTM tiles and GeoTIFF: an outline, a spacing, and posts that are read by windows."""

from __future__ import annotations

import contextlib
import gzip
import math
import re
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sidelong.app.errors import InputError, missing_package

HeightArray = npt.NDArray[np.float32]

# Metres above sea level; what lies beyond is a fault of the data and counts as void.
LOWEST_M, HIGHEST_M = -500.0, 9000.0
_SLIVER_DEG = 1e-9
_METRES = dict.fromkeys(("", "m", "metre", "meter", "metres", "meters"), 1.0)
_METRES |= dict.fromkeys(("ft", "foot", "feet"), 0.3048) | dict.fromkeys(("us-ft", "us survey foot"), 1200.0 / 3937.0)
# This number of pixels is decimated in a few seconds; they must be unpacked for it.
_PIXELS_MAX = 400_000_000
_CACHE_BYTES = 32 << 20
_UNPACKED_MAX_BYTES = 64 << 20
_TILE_NAME = re.compile(r"([NS])(\d{2})([EW])(\d{3})", re.IGNORECASE)
_SIDES = (1201, 3601)


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


class Raster:
    """One file of heights, read by GDAL; opening it reads nothing but its outline.

    A GeoTIFF has any projection; its first band is the height above sea level. An SRTM tile (.hgt) is named after its
    south-west corner.

    Args:
        path: The file, or the archive that it is in.
        member: Its name in a zip archive; empty: the file itself.
        size: Its length, bytes; None: that of the file.

    Raises:
        InputError: rasterio is not installed, or the file has no heights; it names the file.
    """

    def __init__(self, path: Path, member: str = "", size: int | None = None) -> None:
        self.path, self._member = path, member
        self._name = Path(member or path.name.removesuffix(".gz")).name
        self._driver = "SRTMHGT" if self._name.lower().endswith(".hgt") else "GTiff"
        if self._driver == "SRTMHGT":
            self.posts = self._posts_of_tile(_length(path) if size is None else size)
            self._scale, self._offset_m = 1.0, 0.0
            return
        with self._opened() as (dataset, raster):
            self._scale = dataset.scales[0] * _METRES[_unit(dataset)]
            self._offset_m = dataset.offsets[0] * _METRES[_unit(dataset)]
            t, rows, columns = raster.transform, raster.height, raster.width
        if rows < 2 or columns < 2 or not all(map(math.isfinite, t[:6])):
            raise InputError(f"{path}: has no raster of heights; replace it.")
        # Posts stand in the middle of the pixels; rows come from north to south.
        self.posts = Posts(t.f + (rows - 0.5) * t.e, t.c + 0.5 * t.a, -t.e, t.a, rows, columns)

    def _posts_of_tile(self, size: int) -> Posts:
        """Return the outline of an SRTM tile by its name and length: many tiles are not opened for it."""
        match = _TILE_NAME.match(self._name)
        if match is None:
            raise InputError(f"{self.path}: is not named after its south-west corner, like N36W085.hgt; rename it.")
        latitude_deg = int(match[2]) * (1 if match[1].upper() == "N" else -1)
        longitude_deg = int(match[4]) * (1 if match[3].upper() == "E" else -1)
        if not (-90 <= latitude_deg < 90 and -180 <= longitude_deg < 180):
            raise InputError(f"{self.path}: no place on earth has the corner {match[0]}; rename it.")
        side = math.isqrt(size // 2)
        if side not in _SIDES or 2 * side * side != size:
            sizes = " or ".join(f"{2 * one * one:,}" for one in _SIDES)
            raise InputError(
                f"{self.path}: has {size:,} bytes where an SRTM tile has {sizes}; it is damaged: replace it."
            )
        return Posts(latitude_deg, longitude_deg, 1.0 / (side - 1), 1.0 / (side - 1), side, side)

    def _unpacked(self) -> bytes:
        """Return the file in an archive: GDAL itself does not survive damaged ones."""
        try:
            if not self._member:
                with gzip.open(self.path) as file:
                    content = file.read(_UNPACKED_MAX_BYTES + 1)
            else:
                with zipfile.ZipFile(self.path) as archive, archive.open(self._member) as file:
                    content = file.read(_UNPACKED_MAX_BYTES + 1)
        except (
            *(OSError, EOFError, zipfile.BadZipFile, zlib.error),
            *(RuntimeError, ValueError, LookupError),
        ) as error:
            raise InputError(f"{self.path}: cannot be unpacked ({error!s:.80}); replace it.") from error
        if len(content) > _UNPACKED_MAX_BYTES:
            raise InputError(f"{self.path}: is longer than {_UNPACKED_MAX_BYTES >> 20} MiB; unpack it.")
        return content

    @contextlib.contextmanager
    def _opened(self, wanted: Posts | None = None) -> Iterator[tuple[Any, Any]]:
        """Yield the dataset, and the same at posts in latitude and longitude; None: at some of its own spacing."""
        try:
            import rasterio  # noqa: PLC0415  # an extra
            from rasterio.vrt import WarpedVRT  # noqa: PLC0415
        except ImportError as error:
            raise missing_package(f"{self.path}: elevation data", "rasterio") from error
        grid: dict[str, Any] = {}
        if wanted is not None:
            west_deg = wanted.west_deg - 0.5 * wanted.step_east_deg
            north_deg = wanted.bounds.north_deg + 0.5 * wanted.step_north_deg
            corner = rasterio.transform.from_origin(west_deg, north_deg, wanted.step_east_deg, wanted.step_north_deg)
            grid = {"transform": corner, "width": wanted.columns, "height": wanted.rows}
            # What posts far apart are the mean of. GDAL would guess it, wrongly for few posts.
            grid["XSCALE"] = 1.0 / max(1, int(wanted.step_east_deg / self.posts.step_east_deg + 1e-9))
            grid["YSCALE"] = 1.0 / max(1, int(wanted.step_north_deg / self.posts.step_north_deg + 1e-9))
        with contextlib.ExitStack() as opened:
            # Without it errors are printed; the cache would take a twentieth of the memory.
            opened.enter_context(rasterio.Env(GDAL_CACHEMAX=_CACHE_BYTES))
            try:
                source: Any = self.path
                if self._member or self.path.suffix == ".gz":
                    source = opened.enter_context(rasterio.MemoryFile(self._unpacked(), filename=self._name))
                # Another format might be a list of other files, or of addresses.
                dataset = opened.enter_context(rasterio.open(source, driver=self._driver))
            except InputError:
                raise
            except Exception as error:  # here and below: those of GDAL have no public class
                kind = "GeoTIFF" if self._driver == "GTiff" else "SRTM tile"
                raise InputError(f"{self.path}: is no readable {kind} ({error}); replace it.") from error
            self._check(dataset)
            form = {"crs": "EPSG:4326", "dtype": "float32", "nodata": math.nan} | grid
            try:
                raster = opened.enter_context(
                    WarpedVRT(dataset, resampling=rasterio.enums.Resampling.bilinear, **form)
                )
            except Exception as error:
                raise InputError(
                    f"{self.path}: cannot be converted to latitude and longitude; write it in another coordinate "
                    "system."
                ) from error
            yield dataset, raster

    def _check(self, dataset: Any) -> None:
        if dataset.crs is None:
            raise InputError(f"{self.path}: has no coordinate system; write it with one.")
        if dataset.colorinterp[0].name not in ("gray", "undefined") or "complex" in dataset.dtypes[0]:
            raise InputError(f"{self.path}: is a picture, and no heights; give a GeoTIFF of elevation data.")
        if _unit(dataset) not in _METRES:
            raise InputError(f"{self.path}: has heights in {_unit(dataset)}; write it in metres or feet.")

    def read(self, wanted: Posts) -> HeightArray:
        """Return heights above sea level (rows, columns) at posts, bilinear; NaN where void or beyond the tile.

        Memory grows with the posts wanted, never with the file. Raises InputError naming a file that cannot be read.
        """
        common = self.posts.bounds.overlap(wanted.bounds)
        pixels = 0 if common is None else common.area_deg2 / (self.posts.step_north_deg * self.posts.step_east_deg)
        if pixels > _PIXELS_MAX:
            raise InputError(
                f"{self.path}: has {pixels:,.0f} pixels there, {_PIXELS_MAX:,} at most serve; make it coarser "
                "(gdalwarp -tr)."
            )
        with self._opened(wanted) as (_, raster):
            try:
                band = raster.read(1)
            except Exception as error:
                raise InputError(f"{self.path}: cannot be read ({error}); replace it.") from error
        heights: HeightArray = band[::-1] * np.float32(self._scale) + np.float32(self._offset_m)
        heights[~((heights >= LOWEST_M) & (heights <= HIGHEST_M))] = np.nan
        return heights


def _length(path: Path) -> int:
    """Return the length of a file, or of the file packed in it, bytes."""
    with path.open("rb") as file:
        end = file.seek(0, 2)
        if path.suffix != ".gz" or end < 4:
            return end
        file.seek(-4, 2)  # where gzip keeps it
        return int.from_bytes(file.read(4), "little")


def _unit(dataset: Any) -> str:
    return (dataset.units[0] or "").lower()
