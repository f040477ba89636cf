"""``sidelong route``: checks, drawing, and routes of recorded flights."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from shapely import LineString, Point
from typer.testing import CliRunner

from sidelong.app.cli import app
from sidelong.app.errors import InputError
from sidelong.app.records.route_file import read_route
from sidelong.estimators.frames import LocalPlane

LOG = Path(__file__).parents[1] / "data" / "px4-follow-walk-and-drive.tlog"


def run(*words: object) -> str:
    found = CliRunner().invoke(app, ["route", *map(str, words)])
    if found.exception is not None and not isinstance(found.exception, SystemExit):
        raise found.exception
    return " ".join(found.output.split())


def write(file: Path, points: list[tuple[float, float]], header: str = "east_m,north_m") -> Path:
    file.write_text("\n".join([header, *(f"{a},{b}" for a, b in points)]))
    return file


def rows(spacing_m: float, same_way: bool) -> list[tuple[float, float]]:
    """Four rows of a field, 300 m long."""
    points = []
    for k in range(4):
        ends = [(k * spacing_m, 0.0), (k * spacing_m, 300.0)]
        points += ends if same_way or k % 2 == 0 else ends[::-1]
    return points


@pytest.mark.parametrize(
    ("spacing_m", "same_way", "warned"), [(15.0, True, True), (60.0, True, False), (15.0, False, False)]
)
def test_rows_too_close_to_distinguish_are_reported(tmp_path, spacing_m, same_way, warned) -> None:
    out = tmp_path / "route.json"
    words = run(write(tmp_path / "rows.csv", rows(spacing_m, same_way)), "--json", out)
    share = json.loads(out.read_text())["share_near_another_part"]
    assert share > 0.5 if warned else share < 0.02  # neighbouring turns of the rows are near one another
    assert ("may be mistaken" in words) == warned


def test_lap_and_metres_are_pointed_out(tmp_path) -> None:
    square = write(tmp_path / "square.csv", [(0.0, 0.0), (0.0, 500.0), (500.0, 500.0), (500.0, 0.0), (20.0, 0.0)])
    words = run(square)
    assert "route.lap = true" in words
    assert "a flight needs degrees" in words
    assert "route.lap" not in run(square, "--lap")


def test_first_point_long_legs_and_unused_lines_are_printed(tmp_path) -> None:
    far = write(tmp_path / "far.csv", [(47.4, 8.5), (47.4, 8.6), (8.6, 47.4)], "lat,lon")
    words = run(far)
    assert "first point 47.4, 8.5 degrees" in words
    assert "far.csv: has a leg of " in words
    assert "not used" not in words
    line = "<LineString><coordinates>8.5,47.4 8.5,47.5</coordinates></LineString>"
    (tmp_path / "three.kml").write_text(f"<kml>{line * 3}</kml>")
    words = run(tmp_path / "three.kml")
    assert "three.kml: '1', the longest, is used, 2 further lines of the file are not used" in words
    assert "has a leg" not in words


@pytest.mark.parametrize("suffix", ["csv", "gpx", "geojson"])
def test_recorded_flight_becomes_a_route_that_follows_the_target(tmp_path, suffix) -> None:
    file, picture, out = tmp_path / f"route.{suffix}", tmp_path / "route.png", tmp_path / "route.json"
    log, whole = tmp_path / "cut.tlog", LOG.read_bytes()
    log.write_bytes(whole[: len(whole) // 3])
    words = run(file, "--from", log, "--png", picture, "--json", out)
    assert "route:" in words
    points = read_route(file)
    assert points.geodetic
    truth = np.genfromtxt(LOG.with_suffix(".truth.csv"), delimiter=",", names=True)
    plane = LocalPlane(float(points.first[0]), float(points.second[0]))
    places = zip(truth["target_lat_deg"], truth["target_lon_deg"], strict=True)
    driven = LineString([plane.east_north_m(*place) for place in places])
    apart_m = [driven.distance(Point(place)) for place in zip(*points.in_plane(plane), strict=True)]
    assert np.median(apart_m) < 15.0
    assert 100.0 < json.loads(out.read_text())["length_m"] < 20_000.0
    assert picture.stat().st_size > 5000


def test_what_cannot_become_a_route_is_reported(tmp_path) -> None:
    with pytest.raises(InputError, match=r"--from writes \.csv, \.geojson, \.gpx"):
        run(tmp_path / "route.kml", "--from", LOG)
    with pytest.raises(InputError, match=r"there is no folder .*; create it or give another file to route\.$"):
        run(tmp_path / "none" / "route.csv", "--from", LOG)
    with pytest.raises(InputError, match="two different points"):
        run(write(tmp_path / "one.csv", [(1.0, 1.0), (1.0, 1.0)]))
