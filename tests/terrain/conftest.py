"""Real ground: the elevation model that matplotlib ships, 30 x 32 km of Tennessee's hills at 3 arc seconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib import cbook

from app.terrain.elevation_data import ElevationData
from estimators.frames import LocalPlane
from estimators.terrain.ground import Ground

HOME_DEG = (36.59, -84.24)
SIDE, VOID = 1201, -32768


def hills() -> tuple[np.ndarray, int, int]:
    """Heights above sea (rows from the north), and the row and column of an N36W085 tile where they begin."""
    with cbook.get_sample_data("jacksboro_fault_dem.npz") as data:
        north_deg, west_deg, step_deg = float(data["ymin"]), float(data["xmin"]), float(data["dx"])
        row, column = (37.0 - north_deg) / step_deg + 0.5, (west_deg + 85.0) / step_deg + 0.5
        return data["elevation"].astype(np.int16), round(row), round(column)


@pytest.fixture(scope="session")
def tile_heights() -> np.ndarray:
    """A whole tile, void but for the hills."""
    heights, row, column = hills()
    tile = np.full((SIDE, SIDE), VOID, np.int16)
    tile[row : row + heights.shape[0], column : column + heights.shape[1]] = heights
    return tile


@pytest.fixture(scope="session")
def hills_folder(tile_heights: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dem")
    tile_heights.astype(">i2").tofile(folder / "N36W085.hgt")
    return folder


@pytest.fixture(scope="session")
def plane() -> LocalPlane:
    return LocalPlane(*HOME_DEG)


@pytest.fixture(scope="session")
def ground(hills_folder: Path, plane: LocalPlane) -> Ground:
    return ElevationData(hills_folder).ground(plane, HOME_DEG, 4.0)
