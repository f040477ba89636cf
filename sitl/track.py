"""A recorded track as a target motion: without GPS spikes, and never faster than a ground vehicle could be."""

from __future__ import annotations

import csv
import datetime
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from sitl.geodesy import HomePlane

_SPIKE_SPEED_M_S = 15.0
_LIVELY_SPEED_M_S = 2.5
_LIVELY_WINDOW_S = 60.0


class TrackError(ValueError):
    """The file cannot be used as a track; the message names it and says why."""


@dataclass(frozen=True, slots=True)
class Track:
    """Points with strictly rising times, relative to the first; at least two."""

    time_s: Sequence[float]
    east_m: Sequence[float]
    north_m: Sequence[float]

    def first_motion_s(self) -> float:
        """Return when the first minute begins that covers ground at a jog; 0 if there is none."""
        length_m = [0.0]
        for i in range(1, len(self.time_s)):
            step_m = math.hypot(self.east_m[i] - self.east_m[i - 1], self.north_m[i] - self.north_m[i - 1])
            length_m.append(length_m[-1] + step_m)
        for i, begin_s in enumerate(self.time_s):
            j = bisect_right(self.time_s, begin_s + _LIVELY_WINDOW_S) - 1
            if length_m[j] - length_m[i] >= _LIVELY_SPEED_M_S * _LIVELY_WINDOW_S:
                return begin_s
        return 0.0


class TrackMotion:
    """Moves along the track, in step with it, but never faster than ``speed_max_m_s``: jumps are walked."""

    __slots__ = ("_arc_m", "_progress_m", "_skip_s", "_speed_max_m_s", "_start_m", "_time_s", "_track")

    def __init__(self, track: Track, start_m: tuple[float, float], speed_max_m_s: float, skip_s: float) -> None:
        self._track = track
        self._skip_s = skip_s
        self._speed_max_m_s = speed_max_m_s
        self._arc_m = [0.0]
        for i in range(1, len(track.time_s)):
            step_m = math.hypot(
                track.east_m[i] - track.east_m[i - 1],
                track.north_m[i] - track.north_m[i - 1],
            )
            self._arc_m.append(self._arc_m[-1] + step_m)
        self._time_s = 0.0
        self._progress_m = self._recorded_arc_m(skip_s)
        first_m = self._position_m(self._progress_m)
        self._start_m = (start_m[0] - first_m[0], start_m[1] - first_m[1])

    def at(self, time_s: float) -> tuple[float, float]:
        reach_m = self._progress_m + self._speed_max_m_s * (time_s - self._time_s)
        self._progress_m = max(self._progress_m, min(reach_m, self._recorded_arc_m(self._skip_s + time_s)))
        self._time_s = time_s
        east_m, north_m = self._position_m(self._progress_m)
        return east_m + self._start_m[0], north_m + self._start_m[1]

    def _recorded_arc_m(self, time_s: float) -> float:
        return _interpolate(time_s, self._track.time_s, self._arc_m)

    def _position_m(self, arc_m: float) -> tuple[float, float]:
        return (
            _interpolate(arc_m, self._arc_m, self._track.east_m),
            _interpolate(arc_m, self._arc_m, self._track.north_m),
        )


def read_track(path: Path) -> Track:
    """Read a .gpx track or a .csv with the columns time_s,east_m,north_m or time,lat,lon.

    Raises TrackError when the file cannot be read or holds fewer than two usable points.
    """
    try:
        rows = _read_gpx(path) if path.suffix.lower() == ".gpx" else _read_csv(path)
    except OSError as error:
        raise TrackError(f"{path} cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, ElementTree.ParseError, ValueError, KeyError) as error:
        raise TrackError(f"{path} is no readable track: {error}") from error
    points = _without_spikes(sorted(rows))
    if len(points) < 2:
        raise TrackError(f"{path} holds {len(points)} usable points with times; a track needs two")
    first_s = points[0][0]
    time_s, east_m, north_m = zip(*points, strict=True)
    return Track([t - first_s for t in time_s], east_m, north_m)


def _read_gpx(path: Path) -> list[tuple[float, float, float]]:
    rows = []
    for point in ElementTree.parse(path).iter():
        if not point.tag.endswith("}trkpt") and point.tag != "trkpt":
            continue
        stamp = next((child.text for child in point if child.tag.rpartition("}")[2] == "time"), None)
        if stamp:
            rows.append((_seconds(stamp), float(point.attrib["lat"]), float(point.attrib["lon"])))
    return _from_geodetic(rows)


def _read_csv(path: Path) -> list[tuple[float, float, float]]:
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        columns = reader.fieldnames or ()
        if {"time_s", "east_m", "north_m"} <= set(columns):
            return [(float(r["time_s"]), float(r["east_m"]), float(r["north_m"])) for r in reader]
        if {"time", "lat", "lon"} <= set(columns):
            return _from_geodetic([(_seconds(r["time"]), float(r["lat"]), float(r["lon"])) for r in reader])
    raise ValueError("the header is neither time_s,east_m,north_m nor time,lat,lon")


def _seconds(stamp: str) -> float:
    try:
        return float(stamp)
    except ValueError:
        return datetime.datetime.fromisoformat(stamp.strip()).timestamp()


def _from_geodetic(rows: list[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    if not rows:
        return []
    plane = HomePlane(rows[0][1], rows[0][2])
    return [
        (time_s, *plane.east_north_m(latitude_deg, longitude_deg)) for time_s, latitude_deg, longitude_deg in rows
    ]


def _without_spikes(rows: list[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    """Drop repeated times and single points that a ground vehicle could not have reached and left again."""
    kept: list[tuple[float, float, float]] = []
    for i, row in enumerate(rows):
        if not all(math.isfinite(value) for value in row):
            continue
        if kept and row[0] <= kept[-1][0]:
            continue
        follower = rows[i + 1] if i + 1 < len(rows) else None
        if kept and _speed_m_s(kept[-1], row) > _SPIKE_SPEED_M_S:
            confirmed = follower is not None and _speed_m_s(row, follower) <= _SPIKE_SPEED_M_S
            if not confirmed:
                continue
        kept.append(row)
    return kept


def _speed_m_s(one: tuple[float, float, float], other: tuple[float, float, float]) -> float:
    step_s = other[0] - one[0]
    return math.hypot(other[1] - one[1], other[2] - one[2]) / step_s if step_s > 0.0 else math.inf


def _interpolate(x: float, xs: Sequence[float], ys: Sequence[float]) -> float:
    i = bisect_right(xs, x)
    if i == 0:
        return ys[0]
    if i == len(xs):
        return ys[-1]
    return ys[i - 1] + (ys[i] - ys[i - 1]) * (x - xs[i - 1]) / (xs[i] - xs[i - 1])
