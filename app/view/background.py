"""The background map: raster tiles from one file, each read on request, or one image with its bounds."""

from __future__ import annotations

import os
import sqlite3
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from sidelong.app.errors import InputError, missing_package
from sidelong.app.link.message import plain

_PICTURE_MAX_BYTES, _TILE_MAX_BYTES, _ZOOM_MAX = 64 << 20, 16 << 20, 24
_OPEN_WITHIN_S, _TILE_WITHIN_S = 10.0, 0.5
_STEPS = 10_000  # of SQLite's machine between two looks at the clock: well below a millisecond
_FORMATS = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"), (b"RIFF", "image/webp"))
_SUFFIXES = ".mbtiles, .pmtiles, .png, .jpg or .webp"


class MbTiles:
    """Square pictures in Web Mercator of an SQLite file. Raises sqlite3.Error for another file, or a slow query.

    ``tiles`` may be a view, a program of whoever made the file: queries have a time limit, values a size limit.
    """

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _TILE_MAX_BYTES)
        query = "select (select min(zoom_level) from tiles), (select max(zoom_level) from tiles)"  # each by the index
        least, most = self._row(query, (), _OPEN_WITHIN_S) or (0, 0)
        self.zooms = (int(least or 0), int(most or 0))

    def tile(self, zoom: int, column: int, row: int) -> bytes | None:
        """Return a tile, rows counted from north (the file counts from south); None where there is none."""
        query = "select tile_data from tiles where zoom_level = ? and tile_column = ? and tile_row = ?"
        found = self._row(query, (zoom, column, (1 << zoom) - 1 - row), _TILE_WITHIN_S)
        return None if found is None else bytes(found[0])

    def any_tile(self) -> bytes:
        """Return some tile, b'' if there is none."""
        found = self._row("select tile_data from tiles limit 1", (), _OPEN_WITHIN_S)
        return b"" if found is None else bytes(found[0])

    def _row(self, query: str, values: tuple[int, ...], within_s: float) -> tuple[Any, ...] | None:
        """Return a query's first row. Raises sqlite3.OperationalError when it takes longer than ``within_s``."""
        deadline_s = time.monotonic() + within_s
        self._database.set_progress_handler(lambda: time.monotonic() > deadline_s, _STEPS)
        found: tuple[Any, ...] | None = self._database.execute(query, values).fetchone()
        return found


class PmTiles:
    """Raises ImportError without the package pmtiles, and one of many errors where the file is no such thing."""

    def __init__(self, path: Path) -> None:
        from pmtiles.reader import Reader, all_tiles  # noqa: PLC0415  # an extra

        file = path.open("rb", buffering=0)

        def read(offset: int, length: int) -> bytes:
            return os.pread(file.fileno(), length, offset)

        self._reader, self._every = Reader(read), partial(all_tiles, read)
        header: dict[str, Any] = self._reader.header()
        self.zooms = (int(header["min_zoom"]), int(header["max_zoom"]))

    def tile(self, zoom: int, column: int, row: int) -> bytes | None:
        """Return a tile; rows count from the north. None: there is none."""
        found: bytes | None = self._reader.get(zoom, column, row)
        return found

    def any_tile(self) -> bytes:
        """Return some tile, b'' if there is none."""
        return next((bytes(data) for _, data in self._every()), b"")


Tiles = MbTiles | PmTiles
_OPENERS: dict[str, Callable[[Path], Tiles]] = {".mbtiles": MbTiles, ".pmtiles": PmTiles}


@dataclass(frozen=True, slots=True)
class Background:
    """A map's file. bounds_deg: of a picture, (south, west, north, east); zooms: of tiles, (least, greatest)."""

    path: Path
    bounds_deg: tuple[float, float, float, float] | None = None
    zooms: tuple[int, int] | None = None

    def opened(self) -> Tiles | None:
        """Open the file of tiles; None for a single picture."""
        return _OPENERS[self.path.suffix.lower()](self.path) if self.zooms is not None else None


def readable_tile(tiles: Tiles, zoom: int, column: int, row: int) -> bytes | None:
    """Return a tile, None for one that the file has not or that is damaged."""
    try:
        return tiles.tile(zoom, column, row)
    except Exception:  # whatever two readers make of a damaged part
        return None


def background(path: Path, bounds: tuple[float, float, float, float] | None) -> Background:
    """Return a map's file, looked into; bounds: of a picture, S, W, N, E. Raises InputError if it cannot be shown."""
    if not path.is_file():
        raise InputError(f"{path} is no file; give one that ends in {_SUFFIXES}.")
    suffix = path.suffix.lower()
    if suffix not in _OPENERS:
        return _picture(path, bounds)
    if bounds is not None:
        raise InputError("display.map_bounds are of a picture; tiles know where they lie: leave it out.")
    try:
        tiles = _OPENERS[suffix](path)
        data = tiles.any_tile()
    except ImportError:
        raise missing_package(f"{path}", "pmtiles", "give an .mbtiles file") from None
    except Exception as error:  # whatever two readers make of another's bytes
        raise InputError(
            f"{path} is not a {suffix[1:]} file that can be read ({plain(str(error))}); is it whole?"
        ) from error
    if media_type(data) is None:
        raise InputError(f"{path} holds no pictures; give raster tiles (PNG, JPEG or WebP), not vector ones.")
    least, most = tiles.zooms
    if not 0 <= least <= most <= _ZOOM_MAX:
        raise InputError(f"{path} has zooms from {least} to {most}; 0 to {_ZOOM_MAX} make sense.")
    return Background(path, zooms=tiles.zooms)


def _picture(path: Path, bounds: tuple[float, float, float, float] | None) -> Background:
    with path.open("rb") as file:
        start = file.read(16)
    if media_type(start) is None:
        raise InputError(f"{path} is no map that can be shown; give a file that ends in {_SUFFIXES}.")
    if path.stat().st_size > _PICTURE_MAX_BYTES:
        raise InputError(f"{path} is too large for one picture; cut it into tiles (gdal2tiles, .mbtiles).")
    if bounds is None:
        raise InputError(f"{path} does not say where it lies; add display.map_bounds = [S, W, N, E] in degrees.")
    south, west, north, east = bounds
    if -85.0 <= south < north <= 85.0 and -180.0 <= west < east <= 180.0:
        return Background(path, bounds)
    raise InputError(
        f"display.map_bounds: {list(bounds)} is no [S, W, N, E] in degrees such as [47.3, 8.4, 47.5, 8.6]."
    )


def media_type(data: bytes) -> str | None:
    """Return the media type of a picture or vector tile by its first bytes; None: another format."""
    return next((media for begin, media in _FORMATS if data.startswith(begin)), None)


def is_tile(zoom: int, column: int, row: int) -> bool:
    """Return whether the zoom has such a tile."""
    return 0 <= zoom <= _ZOOM_MAX and max(column, row) < 1 << zoom and min(column, row) >= 0
