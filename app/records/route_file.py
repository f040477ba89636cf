"""Read the way points of a route, from each file that :mod:`sidelong.sitl.world.track_file` reads."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sidelong.app.errors import InputError
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.path import FloatArray
from sidelong.mission.route.route import REACH_M
from sidelong.sitl.world.track_file import SUFFIXES, TrackError, chosen, file_and_name, read_lines

_REMEDY = "give a route as .gpx, .geojson, .kml, .cot, or .csv with east_m,north_m or lat,lon"
_PREFERRED = ("route", "track", "line", "area", "points")
ROUTE_SUFFIXES = SUFFIXES


@dataclass(frozen=True, slots=True, eq=False)
class RoutePoints:
    """Way points: latitude and longitude (n,) in degrees, or east and north in metres; note: lines not used."""

    first: FloatArray
    second: FloatArray
    geodetic: bool
    note: str = ""

    def in_plane(self, plane: LocalPlane) -> tuple[FloatArray, FloatArray]:
        """Return east and north (n,) in metres; points that are in metres already are relative to the origin."""
        if not self.geodetic:
            return self.first, self.second
        places = [plane.east_north_m(*place) for place in zip(self.first.tolist(), self.second.tolist(), strict=True)]
        east_m, north_m = np.array(places).T
        return east_m, north_m


def read_route(path: Path) -> RoutePoints:
    """Read a route file; FILE#NAME selects one of several lines. Raises InputError.

    Without a name it is the target's of a flight's export. Else routes come before tracks, drawn lines, areas and way
    points, and the longest of them is used.
    """
    file, name = file_and_name(path)
    try:
        lines, geodetic = read_lines(file)
    except TrackError as error:
        raise InputError(f"{error}; {_REMEDY}.") from error
    if not lines:
        raise InputError(f"{file}: contains no points of a route; {_REMEDY}.")
    kinds = {line.kind for line in lines if len(line.points) > 1}
    best = next((kind for kind in _PREFERRED if kind in kinds), "")
    # A line of another kind is used only by its name.
    lengths = [(line, line.length_m(geodetic) if line.kind == best else -1.0) for line in lines]
    try:
        index, note = chosen(file, lengths, name)
    except TrackError as error:
        raise InputError(f"{error}.") from error
    points = [point[1:3] for point in lines[index].points]
    different = len(set(points))
    if different < 2:
        raise InputError(f"{file}: contains {different} points of a route; it needs at least two different points.")
    first, second = np.array(points, np.float64).T
    limits = (90.0, 180.0) if geodetic else (REACH_M, REACH_M)
    within = (np.abs(first) <= limits[0]) & (np.abs(second) <= limits[1])
    if not within.all():
        bad = int(np.argmin(within))
        ranges = ", ".join(f"-{limit:g} to {limit:g}" for limit in limits)
        raise InputError(f"{file}: point {bad + 1}, {first[bad]:g}, {second[bad]:g}, is out of range ({ranges}).")
    return RoutePoints(np.ascontiguousarray(first), np.ascontiguousarray(second), geodetic, note)


def read_flight_route(path: Path) -> RoutePoints:
    """Read a route file for a flight. Raises InputError as :func:`read_route`, or if the points are in metres."""
    points = read_route(path)
    if not points.geodetic:
        raise InputError(f"{path}: is in metres: studies use it, a flight needs degrees (lat,lon).")
    return points
