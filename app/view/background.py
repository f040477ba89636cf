"""The background map: raster tiles of a file or of a server, each read on request, or one image with its bounds."""

from __future__ import annotations

import hashlib
import os
import sqlite3
import string
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, ProxyHandler, Request, build_opener

from sidelong.app.errors import InputError, missing_package
from sidelong.app.link.message import plain

_PICTURE_MAX_BYTES, _TILE_MAX_BYTES, _ZOOM_MAX = 64 << 20, 16 << 20, 24
_OPEN_WITHIN_S, _TILE_WITHIN_S = 10.0, 0.5
_ANSWER_WITHIN_S, _RETRY_AFTER_S = 5.0, 10.0  # of a tile server
_KEPT_MAX_BYTES, _URL_ZOOMS = 1 << 30, (0, 19)
_STEPS = 10_000  # of SQLite's machine between two looks at the clock: well below a millisecond
_FORMATS = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"), (b"RIFF", "image/webp"))
_URL_SUCH_AS = "such as http://127.0.0.1:8080/{z}/{x}/{y}.png, with {z}, {x} and {y} once each"
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
        found: bytes | None = self._reader.get(zoom, column, row)
        return found

    def any_tile(self) -> bytes:
        return next((bytes(data) for _, data in self._every()), b"")


class _NoRedirect(HTTPRedirectHandler):
    def redirect_request(self, *_: object, **__: object) -> None:
        return None


class UrlTiles:
    """Tiles of a server, each requested once and kept in an .mbtiles file: the map remains without the server.

    Requests go to the configured address alone, by no proxy and no redirect. Raises sqlite3.Error, OSError: the file
    cannot be written.
    """

    _opener = build_opener(ProxyHandler({}), _NoRedirect)

    def __init__(self, template: str, file: Path) -> None:
        self._template = template
        self._retry_s = 0.0  # no request before: the server did not answer
        self._missing: set[tuple[int, int, int]] = set()  # the server has none
        self._database = sqlite3.connect(file, isolation_level=None)
        self._database.execute(f"pragma max_page_count = {_KEPT_MAX_BYTES // 4096}")  # then no more are kept
        columns = "zoom_level integer, tile_column integer, tile_row integer, tile_data blob"
        key = "primary key (zoom_level, tile_column, tile_row)"
        self._database.execute(f"create table if not exists tiles ({columns}, {key})")
        self.tile = MbTiles(file).tile

    def request(self, zoom: int, column: int, row: int) -> bytes | None:
        """Request a tile from the server, within seconds; None: it has none, or did not answer. For a thread."""
        place = zoom, column, row
        if place in self._missing or time.monotonic() < self._retry_s:
            return None
        url = self._template.format(z=zoom, x=column, y=row)
        try:
            asked = Request(url, headers={"User-Agent": "sidelong"})
            with self._opener.open(asked, timeout=_ANSWER_WITHIN_S) as answer:
                data: bytes = answer.read(_TILE_MAX_BYTES)
        except HTTPError:
            data = b""
        except (OSError, ValueError):  # of the link; a malformed answer
            self._retry_s = time.monotonic() + _RETRY_AFTER_S
            return None
        if media_type(data) is None:
            self._missing.add(place)
            return None
        return data

    def keep(self, zoom: int, column: int, row: int, data: bytes) -> None:
        """Keep a tile for later. Raises sqlite3.Error: the file is full or cannot be written."""
        self._database.execute(
            "insert or replace into tiles values (?, ?, ?, ?)", (zoom, column, (1 << zoom) - 1 - row, data)
        )


Tiles = MbTiles | PmTiles | UrlTiles
_OPENERS: dict[str, Callable[[Path], MbTiles | PmTiles]] = {".mbtiles": MbTiles, ".pmtiles": PmTiles}


@dataclass(frozen=True, slots=True)
class Background:
    """A map's file. bounds_deg: of a picture, (south, west, north, east); zooms: of tiles, (least, greatest).

    url: template of a tile server, whose tiles are kept in the file.
    """

    path: Path
    bounds_deg: tuple[float, float, float, float] | None = None
    zooms: tuple[int, int] | None = None
    url: str | None = None

    def opened(self) -> Tiles | None:
        if self.url is not None:
            return UrlTiles(self.url, self.path)
        return _OPENERS[self.path.suffix.lower()](self.path) if self.zooms is not None else None


def readable_tile(tiles: Tiles, zoom: int, column: int, row: int) -> bytes | None:
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


def tile_server(template: str) -> Background:
    """Return the map of a tile server, kept in a file of the user's cache folder. Raises InputError."""
    try:
        names = sorted(name for _, name, _, _ in string.Formatter().parse(template) if name is not None)
        address = urlsplit(template)
    except ValueError as error:
        raise InputError(f"{template!r} is no URL ({error}); give one {_URL_SUCH_AS}.") from error
    if names != ["x", "y", "z"] or address.scheme not in ("http", "https") or not address.hostname:
        raise InputError(f"{template!r} is no URL of raster tiles; give one {_URL_SUCH_AS}.")
    folder = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "sidelong" / "tiles"
    path = folder / f"{address.hostname}-{hashlib.sha256(template.encode()).hexdigest()[:8]}.mbtiles"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        UrlTiles(template, path)
    except (OSError, sqlite3.Error) as error:
        raise InputError(f"its tiles cannot be kept in {path} ({error}); set XDG_CACHE_HOME.") from error
    return Background(path, zooms=_URL_ZOOMS, url=template)


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
    return next((media for begin, media in _FORMATS if data.startswith(begin)), None)


def is_tile(zoom: int, column: int, row: int) -> bool:
    return 0 <= zoom <= _ZOOM_MAX and max(column, row) < 1 << zoom and min(column, row) >= 0
