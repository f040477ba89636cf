"""What really happened, in the columns of the recorded truth files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TextIO

HEADER = (
    "time_boot_s,target_east_m,target_north_m,target_lat_deg,target_lon_deg,uav_lat_deg,uav_lon_deg,"
    "uav_relative_alt_m,slant_range_m,bearing_deg,laser_valid,laser_outlier,target_height_m,clearance_m,in_sight"
)
_FLUSH_S = 1.0


@dataclass(frozen=True, slots=True)
class TruthRow:
    """Target and aircraft at one moment of the vehicle's clock. bearing_rad is the target's, from the aircraft.

    clearance_m is the aircraft's height over the ground below it.
    """

    time_s: float
    target_m: tuple[float, float, float]
    target_deg: tuple[float, float]
    aircraft_m: tuple[float, float, float]
    aircraft_deg: tuple[float, float]
    slant_range_m: float
    bearing_rad: float
    laser_valid: bool
    laser_outlier: bool
    clearance_m: float
    in_sight: bool

    def line(self) -> str:
        return (
            f"{self.time_s:.3f},{self.target_m[0]:.3f},{self.target_m[1]:.3f},"
            f"{self.target_deg[0]:.8f},{self.target_deg[1]:.8f},{self.aircraft_deg[0]:.8f},{self.aircraft_deg[1]:.8f},"
            f"{self.aircraft_m[2]:.2f},{self.slant_range_m:.3f},{math.degrees(self.bearing_rad):.4f},"
            f"{int(self.laser_valid)},{int(self.laser_outlier)},"
            f"{self.target_m[2]:.2f},{self.clearance_m:.2f},{int(self.in_sight)}"
        )


class TruthFile:
    """Writes rows to a file, flushed at least once a simulated second."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._flushed_s = -math.inf
        file.write(HEADER + "\n")

    def write(self, row: TruthRow) -> None:
        self._file.write(row.line() + "\n")
        if abs(row.time_s - self._flushed_s) >= _FLUSH_S:
            self._file.flush()
            self._flushed_s = row.time_s
