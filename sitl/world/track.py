"""A recorded track as a target motion: without GPS spikes, and never faster than a ground vehicle could be."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from pathlib import Path

from sidelong.sitl.world.geodesy import HomePlane
from sidelong.sitl.world.track_file import Line, TrackError, chosen, file_and_name, read_lines

_SPIKE_SPEED_M_S = 15.0
_SPIKE_DETOUR = 3.0  # by way of a spike, over the direct way past it
_LIVELY_SPEED_M_S = 2.5
_LIVELY_WINDOW_S = 60.0

_REACH_M = 1e7
# Times of the years 1990 to 2100 by their size: least, greatest, units per second.
_UNITS = ((9e17, 4.1e18, 1e9), (1.2e17, 6.7e17, 1e7), (6e14, 4.1e15, 1e6), (6e11, 4.1e12, 1e3))
_SINCE_START_MAX_S, _STEP_MAX_S = 3e8, 1e5  # other times, which count from any moment
_TOO_SLOW_M_S, _WALK_M_S, _IMPOSSIBLE_M_S = 0.01, 0.3, 100.0
# A longer gap, also in steps of the track, ends a part of it.
_GAP_S, _GAP_STEPS, _GAP_MAX_S = 6 * 3600.0, 10.0, 7 * 86_400.0
_SAME_PLACE_M = 15.0

_Timed = tuple[float, float, float, int]  # time, east, north, line of the file


@dataclass(frozen=True, slots=True)
class RecordedTrack:
    """Points with strictly rising times, relative to the first; at least two."""

    time_s: Sequence[float]
    east_m: Sequence[float]
    north_m: Sequence[float]
    origin_deg: tuple[float, float] | None = None  # of east and north zero; None where the file is in metres
    note: str = ""  # what of the file is not used, in words

    def lengths_m(self) -> list[float]:
        """Return the length of the track up to each of its points."""
        steps = pairwise(zip(self.east_m, self.north_m, strict=True))
        return list(accumulate((math.dist(*pair) for pair in steps), initial=0.0))

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

    def __init__(
        self, track: RecordedTrack, start_m: tuple[float, float], speed_max_m_s: float, skip_s: float
    ) -> None:
        self._track = track
        self._skip_s = skip_s
        self._speed_max_m_s = speed_max_m_s
        self._arc_m = track.lengths_m()
        self._time_s = 0.0
        self._progress_m = self._recorded_arc_m(skip_s)
        first_m = self._position_m(self._progress_m)
        self._start_m = (start_m[0] - first_m[0], start_m[1] - first_m[1])

    def at(self, time_s: float) -> tuple[float, float]:
        """Return (east, north) m at a time, s, no further than the speed limit allows; times must not go back."""
        reach_m = self._progress_m + self._speed_max_m_s * (time_s - self._time_s)
        self._progress_m = max(self._progress_m, min(reach_m, self._recorded_arc_m(self._skip_s + time_s)))
        self._time_s = time_s
        east_m, north_m = self._position_m(self._progress_m)
        return east_m + self._start_m[0], north_m + self._start_m[1]

    def _recorded_arc_m(self, time_s: float) -> float:
        return _interpolate(time_s, self._track.time_s, self._arc_m)

    def _position_m(self, arc_m: float) -> tuple[float, float]:
        axes_m = self._track.east_m, self._track.north_m
        east_m, north_m = (_interpolate(arc_m, self._arc_m, axis_m) for axis_m in axes_m)
        return east_m, north_m


def read_track(path: Path) -> RecordedTrack:
    """Read a track; FILE#NAME selects one of several. Its times are judged by the speeds that they imply.

    Points come in the order of time, relative to the first; spikes of the receiver are left out. Raises TrackError
    if the file cannot be read or holds fewer than two usable points.
    """
    file, name = file_and_name(path)
    lines, geodetic = read_lines(file)
    tracks: list[tuple[Line, RecordedTrack]] = []
    refused = "holds 0 usable points with times; a track needs two"
    for line in lines:
        try:
            tracks.append((line, _judged(line, geodetic)))
        except TrackError as error:
            if line.name == name:
                raise TrackError(f"{file}: {error}") from error
            refused = str(error) if line is lines[0] or len(line.points) > 1 else refused
    if not tracks:
        raise TrackError(f"{file}: {refused}")
    # Way points with times are used only where there is no track.
    lengths = [(line, -1.0 if line.kind == "points" else track.lengths_m()[-1]) for line, track in tracks]
    index, note = chosen(file, lengths, name)
    track = tracks[index][1]
    return replace(track, note="; ".join(filter(None, (note, track.note))))


def _judged(line: Line, geodetic: bool) -> RecordedTrack:
    """Return a line as a track, by the speeds that its times imply.

    Times of day in ms, microseconds, ns or 100 ns are recognised by their size, others by speeds too slow to be any
    target's. Where the time jumps by hours, or the clock was set back, the longest part is used. So are points of no
    date left out. Raises TrackError for fewer than two usable points, impossible speeds, and several positions of the
    same time.
    """
    limits = (90.0, 180.0) if geodetic else (_REACH_M, _REACH_M)
    within = [p for p in line.points if abs(p[1]) <= limits[0] and abs(p[2]) <= limits[1]]
    if geodetic and any(p[1] or p[2] for p in within):
        within = [p for p in within if p[1] or p[2]]  # a receiver without a fix reports 0, 0
    if not within and line.points:
        _, first, second, at = line.points[0]
        raise TrackError(f"line {at}: {first:g}, {second:g} is out of range ({limits[0]:g}, {limits[1]:g})")
    plane = HomePlane(*within[0][1:3]) if within and geodetic else None
    points: list[_Timed] = [
        (time_s, *(plane.east_north_m(first, second) if plane else (first, second)), at)
        for time_s, first, second, at in within
        if math.isfinite(time_s)
    ]
    if len(points) < 2:
        raise TrackError(f"holds {len(points)} usable points with times; a track needs two")
    points, left_out = _longest_part(_in_seconds(points))
    notes = [f"{left_out} points at other times are left out"] if left_out else []
    points = _without_spikes(_rising(points))
    if len(points) < 2:
        raise TrackError("holds 1 usable point with a time; a track needs two")
    speeds_m_s = [_speed_m_s(*pair) for pair in pairwise(points)]
    typical_m_s = sorted(speeds_m_s)[len(speeds_m_s) // 2]
    if typical_m_s > _IMPOSSIBLE_M_S:
        worst = max(range(len(speeds_m_s)), key=speeds_m_s.__getitem__)
        raise TrackError(
            f"its times imply {typical_m_s:.3g} m/s, from line {points[worst][3]} to {points[worst + 1][3]} "
            f"{speeds_m_s[worst]:.3g} m/s; give times in seconds or of ISO 8601"
        )
    time_s, east_m, north_m, _ = zip(*points, strict=True)
    origin_deg = (plane.latitude_deg, plane.longitude_deg) if plane else None
    return RecordedTrack([t - time_s[0] for t in time_s], east_m, north_m, origin_deg, "; ".join(notes))


def _in_seconds(points: list[_Timed]) -> list[_Timed]:
    """Return the points with times in seconds, whatever the unit was."""
    middle = sorted(abs(p[0]) for p in points)[len(points) // 2]
    steps_s = sorted(abs(b[0] - a[0]) for a, b in pairwise(points))
    per_second = next((unit for least, greatest, unit in _UNITS if least < middle < greatest), 1.0)
    if per_second == 1.0 and (middle < _SINCE_START_MAX_S or steps_s[len(steps_s) // 2] >= _STEP_MAX_S):
        speeds_m_s = sorted(_speed_m_s(a, b) for a, b in pairwise(points) if b[0] > a[0])
        quick_m_s = speeds_m_s[9 * len(speeds_m_s) // 10] if speeds_m_s else 1.0
        if quick_m_s < _TOO_SLOW_M_S:
            per_second = next((u for u in (1e3, 1e6, 1e9) if _WALK_M_S < u * quick_m_s < _IMPOSSIBLE_M_S), 1.0)
    return points if per_second == 1.0 else [(t / per_second, *place) for t, *place in points]  # type: ignore[misc]


def _longest_part(points: list[_Timed]) -> tuple[list[_Timed], int]:
    """Return the longest part without a gap of hours or a clock that is set back, and the number of other points."""
    ordered = sorted(points)
    steps_s = sorted(b[0] - a[0] for a, b in pairwise(ordered))
    gap_s = min(max(_GAP_S, _GAP_STEPS * steps_s[len(steps_s) // 2]), _GAP_MAX_S)
    part = max(_split(ordered, lambda a, b: b[0] - a[0] > gap_s), key=_length_m)
    first_s, last_s = part[0][0], part[-1][0]
    recorded = [p for p in points if first_s <= p[0] <= last_s]
    if sum(b[0] < a[0] for a, b in pairwise(recorded)) > len(recorded) // 2:
        recorded.reverse()
    if _length_m(part) > 2.0 * _length_m(recorded) + _SAME_PLACE_M:  # in order of time, two passes are mixed
        part = max(_split(recorded, lambda a, b: b[0] < a[0]), key=_length_m)
    twice = sum(b[0] == a[0] and math.dist(a[1:3], b[1:3]) > _SAME_PLACE_M for a, b in pairwise(part))
    if twice > max(0.2 * len(part), 1):
        at = next(b[3] for a, b in pairwise(part) if b[0] == a[0] and math.dist(a[1:3], b[1:3]) > _SAME_PLACE_M)
        raise TrackError(
            f"line {at}: several positions have the same time; give times that rise, or a column that names each "
            "track (mmsi, name, id)"
        )
    return part, len(points) - len(part)


def _split(points: list[_Timed], between: Callable[[_Timed, _Timed], bool]) -> list[list[_Timed]]:
    ends = [k for k, pair in enumerate(pairwise(points), 1) if between(*pair)]
    return [points[a:b] for a, b in pairwise([0, *ends, len(points)])]


def _length_m(points: list[_Timed]) -> float:
    return sum(math.dist(a[1:3], b[1:3]) for a, b in pairwise(points))


def _rising(points: list[_Timed]) -> list[_Timed]:
    """Return the points in the order of time, the first of each time."""
    points = sorted(points)
    return [point for k, point in enumerate(points) if k == 0 or point[0] > points[k - 1][0]]


def _without_spikes(points: list[_Timed]) -> list[_Timed]:
    """Drop single points that lie far off the way between their neighbours, faster there and back than is possible.

    The last point has no neighbour behind it: it is dropped when it cannot be reached at the speed of the others.
    """
    kept: list[_Timed] = []
    for k, point in enumerate(points):
        if kept:
            there_m_s, there_m = _speed_m_s(kept[-1], point), math.dist(kept[-1][1:3], point[1:3])
            if k + 1 == len(points):
                before_m_s = _speed_m_s(kept[-2], kept[-1]) if len(kept) > 1 else 0.0
                if there_m_s > _SPIKE_SPEED_M_S and there_m_s > before_m_s + _SPIKE_SPEED_M_S:
                    continue
            else:
                back_m, direct_m = (math.dist(points[k + 1][1:3], p[1:3]) for p in (point, kept[-1]))
                hurried = min(there_m_s, _speed_m_s(point, points[k + 1])) > _SPIKE_SPEED_M_S
                if hurried and there_m + back_m > _SPIKE_DETOUR * direct_m:
                    continue
        kept.append(point)
    return kept


def _speed_m_s(one: _Timed, other: _Timed) -> float:
    return math.dist(one[1:3], other[1:3]) / (other[0] - one[0])


def _interpolate(x: float, xs: Sequence[float], ys: Sequence[float]) -> float:
    i = bisect_right(xs, x)
    if i == 0:
        return ys[0]
    if i == len(xs):
        return ys[-1]
    return ys[i - 1] + (ys[i] - ys[i - 1]) * (x - xs[i - 1]) / (xs[i] - xs[i - 1])
