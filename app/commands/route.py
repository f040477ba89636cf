"""``sidelong route``: check a route file before a flight, or make one of a recorded flight."""

from __future__ import annotations

import json as json_format
import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from sidelong.app.commands.output import (
    JsonOption,
    checked_file,
    checked_output,
    console,
    say,
    share_progress,
    write_json,
    writing,
)
from sidelong.app.errors import InputError
from sidelong.app.records.route_file import RoutePoints, read_route
from sidelong.app.records.text_file import write_text
from sidelong.app.report.history import read_flight
from sidelong.estimators.compiled import FOLDER
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.route.route import Route, route_of

_SIMPLIFIED_M = 3.0  # a route made of a flight keeps the estimated path to this distance
_POINTS_MAX = 2000  # compared with one another to find parts that lie close together
_APART_M = 100.0  # along the route: nearer parts are the same leg or its turn
_LAP_M = 50.0
_LONG_LEG_M = 20_000.0  # longer legs are probably wrong coordinates
_NEAR_SHARE = 0.02  # turns at the ends of rows are always near one another


def route(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE[#NAME]", help=".gpx, .geojson, .kml, .kmz, .csv, .plan or .waypoints; with --from written."
        ),
    ],
    source: Annotated[Path | None, typer.Option("--from", metavar="RUN", help="Make FILE of this flight.")] = None,
    lap: Annotated[bool, typer.Option("--lap", help="The last way point connects to the first one.")] = False,
    tolerance: Annotated[float, typer.Option(min=1.0, max=200.0, help="1-sigma lateral offset, m.")] = 10.0,
    png: Annotated[Path | None, typer.Option(help="Draw the route into this file.")] = None,
    json: JsonOption = None,
) -> None:
    """Check a route of the target before a flight, or make one of a recorded flight.

    Prints first point, length, legs and warnings: parts of the route that lie too close together to distinguish, a
    lap that is not configured as one, way points far apart, lines that are not used. --from writes the estimated path
    of the target, simplified to 3 m.

    For example:
      sidelong route ferry.gpx --png ferry.png
      sidelong route patrol.geojson --from runs/20261121T101500Z
    """
    checked_output(json)
    checked_file("--png", png)
    if source is not None:
        checked_file("route", file)
        _write_from(source, file)
    points = read_route(file)
    plane = LocalPlane(float(points.first[0]), float(points.second[0])) if points.geodetic else LocalPlane(0.0, 0.0)
    east_m, north_m = points.in_plane(plane)
    try:
        found = route_of(east_m, north_m, lap=lap, tolerance_m=tolerance)
    except ValueError as error:
        raise InputError(f"{file}: {error}; correct it.") from error
    values = _values(found, east_m, north_m, points)
    table = Table("", "", box=None, show_header=False, pad_edge=False)
    table.add_row("way points", f"{values['way_points']}")
    unit = "degrees" if points.geodetic else "m"
    table.add_row("first point", f"{points.first[0]:.10g}, {points.second[0]:.10g} {unit}")
    table.add_row("length", f"{found.length_m:.0f} m")
    table.add_row("longest leg", f"{values['longest_leg_m']:.0f} m")
    table.add_row("extent", "{:.0f} m by {:.0f} m".format(*values["extent_m"]))
    table.add_row("from end to start", f"{values['end_to_start_m']:.0f} m")
    console.print(table)
    for warning in values["warnings"]:
        say(f"{file.name}: {warning}")
    if png is not None:
        _draw(found, east_m, north_m, png)
    write_json(json, values)


def _values(found: Route, east_m: np.ndarray, north_m: np.ndarray, points: RoutePoints) -> dict[str, Any]:
    leg_m = np.hypot(np.diff(east_m), np.diff(north_m))
    gap_m = float(np.hypot(east_m[-1] - east_m[0], north_m[-1] - north_m[0]))
    near_m, share = _near_parts(found)
    warnings = []
    if not points.geodetic:
        warnings.append("is in metres: studies use it, a flight needs degrees (lat,lon).")
    if points.note:
        warnings.append(f"{points.note}.")
    if leg_m.max() > _LONG_LEG_M:
        warnings.append(f"has a leg of {leg_m.max() / 1000.0:.0f} km; check its way points.")
    if not found.lap and gap_m < _LAP_M < 0.2 * found.length_m:
        warnings.append(f"ends {gap_m:.0f} m from its start; if the target repeats it, set route.lap = true.")
    if share > _NEAR_SHARE:
        warnings.append(
            f"{100.0 * share:.0f} % of it lies within {near_m:.0f} m of another part in the same direction; "
            "the target's progress may be mistaken there. A smaller route.tolerance_m helps if the route is accurate."
        )
    return {
        "way_points": int(east_m.size),
        "length_m": found.length_m,
        "longest_leg_m": float(leg_m.max()),
        "extent_m": [float(np.ptp(east_m)), float(np.ptp(north_m))],
        "end_to_start_m": gap_m,
        "share_near_another_part": share,
        "near_m": near_m,
        "warnings": warnings,
    }


def _near_parts(found: Route) -> tuple[float, float]:
    """Return twice the tolerance in m, and the share of the route nearer than that to another part of its course."""
    near_m = 2.0 * found.tolerance_m
    every = max(1, -(-found.east_m.size // _POINTS_MAX))
    points = np.stack([found.east_m, found.north_m], axis=1)
    ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    if not found.lap:
        ahead[0], ahead[-1] = points[1] - points[0], points[-1] - points[-2]
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    points, ahead = points[::every], ahead[::every]
    along_m = np.arange(len(points)) * every * found.spacing_m
    count = 0
    for k, (here, course) in enumerate(zip(points, ahead, strict=True)):
        apart_m = np.abs(along_m - along_m[k])
        if found.lap:
            apart_m = np.minimum(apart_m, found.length_m - apart_m)
        close = (np.hypot(*(points - here).T) < near_m) & (apart_m > _APART_M) & (ahead @ course > 0.7)
        count += bool(close.any())
    return near_m, count / len(points)


def _write_from(source: Path, file: Path) -> None:
    from shapely import LineString  # noqa: PLC0415  # only needed here

    writer = _WRITERS.get(file.suffix.lower())
    if writer is None:
        raise InputError(f"{file}: --from writes {', '.join(_WRITERS)}; give such a file name.")
    with share_progress(f"reading {source.name}") as progress:
        flown = read_flight(source, progress=progress).history
    path_m = [(e.east_m, e.north_m) for e in flown.estimates if e.time_s >= flown.start_s]
    if len(path_m) < 2:
        raise InputError(f"{source}: contains fewer than two estimates of the target; give a longer flight.")
    line = LineString(path_m).simplify(_SIMPLIFIED_M)
    text = writer([flown.plane.latitude_longitude_deg(*point) for point in line.coords])
    with writing(file, "route"):
        write_text(file, text)
    say(f"route: {file}")


def _csv(places_deg: list[tuple[float, float]]) -> str:
    return "lat,lon\n" + "".join(f"{latitude:.7f},{longitude:.7f}\n" for latitude, longitude in places_deg)


def _geojson(places_deg: list[tuple[float, float]]) -> str:
    line = [[round(longitude, 7), round(latitude, 7)] for latitude, longitude in places_deg]
    geometry = {"type": "LineString", "coordinates": line}
    return json_format.dumps({"type": "Feature", "properties": {}, "geometry": geometry}) + "\n"


def _gpx(places_deg: list[tuple[float, float]]) -> str:
    from gpxpy.gpx import GPX, GPXRoute, GPXRoutePoint  # noqa: PLC0415  # only needed here

    document, line = GPX(), GPXRoute()
    line.points = [GPXRoutePoint(round(latitude, 7), round(longitude, 7)) for latitude, longitude in places_deg]
    document.routes.append(line)
    return document.to_xml() + "\n"


_WRITERS = {".csv": _csv, ".geojson": _geojson, ".gpx": _gpx}


def _draw(found: Route, east_m: np.ndarray, north_m: np.ndarray, file: Path) -> None:
    os.environ.setdefault("MPLCONFIGDIR", str(FOLDER.parent / "matplotlib"))  # the home may be read-only
    from matplotlib.figure import Figure  # noqa: PLC0415  # half a second

    drawn = Figure(figsize=(7.0, 7.0), layout="constrained")
    axes = drawn.subplots()
    line_m = np.stack([found.east_m, found.north_m], axis=1)
    line_m = np.concatenate([line_m, line_m[:1]]) if found.lap else line_m
    axes.plot(*line_m.T, linewidth=1.5, label=f"route, {found.length_m:.0f} m")
    axes.plot(east_m, north_m, ".", markersize=3.0)
    axes.plot(*line_m[0], "o", label="start")
    every = max(1, len(line_m) // 12)
    for here, after in zip(line_m[every::every], line_m[every + 1 :: every], strict=False):
        axes.annotate("", after, here, arrowprops={"arrowstyle": "->"})
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="east of the start, m", ylabel="north of the start, m")
    axes.legend()
    with writing(file, "--png"):
        drawn.savefig(file, format="png", dpi=120)
