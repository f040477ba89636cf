"""A flight in the formats of other programs: tracks for maps, mission items for ground stations."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np

from sidelong.app.errors import InputError
from sidelong.app.records.animation import animated_svg
from sidelong.app.records.track import ROUTE_POINTS, FlownTrack, PositionTrack, ring
from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.upload.items import FRAME_GLOBAL, NAV_WAYPOINT, plan_file
from sidelong.mission.upload.mission_item import MissionItem, e7

_KML = "http://www.opengis.net/kml/2.2"
_KML_COLOURS = {"aircraft": "ff0080ff", "target": "ff0000ff", "circle": "ffffaa00", "route": "8000d7ff"}
_KML_EXTENSION = "http://www.google.com/kml/ext/2.2"


class Format(StrEnum):
    """Missions for QGroundControl (.plan) and Mission Planner (WPL 110); tracks for maps, tables and GPS tools.

    SVG is an animated picture. MCAP and KLV are made of the events themselves, in modules of their own.
    """

    PLAN = "plan"
    WAYPOINTS = "waypoints"
    KML = "kml"
    GEOJSON = "geojson"
    CSV = "csv"
    GPX = "gpx"
    MCAP = "mcap"
    KLV = "klv"
    SVG = "svg"


MISSIONS = frozenset({Format.PLAN, Format.WAYPOINTS})
"""Of one aircraft each; tracks of several go into one file."""


def export(flights: Sequence[FlownTrack], wanted: Format, out: Path) -> None:
    """Write a flight to ``out``, or the tracks of several aircraft that flew together.

    Raises InputError when one has nothing to write in this format, OSError when the file cannot be written.
    """
    if wanted in MISSIONS:
        (flight,) = flights
        if flight.mission is None:
            raise InputError(f"{flight.name} has no mission items to export.")
        text = _MISSION_WRITERS[wanted](flight)
    else:
        for flight in flights:
            if len(flight.aircraft) < 2:
                raise InputError(f"{flight.name} has fewer than two positions, so there is no track to export.")
        text = _TRACK_WRITERS[wanted](flights)
    out.write_text(text, encoding="utf-8")


# -- mission items ------------------------------------------------------------------------------------------


def _plan(flight: FlownTrack) -> str:
    mission = flight.mission
    assert mission is not None  # export() looks
    return plan_file(
        mission.items,
        flight.plane,
        flight.home_altitude_m or 0.0,
        mission.airspeed_m_s,
        mission.mav_autopilot,
        mission.keep_in,
        mission.keep_out,
    )


def _waypoints(flight: FlownTrack) -> str:
    assert flight.mission is not None  # export() looks
    # Mission Planner treats the first line as home, whatever it contains.
    x, y = e7(flight.degrees(0.0, 0.0))
    home = MissionItem(NAV_WAYPOINT, FRAME_GLOBAL, 0.0, 0.0, 0.0, 0.0, x, y, flight.home_altitude_m or 0.0)
    lines = ["QGC WPL 110"]
    for sequence, item in enumerate((home, *flight.mission.items)):
        parameters = (item.param1, item.param2, item.param3, item.param4)
        values = (
            *(sequence, int(sequence == 0), item.frame, item.command),
            *(f"{value:.8f}" for value in (*parameters, *item.latitude_longitude_deg)),
            *(f"{item.z:.6f}", int(item.autocontinue)),
        )
        lines.append("\t".join(map(str, values)))
    return "\n".join(lines) + "\n"


# -- tables -------------------------------------------------------------------------------------------------


def _csv(flights: Sequence[FlownTrack]) -> str:
    """One row a moment; ``what`` is aircraft, target (estimated) or circle (its centre, since then).

    Times are each aircraft's own; utc is the same for all.
    """
    text = io.StringIO()
    names = "time_s utc what latitude_deg longitude_deg height_m velocity_east_m_s velocity_north_m_s sigma_m quality"
    writer = csv.DictWriter(text, [*names.split(), "radius_m", "clockwise"], restval="", lineterminator="\n")
    writer.writeheader()
    for flight in flights:
        writer.writerows(sorted(_rows(flight), key=lambda row: row["time_s"]))
    return text.getvalue()


def _rows(flight: FlownTrack) -> Iterator[dict[str, Any]]:
    moments: list[tuple[str, float, Any, dict[str, Any]]] = [
        ("circle", since_s, circle, {"clockwise": int(circle.clockwise)}) for since_s, circle in flight.circles
    ]
    moments += [("aircraft", place.time_s, place, {}) for place in flight.aircraft]
    for name, estimates in flight.of_targets().items():
        moments += [(name, e.time_s, e, {"sigma_m": _sigma_m(e), "quality": e.quality.value}) for e in estimates]
    for what, time_s, place, own in moments:
        latitude_deg, longitude_deg = flight.degrees(place.east_m, place.north_m)
        measured = ("height_m", "velocity_east_m_s", "velocity_north_m_s", "radius_m")
        values = own | {name: getattr(place, name) for name in measured if hasattr(place, name)}
        yield {
            "time_s": round(time_s, 6),
            "utc": flight.utc(time_s) or "",
            "what": flight.named(what),
            "latitude_deg": f"{latitude_deg:.8f}",
            "longitude_deg": f"{longitude_deg:.8f}",
            **{name: round(value, 3) if isinstance(value, float) else value for name, value in values.items()},
        }


def _sigma_m(estimate: TargetEstimate) -> float:
    """Return the standard deviation of the position along its worst direction."""
    return math.sqrt(np.linalg.eigvalsh(estimate.covariance[:2, :2])[-1])


# -- maps ---------------------------------------------------------------------------------------------------


def _geojson(flights: Sequence[FlownTrack]) -> str:
    features = [feature for flight in flights for feature in _features(flight)]
    return json.dumps({"type": "FeatureCollection", "features": features}, separators=(",", ":")) + "\n"


def _features(flight: FlownTrack) -> Iterator[dict[str, Any]]:
    def feature(name: str, kind: str, coordinates: list[Any], **properties: Any) -> dict[str, Any]:
        return {
            "type": "Feature",
            "properties": {"name": name, **properties},
            "geometry": {"type": kind, "coordinates": coordinates},
        }

    def places(points_m: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
        return [flight.degrees(*point)[::-1] for point in points_m]

    for track in flight.tracks():
        utc = [flight.utc(place.time_s) for place in track.places] if flight.booted else None
        line = [(place.longitude_deg, place.latitude_deg, *place.height_m) for place in track.places]
        drawn = feature(track.name, "LineString", line, time_s=[place.time_s for place in track.places], utc=utc)
        if track.kind == "aircraft":  # heights are above home where its altitude is not known
            drawn["properties"]["height_above"] = "home" if flight.home_altitude_m is None else "sea level"
        if len(line) > 1:
            yield drawn
    if flight.route is not None:
        yield feature(flight.named("route"), "LineString", places(flight.route.outline_m(ROUTE_POINTS).tolist()))
    for since_s, circle in flight.circles:
        corners = places(ring(circle))
        # A polygon's outer ring runs counter-clockwise (RFC 7946).
        outer = corners[::-1] if circle.clockwise else corners
        circled = {"radius_m": circle.radius_m, "clockwise": circle.clockwise}
        since = {"since_s": since_s, "since_utc": flight.utc(since_s)}
        yield feature(flight.named("circle"), "Polygon", [outer], **since, **circled)


def _gpx(flights: Sequence[FlownTrack]) -> str:
    from gpxpy.gpx import GPX, GPXTrack, GPXTrackPoint, GPXTrackSegment  # noqa: PLC0415  # only needed here

    document = GPX()
    document.creator = "sidelong"
    for flight in flights:
        for track in flight.tracks():
            segment = GPXTrackSegment()
            for place in track.places:
                above_sea_m = place.height_m[0] if place.height_m and flight.home_altitude_m is not None else None
                point = GPXTrackPoint(place.latitude_deg, place.longitude_deg, above_sea_m, flight.at(place.time_s))
                segment.points.append(point)
            made = GPXTrack(track.name)
            made.segments.append(segment)
            document.tracks.append(made)
    return str(document.to_xml()) + "\n"


def _kml(flights: Sequence[FlownTrack]) -> str:
    root = Xml.Element("kml", {"xmlns": _KML, "xmlns:gx": _KML_EXTENSION})
    document = _child(root, "Document")
    _child(document, "name", flights[0].name)
    for name, colour in _KML_COLOURS.items():
        style = _child(_child(document, "Style", id=name), "LineStyle")
        _child(style, "color", colour)
        _child(style, "width", "2")
    for flight in flights:
        for track in flight.tracks():
            _kml_track(_kml_mark(document, track.kind, track.name), flight, track)
        lines = []
        if flight.route is not None:
            outline_m = flight.route.outline_m(ROUTE_POINTS).tolist()
            lines.append(("route", f", {flight.route.length_m:.0f} m", outline_m))
        for since_s, circle in flight.circles:
            lines.append(("circle", f" from {since_s:.1f} s, radius {circle.radius_m:.0f} m", ring(circle)))
        for kind, about, points_m in lines:
            line = _child(_kml_mark(document, kind, f"{flight.named(kind)}{about}"), "LineString")
            places = (flight.degrees(*point) for point in points_m)
            _child(line, "coordinates", " ".join(f"{lon:.8f},{lat:.8f}" for lat, lon in places))
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"


def _kml_mark(document: Xml.Element, style: str, name: str) -> Xml.Element:
    mark = _child(document, "Placemark")
    _child(mark, "name", name)
    _child(mark, "styleUrl", f"#{style}")
    return mark


def _kml_track(mark: Xml.Element, flight: FlownTrack, track: PositionTrack) -> None:
    """Add a track that can be played back, or a plain line where the time of day is not known."""
    line = _child(mark, "LineString" if flight.booted is None else "gx:Track")
    # Heights are above home: over hills they mean something above the sea only.
    aloft = "relativeToGround" if flight.home_altitude_m is None else "absolute"
    _child(line, "altitudeMode", aloft if track.kind == "aircraft" else "clampToGround")
    places = [
        (f"{place.longitude_deg:.8f}", f"{place.latitude_deg:.8f}", f"{sum(place.height_m):.2f}")
        for place in track.places
    ]
    if flight.booted is None:
        _child(line, "coordinates", " ".join(map(",".join, places)))
        return
    for place in track.places:
        _child(line, "when", flight.utc(place.time_s))
    for coordinates in places:
        _child(line, "gx:coord", " ".join(coordinates))


def _child(parent: Xml.Element, tag: str, text: str | None = None, **attributes: str) -> Xml.Element:
    child = Xml.SubElement(parent, tag, attributes)
    child.text = text
    return child


_MISSION_WRITERS: dict[Format, Callable[[FlownTrack], str]] = {Format.PLAN: _plan, Format.WAYPOINTS: _waypoints}
_TRACK_WRITERS: dict[Format, Callable[[Sequence[FlownTrack]], str]] = {
    Format.CSV: _csv,
    Format.GEOJSON: _geojson,
    Format.GPX: _gpx,
    Format.KML: _kml,
    Format.SVG: animated_svg,
}
