"""Exports, read back by other people's readers where there are any."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from datetime import UTC, datetime
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
from pymavlink import mavwp
from shapely.geometry import shape

from sidelong.app.errors import InputError
from sidelong.app.records.export import FlownTrack, Format, Mission, export
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import PositionReading
from sidelong.mission.core.circle import Circle
from sidelong.mission.upload.items import circle_item

PLANE = LocalPlane(47.4, 8.5)
CIRCLES = [(12.0, Circle(100.0, 50.0, 80.0, clockwise=True)), (40.0, Circle(300.0, 50.0, 60.0, clockwise=False))]
FLIGHT = FlownTrack(
    name="a flight <&>",
    plane=PLANE,
    aircraft=[PositionReading(10.0 + i, 10.0 * i, -5.0 * i, 120.0, 10.0, -5.0, 0.0) for i in range(50)],
    estimates=[
        TargetEstimate(10.5 + i, 3.0 * i, 200.0, 3.0, 0.0, np.diag([4.0, 9.0, 1.0, 1.0]), TrackQuality.GOOD, 10.5 + i)
        for i in range(40)
    ],
    circles=CIRCLES,
    mission=Mission(
        [circle_item(circle, PLANE, 120.0) for _, circle in CIRCLES],
        airspeed_m_s=15.0,
        mav_autopilot=12,
        keep_in=[[(-900.0, -900.0), (900.0, -900.0), (900.0, 900.0), (-900.0, 900.0)]],
    ),
    booted=datetime(2026, 11, 21, 9, 0, 0, tzinfo=UTC),
    home_altitude_m=488.0,
)


@pytest.fixture
def written(tmp_path):
    def write(wanted: Format, flight: FlownTrack = FLIGHT) -> str:
        export([flight], wanted, tmp_path / "out")
        return (tmp_path / "out").read_text()

    return write


def test_the_plan_has_the_mission_and_its_fence(written):
    plan = json.loads(written(Format.PLAN))
    assert plan["mission"]["plannedHomePosition"] == [47.4, 8.5, 488.0]
    assert [item["params"][2] for item in plan["mission"]["items"]] == [80.0, -60.0]
    (fence,) = plan["geoFence"]["polygons"]
    assert PLANE.east_north_m(*fence["polygon"][-1]) == pytest.approx((-900.0, -900.0), abs=0.01)


def test_waypoints_are_read_by_pymavlink(written, tmp_path):
    written(Format.WAYPOINTS)
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(tmp_path / "out")) == 3
    home, *circles = (loader.wp(i) for i in range(3))
    assert (home.command, home.frame, home.current) == (16, 0, 1)
    assert (home.x, home.y, home.z) == pytest.approx((47.4, 8.5, 488.0))
    assert [(wp.command, wp.frame, wp.param3, wp.z) for wp in circles] == [
        (17, 3, 80.0, 120.0),
        (17, 3, -60.0, 120.0),
    ]
    for wp, (_, circle) in zip(circles, CIRCLES, strict=True):
        assert PLANE.east_north_m(wp.x, wp.y) == pytest.approx((circle.east_m, circle.north_m), abs=0.01)


def test_csv_has_every_moment_in_order_of_time(written):
    rows = list(csv.DictReader(written(Format.CSV).splitlines()))
    times_s = [float(row["time_s"]) for row in rows]
    assert times_s == sorted(times_s)
    assert [sum(row["what"] == what for row in rows) for what in ("aircraft", "target", "circle")] == [50, 40, 2]
    first_target = next(row for row in rows if row["what"] == "target")
    assert first_target["utc"] == "2026-11-21T09:00:10.500Z"
    assert float(first_target["sigma_m"]) == 3.0
    assert first_target["quality"] == "good"
    position = float(first_target["latitude_deg"]), float(first_target["longitude_deg"])
    assert PLANE.east_north_m(*position) == pytest.approx((0.0, 200.0), abs=0.002)


def test_geojson_is_valid_geometry(written):
    collection = json.loads(written(Format.GEOJSON))
    aircraft, target, *circles = collection["features"]
    for feature in collection["features"]:
        assert shape(feature["geometry"]).is_valid
    assert len(aircraft["geometry"]["coordinates"]) == len(aircraft["properties"]["time_s"]) == 50
    assert aircraft["geometry"]["coordinates"][0] == [8.5, 47.4, 608.0]
    assert aircraft["properties"]["height_above"] == "sea level"
    assert len(target["geometry"]["coordinates"]) == 40
    for feature, (since_s, circle) in zip(circles, CIRCLES, strict=True):
        polygon = shape(feature["geometry"])
        assert polygon.exterior.is_ccw
        east_m, north_m = PLANE.east_north_m(polygon.centroid.y, polygon.centroid.x)
        assert (east_m, north_m) == pytest.approx((circle.east_m, circle.north_m), abs=0.1)
        assert feature["properties"]["since_s"] == since_s
        assert feature["properties"]["clockwise"] is circle.clockwise


def test_gpx_has_tracks_with_heights_and_times(written):
    names = {"g": "http://www.topografix.com/GPX/1/1"}
    root = Xml.fromstring(written(Format.GPX))
    aircraft, target = root.findall("g:trk", names)
    points = aircraft.findall("g:trkseg/g:trkpt", names)
    assert len(points) == 50
    assert (float(points[0].get("lat")), float(points[0].get("lon"))) == (47.4, 8.5)
    assert float(points[3].findtext("g:ele", namespaces=names)) == 608.0
    assert points[3].findtext("g:time", namespaces=names) == "2026-11-21T09:00:13Z"
    assert len(target.findall("g:trkseg/g:trkpt", names)) == 40


def test_kml_tracks_have_a_time_for_each_place(written):
    names = {"k": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}
    root = Xml.fromstring(written(Format.KML))
    assert root.findtext("k:Document/k:name", namespaces=names) == "a flight <&>"
    aircraft, target = root.findall(".//gx:Track", names)
    assert len(aircraft.findall("k:when", names)) == len(aircraft.findall("gx:coord", names)) == 50
    assert aircraft.findtext("k:altitudeMode", namespaces=names) == "absolute"
    assert aircraft.findtext("gx:coord", namespaces=names) == "8.50000000 47.40000000 608.00"
    assert len(target.findall("gx:coord", names)) == 40
    rings = root.findall(".//k:LineString/k:coordinates", names)
    assert [len(ring.text.split()) for ring in rings] == [73, 73]


def test_without_the_time_of_day_the_tracks_are_plain_lines(written):
    flight = replace(FLIGHT, booted=None, home_altitude_m=None)
    assert "<when>" not in written(Format.KML, flight)
    assert Xml.fromstring(written(Format.KML, flight)) is not None
    assert "relativeToGround" in written(Format.KML, flight)  # the best where home's altitude is not known
    assert "<time>" not in written(Format.GPX, flight)
    assert "<ele>" not in written(Format.GPX, flight)
    aircraft = json.loads(written(Format.GEOJSON, flight))["features"][0]
    assert aircraft["properties"]["height_above"] == "home"
    assert aircraft["properties"]["utc"] is None
    assert not math.isnan(aircraft["geometry"]["coordinates"][0][2])


@pytest.mark.parametrize("wanted", [wanted for wanted in Format if wanted not in {Format.MCAP, Format.KLV}])
def test_a_flight_with_nothing_to_write_is_an_input_error(tmp_path, wanted):
    with pytest.raises(InputError, match="to export"):
        export([replace(FLIGHT, aircraft=[], mission=None)], wanted, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_animation_moves_aircraft_and_target_on_light_and_dark_backgrounds(written):
    text = written(Format.SVG)
    root = Xml.fromstring(text)
    motions = root.findall(".//{http://www.w3.org/2000/svg}animateMotion")
    assert [len(motion.get("values").split(";")) for motion in motions] == [49, 49]
    assert "prefers-color-scheme: dark" in text


def test_a_flight_without_a_target_is_not_animated(written):
    with pytest.raises(InputError, match="no target"):
        written(Format.SVG, replace(FLIGHT, estimates=[]))


def test_tracks_of_several_aircraft_are_distinguished(tmp_path):
    several = [replace(FLIGHT, label="north"), replace(FLIGHT, label="south")]
    for wanted, written in ((Format.KML, ">south circle from 40.0 s"), (Format.GPX, "<name>north aircraft</name>")):
        export(several, wanted, tmp_path / "out")
        assert written in (tmp_path / "out").read_text()
    export(several, Format.GEOJSON, tmp_path / "out")
    names = [one["properties"]["name"] for one in json.loads((tmp_path / "out").read_text())["features"]]
    assert names.count("north circle") == names.count("south circle") == len(CIRCLES)
    export(several, Format.CSV, tmp_path / "out")
    rows = list(csv.DictReader((tmp_path / "out").open()))
    assert sum(row["what"] == "south target" for row in rows) == len(FLIGHT.estimates)
