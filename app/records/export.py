"""A flight in the formats of other programs: tracks for maps, mission items for ground stations."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

from sidelong.app.errors import InputError
from sidelong.app.records.animation import animated_svg
from sidelong.app.records.track import ROUTE_POINTS, Flight, ring, sigma_m
from sidelong.mission.upload.items import FRAME_GLOBAL, NAV_WAYPOINT
from sidelong.mission.upload.mission_item import MissionItem, e7
from sidelong.mission.upload.plan_file import plan_file

_GPX = "http://www.topografix.com/GPX/1/1"
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


def export(flights: Sequence[Flight], wanted: Format, out: Path) -> None:
    """Write a flight to ``out``, or the tracks of several aircraft that flew together.

    Raises InputError when one has nothing to write in this format or the file cannot be written.
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
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{out} cannot be written: {error.strerror}.") from error


# -- mission items ------------------------------------------------------------------------------------------


def _plan(flight: Flight) -> str:
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


def _waypoints(flight: Flight) -> str:
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


def _csv(flights: Sequence[Flight]) -> str:
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


def _rows(flight: Flight) -> Iterator[dict[str, Any]]:
    def row(what: str, time_s: float, east_m: float, north_m: float, **values: Any) -> dict[str, Any]:
        latitude_deg, longitude_deg = flight.degrees(east_m, north_m)
        return {
            "time_s": round(time_s, 6),
            "utc": flight.utc(time_s) or "",
            "what": flight.named(what),
            "latitude_deg": f"{latitude_deg:.8f}",
            "longitude_deg": f"{longitude_deg:.8f}",
            **{name: round(value, 3) if isinstance(value, float) else value for name, value in values.items()},
        }

    for since_s, circle in flight.circles:
        yield row(
            "circle",
            since_s,
            circle.east_m,
            circle.north_m,
            radius_m=circle.radius_m,
            clockwise=int(circle.clockwise),
        )
    for p in flight.aircraft:
        yield row(
            "aircraft",
            p.time_s,
            p.east_m,
            p.north_m,
            height_m=p.height_m,
            velocity_east_m_s=p.velocity_east_m_s,
            velocity_north_m_s=p.velocity_north_m_s,
        )
    for name, estimates in flight.of_targets().items():
        for e in estimates:
            yield row(
                name,
                e.time_s,
                e.east_m,
                e.north_m,
                velocity_east_m_s=e.velocity_east_m_s,
                velocity_north_m_s=e.velocity_north_m_s,
                sigma_m=sigma_m(e),
                quality=e.quality.value,
            )


# -- maps ---------------------------------------------------------------------------------------------------


def _geojson(flights: Sequence[Flight]) -> str:
    features = [feature for flight in flights for feature in _features(flight)]
    return json.dumps({"type": "FeatureCollection", "features": features}, separators=(",", ":")) + "\n"


def _features(flight: Flight) -> list[dict[str, Any]]:
    def feature(name: str, kind: str, coordinates: list[Any], **properties: Any) -> dict[str, Any]:
        return {
            "type": "Feature",
            "properties": {"name": flight.named(name), **properties},
            "geometry": {"type": kind, "coordinates": coordinates},
        }

    def line(name: str, moments: list[tuple[float, list[float]]]) -> dict[str, Any]:
        times_s = [time_s for time_s, _ in moments]
        utc = [flight.utc(time_s) for time_s in times_s] if flight.booted else None
        return feature(name, "LineString", [place for _, place in moments], time_s=times_s, utc=utc)

    def place(east_m: float, north_m: float, *height_m: float) -> list[float]:
        latitude_deg, longitude_deg = flight.degrees(east_m, north_m)
        return [longitude_deg, latitude_deg, *(round(value, 3) for value in height_m)]

    # Heights are above home where its altitude is not known; the property states it.
    base_m = flight.home_altitude_m
    aircraft = line(
        "aircraft",
        [(p.time_s, place(p.east_m, p.north_m, p.height_m + (base_m or 0.0))) for p in flight.aircraft],
    )
    aircraft["properties"]["height_above"] = "home" if base_m is None else "sea level"
    features = [aircraft]
    if flight.route is not None:
        route_m = flight.route.outline_m(ROUTE_POINTS).tolist()
        features.append(feature("route", "LineString", [place(*point) for point in route_m]))
    for name, estimates in flight.of_targets().items():
        if len(estimates) > 1:
            features.append(line(name, [(e.time_s, place(e.east_m, e.north_m)) for e in estimates]))
    for since_s, circle in flight.circles:
        corners = [place(*corner) for corner in ring(circle)]
        # A polygon's outer ring runs counter-clockwise (RFC 7946).
        outer = corners[::-1] if circle.clockwise else corners
        features.append(
            feature(
                "circle",
                "Polygon",
                [outer],
                since_s=since_s,
                since_utc=flight.utc(since_s),
                radius_m=circle.radius_m,
                clockwise=circle.clockwise,
            )
        )
    return features


def _gpx(flights: Sequence[Flight]) -> str:
    root = Xml.Element("gpx", {"xmlns": _GPX, "version": "1.1", "creator": "sidelong"})
    for flight in flights:
        _gpx_tracks(root, flight)
    return _document(root)


def _gpx_tracks(root: Xml.Element, flight: Flight) -> None:
    base_m = flight.home_altitude_m
    aircraft = [
        (p.time_s, p.east_m, p.north_m, None if base_m is None else base_m + p.height_m) for p in flight.aircraft
    ]
    tracks: dict[str, list[tuple[float, float, float, float | None]]] = {"aircraft": aircraft}
    for name, estimates in flight.of_targets().items():
        tracks[name] = [(e.time_s, e.east_m, e.north_m, None) for e in estimates]
    for name, moments in tracks.items():
        if not moments:
            continue
        track = Xml.SubElement(root, "trk")
        Xml.SubElement(track, "name").text = flight.named(name)
        segment = Xml.SubElement(track, "trkseg")
        for time_s, east_m, north_m, altitude_m in moments:
            latitude_deg, longitude_deg = flight.degrees(east_m, north_m)
            position = {"lat": f"{latitude_deg:.8f}", "lon": f"{longitude_deg:.8f}"}
            point = Xml.SubElement(segment, "trkpt", position)
            if altitude_m is not None:
                Xml.SubElement(point, "ele").text = f"{altitude_m:.3f}"
            utc = flight.utc(time_s)
            if utc is not None:
                Xml.SubElement(point, "time").text = utc


def _kml(flights: Sequence[Flight]) -> str:
    root = Xml.Element("kml", {"xmlns": _KML, "xmlns:gx": _KML_EXTENSION})
    document = Xml.SubElement(root, "Document")
    Xml.SubElement(document, "name").text = flights[0].name
    for name, colour in _KML_COLOURS.items():
        style = Xml.SubElement(Xml.SubElement(document, "Style", {"id": name}), "LineStyle")
        Xml.SubElement(style, "color").text = colour
        Xml.SubElement(style, "width").text = "2"
    for flight in flights:
        _kml_flight(document, flight)
    return _document(root)


def _kml_flight(document: Xml.Element, flight: Flight) -> None:
    # Heights are above home: over hills they mean something above the sea only.
    base_m = flight.home_altitude_m
    _kml_track(
        document,
        flight,
        "aircraft",
        "aircraft",
        "relativeToGround" if base_m is None else "absolute",
        [(p.time_s, p.east_m, p.north_m, (base_m or 0.0) + p.height_m) for p in flight.aircraft],
    )
    for name, estimates in flight.of_targets().items():
        places_m = [(e.time_s, e.east_m, e.north_m, 0.0) for e in estimates]
        _kml_track(document, flight, "target", name, "clampToGround", places_m)
    if flight.route is not None:
        name = f"{flight.named('route')}, {flight.route.length_m:.0f} m"
        _kml_line(document, flight, "route", name, flight.route.outline_m(ROUTE_POINTS).tolist())
    for since_s, circle in flight.circles:
        name = f"{flight.named('circle')} from {since_s:.1f} s, radius {circle.radius_m:.0f} m"
        _kml_line(document, flight, "circle", name, ring(circle))


def _kml_line(
    document: Xml.Element, flight: Flight, style: str, name: str, points_m: Iterable[tuple[float, float]]
) -> None:
    line = Xml.SubElement(_kml_mark(document, style, name), "LineString")
    places = (flight.degrees(*point) for point in points_m)
    Xml.SubElement(line, "coordinates").text = " ".join(f"{lon:.8f},{lat:.8f}" for lat, lon in places)


def _kml_mark(document: Xml.Element, style: str, name: str) -> Xml.Element:
    mark = Xml.SubElement(document, "Placemark")
    Xml.SubElement(mark, "name").text = name
    Xml.SubElement(mark, "styleUrl").text = f"#{style}"
    return mark


def _kml_track(
    document: Xml.Element,
    flight: Flight,
    style: str,
    name: str,
    altitude_mode: str,
    moments: list[tuple[float, float, float, float]],
) -> None:
    """Add a track that can be played back, or a plain line where the time of day is not known."""
    if not moments:
        return
    mark = _kml_mark(document, style, flight.named(name))
    track = Xml.SubElement(mark, "LineString" if flight.booted is None else "gx:Track")
    Xml.SubElement(track, "altitudeMode").text = altitude_mode
    places = []
    for _, east_m, north_m, height_m in moments:
        latitude_deg, longitude_deg = flight.degrees(east_m, north_m)
        places.append((f"{longitude_deg:.8f}", f"{latitude_deg:.8f}", f"{height_m:.2f}"))
    if flight.booted is None:
        Xml.SubElement(track, "coordinates").text = " ".join(map(",".join, places))
        return
    for time_s, *_ in moments:
        Xml.SubElement(track, "when").text = flight.utc(time_s)
    for place in places:
        Xml.SubElement(track, "gx:coord").text = " ".join(place)


def _document(root: Xml.Element) -> str:
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"


_MISSION_WRITERS: dict[Format, Callable[[Flight], str]] = {Format.PLAN: _plan, Format.WAYPOINTS: _waypoints}
_TRACK_WRITERS: dict[Format, Callable[[Sequence[Flight]], str]] = {
    Format.CSV: _csv,
    Format.GEOJSON: _geojson,
    Format.GPX: _gpx,
    Format.KML: _kml,
    Format.SVG: animated_svg,
}
