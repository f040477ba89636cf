"""Route files: GPX, GeoJSON, KML and CSV."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from sidelong.app.errors import InputError
from sidelong.app.route_file import read_route
from sidelong.app.study.recorded import recorded_targets
from sidelong.app.study.routes import route_next_to
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
        ("a.txt", "", "is not a route file"),
        ("a.gpx", "<gpx", "is not a readable route"),
        ("a.geojson", "[]", "is not a readable route"),
        ("a.kml", "<kml/>", "contains 0 points"),
        ("a.csv", "x,y\n1,2", "names neither"),
        ("a.csv", "lat,lon\n47,8\n123.4,8", "point 2, 123.4, 8, is out of range"),
        ("a.csv", "east_m,north_m\n1,2", "contains 1 points"),
        ("a.csv", "lat,lon\n47,8\n\n47;9,x\n", "line 4, 47;9,x, holds no position"),
        ("a.csv", "lat,lon\n47,8\n47\n", "line 3, 47, holds no position"),
        ("a.csv", "lat,lon\n47,8\n47,\n", "point 2, 47, nan, is out of range"),
        ("a.csv", "east_m,north_m\n0,0\n1e308,5\n-1e308,5", "point 2, .*, is out of range"),
    ],
)
def test_wrong_file_is_one_sentence(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        read_route(tmp_path / name)


def test_route_next_to_a_track_is_in_the_frame_of_the_track(tmp_path: Path) -> None:
    rows = "\n".join(f"{t},{10 + t},{20.0}" for t in range(0, 100, 5))
    (tmp_path / "walk.csv").write_text(f"t_s,east_m,north_m\n{rows}\n")
    (tmp_path / "walk.route.csv").write_text("east_m,north_m\n10,25\n200,25\n")
    (track,) = recorded_targets([tmp_path], 5.0, route_next_to).flown
    assert track.route is not None
    assert (track.route.east_m[0], track.route.north_m[0]) == pytest.approx((0.0, 5.0))
    assert recorded_targets([tmp_path], 5.0).flown[0].route is None
