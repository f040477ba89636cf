"""A recorded track as a target motion: without GPS spikes, and never faster than a ground vehicle could be."""

from __future__ import annotations

import contextlib
import csv
import datetime
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path
from xml.etree import ElementTree

from sidelong.sitl.world.geodesy import HomePlane

_FILE_MAX_BYTES = 8 << 20
_TARGET_TRACK = "target"
_SPIKE_SPEED_M_S = 15.0
_SPIKE_DETOUR = 3.0  # by way of a spike, over the direct way past it
_LIVELY_SPEED_M_S = 2.5
_LIVELY_WINDOW_S = 60.0


_Point = tuple[float, float, float]  # time, then east and north or latitude and longitude
_Rows = tuple[list[_Point], tuple[float, float] | None]  # points, and latitude and longitude of their origin
# What the columns of a CSV may be called: time and two of place; whether these are degrees.
_COLUMNS = (
    ((("t_s", "time_s", "time", "t"), ("east_m",), ("north_m",)), False),
    ((("time", "t_s", "time_s", "t"), ("lat", "latitude", "lat_deg"), ("lon", "longitude", "lon_deg")), True),
)


class TrackError(ValueError):
    """The file cannot be used as a track; the message names it and the reason."""


@dataclass(frozen=True, slots=True)
class Track:
    """Points with strictly rising times, relative to the first; at least two.

    origin_deg: latitude and longitude of east and north zero; None where the file is in metres.
    """

    time_s: Sequence[float]
    east_m: Sequence[float]
    north_m: Sequence[float]
    origin_deg: tuple[float, float] | None = None

    def lengths_m(self) -> list[float]:
        """Return the length of the track up to each of its points."""
        places = list(zip(self.east_m, self.north_m, strict=True))
        return list(accumulate((math.dist(*pair) for pair in pairwise(places)), initial=0.0))

    def first_motion_s(self) -> float:
        """Return when the first minute begins that covers ground at a jog; 0 if there is none."""
        length_m = self.lengths_m()
        for i, begin_s in enumerate(self.time_s):
            j = bisect_right(self.time_s, begin_s + _LIVELY_WINDOW_S) - 1
            if length_m[j] - length_m[i] >= _LIVELY_SPEED_M_S * _LIVELY_WINDOW_S:
                return begin_s
        return 0.0


class TrackMotion:
    """Moves along the track, in step with it, but never faster than ``speed_max_m_s``: jumps are walked."""

    def __init__(self, track: Track, start_m: tuple[float, float], speed_max_m_s: float, skip_s: float) -> None:
        self._track = track
        self._skip_s = skip_s
        self._speed_max_m_s = speed_max_m_s
        self._arc_m = track.lengths_m()
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
    """Read a .gpx track, or a .csv whose header names t_s, east_m, north_m or time, lat, lon among its columns.

    Points come in the order of time, relative to the first; spikes of the receiver are left out.
    Raises TrackError when the file cannot be read, is too long, or holds fewer than two usable points.
    """
    try:
        if path.exists() and not path.is_file():
            raise TrackError(f"{path} cannot be read: it is not a file")
        if path.stat().st_size > _FILE_MAX_BYTES:
            raise TrackError(f"{path} is longer than {_FILE_MAX_BYTES >> 20} MiB; cut the track")
        rows, origin_deg = _read_gpx(path) if path.suffix.lower() == ".gpx" else _read_csv(path)
    except OSError as error:
        raise TrackError(f"{path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise TrackError(f"{path} is not text in UTF-8; a track is a .gpx or a .csv file") from error
    except (ElementTree.ParseError, csv.Error, LookupError, ArithmeticError, ValueError) as error:
        if isinstance(error, TrackError):
            raise
        raise TrackError(f"{path} is no readable track: {error!s:.160}") from error
    points = _without_spikes(_rising([row for row in rows if all(map(math.isfinite, row))]))
    if len(points) < 2:
        raise TrackError(f"{path} holds {len(points)} usable points with times; a track needs two")
    first_s = points[0][0]
    time_s, east_m, north_m = zip(*points, strict=True)
    return Track([t - first_s for t in time_s], east_m, north_m, origin_deg)


def _read_gpx(path: Path) -> _Rows:
    """Return the points of all tracks; of a flight's own export those of the target alone."""
    rows: list[_Point] = []
    of_target: list[_Point] = []
    track_begun = 0  # how many points there were before the present track
    with path.open("rb") as file:
        for _, element in ElementTree.iterparse(file):
            name = element.tag.rpartition("}")[2]
            if name == "trkpt":
                latitude, longitude, stamp = element.get("lat"), element.get("lon"), element.findtext("{*}time", "")
                if latitude and longitude and stamp.strip():
                    rows.append((_seconds(stamp), float(latitude), float(longitude)))
                element.clear()
            elif name == "trk":
                if element.findtext("{*}name") == _TARGET_TRACK:
                    of_target += rows[track_begun:]
                track_begun = len(rows)
    return _from_geodetic(of_target or rows)


def _read_csv(path: Path) -> _Rows:
    with path.open(newline="", encoding="utf-8-sig") as file:
        header = file.readline()
        columns = [name.strip().lower() for name in next(csv.reader([header], delimiter=_delimiter(header)), [])]
        rows = csv.reader(file, delimiter=_delimiter(header))
        for names, geodetic in _COLUMNS:
            places = [next((columns.index(n) for n in alike if n in columns), None) for alike in names]
            if None not in places:
                found = []
                for row in rows:
                    try:
                        point = _point([row[k] for k in places if k is not None and k < len(row)])
                    except ValueError as error:
                        raise ValueError(f"line {rows.line_num + 1}: {error}") from error
                    if point is not None:
                        found.append(point)
                return _from_geodetic(found) if geodetic else (found, None)
    raise ValueError("the header names neither t_s, east_m, north_m nor time, lat, lon")


def _delimiter(header: str) -> str:
    return max(",;\t", key=header.count)


def _point(cells: list[str]) -> _Point | None:
    """Return a row's time and position, None if a cell is empty. Raises ValueError if a cell is not a number."""
    if len(cells) < 3 or not all(cell.strip() for cell in cells):
        return None
    return _seconds(cells[0]), float(cells[1]), float(cells[2])


def _seconds(stamp: str) -> float:
    with contextlib.suppress(ValueError):
        return float(stamp)
    try:
        return datetime.datetime.fromisoformat(stamp.strip()).timestamp()
    except ValueError as error:
        raise ValueError(f"{stamp!r:.40} is neither seconds nor a time of ISO 8601") from error


def _from_geodetic(rows: list[_Point]) -> _Rows:
    rows = [row for row in rows if abs(row[1]) <= 90.0 and abs(row[2]) <= 180.0]
    if not rows:
        return [], None
    origin_deg = rows[0][1:]
    plane = HomePlane(*origin_deg)
    return [
        (time_s, *plane.east_north_m(latitude_deg, longitude_deg)) for time_s, latitude_deg, longitude_deg in rows
    ], origin_deg


def _rising(rows: list[_Point]) -> list[_Point]:
    """Return the points in the order of time, the first of each time."""
    return [row for k, row in enumerate(rows) if k == 0 or row[0] > rows[k - 1][0]] if (rows := sorted(rows)) else []


def _without_spikes(points: list[_Point]) -> list[_Point]:
    """Drop single points that lie far off the way between their neighbours, faster there and back than is possible.

    The last point has no neighbour behind it: it is dropped when it cannot be reached at the speed of the others.
    """
    kept: list[_Point] = []
    for k, point in enumerate(points):
        if kept:
            there_m_s, there_m = _speed_m_s(kept[-1], point), math.dist(kept[-1][1:], point[1:])
            if k + 1 == len(points):
                before_m_s = _speed_m_s(kept[-2], kept[-1]) if len(kept) > 1 else 0.0
                if there_m_s > _SPIKE_SPEED_M_S and there_m_s > before_m_s + _SPIKE_SPEED_M_S:
                    continue
            else:
                back_m, direct_m = (math.dist(points[k + 1][1:], p[1:]) for p in (point, kept[-1]))
                hurried = min(there_m_s, _speed_m_s(point, points[k + 1])) > _SPIKE_SPEED_M_S
                if hurried and there_m + back_m > _SPIKE_DETOUR * direct_m:
                    continue
        kept.append(point)
    return kept


def _speed_m_s(one: _Point, other: _Point) -> float:
    return math.dist(one[1:], other[1:]) / (other[0] - one[0])


def _interpolate(x: float, xs: Sequence[float], ys: Sequence[float]) -> float:
    i = bisect_right(xs, x)
    if i == 0:
        return ys[0]
    if i == len(xs):
        return ys[-1]
    return ys[i - 1] + (ys[i] - ys[i - 1]) * (x - xs[i - 1]) / (xs[i] - xs[i - 1])
