"""Positions in the files of other programs, for tracks and routes: GPX, KML, GeoJSON, CoT, CSV and missions.

The content decides on the format, the suffix only on whether a file is tried. A file holds one line or several; one
of them is used: the one that is asked for, else the target's of a flight's export, else the longest.
"""

from __future__ import annotations

import codecs
import csv
import io
import json
import math
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import islice, pairwise, zip_longest
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

SUFFIXES = (
    *(".gpx", ".kml", ".kmz", ".geojson", ".json", ".cot", ".xml", ".csv", ".tsv", ".txt"),
    *(".plan", ".waypoints", ".nmea"),
)
_FILE_MAX_BYTES = 16 << 20
_POINTS_MAX = 400_000
_PARTS_MAX = 2_000_000  # elements of XML, with their attributes, or lists and objects of JSON
_TARGET = "target"
_LISTED = 5  # lines that are not used, by name
_METRES_PER_DEG = 111_320.0

_DECLARED = re.compile(rb"""<\?xml[^>]*?encoding\s*=\s*["']([\w.:-]{1,40})""")
_STRAY = re.compile(r"&(?!(?:amp|lt|gt|quot|apos|#\d{1,7}|#x[0-9a-fA-F]{1,6});)")  # HTML's entities, and plain &
_DECLARATION, _EVENT = re.compile(r"<\?xml[^>]*\?>"), re.compile(r"\s*(?:<\?xml[^>]*\?>\s*)?<event\b")
_POSITION = re.compile(r"[^\s,]+(?:\s*,\s*[^\s,]+)*")
_SPACE_OR_COMMA = re.compile(r"[\s,]+")
_COMPACT = re.compile(r"((?:19|20)?\d\d)(\d\d)(\d\d)(?: |(?<=\d{8}))(\d\d)(\d\d)(\d\d(?:\.\d+)?)()")
_CLOCK = re.compile(
    r"(?:(\d{1,4})[-/.](\d{1,2})[-/.](\d{1,4})[T ,]+)?(\d{1,2}):(\d\d)(?::(\d\d(?:[.,]\d+)?))?\s*([AaPp][Mm])?"
    r"\s*(?:Z|UTC|GMT|[+-]00:?00)?"
)
_NO_TIME = re.compile(r"[\d\s:.,/TZ+-]+")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")
_SEXAGESIMAL = re.compile(r"([NSEW]?)\s*([\d.]+)[°\s]*(?:([\d.]+)['\s]*)?(?:([\d.]+)[\"\s]*)?([NSEW]?)")
_RMC = re.compile(  # NMEA 0183: time, position and date
    r"^.{0,40}\$..RMC,(\d{6}[.\d]{0,9}),A,(\d\d)([\d.]{1,12}),([NS]),(\d{3})([\d.]{1,12}),([EW]),[^,\n]{0,9},"
    r"[^,\n]{0,9},(\d\d)(\d\d)(\d\d)",
    re.MULTILINE,
)
_CELL_MAX = 64  # characters of a time or coordinate: the expressions above take long for more
# Columns by what their names may be, the best first; words are joined by "_".
_TIMES = (
    *("t_s", "time_s", "seconds_elapsed", "timestamp", "time", "t", "datetime", "date_time", "basedatetime"),
    *("base_date_time", "date_time_utc", "utc", "fixtime", "epoch", "unixtime", "unix", "ts", "date"),
)
_CLOCKS = ("time", "utc_t", "heure", "hora", "uhrzeit")
_LATITUDES, _LONGITUDES = ("lat", "latitude"), ("lon", "longitude", "long", "lng")
_OWNERS = (
    *("what", "mmsi", "imo", "individual_local_identifier", "tag_local_identifier", "track_id", "trackid"),
    *("vessel_id", "trip_id", "device_id", "deviceid", "object_id", "user_id", "uid", "icao24", "callsign"),
    *("vesselname", "name", "title", "id"),
)
_WAY_POINT_COMMANDS = frozenset({16, 17, 18, 19, 21, 22, 31, 82, 84, 85})  # MAV_CMD_NAV_*
_WPL_COLUMNS = 12


class TrackError(ValueError):
    """The file cannot be used as a track or route; the message names it and the reason."""


@dataclass(slots=True)
class Line:
    """One track, route, drawn line, area or set of points of a file.

    points: (time, latitude, longitude, line of the file), or with east and north in metres. The time is in seconds
    or, where it is a number, as in the file; NaN where there is none or no calendar has it.
    """

    kind: str  # "route", "line", "track", "area" or "points"
    name: str = ""  # its number where the file has none
    points: list[tuple[float, float, float, int]] = field(default_factory=list)

    def length_m(self, geodetic: bool) -> float:
        """Return the length, accurate enough to compare lines."""
        latitude_deg = self.points[0][1]
        narrow = math.cos(math.radians(latitude_deg)) if abs(latitude_deg) <= 90.0 else 1.0
        axes = (_METRES_PER_DEG, _METRES_PER_DEG * narrow) if geodetic else (1.0, 1.0)
        return sum(math.hypot(axes[0] * (b[1] - a[1]), axes[1] * (b[2] - a[2])) for a, b in pairwise(self.points))


class _Lines(list[Line]):
    point_count = 0  # of all lines

    def begin(self, kind: str, name: str = "") -> Line:
        self.append(line := Line(kind, name))
        return line

    def add(self, line: Line, time: float, first: float, second: float, at: int) -> None:
        self.point_count += 1
        if self.point_count > _POINTS_MAX:
            raise ValueError(f"it holds more than {_POINTS_MAX:,} points; thin it out")
        line.points.append((time, first, second, at))


def file_and_name(path: Path) -> tuple[Path, str]:
    """Return a file and, of FILE#NAME, the name of the line that is asked for; empty if none is."""
    file, mark, name = str(path).rpartition("#")
    return (Path(file), name.strip()) if mark and not path.exists() else (path, "")


def is_track_file(path: Path) -> bool:
    """Return whether the ending is that of a track, '#NAME' behind it left out."""
    return file_and_name(path)[0].suffix.lower() in SUFFIXES


def read_lines(path: Path) -> tuple[list[Line], bool]:
    """Return the lines of a file that hold points, and whether these are in degrees. Raises TrackError."""
    if path.suffix.lower() not in SUFFIXES and not path.is_dir():
        raise TrackError(f"{path}: is not a route file or track; give one of {', '.join(SUFFIXES)}")
    lines, geodetic = _Lines(), True
    try:
        text = _text(path)
        begin = text.lstrip()[:16]
        if begin.startswith("<"):
            _read_xml(text, lines)
        elif begin.startswith(("{", "[")) or path.suffix.lower() in (".json", ".geojson", ".plan"):
            _read_json(text, lines)
        elif begin.startswith("QGC WPL"):
            _add_mission(lines, _wpl_items(text))
        elif _RMC.search(text):
            _read_nmea(text, lines)
        else:
            geodetic = _read_csv(text, lines)
    except OSError as error:
        raise TrackError(f"{path}: cannot be read ({error.strerror})") from error
    except TrackError as error:
        raise TrackError(f"{path}: {error}") from error
    except Exception as error:  # of one of several parsers
        reason = _one_line(str(error)) or type(error).__name__
        raise TrackError(f"{path}: is not a readable track or route: {reason:.160}") from error
    found = [line for line in lines if line.points]
    for number, line in enumerate(found, 1):
        line.name = _one_line(line.name) or str(number)
    return found, geodetic


def chosen(file: Path, found: Sequence[tuple[Line, float]], name: str) -> tuple[int, str]:
    """Return the index of the line to use, and a note on the others. Raises TrackError if none has this name.

    Each is given with its length in m. The name may be its number; empty: the target's line, else the longest.
    """
    names = [line.name for line, _ in found]
    wanted = name or _TARGET
    named = [k for k, one in enumerate(names) if one == wanted or (not name and one.endswith(f" {_TARGET}"))]
    if name and not named:
        if not name.isdecimal() or not 1 <= int(name) <= len(names):
            raise TrackError(f"{file}: has no track or route {name!r:.60}; it has {_listed(names)}")
        named = [int(name) - 1]
    best = max(named or range(len(names)), key=lambda k: found[k][1])
    others, reason = names[:best] + names[best + 1 :], "" if named else ", the longest,"
    if not others:
        return best, ""
    lines = "line of the file is" if len(others) == 1 else "lines of the file are"
    used = f"{names[best]!r:.60}{reason} is used, {len(others)} further {lines} not used ({_listed(others)})"
    return best, f"{used}; FILE#NAME selects another"


def _one_line(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text[:1000]).split())


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"{name:.40}" for name in names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")


def _text(path: Path) -> str:
    """Return the text of a file, or of the track in a zipped one; XML in the encoding that it declares."""
    if path.exists() and not path.is_file():
        raise TrackError("cannot be read: it is not a file")
    with path.open("rb") as file:
        data = file.read(_FILE_MAX_BYTES + 1)
    if data.startswith(b"PK\x03\x04"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = [name for name in archive.namelist() if Path(name).suffix.lower() in SUFFIXES]
            inner = next((name for name in names if name.endswith("doc.kml")), names[0] if names else None)
            if inner is None:
                raise TrackError("is an archive without a track or route")
            with archive.open(inner) as member:
                data = member.read(_FILE_MAX_BYTES + 1)
    if len(data) > _FILE_MAX_BYTES:
        raise TrackError(f"is longer than {_FILE_MAX_BYTES >> 20} MiB; cut the track")
    data = data.removeprefix(codecs.BOM_UTF8)
    declared = _DECLARED.match(data.lstrip()[:200])
    encoding = "utf-8" if declared is None else codecs.lookup(declared[1].decode()).name
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif encoding in ("idna", "punycode") or encoding.startswith(("utf-16", "utf-32")):
        encoding = "utf-8"  # the declaration itself is in ASCII
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("cp1252", "replace")  # positions are ASCII, whatever names are in
    if "\0" in text[:32]:
        raise TrackError("is not text in UTF-8; a track is a .gpx or a .csv file")
    if not text.strip():
        raise TrackError("is empty")
    return text.replace("\0", "")  # some loggers pad their cells


def _seconds(stamp: object) -> float:
    """Return a time in seconds, a number unchanged, NaN for a time that no calendar has. Raises ValueError."""
    if isinstance(stamp, int | float):
        return float(stamp)
    text = str(stamp or "").strip()
    readable = len(text) <= _CELL_MAX
    parts = _COMPACT.fullmatch(text) if readable else None
    if parts is None and readable:
        with suppress(ValueError):
            return float(text)
        with suppress(ValueError):
            time = datetime.fromisoformat(text)
            return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()
        parts = _CLOCK.fullmatch(text)
        if parts is None and _NO_TIME.fullmatch(text):
            return math.nan
    if parts is None:
        raise ValueError(f"{text!r:.40} is neither seconds nor a time of ISO 8601")
    year, month, day, hour, minute = (int(part or 0) for part in parts.groups()[:5])
    second = float((parts[6] or "0").replace(",", "."))
    if parts[7]:
        hour = hour % 12 + 12 * (parts[7].lower() == "pm")
    if parts[1] is None:
        return hour * 3600.0 + minute * 60.0 + second
    if len(parts[1]) < 4 and parts.re is _CLOCK:
        year, month, day = day, (month if month <= 12 else year), (year if month <= 12 else month)
    year += 2000 if year < 100 and len(parts[1]) < 3 else 0
    try:
        return datetime(year, month, day, hour, minute, tzinfo=UTC).timestamp() + second
    except ValueError:
        return math.nan


def _read_xml(text: str, lines: _Lines) -> None:
    """Read GPX, KML or cursor on target: prefixes need not be declared, entities are refused."""
    builder, parser, handlers = ElementTree.TreeBuilder(), expat.ParserCreate(), _handlers(lines)
    parser.buffer_text = True
    parts = 0

    def local(name: str) -> str:
        return name.rpartition(":")[2]

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal parts
        parts += 1 + 3 * len(attributes)
        if parts > _PARTS_MAX:
            raise ValueError("it has too many parts")
        builder.start(local(name), {local(key): value for key, value in attributes.items()})

    def end(name: str) -> None:
        element = builder.end(local(name))
        if handler := handlers.get(element.tag):
            try:
                handler(element, parser.CurrentLineNumber)
            except ValueError as error:
                raise ValueError(f"line {parser.CurrentLineNumber}: {error}") from error
            element.clear()

    def refuse(*_: object) -> None:
        raise ValueError("it declares entities")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.EntityDeclHandler = builder.data, refuse
    text = _STRAY.sub("&amp;", text)
    if _EVENT.match(text):  # a recorded stream has one document after another
        text = f"<events>{_DECLARATION.sub('', text)}</events>"
    parser.Parse(text, True)


def _handlers(lines: _Lines) -> dict[str, Callable[[ElementTree.Element, int], None]]:
    """Return what takes an element of this name at its end, with its line of the file.

    The segments of a GPX track are one line, and so are the tracks of a gx:MultiTrack that follow one another.
    """
    way_points, marks, present = lines.begin("points", "way points"), lines.begin("points", "placemarks"), Line("")
    named = [len(lines)]  # how many lines have been given their placemark's name
    senders: dict[str, Line] = {}  # of cursor on target

    def point(element: ElementTree.Element, at: int) -> None:
        latitude, longitude = element.get("lat"), element.get("lon")
        if latitude and longitude:
            line = way_points if element.tag == "wpt" else present
            lines.add(line, _stamp(element.findtext("time", "")), float(latitude), float(longitude), at)

    def whole(element: ElementTree.Element, _at: int) -> None:
        line = lines.begin("track" if element.tag == "trk" else "route", element.findtext("name", ""))
        line.points, present.points = present.points, []

    def coordinates(element: ElementTree.Element, at: int) -> None:
        kind = {"LineString": "line", "LinearRing": "area"}.get(element.tag)
        line = marks if kind is None else lines.begin(kind)
        for position in _POSITION.finditer(element.findtext("coordinates", "")):
            words = position[0].split(",")
            if len(words) > 3:
                raise ValueError(f"{position[0]:.60} is more than one position; put a space between them")
            lines.add(line, math.nan, *_latitude_longitude(words), at)

    def track(element: ElementTree.Element, at: int) -> None:
        line, stamps = lines.begin("track"), [one.text or "" for one in element.iter("when")]
        for one, stamp in zip_longest(element.findall(".//coord"), stamps, fillvalue=""):
            words = _SPACE_OR_COMMA.split("" if isinstance(one, str) else (one.text or "").strip())
            if words != [""]:
                lines.add(line, _stamp(stamp), *_latitude_longitude(words), at)

    def tracks(_element: ElementTree.Element, _at: int) -> None:
        own = [line for line in lines[named[0] :] if line.kind == "track" and line.points]
        for line in own[1:]:
            if line.points[0][0] > own[0].points[-1][0]:  # else it is of somebody else
                own[0].points += line.points
                line.points = []

    def hole(_element: ElementTree.Element, _at: int) -> None:
        lines[-1].points = []

    def placemark(element: ElementTree.Element, _at: int) -> None:
        stamp = element.findtext("TimeStamp/when", "").strip()
        if stamp and marks.points and element.find("Point") is not None:
            marks.points[-1] = (_seconds(stamp), *marks.points[-1][1:])
        for line in lines[named[0] :]:
            line.name = element.findtext("name", "")
        named[0] = len(lines)

    def event(element: ElementTree.Element, at: int) -> None:
        contact, point = element.find("detail/contact"), element.find("point")
        uid = element.get("uid", "")
        name = contact.get("callsign", uid) if contact is not None else uid
        links = [link.attrib["point"].split(",") for link in element.iter("link") if "point" in link.attrib]
        if links:
            line = lines.begin("route", name)
            for words in links:
                lines.add(line, math.nan, *_latitude_longitude(words[1::-1]), at)
        elif point is not None and element.get("time") and element.get("type", "a-").startswith("a-"):
            line = senders.get(uid) or senders.setdefault(uid, lines.begin("track", name))
            place = _latitude_longitude([point.get("lon"), point.get("lat")])
            lines.add(line, _seconds(element.get("time")), *place, at)

    return {
        **dict.fromkeys(("trkpt", "rtept", "wpt"), point),
        **dict.fromkeys(("trk", "rte"), whole),
        **dict.fromkeys(("LineString", "LinearRing", "Point"), coordinates),
        **{"Track": track, "MultiTrack": tracks, "innerBoundaryIs": hole, "Placemark": placemark, "event": event},
    }


def _latitude_longitude(position: Any) -> tuple[float, float]:
    """Return latitude and longitude of a position that names the longitude first. Raises ValueError."""
    match position:
        case [longitude, latitude, *_]:
            with suppress(ValueError, TypeError):
                return float(latitude), float(longitude)
    raise ValueError(f"{position!r:.60} is not a position in degrees (longitude, latitude)")


def _read_json(text: str, lines: _Lines) -> None:
    """Read GeoJSON, or a mission of QGroundControl."""
    if text.count("[") + text.count("{") > _PARTS_MAX:
        raise ValueError("it has too many parts")
    document = json.loads(text)
    match document:
        case {"fileType": "Plan", "mission": {"items": [*items]}} | {"fileType": "Mission", "items": [*items]}:
            _add_mission(lines, _plan_items(items))
            return
    points: list[tuple[dict[str, Any], float, float]] = []
    for properties, geometry in _geometries(document, {}):
        kind, coordinates = geometry["type"], geometry["coordinates"]
        name = str(properties.get("name") or properties.get("title") or "")
        if kind in ("Point", "MultiPoint"):
            positions = [coordinates] if kind == "Point" else coordinates
            points += [(properties, *_latitude_longitude(position)) for position in positions]
        elif kind in ("LineString", "MultiLineString"):
            _add_line(lines, lines.begin("line", name), coordinates if "M" in kind else [coordinates], properties)
        elif kind in ("Polygon", "MultiPolygon"):
            for rings in coordinates if "M" in kind else [coordinates]:
                _add_line(lines, lines.begin("area", name), rings[:1], properties)
    if points:
        keys = [key for key in points[0][0] if key.lower() not in ("lat", "lon", "latitude", "longitude")]
        rows = ((0, [own.get(key) for key in keys] + [lat, lon]) for own, lat, lon in points)
        _read_table([*keys, "lat", "lon"], rows, lines, "points")


def _geometries(document: Any, properties: dict[str, Any]) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    match document:
        case {"type": "FeatureCollection", "features": [*parts]} | {"geometries": [*parts]}:
            for part in parts:
                yield from _geometries(part, properties)
        case {"type": "Feature"}:
            if document.get("geometry"):
                own = document.get("properties")
                yield from _geometries(document["geometry"], own if isinstance(own, dict) else {})
        case {"type": str(), "coordinates": [*_]}:
            yield properties, document
        case _:
            raise ValueError("it is not a GeoJSON object")


def _add_line(lines: _Lines, line: Line, parts: Sequence[Any], properties: dict[str, Any]) -> None:
    """Add the positions of all parts, with their times if a property has as many."""
    of_each = properties.get("coordinateProperties")
    own = {**(of_each if isinstance(of_each, dict) else {}), **properties}
    keys = ("coordTimes", "times", "utc", "time_s")
    stamps: list[Any] = next((own[key] for key in keys if isinstance(own.get(key), list)), [])
    if stamps and isinstance(stamps[0], list):
        stamps = [stamp for part in stamps for stamp in part]
    positions = [position for part in parts for position in part]
    if len(stamps) != len(positions):
        stamps = [math.nan] * len(positions)
    for stamp, position in zip(stamps, positions, strict=True):
        lines.add(line, _seconds(stamp), *_latitude_longitude(position), 0)


_MissionItem = tuple[Any, Any, Any, int]  # command, latitude, longitude, line of the file


def _plan_items(items: list[Any]) -> Iterator[_MissionItem]:
    """Yield the simple items of QGroundControl, and those that complex ones, such as surveys, consist of."""
    for item in items:
        match item:
            case {"TransectStyleComplexItem": {"Items": [*inner]}}:
                yield from _plan_items(inner)
            case {"command": command, "params": [_, _, _, _, latitude, longitude, *_]}:
                yield command, latitude, longitude, 0
            case {"command": command, "coordinate": [latitude, longitude, *_]}:  # of older files
                yield command, latitude, longitude, 0


def _wpl_items(text: str) -> Iterator[_MissionItem]:
    """Yield the items of Mission Planner (QGC WPL); item 0 in the frame of absolute altitudes is home."""
    for number, row in enumerate(text.splitlines(), 1):
        cells = row.split()
        is_item = number > 1 and len(cells) >= _WPL_COLUMNS and not row.startswith("#")
        if is_item and not (cells[0] == "0" and cells[2] == "0"):
            yield cells[3], cells[8], cells[9], number


def _add_mission(lines: _Lines, items: Iterable[_MissionItem]) -> None:
    """Add the items that are flown to; at 0, 0 they mean the present position."""
    line = lines.begin("route", "mission")
    for command, latitude, longitude, at in items:
        try:
            if int(command) in _WAY_POINT_COMMANDS and latitude is not None and longitude is not None:
                place = _latitude_longitude([longitude, latitude])
                if place != (0.0, 0.0):
                    lines.add(line, math.nan, *place, at)
        except ValueError as error:
            raise ValueError(f"line {at}: {error}") from error


def _read_nmea(text: str, lines: _Lines) -> None:
    """Read the RMC sentences of a receiver's log."""
    line = lines.begin("track")
    for at, row in enumerate(text.splitlines(), 1):
        if found := _RMC.match(row):
            clock, lat, lat_min, north, lon, lon_min, east, day, month, year = found.groups()
            place = _coordinate(f"{lat} {lat_min} {north}"), _coordinate(f"{lon} {lon_min} {east}")
            lines.add(line, _seconds(f"{year}{month}{day} {clock}"), *place, at)


def _read_csv(text: str, lines: _Lines) -> bool:
    """Read a table after its first line that names the columns of a position; return whether it is in degrees."""
    begun, number = 0, 1
    for row in islice(io.StringIO(text), 40):
        lower = row.lower()
        if ("lat" in lower and ("lon" in lower or "lng" in lower)) or ("east_m" in lower and "north_m" in lower):
            break
        begun, number = begun + len(row), number + 1
    else:
        raise ValueError("the header names neither t_s, east_m, north_m nor time, lat, lon")
    delimiter = max(",;\t|", key=row.count)
    rows = csv.reader(io.StringIO(text[begun:], newline=""), delimiter=delimiter)
    header = next(rows)
    filled = ((rows.line_num + number - 1, cells) for cells in rows if any(map(str.strip, cells)))
    return _read_table(header, filled, lines, "route")


def _read_table(header: list[str], rows: Iterable[tuple[int, list[Any]]], lines: _Lines, kind: str) -> bool:
    """Read rows (line of the file, cells), those of each mmsi, name or other owner as a line of its own.

    kind: that of a line without times.
    """
    names = [re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") for name in header]
    places = [names.index(name) if name in names else None for name in ("east_m", "north_m")]
    geodetic = None in places
    if geodetic:
        places = [_column(names, alike) for alike in (_LATITUDES, _LONGITUDES)]
    first, second = places
    if first is None or second is None:
        raise ValueError("the header names neither t_s, east_m, north_m nor time, lat, lon")
    time, date, clock = (_column(names, alike) for alike in (_TIMES, ("date", "utc_d"), _CLOCKS))
    if None in (date, clock) or date == clock or time not in (date, clock):
        date = None
    else:
        time = clock  # the date has a column of its own
    owners = [names.index(name) for name in _OWNERS if name in names]
    every = Line(kind if time is None else "track")
    of: dict[int, list[str]] = {column: [] for column in owners}
    known: dict[str, str] = {}
    for at, cells in rows:
        latitude, longitude, stamp, day = (
            str(cells[k]).strip() if k is not None and k < len(cells) and cells[k] is not None else ""
            for k in (first, second, time, date)
        )
        if time is not None and not (latitude and longitude):
            continue
        try:
            place = _coordinate(latitude), _coordinate(longitude)
            time_s = _stamp(stamp, day) if stamp else math.nan
        except ValueError as error:
            shown = ",".join(map(str, cells))
            raise ValueError(f"line {at}, {shown:.60}: {error}") from error
        lines.add(every, time_s, *place, at)
        for column, values in of.items():
            word = str(cells[column] or "").strip() if column < len(cells) else ""
            values.append(known.setdefault(word, word))
    owner = next((own for own in of.values() if 1 < len(set(own)) <= len(own) / 2), None)
    if owner is None:
        lines.append(every)
        return geodetic
    found: dict[str, Line] = {}
    for name, point in zip(owner, every.points, strict=True):
        line = found.get(name) or found.setdefault(name, lines.begin(every.kind, name))
        line.points.append(point)
    return geodetic


def _column(names: list[str], alike: Sequence[str]) -> int | None:
    """Return the column of the first name, else the shortest name that has one of them as a word."""
    for name in alike:
        if name in names:
            return names.index(name)
    having = [name for name in names if not set(name.split("_")).isdisjoint(alike)]
    return names.index(min(having, key=len)) if having else None


def _stamp(time: str, date: str = "") -> float:
    """Return a time, NaN if there is none; date: a separate cell, which a whole time of its own does not need."""
    if date:
        with suppress(ValueError):
            joined = _seconds(f"{date} {time}")
            if math.isfinite(joined):
                return joined
    if not time.strip():
        return math.nan
    return _seconds(time.replace(",", ".") if _DECIMAL_COMMA.fullmatch(time) else time)


def _coordinate(word: str) -> float:
    """Return a coordinate in degrees; it may have a decimal comma, minutes, and N, S, E or W. Raises ValueError."""
    word = word.replace(",", ".").rstrip("° ")
    parts = _SEXAGESIMAL.fullmatch(word) if len(word) <= _CELL_MAX else None
    if parts is None or not parts[1] + parts[5]:
        return float(word)
    degrees, minutes, seconds = (float(part or 0.0) for part in parts.groups()[1:4])
    return (degrees + minutes / 60.0 + seconds / 3600.0) * (-1.0 if parts[1] + parts[5] in "SW" else 1.0)
