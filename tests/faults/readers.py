"""Every reader of files, with a whole file of its kind to be damaged."""

from __future__ import annotations

import contextlib
import io
import json
import random
import sqlite3
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from pmtiles.tile import Compression, TileType, zxy_to_tileid
from pmtiles.writer import Writer
from pymavlink.dialects.v20 import common as mavlink
from rasterio.io import MemoryFile
from rasterio.transform import from_origin

from sidelong.app.analysis.truth import read_truth
from sidelong.app.config import Config, load_config
from sidelong.app.errors import InputError
from sidelong.app.fleet.fleet_file import load_fleet
from sidelong.app.flight.recording import JOURNAL_TYPES, journalled_config
from sidelong.app.link.telemetry import Telemetry
from sidelong.app.planners.value_cache import stored_table
from sidelong.app.records.journal import Header, JournalReader, encode
from sidelong.app.records.log import open_log
from sidelong.app.records.route_file import read_route
from sidelong.app.records.run_folder import RunFolder
from sidelong.app.report.history import read_summary
from sidelong.app.sharing.beacon import decode
from sidelong.app.terrain.elevation_data import Bounds, ElevationData
from sidelong.app.view.background import background, readable_tile
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import (
    Announce,
    ControlAcquired,
    DecisionRecord,
    End,
    ModeReported,
    PlanStatus,
    UploadPlan,
)
from sidelong.mission.core.plan import Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.predictive.value_table import TableConfiguration, WatchCost
from sidelong.sitl.world.track import read_track
from sidelong.sitl.world.track_file import TrackError
from tests.faults.damage import Damage, damaged, resealed
from tests.logs import dataflash_pieces, ulog_pieces

DATA = Path(__file__).resolve().parent.parent / "data"
_EXCERPT_BYTES = 20_000  # so that a header is often met, and a million are read within half an hour
TABLE = TableConfiguration(
    10.0, 50.0, 50.0, 0.0008, 5.0, WatchCost.inside(100.0, 500.0), cells=2, improvements=(1, 1)
)


@dataclass(frozen=True, slots=True)
class Reader:
    """read raises one of ``complaints``, whose text is the sentence, or returns."""

    name: str
    suffix: str
    whole: bytes
    read: Callable[[Path], object]
    damage: Damage = damaged


def _log(path: Path) -> None:
    log, telemetry = open_log(path), Telemetry()
    for message in log.messages(telemetry.wanted):
        telemetry.event(message)
    log.looked_for()


def _journal(path: Path) -> None:
    reader = JournalReader(path, JOURNAL_TYPES)
    for _ in reader:
        pass
    journalled_config(reader)


def _summary(path: Path) -> None:
    folder = RunFolder(path.parent)
    path.replace(folder.summary)
    read_summary(folder.read_summary(), str(folder.summary)).table()


def _table(path: Path) -> None:
    assert stored_table(path, TABLE) is None


def _beacon(path: Path) -> None:
    decode(path.read_bytes(), datetime(2026, 11, 21, tzinfo=UTC))


def _track(path: Path) -> None:
    with contextlib.suppress(InputError):
        read_route(path)
    read_track(path)


def _route(path: Path) -> None:
    with contextlib.suppress(TrackError):
        read_track(path)
    read_route(path)


def _zipped(name: str, content: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return file.getvalue()


def _terrain(path: Path) -> None:
    ElevationData(path).coverage(Bounds(47.2, 8.2, 47.25, 8.25))


def _tile() -> bytes:
    return np.add.outer(np.arange(1201), np.arange(1201)).astype(">i2").tobytes()


def _geotiff() -> bytes:
    place = {"crs": "EPSG:4326", "transform": from_origin(8.0, 48.0, 1 / 60, 1 / 60), "nodata": -32768}
    with MemoryFile() as file:
        with file.open(driver="GTiff", width=60, height=60, count=1, dtype="int16", **place) as written:
            written.write(np.add.outer(np.arange(60), np.arange(60)).astype(np.int16), 1)
        return bytes(file.getbuffer())


def _tiles(path: Path) -> None:
    tiles = background(path, None).opened()
    assert tiles is not None
    for zoom, column, row in _TILE_PLACES:
        readable_tile(tiles, zoom, column, row)


def _mbtiles() -> bytes:
    with sqlite3.connect(":memory:") as database:
        database.execute("create table tiles (zoom_level, tile_column, tile_row, tile_data)")
        for place in _TILE_PLACES:
            database.execute("insert into tiles values (?, ?, ?, ?)", (*place, _PICTURE))
        return database.serialize()


def _pmtiles() -> bytes:
    file = io.BytesIO()
    writer = Writer(file)
    for tile_id in sorted(zxy_to_tileid(*place) for place in _TILE_PLACES):
        writer.write_tile(tile_id, _PICTURE)
    degrees = dict.fromkeys(
        ("min_lon_e7", "min_lat_e7", "max_lon_e7", "max_lat_e7", "center_lon_e7", "center_lat_e7"), 0
    )
    form = {"tile_type": TileType.PNG, "tile_compression": Compression.NONE, "center_zoom": 0}
    writer.finalize(degrees | form, {})
    return file.getvalue()


def _follow_target() -> bytes:
    beacon, three = mavlink.MAVLink(None, srcSystem=9), [0.0, 0.0, 0.0]
    place = (474_000_000, 85_000_000, 400.0)
    announced = mavlink.MAVLink_follow_target_message(1000, 1, *place, three, three, [1.0, *three], three, three, 0)
    return announced.pack(beacon)


def _journal_bytes() -> bytes:
    circle, laser = Circle(0.0, 250.0, 50.0, True), Source("DISTANCE_SENSOR", 154, 1, 100)
    plan = Plan(circle, None, 12.0)
    events = [Header("sidelong", Config().model_dump(mode="json"), LocalPlane(47.4, 8.5), {"simulation": 1})]
    events += [ModeReported(10.0, "AUTO", True), ControlAcquired(10.0, circle, "AUTO")]
    for step in range(40):
        time_s = 10.0 + 0.1 * step
        events += [
            AttitudeReading(time_s, 0.4, 0.0, 1.0),
            PositionReading(time_s, 1.5 * step, 300.0, 100.0, 15.0, 0.0, 0.0),
            GimbalReading(time_s, (1.0, 0.0, 0.0, 0.0), "earth", Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)),
            RangeReading(time_s, 250.0, laser, quality=0.9),
        ]
    events += [
        DecisionRecord(14.0, True, "moving 50 m", {"cost": 1.0}),
        UploadPlan(14.0, 1, plan, circle, Plan(circle), Wind(), "moving 50 m"),
        Announce(14.0, "decision", "moving 50 m"),
        PlanStatus(14.5, 1, "ready"),
        PlanStatus(15.0, 1, "departed"),
        End(20.0, "hold", "ended by the operator"),
    ]
    return b"".join(map(encode, events))


_CONFIG = b"""
[aircraft]
airspeed_m_s = 15.0
radius_m = 50.0
[requirement]
range_min_m = 100.0
side = "120-200"
[planner]
winds_m_s = [4.0, 8.0]
[sensors]
lever_arm_m = [0.1, 0.0, -0.2]
[link]
url = "udpin://0.0.0.0:14540"
[fences]
keep_in = [[[47.40, 8.50], [47.42, 8.50], [47.42, 8.53], [47.40, 8.53]]]
floor_m = 60.0
ceiling_m = 150.0
"""
_FLEET = b"""
[requirement]
side = "right"
[[aircraft]]
name = "north"
url = "udpin://0.0.0.0:14540"
radius_m = 60
[[aircraft]]
name = "south"
url = "udpin://0.0.0.0:14541"
height_m = 200
[aircraft.sensors]
range_component = 9
"""
_COT = b"""<event version="2.0" uid="boat-1" type="a-f-S" how="m-g" time="2026-11-21T10:00:00Z">
<point lat="47.4" lon="8.5" hae="400.0" ce="5.0" le="10.0"/><detail><contact callsign="boat"/></detail></event>"""
_PICTURE = b"\x89PNG\r\n\x1a\n" + bytes(200)
_TILE_PLACES = [(zoom, column, row) for zoom in range(3) for column in range(1 << zoom) for row in range(1 << zoom)]
_SUMMARY = {
    **dict.fromkeys(("duration_s", "time_in_band", "time_on_side", "min_range_m", "max_range_m"), 1.0),
    **dict.fromkeys(("moves", "uploads", "upload_failures", "sightings", "rejected"), 3),
    **{"source": "truth", "estimate_rmse_m": None, "outcome": "completed"},
}
_GPX = (DATA / "target-bike.gpx").read_bytes()[:_EXCERPT_BYTES].rpartition(b"<trkpt")[0] + b"</trkseg></trk></gpx>"
_AIS = b"BaseDateTime,MMSI,LAT,LON,SOG\n" + b"".join(
    b"2025-05-04T09:%02d:%02d,%d,47.%05d,%d.5,3.1\n" % (t // 60, t % 60, 211000000 + t % 3, 10 * t, 8 + t % 3)
    for t in range(300)
)
_PLACES = [(8.5, 47.4 + 1e-4 * k) for k in range(60)]
_KML = (
    "<?xml version='1.0' encoding='UTF-8'?><kml xmlns='http://www.opengis.net/kml/2.2'><Document><Placemark>"
    "<name>line</name><LineString><coordinates>"
    + " ".join(f"{lon},{lat:.4f},0" for lon, lat in _PLACES)
    + "</coordinates></LineString></Placemark><Placemark><gx:Track>"
    + "".join(f"<when>2025-05-04T09:00:{k:02d}Z</when>" for k in range(60))
    + "".join(f"<gx:coord>{lon} {lat:.4f} 0</gx:coord>" for lon, lat in _PLACES)
    + "</gx:Track></Placemark></Document></kml>"
).encode()
_LINE = {"type": "LineString", "coordinates": [[lon, round(lat, 4)] for lon, lat in _PLACES]}
_TIMED = {"name": "a", "coordTimes": [f"2025-05-04T09:00:{k:02d}Z" for k in range(60)]}
_POINTS = [
    {"type": "Feature", "properties": {"id": k % 2, "time": k}, "geometry": {"type": "Point", "coordinates": place}}
    for k, place in enumerate(_LINE["coordinates"])
]
_FEATURES = [{"type": "Feature", "properties": _TIMED, "geometry": _LINE}, *_POINTS]
_GEOJSON = json.dumps({"type": "FeatureCollection", "features": _FEATURES}).encode()
_ITEMS = [{"type": "SimpleItem", "command": 16, "params": [0, 0, 0, None, lat, lon, 50]} for lon, lat in _PLACES]
_PLAN = json.dumps({"fileType": "Plan", "mission": {"items": _ITEMS}}).encode()
_WAYPOINTS = b"QGC WPL 110\n" + b"".join(
    b"%d\t0\t3\t16\t0\t0\t0\t0\t%.5f\t%.2f\t50\t1\n" % (k, lat, lon) for k, (lon, lat) in enumerate(_PLACES)
)
_COT_LINE = (
    "<event version='2.0' uid='r' type='b-m-r' time='2026-11-21T10:00:00Z'><point lat='47.4' lon='8.5'/><detail>"
    + "".join(f"<link uid='{k}' point='{lat:.4f},{lon},500'/>" for k, (lon, lat) in enumerate(_PLACES))
    + "</detail></event>"
).encode()
_CSV_TRACK = b"time_s,east_m,north_m\n" + b"".join(b"%d,%d.5,%d.25\n" % (t, 2 * t, t) for t in range(300))


def _excerpt(name: str, begin: int = 0) -> bytes:
    return (DATA / name).read_bytes()[begin : begin + _EXCERPT_BYTES]


def readers(table: bytes) -> dict[str, Reader]:
    """Return every reader by name; ``table`` is the file of a value table of ``TABLE``."""
    every = (
        Reader("tlog", ".tlog", _excerpt("px4-follow-walk-and-drive.tlog", 700_000), _log),
        Reader("ulog", ".ulg", b"".join(ulog_pieces(60)), _log),
        Reader("dataflash", ".bin", b"".join(dataflash_pieces(60)), _log),
        Reader("journal", ".jsonl", _journal_bytes(), _journal),
        Reader("journal, sealed", ".jsonl", _journal_bytes(), _journal, resealed),
        Reader("truth", ".csv", _excerpt("arduplane-follow-bike.truth.csv"), read_truth),
        Reader("summary", ".json", json.dumps(_SUMMARY, indent=2).encode(), _summary),
        Reader("gpx", ".gpx", _GPX, _track),
        Reader("csv track", ".csv", _CSV_TRACK, _track),
        Reader("ais table", ".csv", _AIS, _track),
        Reader("kml", ".kml", _KML, _track),
        Reader("kmz", ".kmz", _zipped("doc.kml", _KML), _track),
        Reader("geojson", ".geojson", _GEOJSON, _track),
        Reader("plan", ".plan", _PLAN, _route),
        Reader("waypoints", ".waypoints", _WAYPOINTS, _route),
        Reader("drawn line, CoT", ".xml", _COT_LINE, _route),
        Reader("config", ".toml", _CONFIG, load_config),
        Reader("fleet", ".toml", _FLEET, load_fleet),
        Reader("beacon, CoT", ".xml", _COT, _beacon),
        Reader("beacon, FOLLOW_TARGET", ".frame", _follow_target(), _beacon),
        Reader("tile, zipped", ".zip", _zipped("N47E008.hgt", _tile()), _terrain),
        Reader("geotiff", ".tif", _geotiff(), _terrain),
        Reader("mbtiles", ".mbtiles", _mbtiles(), _tiles),
        Reader("pmtiles", ".pmtiles", _pmtiles(), _tiles),
        Reader("value table", ".table", table, _table),
    )
    return {reader.name: reader for reader in every}


def fault(reader: Reader, path: Path, seed: str) -> str | None:
    """Read one damaged file, drawn from the seed; return what was wrong with how it was taken, None if nothing."""
    content = reader.damage(reader.whole, random.Random(seed))
    if content == reader.whole:
        return None
    path.write_bytes(content)
    try:
        reader.read(path)
    except (InputError, TrackError) as error:
        sentence = str(error)
        if "\n" in sentence or str(path.parent) not in sentence or len(sentence) > 1500:
            return f"no sentence that names the file: {sentence[:200]!r}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:300]
    return None
