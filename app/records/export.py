"""A flight in the formats of other programs: tracks for maps, mission items for ground stations."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as Xml

import numpy as np

from sidelong.app.errors import InputError
from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import PositionReading
from sidelong.mission.core.circle import Circle
from sidelong.mission.route.route import Route
from sidelong.mission.upload.fences import Outline
from sidelong.mission.upload.items import FRAME_GLOBAL, NAV_WAYPOINT, plan_file
from sidelong.mission.upload.mission_item import MissionItem, e7

_RING_CORNERS = 72
ROUTE_POINTS = 2000  # of a route in a file


@dataclass(frozen=True, slots=True)
class Mission:
    """Items without a home item, the fences (outlines in the plane), and the MAV_AUTOPILOT."""

    items: Sequence[MissionItem]
    airspeed_m_s: float
    mav_autopilot: int
    keep_in: Sequence[Outline] = ()
    keep_out: Sequence[Outline] = ()


class TrackPoint(NamedTuple):
    """height_m: above the sea or, if home's altitude is unknown, above home; empty for a target, on the ground."""

    time_s: float
    latitude_deg: float
    longitude_deg: float
    height_m: tuple[float, ...]


class PositionTrack(NamedTuple):
    """A line that was travelled; kind: "aircraft" or "target"."""

    kind: str
    name: str
    places: list[TrackPoint]


@dataclass(frozen=True, slots=True)
class FlownTrack:
    """Tracks in order of time, in ``plane``.

    circles: (since, circle). booted: when the vehicle's clock was zero. home_altitude_m: above the sea; None:
    unknown. label: the aircraft's name, where there are several; targets: of each estimate the target's name,
    likewise.
    """

    name: str
    plane: LocalPlane
    aircraft: Sequence[PositionReading]
    estimates: Sequence[TargetEstimate] = ()
    circles: Sequence[tuple[float, Circle]] = ()
    mission: Mission | None = None
    booted: datetime | None = None
    home_altitude_m: float | None = None
    label: str = ""
    targets: Sequence[str] = ()
    route: Route | None = None

    def named(self, what: str) -> str:
        """Return a name for a track, with that of the aircraft if several flew."""
        return f"{self.label} {what}" if self.label else what

    def of_targets(self) -> dict[str, list[TargetEstimate]]:
        """Return the estimates of each target by its name."""
        by_name: dict[str, list[TargetEstimate]] = {}
        for estimate, name in zip(self.estimates, self.targets or [""] * len(self.estimates), strict=True):
            by_name.setdefault(name or "target", []).append(estimate)
        return by_name

    def tracks(self) -> Iterator[PositionTrack]:
        """Yield the track of the aircraft and of each target, with geodetic positions."""
        base_m = self.home_altitude_m or 0.0
        flown = [
            TrackPoint(at.time_s, *self.degrees(at.east_m, at.north_m), (round(base_m + at.height_m, 3),))
            for at in self.aircraft
        ]
        yield PositionTrack("aircraft", self.named("aircraft"), flown)
        for name, estimates in self.of_targets().items():
            places = [TrackPoint(at.time_s, *self.degrees(at.east_m, at.north_m), ()) for at in estimates]
            yield PositionTrack("target", self.named(name), places)

    def at(self, time_s: float) -> datetime | None:
        """Return the time of day of a mission time; None: it is not known."""
        return None if self.booted is None else self.booted + timedelta(seconds=time_s)

    def utc(self, time_s: float) -> str | None:
        """Return a time of the vehicle's clock as ISO 8601 in UTC, to the millisecond."""
        moment = self.at(time_s)
        return None if moment is None else moment.replace(tzinfo=None).isoformat(timespec="milliseconds") + "Z"

    def degrees(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return (latitude, longitude), rounded to the millimetre."""
        latitude_deg, longitude_deg = self.plane.latitude_longitude_deg(east_m, north_m)
        return round(latitude_deg, 8), round(longitude_deg, 8)


def ring(circle: Circle) -> list[tuple[float, float]]:
    """Return (east, north) of the corners of a polygon for a circle, in the order it is flown, closed."""
    turn = 1.0 if circle.clockwise else -1.0
    corners = [circle.position_at_course(turn * math.tau * corner / _RING_CORNERS) for corner in range(_RING_CORNERS)]
    return [*corners, corners[0]]


_SPEED = 20.0  # flight time over playing time
_LONGEST_S = 600.0  # the last part of a longer flight is shown
_STEP_S = 1.0
_WIDTH, _MARGIN = 720.0, 40.0
Placed = Callable[[np.ndarray], np.ndarray]
_STYLE = """
svg { color: #24292f; background: #fff; font: 13px sans-serif }
.aircraft { color: #0b5cad } .target { color: #b3400a } .now { color: #6d3fc0 }
@media (prefers-color-scheme: dark) {
  svg { color: #e6edf3; background: #0d1117 }
  .aircraft { color: #6cb6ff } .target { color: #ff9d5c } .now { color: #c5a3ff }
}
path, line, circle { fill: none; stroke: currentColor; stroke-linejoin: round }
.solid { fill: currentColor } .faint { opacity: .25 } text { fill: currentColor; stroke: none }
"""


def animated_svg(flights: Sequence[FlownTrack]) -> str:
    """Return the picture of the last ten minutes, at 20 times real time. Raises InputError without a target."""
    if not any(flight.estimates for flight in flights):
        raise InputError(f"{flights[0].name} has no target, so there is no animation to export; try --format kml.")
    end_s = min(flight.aircraft[-1].time_s for flight in flights)
    begin_s = max(flight.estimates[0].time_s for flight in flights if flight.estimates)
    times_s = np.arange(max(begin_s, end_s - _LONGEST_S), end_s, _STEP_S)
    tracks = [_at(times_s, flight.aircraft) for flight in flights]
    targets = [_at(times_s, flight.estimates) for flight in flights if flight.estimates]
    everything = np.concatenate([*tracks, *targets])
    low, high = everything.min(axis=0), everything.max(axis=0)
    scale = (_WIDTH - 2.0 * _MARGIN) / max(high[0] - low[0], 1.0)
    height = (high[1] - low[1]) * scale + 2.0 * _MARGIN

    def placed(points: np.ndarray) -> np.ndarray:
        right, up = scale * (points - low).T
        return np.column_stack((_MARGIN + right, height - _MARGIN - up))

    seconds = len(times_s) * _STEP_S / _SPEED
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:.0f} {height:.0f}" role="img">',
        "<title>An aircraft circles on one side of a moving target and relocates its circle</title>",
        f"<style>{_STYLE}</style>",
        *_legend(scale, height),
    ]
    for target in targets:
        lines += _moving(placed(target), "target", seconds, 'circle r="5" class="solid"')
    for flight, track in zip(flights, tracks, strict=True):
        lines += _circles(flight, times_s, seconds, placed, scale)
        lines += _sight(placed(track), placed(targets[0]), seconds)
        lines += _moving(placed(track), "aircraft", seconds, 'path d="M9 0L-7 6L-3 0L-7 -6Z" class="solid"')
    return "\n".join([*lines, "</svg>"]) + "\n"


def _at(times_s: np.ndarray, moments: Sequence[object]) -> np.ndarray:
    """Return (east, north) at each time, m: (n, 2)."""
    known = np.array([(moment.time_s, moment.east_m, moment.north_m) for moment in moments])  # type: ignore[attr-defined]
    return np.column_stack([np.interp(times_s, known[:, 0], known[:, axis]) for axis in (1, 2)])


def _animated(seconds: float, timing: str = "", **values: Iterable[float]) -> Iterator[str]:
    for name, several in values.items():
        listed = ";".join(f"{value:.1f}" for value in several)
        repeat = f'{timing} dur="{seconds:.1f}s" repeatCount="indefinite"'
        yield f'<animate attributeName="{name}" values="{listed}"{repeat}/>'


def _moving(points: np.ndarray, kind: str, seconds: float, shape: str) -> Iterator[str]:
    path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
    repeat = f'dur="{seconds:.1f}s" repeatCount="indefinite"'
    yield f'<g class="{kind}"><path class="faint" d="{path}"/>'
    values = ";".join(f"{x:.1f},{y:.1f}" for x, y in points)
    motion = f'<animateMotion values="{values}" calcMode="linear" rotate="auto" {repeat}/>'
    yield f"<{shape}>{motion}</{shape.split(maxsplit=1)[0]}></g>"


def _sight(aircraft: np.ndarray, target: np.ndarray, seconds: float) -> Iterator[str]:
    (x1, y1), (x2, y2) = aircraft.T, target.T
    yield '<line class="target" stroke-dasharray="4 4" opacity=".6">'
    yield from _animated(seconds, x1=x1, y1=y1, x2=x2, y2=y2)
    yield "</line>"


def _circles(flight: FlownTrack, times_s: np.ndarray, seconds: float, placed: Placed, scale: float) -> Iterator[str]:
    """Draw the circle that is commanded at each moment: one shape that jumps."""
    begun = [(max(since_s, times_s[0]), circle) for since_s, circle in flight.circles if since_s < times_s[-1]]
    circles = dict(begun)  # of those from before the first moment, the last
    if not circles:
        return
    centres = placed(np.array([(circle.east_m, circle.north_m) for circle in circles.values()]))
    moments = [f"{(since_s - times_s[0]) / (len(times_s) * _STEP_S):.4f}" for since_s in circles]
    timing = f' calcMode="discrete" keyTimes="{";".join(["0", *moments[1:]])}"'
    yield '<circle class="now" stroke-width="2">'
    radii = [scale * circle.radius_m for circle in circles.values()]
    yield from _animated(seconds, timing, cx=centres[:, 0], cy=centres[:, 1], r=radii)
    yield "</circle>"


def _legend(scale: float, height: float) -> Iterator[str]:
    long_m = 100.0
    y = height - 12.0
    yield f'<path d="M{_MARGIN} {y}h{long_m * scale:.1f}"/><text x="{_MARGIN}" y="{y - 5}">{long_m:.0f} m</text>'
    yield f'<g transform="translate({_WIDTH - 24} 34)"><path class="solid" d="M0 -14L5 4L0 0L-5 4Z"/>'
    yield '<text x="-4" y="18">N</text></g>'
    for place, (kind, words) in enumerate(
        (("aircraft", "aircraft"), ("target", "target and line of sight"), ("now", "commanded circle"))
    ):
        yield f'<text class="{kind}" x="{_MARGIN + 170 * place}" y="20">{words}</text>'


_KML = "http://www.opengis.net/kml/2.2"
_KML_COLOURS = {"aircraft": "ff0080ff", "target": "ff0000ff", "circle": "ffffaa00", "route": "8000d7ff"}
_KML_EXTENSION = "http://www.google.com/kml/ext/2.2"


class Format(StrEnum):
    """Missions of QGroundControl (.plan) and Mission Planner (WPL 110), tracks, an animation, records (MCAP, KLV)."""

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
    """Write a flight to ``out``, or the tracks of several aircraft that flew together. Raises InputError, OSError."""
    if wanted in MISSIONS:
        (flight,) = flights
        if flight.mission is None:
            raise InputError(f"{flight.name} has no mission items to export.")
        text = _MISSION_WRITERS[wanted](flight, flight.mission)
    else:
        for flight in flights:
            if len(flight.aircraft) < 2:
                raise InputError(f"{flight.name} has fewer than two positions, so there is no track to export.")
        text = _TRACK_WRITERS[wanted](flights)
    out.write_text(text, encoding="utf-8")


def _plan(flight: FlownTrack, mission: Mission) -> str:
    return plan_file(
        mission.items,
        flight.plane,
        flight.home_altitude_m or 0.0,
        mission.airspeed_m_s,
        mission.mav_autopilot,
        mission.keep_in,
        mission.keep_out,
    )


def _waypoints(flight: FlownTrack, mission: Mission) -> str:
    # Mission Planner treats the first line as home, whatever it contains.
    x, y = e7(flight.degrees(0.0, 0.0))
    home = MissionItem(NAV_WAYPOINT, FRAME_GLOBAL, 0.0, 0.0, 0.0, 0.0, x, y, flight.home_altitude_m or 0.0)
    lines = ["QGC WPL 110"]
    for sequence, item in enumerate((home, *mission.items)):
        parameters = (item.param1, item.param2, item.param3, item.param4)
        values = (
            *(sequence, int(sequence == 0), item.frame, item.command),
            *(f"{value:.8f}" for value in (*parameters, *item.latitude_longitude_deg)),
            *(f"{item.z:.6f}", int(item.autocontinue)),
        )
        lines.append("\t".join(map(str, values)))
    return "\n".join(lines) + "\n"


def _csv(flights: Sequence[FlownTrack]) -> str:
    """One row a moment of aircraft, target or circle (its centre), by each aircraft's clock and in UTC."""
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
        for e in estimates:  # sigma_m: along the worst direction
            sigma_m = math.sqrt(np.linalg.eigvalsh(e.covariance[:2, :2])[-1])
            moments.append((name, e.time_s, e, {"sigma_m": sigma_m, "quality": e.quality.value}))
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


_MISSION_WRITERS = {Format.PLAN: _plan, Format.WAYPOINTS: _waypoints}
_TRACK_WRITERS: dict[Format, Callable[[Sequence[FlownTrack]], str]] = {
    Format.CSV: _csv,
    Format.GEOJSON: _geojson,
    Format.GPX: _gpx,
    Format.KML: _kml,
    Format.SVG: animated_svg,
}
