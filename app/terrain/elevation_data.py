"""A folder of elevation data: the window about home, and what it covers."""

from __future__ import annotations

import contextlib
import gzip
import math
import re
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sidelong.app.errors import InputError, missing_package
from sidelong.estimators.frames import LocalPlane

if TYPE_CHECKING:
    from sidelong.estimators.terrain.ground import Ground


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
        north_deg = self.south_deg + (self.rows - 1) * self.step_north_deg
        east_deg = self.west_deg + (self.columns - 1) * self.step_east_deg
        return Bounds(self.south_deg, self.west_deg, north_deg, east_deg)


class Raster:
    """One file of heights, read by GDAL; opening it reads nothing but its outline. Raises InputError.

    A GeoTIFF has any projection; its first band is the height above sea level. An SRTM tile (.hgt) is named after its
    south-west corner. member: the name in a zip archive; size: its length, bytes; else those of the file.
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
            raise InputError(f"{self.path}: has {size:,} bytes where an SRTM tile has {sizes}; replace it.")
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
            form["resampling"] = rasterio.enums.Resampling.bilinear
            try:
                raster = opened.enter_context(WarpedVRT(dataset, **form))
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
        """Return heights above sea level (rows, columns) at posts, bilinear; NaN where void or beyond.

        Memory grows with the posts wanted, never with the file. Raises InputError.
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


_SUFFIXES = (".hgt", ".tif", ".tiff", ".hgt.gz", ".zip")
_TILES_MAX = 5_000
_REACH_M = 25_000.0  # an hour at 7 m/s
_POSTS_MAX = 6_000_000  # 24 MB
_COVERAGE_POSTS_MAX = 8_000_000
_KNOTS = 51
_METRES_PER_DEG = 111_320.0


@dataclass(frozen=True, slots=True)
class TileCoverage:
    """What one tile has of some bounds: shares 0..1 of the bounds, heights above sea level, None where all void."""

    file: Path
    spacing_m: float
    covered: float
    void: float
    min_height_m: float | None
    max_height_m: float | None


@dataclass(frozen=True, slots=True)
class Coverage:
    """covered and void are shares 0..1 of the bounds; void is within what the tiles outline."""

    bounds: Bounds
    covered: float
    void: float
    tiles: tuple[TileCoverage, ...]


class ElevationData:
    """The elevation data of a folder or a single file; of overlapping tiles the finest counts. Raises InputError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        tiles = [tile for file in _files(path) for tile in _opened(file)]
        if not tiles:
            raise InputError(f"{path}: holds no elevation data; put .hgt tiles or GeoTIFF files there.")
        self.tiles = sorted(tiles, key=lambda tile: tile.posts.step_north_deg)

    def read(self, wanted: Posts) -> HeightArray:
        """Return heights above sea level (rows, columns) at posts, NaN where void."""
        heights = np.full((wanted.rows, wanted.columns), np.nan, np.float32)
        for tile in self.tiles:
            if tile.posts.bounds.overlap(wanted.bounds) is None or not np.isnan(heights).any():
                continue
            found = tile.read(wanted)
            np.copyto(heights, found, where=np.isnan(heights))
        return heights

    def ground(
        self, plane: LocalPlane, home_deg: tuple[float, float], sigma_m: float = 4.0, reach_m: float = _REACH_M
    ) -> Ground:
        """Return the ground about home (latitude, longitude) in the plane; heights are above that at home."""
        latitude_deg, longitude_deg = home_deg
        reach_north_deg = 1.05 * reach_m / _METRES_PER_DEG  # meridians lean against the plane
        reach_east_deg = min(reach_north_deg / max(math.cos(math.radians(latitude_deg)), 0.01), 179.0)
        about = Bounds(
            max(latitude_deg - reach_north_deg, -90.0),
            max(longitude_deg - reach_east_deg, -180.0),
            min(latitude_deg + reach_north_deg, 90.0),
            min(longitude_deg + reach_east_deg, 180.0),
        )
        finest = next((tile for tile in self.tiles if tile.posts.bounds.overlap(about)), None)
        if finest is None:
            raise InputError(
                f"{self.path}: no elevation data about home at {latitude_deg:.4f}, {longitude_deg:.4f}; "
                f"add {_tile_name(latitude_deg, longitude_deg)}."
            )
        above_sea = _in_plane(self.read(posts := _within(about, finest.posts)), posts, plane, reach_m, sigma_m)
        home_m = above_sea.height_m(*plane.east_north_m(*home_deg))
        if math.isnan(home_m):
            raise InputError(
                f"{self.path}: the elevation data is void at home, {latitude_deg:.4f}, {longitude_deg:.4f}; "
                f"add a {_tile_name(latitude_deg, longitude_deg)} whose voids are filled."
            )
        return replace(above_sea, heights_m=above_sea.heights_m - np.float32(home_m))

    def height_above_sea_m(self, latitude_deg: float, longitude_deg: float) -> float:
        """Return the height at a place, NaN where void."""
        step_deg = self.tiles[0].posts.step_north_deg
        return float(self.read(Posts(latitude_deg, longitude_deg, step_deg, step_deg, 2, 2))[0, 0])

    def coverage(self, bounds: Bounds) -> Coverage:
        """Return what is covered, and where it is void, at the spacing of the data, or at 8 million posts."""
        within = [tile for tile in self.tiles if tile.posts.bounds.overlap(bounds)]
        if not within:
            return Coverage(bounds, 0.0, 0.0, ())
        posts = _within(bounds, within[0].posts, _COVERAGE_POSTS_MAX)
        known = float(np.isfinite(self.read(posts)).mean())
        tiles = tuple(_tile_coverage(tile, bounds) for tile in within)
        return Coverage(bounds, known, _outlined(posts, [tile.posts.bounds for tile in within]) - known, tiles)


@lru_cache(maxsize=1)
def elevation_data(path: Path) -> ElevationData:
    """Return the data of a folder or file, opened once. Raises InputError."""
    return ElevationData(path)


def _in_plane(heights: HeightArray, posts: Posts, plane: LocalPlane, reach_m: float, sigma_m: float) -> Ground:
    """Return heights (rows, columns) at posts as a grid of the plane, twice as fine so that peaks stay."""
    from sidelong.estimators.terrain.ground import Ground  # noqa: PLC0415  # compiled code takes a second to load

    spacing_m = 0.5 * posts.step_north_deg * _METRES_PER_DEG
    count = 2 * math.floor(min(reach_m / spacing_m, 0.5 * math.sqrt(_POSTS_MAX))) + 1
    axis_m = np.linspace(-reach_m, reach_m, count)
    # Degrees by metres bend slowly: between knots of a kilometre a line is right to centimetres.
    knots_m = np.linspace(-reach_m, reach_m, _KNOTS)
    knots = np.array([[plane.latitude_longitude_deg(east, north) for east in knots_m] for north in knots_m])
    knots[..., 1] = np.unwrap(np.unwrap(knots[..., 1], axis=1, period=360.0), axis=0, period=360.0)
    across = np.array([[np.interp(axis_m, knots_m, line) for line in knots[..., k]] for k in (0, 1)])
    in_degrees = Ground(heights, posts.west_deg, posts.south_deg, posts.step_east_deg, posts.step_north_deg)
    found = np.empty((count, count), np.float32)
    for row, north_m in enumerate(axis_m):
        k = min(int(np.searchsorted(knots_m, north_m, "right")) - 1, _KNOTS - 2)
        u = (north_m - knots_m[k]) / (knots_m[k + 1] - knots_m[k])
        latitude_deg, longitude_deg = (1.0 - u) * across[:, k] + u * across[:, k + 1]
        found[row] = in_degrees.heights_at_m(longitude_deg, latitude_deg)
    step_m = float(axis_m[1] - axis_m[0])
    return Ground(found, -reach_m, -reach_m, step_m, step_m, sigma_m)


def _files(path: Path) -> list[Path]:
    if not path.exists():
        raise InputError(f"{path}: there is no such folder of elevation data; give one with .hgt tiles or GeoTIFF.")
    if path.is_file():
        if not path.name.lower().endswith(_SUFFIXES):
            raise InputError(f"{path}: elevation data is .hgt or .tif; give such a file or a folder of them.")
        return [path]
    try:
        files = sorted(file for file in path.iterdir() if file.name.lower().endswith(_SUFFIXES))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a folder that can.") from error
    if len(files) > _TILES_MAX:
        raise InputError(f"{path}: holds {len(files):,} tiles; {_TILES_MAX:,} at most serve.")
    return files


def _opened(path: Path) -> list[Raster]:
    """Return the rasters of a file; a zip archive may hold several, or none."""
    if not path.is_file():  # a pipe would be waited for
        raise InputError(f"{path}: is no file that can be read; replace it.")
    if path.suffix.lower() != ".zip":
        return [Raster(path)]
    try:
        with zipfile.ZipFile(path) as archive:
            members = [one for one in archive.infolist() if one.filename.lower().endswith(_SUFFIXES[:3])]
    except (OSError, zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        raise InputError(f"{path}: is no readable archive ({error!s:.80}); replace it.") from error
    return [Raster(path, one.filename, one.file_size) for one in members[:_TILES_MAX]]


def _tile_name(latitude_deg: float, longitude_deg: float) -> str:
    south, west = math.floor(latitude_deg), math.floor(longitude_deg)
    return f"{'S' if south < 0 else 'N'}{abs(south):02d}{'W' if west < 0 else 'E'}{abs(west):03d}.hgt"


def _within(bounds: Bounds, raster: Posts, posts_max: int = _POSTS_MAX) -> Posts:
    """Return the raster's own posts within bounds, continued beyond its edges; thinned out if they are too many."""

    def axis(low: float, high: float, first: float, step: float) -> tuple[int, int]:
        return math.ceil((low - first) / step - 1e-6), math.floor((high - first) / step + 1e-6)

    rows = axis(bounds.south_deg, bounds.north_deg, raster.south_deg, raster.step_north_deg)
    columns = axis(bounds.west_deg, bounds.east_deg, raster.west_deg, raster.step_east_deg)
    counts = max(rows[1] - rows[0] + 1, 2), max(columns[1] - columns[0] + 1, 2)
    thin = max(1, math.ceil(math.sqrt(counts[0] * counts[1] / posts_max)))
    return Posts(
        raster.south_deg + rows[0] * raster.step_north_deg,
        raster.west_deg + columns[0] * raster.step_east_deg,
        thin * raster.step_north_deg,
        thin * raster.step_east_deg,
        max(counts[0] // thin, 2),
        max(counts[1] // thin, 2),
    )


def _outlined(posts: Posts, outlines: list[Bounds]) -> float:
    latitude = posts.south_deg + np.arange(posts.rows) * posts.step_north_deg
    longitude = posts.west_deg + np.arange(posts.columns) * posts.step_east_deg
    inside = np.zeros((posts.rows, posts.columns), bool)
    for outline in outlines:
        rows = (latitude >= outline.south_deg - 1e-9) & (latitude <= outline.north_deg + 1e-9)
        columns = (longitude >= outline.west_deg - 1e-9) & (longitude <= outline.east_deg + 1e-9)
        inside |= rows[:, None] & columns
    return float(inside.mean())


def _tile_coverage(tile: Raster, bounds: Bounds) -> TileCoverage:
    common = tile.posts.bounds.overlap(bounds)
    assert common is not None
    heights_m = tile.read(_within(common, tile.posts, _COVERAGE_POSTS_MAX))
    known_m = heights_m[np.isfinite(heights_m)]
    known, share = known_m.size / heights_m.size, common.area_deg2 / bounds.area_deg2
    shares = share * known, share * (1.0 - known)
    extremes = (float(known_m.min()), float(known_m.max())) if known else (None, None)
    return TileCoverage(tile.path, tile.posts.step_north_deg * _METRES_PER_DEG, *shares, *extremes)
