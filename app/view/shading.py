"""Pictures in files for the page: a shaded relief of the ground under the map, and what a camera films."""

from __future__ import annotations

import io
import math
import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import png

from sidelong.app.assembly import ground_of
from sidelong.app.config import Config
from sidelong.app.errors import InputError
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.terrain.ground import Ground

_EVERY_S = 0.2  # between two pictures of a camera
_REACH_M, _END_S = 15_000.0, 5.0
_PIXELS_MAX = 1200  # each way
_STEEPER = 2.0  # gentle hills would hardly be seen
_LIGHT_FROM_RAD, _LIGHT_ABOVE_RAD = math.radians(315.0), math.radians(45.0)
_OPACITY_MAX, _LEVEL_GREY = 0.7, 0.25


class PictureFile:
    """A picture in a file until ``close``: of a camera, a line of JSON with what is drawn on it, then its JPEG.

    The page's server answers from the file: a slow browser delays nothing.
    """

    def __init__(self, name: str = "picture") -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="sidelong-"))
        self.file, self._next_s = self._folder / name, 0.0

    def put(self, picture: Callable[[], bytes]) -> None:
        """Replace the picture, at most five times a second. Raises OSError."""
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + _EVERY_S
            whole = self.file.with_suffix(".new")
            whole.write_bytes(picture())
            whole.replace(self.file)

    def close(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)


class Shading(PictureFile):
    """The ground, read in a thread, and its picture; ``edges_m`` (west, south, east, north) once that is there."""

    def __init__(self, config: Config, plane: LocalPlane) -> None:
        self.edges_m: tuple[float, float, float, float] | None = None
        self.ground: Ground | None = None
        super().__init__("shade.png")
        self._announced = False
        self._maker = threading.Thread(target=self._make, args=(config, plane), daemon=True)
        self._maker.start()

    def is_new(self) -> bool:
        """Return True once, when the image is ready."""
        new = self.edges_m is not None and not self._announced
        self._announced |= new
        return new

    def close(self) -> None:
        self._maker.join(_END_S)
        super().close()

    def _make(self, config: Config, plane: LocalPlane) -> None:
        try:
            self.ground = ground_of(config, plane, None)
        except InputError:
            return  # the flight itself refuses it in words
        if self.ground is not None:
            shade = hillshade(self.ground, _REACH_M)
            self.file.write_bytes(shade.png)
            self.edges_m = shade.edges_m


class Hillshade(NamedTuple):
    """A PNG, north up, and its edges in the plane: black away from the light, white towards it, slopes less clear.

    Level ground is a little grey, so that gentle slopes towards the light show on a bright page too; voids are clear.
    """

    png: bytes
    edges_m: tuple[float, float, float, float]


def hillshade(ground: Ground, reach_m: float = math.inf) -> Hillshade:
    """Return the shading of the ground, or of that within ``reach_m`` of the plane's origin each way."""
    rows = _posts_within(ground.south_m, ground.step_north_m, ground.heights_m.shape[0], reach_m)
    columns = _posts_within(ground.west_m, ground.step_east_m, ground.heights_m.shape[1], reach_m)
    thin = max(1, math.ceil(max(len(rows), len(columns)) / _PIXELS_MAX))
    rows, columns = rows[::thin], columns[::thin]
    heights_m = _STEEPER * ground.heights_m[rows[0] : rows[-1] + 1 : thin, columns[0] : columns[-1] + 1 : thin]
    step_east_m, step_north_m = thin * ground.step_east_m, thin * ground.step_north_m
    slope_north, slope_east = np.gradient(heights_m, step_north_m, step_east_m)
    towards_light = slope_east * math.sin(_LIGHT_FROM_RAD) + slope_north * math.cos(_LIGHT_FROM_RAD)
    level = math.sin(_LIGHT_ABOVE_RAD)
    lit = (level - math.cos(_LIGHT_ABOVE_RAD) * towards_light) / np.sqrt(1.0 + slope_east**2 + slope_north**2)
    change = np.where(lit > level, (lit - level) / (1.0 - level), lit / level - 1.0) - _LEVEL_GREY
    change = np.nan_to_num(change)
    pixels = np.zeros((*change.shape, 4), np.uint8)
    pixels[..., :3] = np.where(change > 0.0, 255, 0)[..., None]
    pixels[..., 3] = np.rint(255.0 * _OPACITY_MAX * np.abs(np.clip(change, -1.0, 1.0)))
    height, width, _ = pixels.shape
    picture = io.BytesIO()
    png.Writer(width, height, greyscale=False, alpha=True).write(picture, np.flipud(pixels).reshape(height, -1))
    # A pixel reaches half a step about its post.
    first_m, last_m = (
        (ground.west_m + columns[k] * ground.step_east_m, ground.south_m + rows[k] * ground.step_north_m)
        for k in (0, -1)
    )
    half_m = 0.5 * step_east_m, 0.5 * step_north_m
    edges_m = first_m[0] - half_m[0], first_m[1] - half_m[1], last_m[0] + half_m[0], last_m[1] + half_m[1]
    return Hillshade(picture.getvalue(), edges_m)


def _posts_within(first_m: float, step_m: float, count: int, reach_m: float) -> range:
    """Return the posts of one axis within reach of its origin, two at least."""
    if math.isinf(reach_m):
        return range(count)
    first = min(max(math.ceil((-reach_m - first_m) / step_m), 0), count - 2)
    last = min(max(math.floor((reach_m - first_m) / step_m), first + 1), count - 1)
    return range(first, last + 1)
