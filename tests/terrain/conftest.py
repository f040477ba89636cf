"""Real ground: the elevation model that matplotlib ships, 30 x 32 km of Tennessee's hills at 3 arc seconds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from matplotlib import cbook
from scipy.ndimage import gaussian_filter

from sidelong.app.simulation.target import RandomTarget
from sidelong.app.terrain.elevation_data import ElevationData
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import GimbalReading, PositionReading, RangeReading, Source
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.tracking.tracker import Tracker, TrackerSettings

HOME_DEG = (36.59, -84.24)
SIDE, VOID = 1201, -32768
LASER = Source("DISTANCE_SENSOR", 154, 1, 100)
GIMBAL = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)


def hills() -> tuple[np.ndarray, int, int]:
    """Heights above sea (rows from the north), and the row and column of an N36W085 tile where they begin."""
    with cbook.get_sample_data("jacksboro_fault_dem.npz") as data:
        north_deg, west_deg, step_deg = float(data["ymin"]), float(data["xmin"]), float(data["dx"])
        row, column = (37.0 - north_deg) / step_deg + 0.5, (west_deg + 85.0) / step_deg + 0.5
        return data["elevation"].astype(np.int16), round(row), round(column)


def tile_of_hills() -> np.ndarray:
    """Return a whole tile, void but for the hills."""
    heights, row, column = hills()
    tile = np.full((SIDE, SIDE), VOID, np.int16)
    tile[row : row + heights.shape[0], column : column + heights.shape[1]] = heights
    return tile


def write_hills(folder: Path) -> None:
    """Write the hills as elevation data into a folder."""
    tile_of_hills().astype(">i2").tofile(folder / "N36W085.hgt")


@pytest.fixture(scope="session")
def tile_heights() -> np.ndarray:
    return tile_of_hills()


@pytest.fixture(scope="session")
def hills_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dem")
    write_hills(folder)
    return folder


@pytest.fixture(scope="session")
def plane() -> LocalPlane:
    return LocalPlane(*HOME_DEG)


@pytest.fixture(scope="session")
def ground(hills_folder: Path, plane: LocalPlane) -> Ground:
    return ElevationData(hills_folder).ground(plane, HOME_DEG, 4.0)


@dataclass(frozen=True)
class LaserOut:
    """A target of straight legs and stops over hills, circled 280 m away, 140 m above where it began.

    The tracker is reported elevation data with an error of their own; from OUT_S on there is no range any more.
    """

    true: Ground
    OUT_S: ClassVar[float] = 45.0

    def flown(self, seed: int, *, grounded: bool = True, filter_name: str = "imm") -> tuple[float, float]:
        """Return the RMSE over the minute without a range, m, and the share of it within the 95 % ellipse."""
        rng = np.random.default_rng(seed)
        error_m = gaussian_filter(rng.standard_normal(self.true.heights_m.shape), 3.0)
        given = replace(self.true, heights_m=self.true.heights_m + (4.0 / error_m.std() * error_m).astype(np.float32))
        begin_m = self._somewhere(rng)
        target = RandomTarget(rng, 200.0, 3.0, (30.0, 90.0))
        tracker = Tracker(TrackerSettings(filter=filter_name))
        if grounded:
            tracker.stand_on(given)
        yaw_rad, pitch_rad = rng.normal(0.0, math.radians(0.5), 2)
        phase_rad, height_m = rng.uniform(0.0, 2.0 * math.pi), self.true.height_m(*begin_m) + 140.0
        squares, inside, last = [], [], None
        for k in range(round((self.OUT_S + 60.0) * 10)):
            time_s = 0.1 * k
            truth = target.at(time_s)
            place = np.array((begin_m[0] + truth.east_m, begin_m[1] + truth.north_m))
            target_m = (*place, self.true.height_m(*place))
            angle_rad = phase_rad + time_s * 15.0 / 80.0
            craft_m = (
                place[0] + 255.0 + 80.0 * math.sin(angle_rad),
                place[1] - 116.0 + 80.0 * math.cos(angle_rad),
                max(height_m, target_m[2] + 40.0),
            )
            velocity = np.zeros(3) if last is None else (np.array(craft_m) - last) / 0.1
            last = np.array(craft_m)
            tracker.add(PositionReading(time_s, *craft_m, *velocity))
            if not self.true.sees(craft_m, (*place, target_m[2] + 1.0)):
                continue
            east_m, north_m = place - craft_m[:2]
            level_m, drop_m = math.hypot(east_m, north_m), craft_m[2] - target_m[2]
            noise = rng.standard_normal(3)
            sigma_rad = math.radians(0.35)
            bearing_rad = math.atan2(east_m, north_m) + yaw_rad + sigma_rad * noise[0]
            depression_rad = math.atan2(drop_m, level_m) - pitch_rad + sigma_rad * noise[1]
            cos_y, sin_y = math.cos(bearing_rad / 2), math.sin(bearing_rad / 2)
            cos_p, sin_p = math.cos(depression_rad / 2), -math.sin(depression_rad / 2)
            looking = (cos_y * cos_p, -sin_y * sin_p, cos_y * sin_p, sin_y * cos_p)
            tracker.add(GimbalReading(time_s, looking, "earth", GIMBAL))
            if time_s < self.OUT_S:
                tracker.add(RangeReading(time_s, math.hypot(level_m, drop_m) + 0.8 * noise[2], LASER))
            elif k % 5 == 0:
                estimate = tracker.estimate(time_s)
                off = np.array((estimate.east_m, estimate.north_m)) - place
                squares.append(off @ off)
                inside.append(off @ np.linalg.solve(estimate.covariance[:2, :2], off) < 5.991)
        return math.sqrt(np.mean(squares)), float(np.mean(inside))

    def _somewhere(self, rng: np.random.Generator) -> tuple[float, float]:
        """A place with ground that is known for a walk in any direction."""
        while True:
            east_m, north_m = rng.uniform(-10_000.0, 10_000.0, 2).tolist()
            about = self.true.heights_at_m(
                east_m + np.array((0.0, -1500.0, 1500.0, 0.0, 0.0)),
                north_m + np.array((0.0, 0.0, 0.0, -1500.0, 1500.0)),
            )
            if np.isfinite(about).all():
                return east_m, north_m


@pytest.fixture(scope="session")
def laser_out(ground: Ground) -> LaserOut:
    return LaserOut(ground)
