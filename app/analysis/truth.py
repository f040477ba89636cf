"""The true tracks of target and aircraft, as a simulation writes them alongside its telemetry."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np
import numpy.typing as npt

from sidelong.app.analysis.score import Moment
from sidelong.app.errors import InputError
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.path import FloatArray

_POSITION_COLUMNS = ("target_lat_deg", "target_lon_deg", "uav_lat_deg", "uav_lon_deg")
_GROUND_COLUMNS = ("clearance_m", "in_sight")
_NAME_COLUMN = "target"
_COLUMNS = ("time_boot_s", *_POSITION_COLUMNS)
_FILE_MAX_BYTES = 64 << 20  # three days at 10 Hz
_LINE_MAX_CHARACTERS = 4096
_GREATEST = 1e10  # no time in seconds and no angle in degrees is that great
_GAP_MAX_S = 10.0  # nothing is known of a longer time between two rows
_COMPARED, _SAME_FLIGHT_M = 50, 500.0  # places of the aircraft; farther apart, it is another flight
_VELOCITY_SPAN_S = 1.0  # the file's millimetres are too coarse to difference neighbouring rows


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Rows in order of the vehicle's clock, n >= 2.

    Attributes:
        positions_deg: target latitude and longitude, aircraft latitude and longitude, shape (4, n).
        ground: the aircraft's height above ground, m, and 1 where it sees the target, shape (2, n); NaN: no value.
        target: the name of the target that the payload looks at, shape (n,); '' where the file has no value.
    """

    time_s: FloatArray
    positions_deg: FloatArray
    ground: FloatArray
    target: npt.NDArray[np.str_]

    def at(self, time_s: float, plane: LocalPlane) -> Moment | None:
        """Return aircraft and target at ``time_s``, interpolated; None outside the file's time and in gaps."""
        return next(iter(self.at_each((time_s,), plane)), None)

    def at_each(self, times_s: Sequence[float], plane: LocalPlane) -> list[Moment]:
        """Return aircraft and target at ascending times, without those outside the file's time or in gaps."""
        rows_s, asked_s = self.time_s, np.asarray(times_s, np.float64)
        asked_s = asked_s[(asked_s >= rows_s[0]) & (asked_s <= rows_s[-1])]
        following = np.searchsorted(rows_s, asked_s)
        in_gap = rows_s[following] - rows_s[np.maximum(following - 1, 0)] > _GAP_MAX_S
        asked_s = asked_s[~in_gap | (rows_s[following] == asked_s)]
        before_s = np.maximum(asked_s - _VELOCITY_SPAN_S / 2, rows_s[0])
        after_s = np.minimum(asked_s + _VELOCITY_SPAN_S / 2, rows_s[-1])
        names = np.stack([self._names(span_s) for span_s in (before_s, asked_s, after_s)])
        one = (names == names[1]).all(axis=0)  # while it turns from one to another nothing is known
        asked_s, before_s, after_s, names = asked_s[one], before_s[one], after_s[one], names[1, one]
        target, aircraft = self._places_m(asked_s, slice(0, 2), plane), self._places_m(asked_s, slice(2, 4), plane)
        before, after = (self._places_m(span_s, slice(0, 2), plane) for span_s in (before_s, after_s))
        velocity_m_s = (after - before) / (after_s - before_s)[:, None]
        columns = asked_s[:, None], aircraft, target, velocity_m_s
        rows = np.concatenate(columns, axis=1).tolist()
        return [replace(Moment(*row), target=name) for row, name in zip(rows, names.tolist(), strict=True)]

    def _names(self, time_s: FloatArray) -> npt.NDArray[np.str_]:
        return self.target[np.clip(np.searchsorted(self.time_s, time_s), 0, len(self.time_s) - 1)]

    def over_ground(self, start_s: float) -> tuple[float | None, float | None]:
        """Return the share of rows since ``start_s`` that see the target, and the least clearance, m; or None."""
        clearance_m, in_sight = self.ground[:, self.time_s >= start_s]
        seen, heights_m = in_sight[np.isfinite(in_sight)], clearance_m[np.isfinite(clearance_m)]
        return float(seen.mean()) if seen.size else None, float(heights_m.min()) if heights_m.size else None

    def moments(self, plane: LocalPlane, start_s: float, end_s: float, step_s: float) -> list[Moment]:
        """Return aircraft and target every ``step_s`` from ``start_s`` to ``end_s``, where the file has them."""
        begin_s, end_s = max(start_s, float(self.time_s[0])), min(end_s, float(self.time_s[-1]))
        if not begin_s < end_s:
            return []
        rows_s = np.clip(self.time_s, begin_s, end_s)
        step = np.ceil((rows_s - begin_s) / step_s).astype(np.int64)
        # Iterate over rows, so that damaged times cannot produce more moments than there are rows.
        rows = np.flatnonzero((np.diff(step) > 0) & (np.diff(self.time_s) <= _GAP_MAX_S)).tolist()
        numbers = (number for row in rows for number in range(int(step[row]), int(step[row + 1])))
        return self.at_each([begin_s + number * step_s for number in numbers], plane)

    def require_same_flight(self, places: Sequence[tuple[float, float, float]], plane: LocalPlane) -> None:
        """Raise InputError if the aircraft was elsewhere in this truth; places: time, s, and east and north, m."""
        apart_m = [
            math.hypot(true.aircraft_east_m - east_m, true.aircraft_north_m - north_m)
            for time_s, east_m, north_m in places[:: max(len(places) // _COMPARED, 1)]
            if (true := self.at(time_s, plane)) is not None
        ]
        if apart_m and median(apart_m) > _SAME_FLIGHT_M:
            raise InputError(
                f"--truth: it is of another flight: the aircraft is {median(apart_m) / 1e3:.1f} km from where the "
                "log has it; give the truth of this flight."
            )

    def _places_m(self, time_s: FloatArray, columns: slice, plane: LocalPlane) -> FloatArray:
        """Return these two columns (degrees) as positions in the plane, shape (n, 2), at times of shape (n,)."""
        degrees = np.array([np.interp(time_s, self.time_s, column) for column in self.positions_deg[columns]]).T
        return np.array([plane.east_north_m(*place) for place in degrees.tolist()]).reshape(-1, 2)


def read_truth(path: Path) -> Truth:
    """Read a truth file; rows that are cut or no numbers are passed over. Raises InputError when it is none."""
    rows: dict[float, list[float]] = {}
    names: dict[float, str] = {}
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise InputError(f"{path} is no file; give a CSV file with the true track.")
        if path.stat().st_size > _FILE_MAX_BYTES:
            raise InputError(
                f"{path} is longer than {_FILE_MAX_BYTES >> 20} MiB; give the truth of a shorter flight."
            )
        with path.open(encoding="utf-8", errors="replace", newline="\n") as file:
            columns = file.readline(_LINE_MAX_CHARACTERS).strip().split(",")
            missing = [name for name in _COLUMNS if name not in columns]
            if missing:
                raise InputError(f"{path} is no truth file: it lacks the column {missing[0]}.")
            while line := file.readline(_LINE_MAX_CHARACTERS):
                texts = dict(zip(columns, line.split(","), strict=False))
                row = _row(texts, _COLUMNS)
                if row is not None:
                    rows[row[0]] = row[1:] + (_row(texts, _GROUND_COLUMNS) or [math.nan, math.nan])
                    names[row[0]] = texts.get(_NAME_COLUMN, "").strip()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); give a CSV file with the true track.") from error
    if len(rows) < 2:
        raise InputError(f"{path} has fewer than two rows with times and positions.")
    time_s = np.array(sorted(rows))
    positions_deg, ground = np.split(np.array([rows[time] for time in time_s]).T, [len(_POSITION_COLUMNS)])
    positions_deg[1::2] = np.unwrap(positions_deg[1::2], period=360.0)
    return Truth(time_s, positions_deg, ground, np.array([names[time] for time in time_s]))


def truth_if_whole(path: Path | None, until_s: float, announce: Callable[[str], object]) -> Truth | None:
    """Return the truth of a run that ended at a time of the vehicle's clock, None where it does not cover the run."""
    if path is None or not path.exists():
        return None
    try:
        truth = read_truth(path)
    except InputError as unjudged:
        announce(f"judged by the estimate: {unjudged}")
        return None
    early_s = until_s - float(truth.time_s[-1])
    if early_s > _GAP_MAX_S:
        announce(f"judged by the estimate: {path} ends {early_s:.0f} s before the flight")
        return None
    return truth


def _row(texts: dict[str, str], columns: Sequence[str]) -> list[float] | None:
    try:
        row = [float(texts[name]) for name in columns]
    except (KeyError, ValueError):
        return None
    return row if all(abs(value) <= _GREATEST for value in row) else None  # NaN is not, either
