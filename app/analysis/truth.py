"""The true tracks of target and aircraft, as a simulation writes them beside its telemetry."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from app.analysis.score import Moment
from app.errors import InputError
from estimators.frames import LocalPlane

_POSITION_COLUMNS = ("target_lat_deg", "target_lon_deg", "uav_lat_deg", "uav_lon_deg")
_GROUND_COLUMNS = ("clearance_m", "in_sight")
_COLUMNS = ("time_boot_s", *_POSITION_COLUMNS)
_FILE_MAX_BYTES = 64 << 20  # three days at 10 Hz
_LINE_MAX_CHARACTERS = 4096
_GREATEST = 1e10  # no time in seconds and no angle in degrees is that great
_GAP_MAX_S = 10.0  # nothing is known of a longer time between two rows
_VELOCITY_SPAN_S = 1.0  # the file's millimetres are too coarse to difference neighbouring rows


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Rows in order of time.

    time_s has shape (n,), n >= 2, on the vehicle's clock; positions_deg has shape (4, n): target latitude and
    longitude, aircraft latitude and longitude. ground has shape (2, n): the aircraft's height over the ground below
    it in metres, and 1 where it sees the target; NaN where the file does not tell.
    """

    time_s: npt.NDArray[np.float64]
    positions_deg: npt.NDArray[np.float64]
    ground: npt.NDArray[np.float64]

    def at(self, time_s: float, plane: LocalPlane) -> Moment | None:
        """Return both at ``time_s``, interpolated between rows; None outside the file's time and in its gaps."""
        if not self.time_s[0] <= time_s <= self.time_s[-1]:
            return None
        following = int(np.searchsorted(self.time_s, time_s))
        gap_s = self.time_s[following] - self.time_s[max(following - 1, 0)]
        if gap_s > _GAP_MAX_S and self.time_s[following] != time_s:
            return None
        target_east_m, target_north_m, aircraft_east_m, aircraft_north_m = self._positions_m(time_s, plane)
        before_s = max(time_s - _VELOCITY_SPAN_S / 2, float(self.time_s[0]))
        after_s = min(time_s + _VELOCITY_SPAN_S / 2, float(self.time_s[-1]))
        before, after = self._positions_m(before_s, plane), self._positions_m(after_s, plane)
        return Moment(
            time_s,
            aircraft_east_m,
            aircraft_north_m,
            target_east_m,
            target_north_m,
            (after[0] - before[0]) / (after_s - before_s),
            (after[1] - before[1]) / (after_s - before_s),
        )

    def over_ground(self, start_s: float) -> tuple[float | None, float | None]:
        """Return the share of the rows since ``start_s`` that see the target, and the least height over the ground.

        None where no row tells.
        """
        clearance_m, in_sight = self.ground[:, self.time_s >= start_s]
        seen, heights_m = in_sight[np.isfinite(in_sight)], clearance_m[np.isfinite(clearance_m)]
        return float(seen.mean()) if seen.size else None, float(heights_m.min()) if heights_m.size else None

    def moments(self, plane: LocalPlane, start_s: float, end_s: float, step_s: float) -> Iterator[Moment]:
        """Yield both at every ``step_s`` from ``start_s`` to ``end_s``, as far as the file reaches, without gaps."""
        begin_s, end_s = max(start_s, float(self.time_s[0])), min(end_s, float(self.time_s[-1]))
        if not begin_s < end_s:
            return
        rows_s = np.clip(self.time_s, begin_s, end_s)
        step = np.ceil((rows_s - begin_s) / step_s).astype(np.int64)
        # From row to row, so that damaged times make no more moments than there are rows to make them of.
        for row in np.flatnonzero((np.diff(step) > 0) & (np.diff(self.time_s) <= _GAP_MAX_S)).tolist():
            for number in range(int(step[row]), int(step[row + 1])):
                moment = self.at(begin_s + number * step_s, plane)
                if moment is not None:
                    yield moment

    def _positions_m(self, time_s: float, plane: LocalPlane) -> tuple[float, float, float, float]:
        target_latitude, target_longitude, latitude, longitude = (
            float(np.interp(time_s, self.time_s, column)) for column in self.positions_deg
        )
        return *plane.east_north_m(target_latitude, target_longitude), *plane.east_north_m(latitude, longitude)


def read_truth(path: Path) -> Truth:
    """Read a truth file; rows that are cut or no numbers are passed over, further columns as well.

    Raises InputError when it cannot be read, lacks a column or has fewer than two rows.
    """
    rows: dict[float, list[float]] = {}
    try:
        if path.stat().st_size > _FILE_MAX_BYTES:
            raise InputError(
                f"{path} is longer than {_FILE_MAX_BYTES >> 20} MiB; give the truth of a shorter flight."
            )
        with path.open(encoding="utf-8", errors="replace", newline="\n") as file:
            columns = file.readline(_LINE_MAX_CHARACTERS).strip().split(",")
            missing = [name for name in _COLUMNS if name not in columns]
            if missing:
                raise InputError(f"{path} is no truth file: it lacks the column {missing[0]}.")
            places = [columns.index(name) for name in _COLUMNS]
            told = all(name in columns for name in _GROUND_COLUMNS)
            ground_places = [columns.index(name) for name in _GROUND_COLUMNS] if told else []
            while line := file.readline(_LINE_MAX_CHARACTERS):
                texts = line.split(",")
                row = _row(texts, places)
                if row is not None:
                    rows[row[0]] = row[1:] + (_row(texts, ground_places) or [math.nan, math.nan])
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from error
    if len(rows) < 2:
        raise InputError(f"{path} has fewer than two rows with times and positions.")
    time_s = np.array(sorted(rows))
    positions_deg, ground = np.split(np.array([rows[time] for time in time_s]).T, [len(_POSITION_COLUMNS)])
    positions_deg[1::2] = np.unwrap(positions_deg[1::2], period=360.0)
    return Truth(time_s, positions_deg, ground)


def _row(texts: list[str], places: list[int]) -> list[float] | None:
    try:
        row = [float(texts[place]) for place in places]
    except (IndexError, ValueError):
        return None
    sane = all(map(math.isfinite, row)) and all(abs(value) <= _GREATEST for value in row)
    return row if sane else None
