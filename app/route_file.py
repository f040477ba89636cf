"""Read the way points of a route: GPX, GeoJSON, KML, cursor on target (CoT) or CSV."""

from __future__ import annotations

import contextlib
import csv
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from sidelong.app.errors import InputError
from sidelong.app.text_file import read_text
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.path import FloatArray
from sidelong.mission.route.route import REACH_M

_FILE_MAX_BYTES = 8 << 20
_REMEDY = "give a route as .gpx, .geojson, .kml, .cot, or .csv with east_m,north_m or lat,lon"
_CSV_COLUMNS = ((("east_m",), ("north_m",)), (("lat", "latitude", "lat_deg"), ("lon", "longitude", "lon_deg")))
_Points = list[tuple[float, float]]
_Read = tuple[list[_Points], bool]  # the lines of a file, and whether they are in degrees


@dataclass(frozen=True, slots=True, eq=False)
class RoutePoints:
    """Way points of a route.

    Attributes:
        first: Latitude in degrees, or east in metres (n,).
        second: Longitude in degrees, or north in metres (n,).
        geodetic: Whether they are degrees.
        unused_lines: Number of further lines in the file, which are not used.
    """

    first: FloatArray
    second: FloatArray
    geodetic: bool
    unused_lines: int

    def in_plane(self, plane: LocalPlane) -> tuple[FloatArray, FloatArray]:
        """Return east and north (n,) in metres; points that are in metres already are relative to the origin."""
        if not self.geodetic:
            return self.first, self.second
        places = [plane.east_north_m(*place) for place in zip(self.first.tolist(), self.second.tolist(), strict=True)]
        east_m, north_m = np.array(places).T
        return east_m, north_m


def read_route(path: Path) -> RoutePoints:
    """Read a route file.

    Raises:
        InputError: The file cannot be read or contains fewer than two points.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path}: is not a route file; {_REMEDY}.")
    text = read_text(path, _FILE_MAX_BYTES, _REMEDY)
    try:
        lines, geodetic = reader(text)
    except (ElementTree.ParseError, ValueError, LookupError, TypeError, RecursionError, csv.Error) as error:
        raise InputError(f"{path}: is not a readable route: {error!s:.160}; {_REMEDY}.") from error
    points, *unused = [line for line in lines if line] or [[]]
    different = len(set(points))
    if different < 2:
        raise InputError(f"{path}: contains {different} points of a route; it needs at least two different points.")
    first, second = np.array(points, np.float64).T
    limits = (90.0, 180.0) if geodetic else (REACH_M, REACH_M)
    within = (np.abs(first) <= limits[0]) & (np.abs(second) <= limits[1])
    if not within.all():
        bad = int(np.argmin(within))
        ranges = ", ".join(f"-{limit:g} to {limit:g}" for limit in limits)
        raise InputError(f"{path}: point {bad + 1}, {first[bad]:g}, {second[bad]:g}, is out of range ({ranges}).")
    return RoutePoints(np.ascontiguousarray(first), np.ascontiguousarray(second), geodetic, len(unused))


def read_flight_route(path: Path) -> RoutePoints:
    """Read a route file for a flight.

    Raises:
        InputError: As :func:`read_route`, or the points are in metres.
    """
    points = read_route(path)
    if not points.geodetic:
        raise InputError(f"{path}: is in metres: studies use it, a flight needs degrees (lat,lon).")
    return points


def _gpx(text: str) -> _Read:
    """Return the routes, then the tracks; without either, the way points."""
    from gpxpy import parse  # noqa: PLC0415  # only needed here
    from gpxpy.gpx import GPXException  # noqa: PLC0415

    try:
        gpx = parse(text)
    except GPXException as error:
        raise ValueError(str(error)) from error
    lines: list[list[Any]] = [route.points for route in gpx.routes]
    lines += [[point for segment in track.segments for point in segment.points] for track in gpx.tracks]
    lines = lines if any(lines) else [gpx.waypoints]
    return [[(point.latitude, point.longitude) for point in line] for line in lines], True


def _geojson(text: str) -> _Read:
    """Return the lines of a document, joined in their order to one; without a line, its points."""
    lines: _Points = []
    points: _Points = []
    for geometry in _geometries(json.loads(text)):
        kind, coordinates = geometry["type"], geometry["coordinates"]
        match kind:
            case "LineString":
                lines += map(_latitude_longitude, coordinates)
            case "MultiLineString":
                lines += [_latitude_longitude(position) for line in coordinates for position in line]
            case "Polygon":
                lines += [_latitude_longitude(position) for line in coordinates[:1] for position in line]
            case "Point":
                points.append(_latitude_longitude(coordinates))
            case "MultiPoint":
                points += map(_latitude_longitude, coordinates)
    return [lines or points], True


def _geometries(document: Any) -> Iterator[dict[str, Any]]:
    match document:
        case {"type": "FeatureCollection", "features": [*parts]} | {
            "type": "GeometryCollection",
            "geometries": [*parts],
        }:
            for part in parts:
                yield from _geometries(part)
        case {"type": "Feature"}:
            if document.get("geometry"):
                yield from _geometries(document["geometry"])
        case {"type": str(), "coordinates": [*_]}:
            yield document
        case _:
            raise ValueError("it is not a GeoJSON object")


def _kml(text: str) -> _Read:
    """Return the recorded tracks, joined to one, then the lines; without either, the placemarks."""
    root = ElementTree.fromstring(text)
    placemarks: _Points = []
    track = [element.text or "" for element in root.iter() if _name(element) == "coord"]
    lines = [[_latitude_longitude(words.split()) for words in track]]
    for element in root.iter():
        if _name(element) not in ("LineString", "LinearRing", "Point"):
            continue
        words = next((child.text or "" for child in element if _name(child) == "coordinates"), "")
        points = [_latitude_longitude(one.split(",")) for one in words.split()]
        if _name(element) == "Point":
            placemarks += points
        else:
            lines.append(points)
    return lines if any(lines) else [placemarks], True


def _cot(text: str) -> _Read:
    """Return the points of a route or drawn line: the links in the details of a cursor-on-target event."""
    links = [
        link.attrib["point"].split(",")
        for link in ElementTree.fromstring(text).iter("link")
        if "point" in link.attrib
    ]
    return [[_latitude_longitude(words[1::-1]) for words in links]], True


def _name(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _latitude_longitude(position: Any) -> tuple[float, float]:
    """Return latitude and longitude of a position that names the longitude first. Raises ValueError."""
    match position:
        case [longitude, latitude, *_]:
            with contextlib.suppress(ValueError, TypeError):
                return float(latitude), float(longitude)
    raise ValueError(f"{position!r:.60} is not a position in degrees (longitude, latitude)")


def _csv(text: str) -> _Read:
    rows = csv.reader(text.splitlines(), delimiter=max(",;\t", key=text.lstrip().partition("\n")[0].count))
    filled = ((rows.line_num, row) for row in rows if any(map(str.strip, row)))
    header = [name.strip().lower() for name in next(filled, (0, []))[1]]
    for geodetic, names in enumerate(_CSV_COLUMNS):
        columns = [next((header.index(name) for name in alike if name in header), None) for alike in names]
        first, second = columns
        if first is not None and second is not None:
            return [[_cells(line, row, first, second) for line, row in filled]], bool(geodetic)
    raise ValueError("the header names neither east_m, north_m nor lat, lon")


def _cells(line: int, row: list[str], first: int, second: int) -> tuple[float, float]:
    try:
        return _number(row[first]), _number(row[second])
    except (ValueError, IndexError) as error:
        raise ValueError(f"line {line}, {','.join(row):.60}, holds no position") from error


def _number(word: str) -> float:
    return float(word) if word.strip() else math.nan


_READERS: dict[str, Callable[[str], _Read]] = {
    ".gpx": _gpx,
    ".geojson": _geojson,
    ".json": _geojson,
    ".kml": _kml,
    ".cot": _cot,
    ".csv": _csv,
}
ROUTE_SUFFIXES = tuple(_READERS)
