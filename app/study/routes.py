"""Routes for recorded targets: made from the track's own path, with the errors that a real route has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from shapely import LineString

from sidelong.app.errors import InputError
from sidelong.app.records.route_file import ROUTE_SUFFIXES, read_route
from sidelong.app.study.recorded import RecordedTarget
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.path import FloatArray
from sidelong.mission.route.route import Route, route_of
from sidelong.sitl.world.track import RecordedTrack

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
    """Return the route in NAME.route.csv, .gpx, .geojson or .kml next to a track; None if there is none.

    Raises:
        InputError: The file is not a route.
    """
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
