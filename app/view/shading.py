"""A shaded relief image of the ground under the map, computed in a separate thread."""

from __future__ import annotations

import shutil
import tempfile
import threading
from pathlib import Path

from sidelong.app.assembly import ground_of
from sidelong.app.config import Config
from sidelong.app.errors import InputError
from sidelong.app.terrain.hillshade import hillshade
from sidelong.estimators.frames import LocalPlane

_REACH_M, _END_S = 15_000.0, 5.0


class Shading:
    """A picture in a file of its own until ``close``; ``edges_m`` (west, south, east, north) once it is there."""

    def __init__(self, config: Config, plane: LocalPlane) -> None:
        self.edges_m: tuple[float, float, float, float] | None = None
        self._folder = Path(tempfile.mkdtemp(prefix="sidelong-"))
        self.file = self._folder / "shade.png"
        self._announced = False
        self._maker = threading.Thread(target=self._make, args=(config, plane), daemon=True)
        self._maker.start()

    def is_new(self) -> bool:
        """Return True once, when the image is ready."""
        new = self.edges_m is not None and not self._announced
        self._announced |= new
        return new

    def close(self) -> None:
        """Remove the file."""
        self._maker.join(_END_S)
        shutil.rmtree(self._folder, ignore_errors=True)

    def _make(self, config: Config, plane: LocalPlane) -> None:
        try:
            ground = ground_of(config, plane, None)
        except InputError:
            return  # the flight itself refuses it in words
        if ground is not None:
            shade = hillshade(ground, _REACH_M)
            self.file.write_bytes(shade.png)
            self.edges_m = (shade.west_m, shade.south_m, shade.east_m, shade.north_m)
