"""Recorded tracks as the targets of a study: resampled and smoothed, with the reason for each rejected track."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path

import numpy as np
from shapely import LineString

from sidelong.app.errors import InputError
from sidelong.app.records.route_file import ROUTE_SUFFIXES, read_route
from sidelong.app.simulation.target import TargetTruth
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.path import FloatArray
from sidelong.mission.route.route import Route, route_of
from sidelong.sitl.world.track import RecordedTrack, read_track
from sidelong.sitl.world.track_file import TrackError, file_and_name

STEP_S = 0.5
_SMOOTHED_OVER = 5  # steps: 2.5 s
_SHORTEST_S, _LONGEST_S = 30.0, 48 * 3600.0
# A single step faster than this, and by this much faster than both its neighbours, is a jump of the receiver.
_JUMP_M_S, _JUMP_OVER_OTHERS_M_S = 15.0, 10.0
# The course is the direction of the path over this many steps, held while that path is shorter than this.
_COURSE_STEPS, _COURSE_WAY_M = 10, 2.5
_SUFFIXES = (".csv", ".gpx", ".kml", ".kmz")


@dataclass(frozen=True, eq=False)
class RecordedTarget:
    """A recorded track from its first point, the origin, at steps of half a second (n,), and its known route."""

    name: str
    east_m: FloatArray
    north_m: FloatArray
    route: Route | None = None

    @property
    def duration_s(self) -> float:
        return STEP_S * (self.east_m.size - 1)

    @cached_property
    def key(self) -> int:
        """A number of 64 bits by the motion alone: equal tracks have equal runs."""
        return int.from_bytes(sha256(self.east_m.tobytes() + self.north_m.tobytes()).digest()[:8])

    @cached_property
    def route_key(self) -> str:
        """A digest of the known route, '' without one."""
        if self.route is None:
            return ""
        known = self.route
        points = known.east_m.tobytes() + known.north_m.tobytes()
        return sha256(
            points + f"{known.lap} {known.tolerance_m} {known.speed_m_s} {known.direction}".encode()
        ).hexdigest()

    @cached_property
    def speed_p95_m_s(self) -> float:
        """Speed that is exceeded for 5 % of the time."""
        return float(np.percentile(np.hypot(*self._velocity_m_s), 95))

    @cached_property
    def _velocity_m_s(self) -> tuple[FloatArray, FloatArray]:
        return np.gradient(self.east_m, STEP_S), np.gradient(self.north_m, STEP_S)

    @cached_property
    def _course_rad(self) -> FloatArray:
        """The course (n,), before the first known one that one, 0 if there is none."""
        k = np.arange(self.east_m.size)
        before = np.maximum(k - _COURSE_STEPS, 0)
        way_east_m, way_north_m = self.east_m - self.east_m[before], self.north_m - self.north_m[before]
        counts = np.hypot(way_east_m, way_north_m) > _COURSE_WAY_M
        if not counts.any():
            return np.zeros(k.size)
        held = np.maximum.accumulate(np.where(counts, k, int(np.argmax(counts))))
        return np.asarray(np.arctan2(way_east_m, way_north_m)[held])

    def sampled(self, time_s: FloatArray) -> FloatArray:
        """Return (n, 5) at times (n,): east, north, velocity east, velocity north, course. It stands at its end."""
        own_s = STEP_S * np.arange(self.east_m.size)
        k = np.clip((time_s / STEP_S + 1e-9).astype(int), 0, self.east_m.size - 1)
        east, north = np.interp(time_s, own_s, self.east_m), np.interp(time_s, own_s, self.north_m)
        return np.stack([east, north, *(v[k] for v in self._velocity_m_s), self._course_rad[k]], axis=1)

    def at(self, time_s: float) -> TargetTruth:
        """Return the truth at a time from 0 to the end of the track."""
        return TargetTruth(*map(float, self.sampled(np.array([time_s]))[0]))


def prepared(name: str, track: RecordedTrack) -> RecordedTarget:
    """Resample and smooth a track; gaps are bridged, and what follows a jump is joined to what was before."""
    time_s, east_m, north_m = (np.asarray(values, float) for values in (track.time_s, track.east_m, track.north_m))
    steps_m = np.stack([np.diff(east_m), np.diff(north_m)])
    speed_m_s = np.hypot(*steps_m) / np.diff(time_s)
    around_m_s = np.maximum(np.append(speed_m_s[1:], 0.0), np.insert(speed_m_s[:-1], 0, 0.0))
    steps_m[:, (speed_m_s > _JUMP_M_S) & (speed_m_s > around_m_s + _JUMP_OVER_OTHERS_M_S)] = 0.0
    grid_s = np.arange(0.0, time_s[-1], STEP_S)
    smooth = []
    for step_m in steps_m:
        place_m = np.interp(grid_s, time_s, np.insert(np.cumsum(step_m), 0, 0.0))
        padded_m = np.pad(place_m, _SMOOTHED_OVER // 2, "edge")
        place_m = np.convolve(padded_m, np.full(_SMOOTHED_OVER, 1.0 / _SMOOTHED_OVER), "valid")
        smooth.append(place_m - place_m[0])
    return RecordedTarget(name, *smooth)


@dataclass(frozen=True, slots=True, eq=False)
class RecordedTargets:
    """The tracks to be flown in the order of their names, why others are not: (name, reason), and notes on files."""

    flown: tuple[RecordedTarget, ...]
    skipped: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = ()


def recorded_targets(
    places: list[Path],
    speed_max_m_s: float,
    route_of: Callable[[Path, RecordedTrack], Route | None] = lambda _file, _track: None,
) -> RecordedTargets:
    """Read the .csv, .gpx, .kml and .kmz tracks in folders, or single files. Raises InputError when none is left.

    Tables without a track's columns are passed over. Tracks whose 95th percentile of speed is above speed_max_m_s,
    and those too short or unreadable, are skipped. route_of: finds the route of a track; NAME.route.* are no tracks.
    """
    flown, skipped, notes = [], [], []
    for file in _files(places):
        try:
            track = read_track(file)
        except TrackError as error:
            if "the header names neither" not in str(error) or file in places:
                skipped.append((file.name, str(error).removeprefix(f"{file}: ")))
            continue
        if track.time_s[-1] < _SHORTEST_S:
            skipped.append((file.name, f"lasts {track.time_s[-1]:.0f} s, and {_SHORTEST_S:.0f} s is the least"))
            continue
        if track.time_s[-1] > _LONGEST_S:
            hours = f"lasts {track.time_s[-1] / 3600.0:.0f} h, and {_LONGEST_S / 3600.0:.0f} h is the most; cut it"
            skipped.append((file.name, hours))
            continue
        notes += [f"{file.name}: {track.note}"] if track.note else []
        target = replace(prepared(file.stem, track), route=route_of(file, track))
        if target.speed_p95_m_s > speed_max_m_s:
            speeds = f"95th percentile of speed {target.speed_p95_m_s:.1f} m/s is above {speed_max_m_s:g} m/s"
            skipped.append((file.name, speeds))
        else:
            flown.append(target)
    if not flown:
        where = ", ".join(map(str, places))
        nothing = "there is no .csv or .gpx track with its columns"
        reason = f"the first: {skipped[0][0]}, {skipped[0][1]}" if skipped else nothing
        raise InputError(
            f"--targets: no track to fly in {where} ({reason}); give tracks with the columns t_s, east_m, north_m, "
            f"or raise --target-speed from {speed_max_m_s:g} m/s."
        )
    return RecordedTargets(tuple(flown), tuple(skipped), tuple(notes))


def _files(places: list[Path]) -> list[Path]:
    files: list[Path] = []
    for place in places:
        if place.is_dir():
            try:
                tracks = (p for p in place.iterdir() if p.suffix.lower() in _SUFFIXES and p.is_file())
                found = sorted(p for p in tracks if not p.stem.endswith(".route"))
                stems = {p.stem for p in found if p.suffix.lower() in (".csv", ".gpx")}  # the others are their routes
                files += [p for p in found if p.suffix.lower() in (".csv", ".gpx") or p.stem not in stems]
            except OSError as error:
                raise InputError(f"--targets: {place} cannot be read ({error.strerror}); give a folder.") from error
        elif file_and_name(place)[0].is_file():
            files.append(place)
        else:
            raise InputError(f"--targets: there is no {place}; give a folder of .csv and .gpx tracks.")
    return files


SIMPLIFIED_M = 5.0
DISPLACED_M = (3.0, 8.0)
_DISPLACED_EVERY_M = 400.0  # the displacement changes over about this distance


def own_route(target: RecordedTarget, rng: np.random.Generator) -> Route:
    """Return the path of a track as its route, simplified to 5 m and displaced by 3 to 8 m; no speeds, no stops."""
    path = LineString(np.stack([target.east_m, target.north_m], axis=1)).simplify(SIMPLIFIED_M)
    points_m = np.array(path.coords)
    leg_m = np.hypot(*np.diff(points_m, axis=0).T)
    return route_of(*(points_m + _displacement(np.append(0.0, np.cumsum(leg_m)), rng)).T)


def _displacement(arc_m: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return a displacement (n, 2) of 3 to 8 m whose direction and size change slowly along the path."""
    knots = int(arc_m[-1] / _DISPLACED_EVERY_M) + 2
    at_m = np.arange(knots) * _DISPLACED_EVERY_M
    size_m = np.interp(arc_m, at_m, rng.uniform(*DISPLACED_M, knots))
    turn_rad = np.interp(arc_m, at_m, rng.uniform(-np.pi, np.pi) + np.cumsum(rng.normal(0.0, 0.7, knots)))
    return np.stack([size_m * np.sin(turn_rad), size_m * np.cos(turn_rad)], axis=1)


def route_next_to(file: Path, track: RecordedTrack) -> Route | None:
    """Return the route in NAME.route.csv, .gpx, .geojson or .kml next to a track, or None. Raises InputError."""
    named = [file.with_name(f"{file.stem}.route{suffix}") for suffix in ROUTE_SUFFIXES]
    apart = (".csv", ".txt", file.suffix.lower())
    named += [file.with_suffix(suffix) for suffix in ROUTE_SUFFIXES if suffix not in apart]
    found = next((one for one in named if one.is_file()), None)
    if found is None:
        return None
    points = read_route(found)
    if points.geodetic and track.origin_deg is None:
        raise InputError(f"{found}: is in degrees, but {file.name} is in metres; give east_m,north_m.")
    east_m, north_m = points.in_plane(LocalPlane(*(track.origin_deg or (0.0, 0.0))))
    try:
        return route_of(east_m - track.east_m[0], north_m - track.north_m[0])
    except ValueError as error:
        raise InputError(f"{found}: {error}; correct it.") from error
