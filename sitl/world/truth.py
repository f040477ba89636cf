"""What really happened, in the columns of the recorded truth files."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TextIO

HEADER = (
    "time_boot_s,target_east_m,target_north_m,target_lat_deg,target_lon_deg,uav_lat_deg,uav_lon_deg,"
    "uav_relative_alt_m,slant_range_m,bearing_deg,laser_valid,laser_outlier,target_height_m,clearance_m,in_sight,target"
)
_FLUSH_S = 1.0


@dataclass(frozen=True, slots=True)
class TruthRow:
    """Target and aircraft at one moment of the vehicle's clock."""

    time_s: float
    target_m: tuple[float, float, float]
    target_deg: tuple[float, float]
    aircraft_m: tuple[float, float, float]
    aircraft_deg: tuple[float, float]
    slant_range_m: float
    bearing_rad: float  # of the target from the aircraft
    laser_valid: bool
    laser_outlier: bool
    clearance_m: float | None  # of the aircraft over the ground below it; None where that is not known, as in_sight
    in_sight: bool | None
    target: str = ""  # the name of the one that the payload looks at

    def line(self) -> str:
        """Return the row as CSV, without line feed."""
        clearance = "" if self.clearance_m is None else f"{self.clearance_m:.2f}"
        in_sight = "" if self.in_sight is None else f"{self.in_sight:d}"
        return (
            f"{self.time_s:.3f},{self.target_m[0]:.3f},{self.target_m[1]:.3f},"
            f"{self.target_deg[0]:.8f},{self.target_deg[1]:.8f},{self.aircraft_deg[0]:.8f},{self.aircraft_deg[1]:.8f},"
            f"{self.aircraft_m[2]:.2f},{self.slant_range_m:.3f},{math.degrees(self.bearing_rad):.4f},"
            f"{int(self.laser_valid)},{int(self.laser_outlier)},"
            f"{self.target_m[2]:.2f},{clearance},{in_sight},{self.target}"
        )


class TruthFile:
    """Writes rows to a file, flushed at least once a simulated second.

    A write error ends the writing, not the flight; on_trouble receives it once.
    """

    def __init__(self, file: TextIO, on_trouble: Callable[[str], object] = lambda _text: None) -> None:
        self._file: TextIO | None = file
        self._on_trouble = on_trouble
        self._flushed_s = -math.inf
        self._append(HEADER + "\n", flush=True)

    def write(self, row: TruthRow) -> None:
        if flush := abs(row.time_s - self._flushed_s) >= _FLUSH_S:
            self._flushed_s = row.time_s
        self._append(row.line() + "\n", flush)

    def _append(self, text: str, flush: bool) -> None:
        if self._file is None:
            return
        try:
            self._file.write(text)
            if flush:
                self._file.flush()
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.close()  # or it would be tried again at the end
            self._file = None
            self._on_trouble(f"the truth is not written any more: {error.strerror}")
