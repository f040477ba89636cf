"""Route files: GPX, GeoJSON, KML and CSV."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from sidelong.app.errors import InputError
from sidelong.app.records.route_file import read_route
from sidelong.app.study.recorded import recorded_targets, route_next_to
from sidelong.estimators.frames import LocalPlane

_PLACES = ((47.40, 8.50), (47.41, 8.50), (47.41, 8.52))
_GPX = '<gpx version="1.1" creator="x" xmlns="http://www.topografix.com/GPX/1/1"><rte>{}</rte></gpx>'
_FILES = {
    "a.gpx": _GPX.format("".join(f'<rtept lat="{lat}" lon="{lon}"/>' for lat, lon in _PLACES)),
    "a.geojson": json.dumps(
        {
            "type": "Feature",
            "geometry": {"type": "LineString", "coordinates": [[lon, lat, 5] for lat, lon in _PLACES]},
        }
    ),
    "a.kml": '<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark><LineString><coordinates>'
    + " ".join(f"{lon},{lat},0" for lat, lon in _PLACES)
    + "</coordinates></LineString></Placemark></kml>",
    "a.cot": '<event version="2.0" uid="r" type="b-m-r"><detail>'
    + "".join(f'<link uid="{lat}" point="{lat},{lon},500" type="b-m-p-w"/>' for lat, lon in _PLACES)
    + '<link relation="p-p" uid="pilot"/></detail></event>',
    "a.csv": "lat,lon\n" + "\n".join(f"{lat},{lon}" for lat, lon in _PLACES),
}


@pytest.mark.parametrize("name", _FILES)
def test_every_format_gives_the_same_points(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(_FILES[name])
    points = read_route(tmp_path / name)
    assert points.geodetic
    np.testing.assert_allclose(np.stack([points.first, points.second], axis=1), _PLACES)
    east_m, north_m = points.in_plane(LocalPlane(*_PLACES[0]))
    assert (east_m[0], north_m[0]) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert north_m[1] == pytest.approx(1112.0, abs=2.0)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.doc", "", "is not a route file"),
        ("a.gpx", "<gpx", "is not a readable track or route"),
        ("a.geojson", "[]", "is not a readable track or route: it is not a GeoJSON object"),
        ("a.geojson", "null", "it is not a GeoJSON object"),
        ("a.geojson", '{"type": "Feature", "geometry": [1, 2]}', "it is not a GeoJSON object"),
        (
            "a.geojson",
            '{"type": "LineString", "coordinates": [[8.5, 47], [8.5]]}',
            r"\[8.5\] is not a position in degrees",
        ),
        ("a.geojson", '{"type": "LineString", "coordinates": [null]}', "None is not a position in degrees"),
        ("a.geojson", '{"type": "LineString", "coordinates": ["85", "47"]}', "'85' is not a position in degrees"),
        ("a.geojson", '{"type": "Polygon", "coordinates": []}', "contains no points"),
        ("a.kml", "<LineString><coordinates>8.5 47</coordinates></LineString>", r"\['8.5'\] is not a position"),
        ("a.cot", '<event><link point="47,x"/></event>', r"\['x', '47'\] is not a position in degrees"),
        ("a.kml", "<kml/>", "contains no points"),
        ("a.csv", "x,y\n1,2", "names neither"),
        ("a.csv", "lat,lon\n47,8\n123.4,8", "point 2, 123.4, 8, is out of range"),
        ("a.csv", "east_m,north_m\n1,2", "contains 1 points"),
        ("a.csv", "lat,lon\n47,8\n\n47;9,x\n", "line 4, 47;9,x: could not convert"),
        ("a.csv", "lat,lon\n47,8\n47\n", "line 3, 47: could not convert"),
        ("a.csv", "lat,lon\n47,8\n47,\n", "line 3, 47,: could not convert"),
        ("a.csv", "east_m,north_m\n0,0\n1e308,5\n-1e308,5", "point 2, .*, is out of range"),
    ],
)
def test_wrong_file_is_one_sentence(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        read_route(tmp_path / name)


@pytest.mark.parametrize("name", ["a.gpx", "a.kml"])
def test_longest_line_is_used_and_further_lines_are_counted(tmp_path: Path, name: str) -> None:
    start, line, rest = re.split("(<rte>.*</rte>|<LineString>.*</LineString>)", _FILES[name])
    (tmp_path / name).write_text(start + line + line.replace("47.4", "48.4") * 2 + rest)
    points = read_route(tmp_path / name)
    assert points.first.tolist() == [place[0] for place in _PLACES]
    assert "'1', the longest, is used, 2 further lines of the file are not used (2, 3)" in points.note


def test_recorded_tracks_of_kml_are_joined(tmp_path: Path) -> None:
    whens = "".join(f"<when>2026-05-01T10:{minute:02}:00Z</when>" for minute in range(4))
    place = "<coord>8.5 {} 0</coord>"
    parts = [
        f"<Track>{''.join(whens.split('</when>')[k] + '</when>' for k in part)}"
        f"{''.join(place.format(47 + 1e-4 * k) for k in part)}</Track>"
        for part in ((0, 1), (2, 3))
    ]
    (tmp_path / "a.kml").write_text(f"<kml><MultiTrack>{''.join(parts)}</MultiTrack></kml>")
    points = read_route(tmp_path / "a.kml")
    assert (points.first.tolist(), points.note) == ([47.0, 47.0001, 47.0002, 47.0003], "")


def test_lines_of_geojson_are_joined(tmp_path: Path) -> None:
    lines = {"type": "MultiLineString", "coordinates": [[[8.5, 47.0], [8.6, 47.0]], [[8.6, 48.0], [8.5, 48.0]]]}
    (tmp_path / "a.geojson").write_text(json.dumps(lines))
    points = read_route(tmp_path / "a.geojson")
    assert (points.first.tolist(), points.note) == ([47.0, 47.0, 48.0, 48.0], "")


def test_route_next_to_a_track_is_in_the_frame_of_the_track(tmp_path: Path) -> None:
    rows = "\n".join(f"{t},{10 + t},{20.0}" for t in range(0, 100, 5))
    (tmp_path / "walk.csv").write_text(f"t_s,east_m,north_m\n{rows}\n")
    (tmp_path / "walk.route.csv").write_text("east_m,north_m\n10,25\n200,25\n")
    (track,) = recorded_targets([tmp_path], 5.0, route_next_to).flown
    assert track.route is not None
    assert (track.route.east_m[0], track.route.north_m[0]) == pytest.approx((0.0, 5.0))
    assert recorded_targets([tmp_path], 5.0).flown[0].route is None
