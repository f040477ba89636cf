"""Tracks and routes as other programs write them: read rightly, or refused in one sentence."""

from __future__ import annotations

import io
import json
import math
import re
import zipfile
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pytest

from sidelong.app.config import load_config
from sidelong.app.config_files import check_files
from sidelong.app.errors import InputError
from sidelong.app.records.route_file import read_route
from sidelong.app.study.recorded import recorded_targets
from sidelong.sitl.world.track import RecordedTrack, read_track
from sidelong.sitl.world.track_file import TrackError

BEGIN = datetime(2025, 5, 4, 9, tzinfo=UTC)
STEP_DEG = 1.2e-5  # 1.33 m to the north
Stamp = Callable[[int], object]


def iso(second: float) -> str:
    return (BEGIN + timedelta(seconds=second)).strftime("%Y-%m-%dT%H:%M:%SZ")


def table(header: str, row: Callable[[int], object], count: int = 120) -> str:
    return "\n".join([header, *(str(row(k)) for k in range(count))]) + "\n"


def walk(stamp: Stamp, header: str = "time,lat,lon") -> str:
    return table(header, lambda k: f"{stamp(k)},{47.4 + k * STEP_DEG:.6f},8.55")


def gpx(*tracks: tuple[str, float, Stamp], count: int = 120) -> str:
    """Return tracks: (name, latitude of the first point, time of a point)."""
    points = [
        f"<trk><name>{name}</name><trkseg>"
        + "\n".join(
            f'<trkpt lat="{begin + k * STEP_DEG:.6f}" lon="8.55"><time>{stamp(k)}</time></trkpt>'
            for k in range(count)
        )
        + "</trkseg></trk>"
        for name, begin, stamp in tracks
    ]
    return f'<gpx version="1.1" creator="x" xmlns="http://www.topografix.com/GPX/1/1">{"".join(points)}</gpx>'


def track_of(folder: Path, name: str, content: str | bytes, selected: str = "") -> RecordedTrack:
    (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return read_track(folder / (name + selected))


def assert_walk(track: RecordedTrack, count: int = 120, every_s: float = 1.0) -> None:
    """Assert that it is the walk to the north at 1.33 m/s."""
    assert len(track.time_s) == count
    np.testing.assert_allclose(np.diff(track.time_s), every_s, atol=1e-3)
    np.testing.assert_allclose(np.diff(track.north_m), 1.334 * every_s, atol=0.2)
    assert max(map(abs, track.east_m)) < 0.2


EPOCH_S = BEGIN.timestamp()


@pytest.mark.parametrize(
    ("header", "stamp"),
    [
        ("time,lat,lon", iso),
        ("time,lat,lon", lambda k: f"{EPOCH_S + k:.0f}"),
        ("timestamp,latitude,longitude", lambda k: f"{1000 * (EPOCH_S + k):.0f}"),
        ("unixtime,lat,lon", lambda k: f"{round(EPOCH_S + k)}000000"),
        ("time,lat,lon", lambda k: f"{round(EPOCH_S + k)}000000000"),
        ("time,lat,lon", lambda k: f"{(round(EPOCH_S + k) + 62_135_596_800) * 10**7}"),
        ("t_s,lat,lon", lambda k: k),
        ("time_ms,lat,lon", lambda k: 1000 * k),
        ("time_us,lat,lon", lambda k: 10**6 * k),
        ("t,lat,lon", lambda k: 10**9 * (5 + k)),
        ("Timestamp,Latitude,Longitude", lambda k: f"04/05/2025 09:{k // 60:02d}:{k % 60:02d}"),
        ("Date Time,Lat,Lng", lambda k: f"5/13/2025 9:{k // 60:02d}:{k % 60:02d} PM"),
        ("BaseDateTime,LAT,LON", lambda k: f"2025-05-04T09:{k // 60:02d}:{k % 60:02d}"),
        ("timestamp,location-lat,location-long", lambda k: f"2025-05-04 09:{k // 60:02d}:{k % 60:02d}.000"),
        ("time,lat,lon", lambda k: f"20250504 09{k // 60:02d}{k % 60:02d}"),
        ("time,lat,lon", lambda k: f"2025050409{k // 60:02d}{k % 60:02d}"),
        ("time,lat,lon", lambda k: f"09:{k // 60:02d}:{k % 60:02d}"),
    ],
)
def test_units_and_forms_of_time_are_recognised(tmp_path: Path, header: str, stamp: Stamp) -> None:
    assert_walk(track_of(tmp_path, "walk.csv", walk(stamp, header)))


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("INDEX,TAG,DATE,TIME,LATITUDE N/S,LONGITUDE E/W", "{k},T,250504,09{m:02d}{s:02d},{lat:.6f}N,8.55E"),
        ("utc_d,utc_t,lat,lon", "2025/05/04,09:{m:02d}:{s:02d} AM,{lat:.6f},8.55"),
        (
            "#units\n Lcl Date, Lcl Time, UTCOfst, Latitude, Longitude",
            "2025-05-04, 09:{m:02d}:{s:02d}, +00:00, {lat:.6f}, 8.55",
        ),
        ("time,lat,lon", "2025-05-04T09:{m:02d}:{s:02d}Z,{lat:.6f}°N,E8 33.000"),
        ("INDEX,TIME,LATITUDE N/S,LONGITUDE E/W", '{k}\0\0,09:{m:02d}:{s:02d},{lat:.6f}N,"8°33\'00""E"'),
        ("date,time,lat,lon", "2025-05-04,2025-05-04T09:{m:02d}:{s:02d}Z,{lat:.6f},8.55"),
        ("latitude;longitude;date;heure", "{lat:.6f};8.55;04/05/2025;09:{m:02d}:{s:02d}"),
        ("No;Latitude;Longitude;Date;Time", "{k};{comma};8,55;2025/05/04;09:{m:02d}:{s:02d}"),
        ("Latitude\tLongitude\tTime", "{lat:.6f}\t8.55\t2025-05-04T09:{m:02d}:{s:02d}+02:00"),
        ("exported by a program\n\ntime, lat, lon", "2025-05-04T09:{m:02d}:{s:02d}Z, {lat:.6f}, 8.55"),
    ],
)
def test_layouts_of_other_loggers_are_read(tmp_path: Path, header: str, row: str) -> None:
    def filled(k: int) -> str:
        lat = 47.4 + k * STEP_DEG
        return row.format(k=k, m=k // 60, s=k % 60, lat=lat, comma=f"{lat:.6f}".replace(".", ","))

    assert_walk(track_of(tmp_path, "walk.csv", table(header, filled)))


@pytest.mark.parametrize(
    "odd", ["0000-05-04T09:00:50Z", "1970-01-01T00:00:50Z", "2106-02-07T06:28:15Z", "2025-13-40T09:00:50Z"]
)
@pytest.mark.parametrize("name", ["walk.gpx", "walk.csv"])
def test_one_impossible_time_costs_one_point(tmp_path: Path, name: str, odd: str) -> None:
    def stamp(k: int) -> str:
        return odd if k == 50 else iso(k)

    track = track_of(tmp_path, name, gpx(("walk", 47.4, stamp)) if name.endswith("gpx") else walk(stamp))
    assert (len(track.time_s), track.time_s[-1]) == (119, 119.0)
    assert max(np.diff(track.time_s)) == 2.0


@pytest.mark.parametrize("gap_s", [24 * 3600, 3 * 24 * 3600])
def test_the_longer_part_before_or_after_a_gap_of_days_is_used(tmp_path: Path, gap_s: int) -> None:
    track = track_of(tmp_path, "walk.csv", walk(lambda k: iso(k + gap_s * (k >= 40))))
    assert_walk(track, 80)
    assert "40 points at other times are left out" in track.note


def test_a_clock_that_is_set_back_does_not_mix_two_passes(tmp_path: Path) -> None:
    track = track_of(tmp_path, "walk.csv", walk(lambda k: iso(k - 30 * (k >= 45))))
    assert_walk(track, 75)


def test_the_latest_point_may_come_first(tmp_path: Path) -> None:
    header, *rows = walk(iso).splitlines()
    assert_walk(track_of(tmp_path, "walk.csv", "\n".join([header, *reversed(rows)])))


def test_impossible_speeds_are_refused_with_their_line(tmp_path: Path) -> None:
    with pytest.raises(
        TrackError, match=r"its times imply 1.*e\+03 m/s, from line \d+ to \d+ .*; give times in seconds"
    ):
        track_of(tmp_path, "walk.csv", walk(lambda k: 0.001 * k))


def test_two_tracks_without_names_are_refused_with_their_line(tmp_path: Path) -> None:
    text = table("time,lat,lon", lambda k: f"{iso(k // 2)},{47.4 + k % 2 * 1e-3 + k * STEP_DEG:.6f},8.55")
    with pytest.raises(TrackError, match=r"line 3: several positions have the same time"):
        track_of(tmp_path, "walk.csv", text)


def test_a_receiver_without_a_fix_is_not_at_zero(tmp_path: Path) -> None:
    header, *rows = walk(iso).splitlines()
    lost = [f"{iso(k - 5)},0.0,0.0" for k in range(5)]
    assert_walk(track_of(tmp_path, "walk.csv", "\n".join([header, *lost, *rows])))


def two_walkers() -> str:
    return gpx(("A", 47.4, iso), ("B", 47.5, lambda k: iso(2 * k)))


def two_vessels() -> str:
    return table(
        "time,imo,lat,lon",
        lambda k: f"{iso(k // 2)},{'AB'[k % 2]},{47.4 + k // 2 * STEP_DEG:.6f},{8.55 + k % 2}",
        240,
    )


def two_features() -> str:
    def feature(name: str, begin: float) -> dict[str, object]:
        line = [[8.55, begin + k * STEP_DEG] for k in range(120)]
        properties = {"name": name, "coordTimes": [iso(k) for k in range(120)]}
        return {"type": "Feature", "properties": properties, "geometry": {"type": "LineString", "coordinates": line}}

    return json.dumps({"type": "FeatureCollection", "features": [feature("A", 47.4), feature("B", 47.5)]})


def two_placemarks() -> str:
    whens = "".join(f"<when>{iso(k)}</when>" for k in range(120))
    coords = "".join(f"<gx:coord>8.55 {47.4 + k * STEP_DEG:.6f} 0</gx:coord>" for k in range(120))
    marks = (f"<Placemark><name>{n}</name><gx:Track>{whens}{coords}</gx:Track></Placemark>" for n in "AB")
    return f"<kml><Document>{''.join(marks)}</Document></kml>"


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.gpx", two_walkers), ("a.csv", two_vessels), ("a.geojson", two_features), ("a.kml", two_placemarks)],
)
def test_of_several_tracks_one_is_used_and_the_other_can_be_selected(
    tmp_path: Path, name: str, text: Callable[[], str]
) -> None:
    used = track_of(tmp_path, name, text())
    assert len(used.time_s) == 120
    assert np.ptp(used.north_m) == pytest.approx(119 * 1.334, abs=1.0)
    assert re.match(r"'[AB]', the longest, is used, 1 further line of the file is not used \([AB]\)", used.note)
    for selected in ("A", "B", "1", "2"):
        assert len(read_track(tmp_path / f"{name}#{selected}").time_s) == 120
    with pytest.raises(TrackError, match="has no track or route 'C'; it has A, B"):
        read_track(tmp_path / f"{name}#C")
    route = read_route(tmp_path / f"{name}#B")
    assert route.first.size == 120
    config = load_config(None, {"simulation": {"target": str(tmp_path / name)}})
    assert any("is not used" in note for note in check_files(config))


def test_names_that_are_each_point_s_own_do_not_separate_points(tmp_path: Path) -> None:
    text = table("id,time,lat,lon", lambda k: f"{k},{iso(k)},{47.4 + k * STEP_DEG:.6f},8.55")
    assert_walk(track_of(tmp_path, "walk.csv", text))


def test_points_of_geojson_with_times_are_a_track(tmp_path: Path) -> None:
    features = [
        {
            "type": "Feature",
            "properties": {"time": iso(k), "speed": 1.3},
            "geometry": {"type": "Point", "coordinates": [8.55, 47.4 + k * STEP_DEG]},
        }
        for k in range(120)
    ]
    assert_walk(track_of(tmp_path, "walk.geojson", json.dumps({"type": "FeatureCollection", "features": features})))


def nmea(k: int) -> str:
    minutes = 24.0 + 60.0 * k * STEP_DEG
    body = f"GPRMC,09{k // 60:02d}{k % 60:02d}.00,A,47{minutes:08.5f},N,00833.0000,E,2.6,0.0,040525,,,A"
    return f"$GPGSV,1,1,00*79\r\n${body}*{reduce(xor, body.encode()):02X}"


def event(k: int, kind: str = "a-f-G-U-C", uid: str = "A") -> str:
    return (
        f'<?xml version="1.0"?><event uid="{uid}" type="{kind}" time="{iso(k)}" how="m-g">'
        f'<point lat="{47.4 + k * STEP_DEG:.6f}" lon="8.55"/></event>'
    )


@pytest.mark.parametrize(
    ("name", "row"),
    [
        ("receiver.nmea", nmea),
        ("stamped.txt", lambda k: "2025-05-04 09:00:00 " + nmea(k).replace("\n", "\n2025-05-04 09:00:00 ")),
        ("stream.cot", lambda k: event(k) + event(120 - k, "b-t-f", "GeoChat.A") * (k % 10 == 5)),
    ],
)
def test_streams_of_receivers_and_servers_are_tracks(tmp_path: Path, name: str, row: Callable[[int], str]) -> None:
    track = track_of(tmp_path, name, "\n".join(map(row, range(120))))
    assert_walk(track)
    assert not track.note


@pytest.mark.parametrize(("begin_s", "count"), [(0, 120), (30, 120), (130, 240)])
def test_parts_of_a_multi_track_are_joined_if_they_follow(tmp_path: Path, begin_s: int, count: int) -> None:
    parts = [
        "".join(
            f"<when>{iso(k)}</when><coord>8.55 {47.4 + k * STEP_DEG} 0</coord>" for k in range(first, first + 120)
        )
        for first in (0, begin_s)
    ]
    multi = "".join(f"<Track>{part}</Track>" for part in parts)
    track = track_of(tmp_path, "a.kml", f"<kml><Placemark><MultiTrack>{multi}</MultiTrack></Placemark></kml>")
    assert len(track.time_s) == count
    assert ("1 further line" in track.note) is (count == 120)


LINE = " ".join(f"8.55,{47.4 + k * 1e-3:.4f},0" for k in range(12))
KML = "<kml><Document><Placemark>{}</Placemark></Document></kml>"
MISSION = [
    (16, 0.0, 0.0, "home"),
    (22, 0.0, 0.0, "take-off"),
    *((16, 47.4 + k * 1e-3, 8.55, "") for k in range(12)),
    (201, 47.9, 8.9, "region of interest"),
    (20, 0.0, 0.0, "return"),
]


def kmz() -> bytes:
    """Return an archive that is the same at any time: a part of it names a test, in each worker alike."""
    file, line = io.BytesIO(), KML.format(f"<LineString><coordinates>{LINE}</coordinates></LineString>")
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in (("files/icon.png", b"\x89PNG"), ("doc.kml", line)):
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return file.getvalue()


ROUTES: dict[str, str | bytes] = {
    "prefix.kml": KML.format(f"<gx:visible>1</gx:visible><LineString><coordinates>{LINE}</coordinates></LineString>"),
    "spaces.kml": KML.format(f"<LineString><coordinates>\n{LINE.replace(',', ', ')}\n</coordinates></LineString>"),
    "empty.kml": KML.format(
        "<gx:Track><gx:coord/><gx:coord> </gx:coord>"
        + "".join(f"<gx:coord>{p.replace(',', ' ')}</gx:coord>" for p in LINE.split())
        + "</gx:Track>"
    ),
    "entity.kml": KML.format(f"<name>a & b&nbsp;c</name><LineString><coordinates>{LINE}</coordinates></LineString>"),
    "zipped.kmz": kmz(),
    "latin.kml": (
        '<?xml version="1.0" encoding="windows-1252"?>'
        + KML.format(f"<name>Zürich</name><LineString><coordinates>{LINE}</coordinates></LineString>")
    ).encode("cp1252"),
    "wide.kml": KML.format(f"<LineString><coordinates>{LINE}</coordinates></LineString>").encode("utf-16"),
    "atak.xml": '<?xml version="1.0"?><event uid="r" type="b-m-r"><point lat="0" lon="0"/><detail>'
    + "".join(f'<link point="{lat},{lon}"/>' for lon, lat, _ in (p.split(",") for p in LINE.split()))
    + "</detail></event>",
    "ground.plan": json.dumps(
        {
            "fileType": "Plan",
            "mission": {
                "items": [
                    {"type": "SimpleItem", "command": c, "params": [0, 0, 0, None, lat, lon, 50]}
                    for c, lat, lon, _ in MISSION
                ]
            },
        }
    ),
    "older.plan": json.dumps(
        {
            "fileType": "Mission",
            "items": [{"command": c, "coordinate": [lat, lon, 50], "params": [0] * 4} for c, lat, lon, _ in MISSION],
        }
    ),
    "relative.waypoints": "QGC WPL 120\n# twelve words or more are no item, if they begin as a comment does\n"
    + "".join(f"{k} 0 3 16 0 0 0 0 {47.4 + k * 1e-3} 8.55 50 1\n" for k in range(12)),
    "mission.waypoints": "QGC WPL 110\n"
    + "".join(
        f"{k}\t0\t{3 * (k > 0)}\t{c}\t0\t0\t0\t0\t{lat}\t{lon}\t50\t1\n" for k, (c, lat, lon, _) in enumerate(MISSION)
    ),
    "area.geojson": json.dumps(
        {
            "type": "FeatureCollection",
            "features": [
                {"type": "Feature", "properties": {"title": "folder"}, "geometry": None},
                {
                    "type": "Feature",
                    "properties": {"title": "area"},
                    "geometry": {"type": "Polygon", "coordinates": [[[8, 47], [9, 47], [9, 48], [8, 47]]]},
                },
                {
                    "type": "Feature",
                    "properties": {"title": "line"},
                    "geometry": {
                        "type": "LineString",
                        "coordinates": [list(map(float, p.split(","))) for p in LINE.split()],
                    },
                },
                {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [8.5, 47.5]}},
            ],
        }
    ),
}


@pytest.mark.parametrize("name", ROUTES)
def test_legal_variants_of_a_route_are_read(tmp_path: Path, name: str) -> None:
    content = ROUTES[name]
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    route = read_route(tmp_path / name)
    np.testing.assert_allclose(route.first, 47.4 + 1e-3 * np.arange(12))
    np.testing.assert_allclose(route.second, 8.55)
    assert ("2 further lines of the file are not used (area, 3)" in route.note) == (name == "area.geojson")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        (
            "a.kml",
            KML.format("<LineString><coordinates>8,47,8.1,47.1</coordinates></LineString>"),
            "more than one position",
        ),
        ("a.kml", "<!DOCTYPE a [<!ENTITY b 'c'>]><kml>&b;</kml>", "declares entities"),
        ("a.kmz", kmz()[:80], "is not a readable track or route"),
        ("a.kmz", b"PK\x03\x04", "is not a readable track or route"),
        ("a.json", "[" * 2_000_001, "too many parts"),
        ("a.csv", f"lat,lon\n{'9' * 50_000}x,8\n", "could not convert string to float"),
        ("a.csv", f"time,lat,lon\n9:00{' ' * 100_000}x,47,8\n", "is neither seconds nor a time"),
        ("a.kml", "<kml>" + "<a/>" * 2_000_001, "too many parts"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(tmp_path: Path, name: str, content: str | bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError, match=words) as error:
        read_route(tmp_path / name)
    assert name in str(error.value)
    assert "\n" not in str(error.value)


def test_a_track_of_ten_megabytes_is_read(tmp_path: Path) -> None:
    text = gpx(("long", 40.0, iso), count=95_000)
    assert len(text) > 7_000_000
    track = track_of(tmp_path, "long.gpx", text.replace("</time>", "</time><extensions/>"))
    assert (len(track.time_s), track.time_s[-1]) == (95_000, 94_999.0)


def test_more_points_than_memory_has_room_for_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TrackError, match="more than 400,000 points; thin it out"):
        track_of(tmp_path, "long.csv", "t_s,east_m,north_m\n" + "1,2,3\n" * 400_001)


def test_a_study_skips_tracks_of_weeks_and_notes_what_it_does_not_use(tmp_path: Path) -> None:
    (tmp_path / "two.gpx").write_text(two_walkers())
    (tmp_path / "weeks.csv").write_text(walk(lambda k: iso(k * 14_400.0)))
    found = recorded_targets([tmp_path], 5.0)
    assert [one.name for one in found.flown] == ["two"]
    assert found.skipped == (("weeks.csv", "lasts 476 h, and 48 h is the most; cut it"),)
    assert found.notes[0].startswith("two.gpx: 'B', the longest, is used") or "'A'" in found.notes[0]


def test_nanoseconds_do_not_fill_the_memory_of_a_study(tmp_path: Path) -> None:
    (tmp_path / "Location.csv").write_text(walk(lambda k: f"{round(EPOCH_S + k)}000000000"))
    (target,) = recorded_targets([tmp_path], 5.0).flown
    assert target.duration_s == pytest.approx(118.5)
    assert math.isfinite(target.speed_p95_m_s)


def test_sentences_stay_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(TrackError, match="is not a readable track or route") as error:
        track_of(tmp_path, "walk.csv", 't_s,east_m,north_m\n0,1,2\n1,"2\n3\x1b[2J",4\n')
    assert str(error.value).isprintable()


def test_a_table_with_semicolons_has_decimal_commas(tmp_path):
    path = tmp_path / "track.csv"
    path.write_text("t_s;east_m;north_m\n0,0;1,5;2,5\n10,5;11,5;2,5\n")
    track = read_track(path)
    assert list(track.time_s) == [0.0, 10.5]
    assert list(track.east_m) == [1.5, 11.5]
