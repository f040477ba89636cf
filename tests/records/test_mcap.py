"""A flight as MCAP, read back by the mcap package and held against Foxglove's own schemas."""

from __future__ import annotations

import importlib
import json
import math
import sys
from contextlib import closing
from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np
import pytest

from sidelong.app.errors import InputError
from sidelong.app.records.mcap import LAYOUT, McapLog, McapWriter
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.estimators.tracking.tracker import Tracker, TrackerSettings
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import Announce, ControlAcquired, HealthChanged, PlanStatus, RouteGiven, UploadPlan
from sidelong.mission.core.inputs import Input, InputState
from sidelong.mission.core.path import Path as Line
from sidelong.mission.core.plan import Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.route.route import RouteFollower, RouteProgress, route_of

mcap_reader = pytest.importorskip("mcap.reader")

PLANE = LocalPlane(47.4, 8.5)
BOOTED = datetime(2026, 11, 21, 9, 0, 0, 600_000, tzinfo=UTC)
HOME_ALTITUDE_M = 488.0
CIRCLE = Circle(100.0, 50.0, 80.0, clockwise=True)
MOVED = Circle(300.0, 50.0, 80.0, clockwise=True)
LINE = Line(*(np.array([0.0, 100.0, 200.0]) for _ in range(5)))


def flight(log: McapLog) -> None:
    """Ten seconds next to a target that stands 200 m north, 120 m below."""
    laser, gimbal = Source("DISTANCE_SENSOR", 154, 1, 100), Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
    down_rad = math.atan2(120.0, 200.0)
    sight = (math.cos(down_rad / 2), 0.0, -math.sin(down_rad / 2), 0.0)
    log.event(RouteGiven(10.0, (200.0, 200.0), (0.0, 500.0), False, 12.0, None, "either"))
    log.event(ControlAcquired(10.0, CIRCLE, "AUTO"))
    for i in range(101):
        time_s = 10.0 + 0.1 * i
        log.event(AttitudeReading(time_s, 0.0, 0.0, math.pi / 2))
        log.event(PositionReading(time_s, 0.0, 0.0, 120.0, 10.0, 0.0, 0.0))
        log.event(GimbalReading(time_s, sight, "earth", gimbal))
        log.event(RangeReading(time_s, math.hypot(120.0, 200.0), laser, 0.8, 0.9))
    log.command(
        UploadPlan(
            15.0,
            number=1,
            plan=Plan(MOVED, LINE, 16.0),
            commanded=MOVED,
            present=Plan(CIRCLE),
            wind=Wind(),
            reason="the range would grow",
        )
    )
    log.command(Announce(15.0, "decision", "moving the circle"))
    log.command(HealthChanged(15.5, Input.LASER, InputState.STALE, "no range from the laser for 20 s", 5.5))
    log.event(PlanStatus(16.0, 1, "departed"))


@pytest.fixture
def messages(tmp_path) -> dict[str, list]:
    with closing(McapWriter(tmp_path / "flight.mcap")) as writer:
        flight(McapLog(writer, PLANE, Tracker(TrackerSettings()), BOOTED, HOME_ALTITUDE_M))
    found: dict[str, list] = {}
    with (tmp_path / "flight.mcap").open("rb") as file:
        for schema, channel, message in mcap_reader.make_reader(file).iter_messages():
            content = json.loads(message.data)
            assert set(json.loads(schema.data)["properties"]) == set(content)
            found.setdefault(channel.topic, []).append((schema.name, message.log_time, content))
    return found


def test_every_kind_of_thing_has_its_topic(messages):
    counted = {topic: len(several) for topic, several in messages.items()}
    assert counted.pop("/scene") == counted["/sighting"] + counted["/target"] + 4
    assert counted.pop("/target") == counted.pop("/watch") == counted.pop("/target/fix") > 90
    assert counted.pop("/sighting") > 90
    assert counted.pop("/route") == 11  # once a second
    assert counted == {
        "/tf": 101,
        "/aircraft": 101,
        "/aircraft/fix": 101,
        "/aircraft/numbers": 101,
        "/circle": 2,
        "/circle/map": 2,
        "/plan": 1,
        "/plan/map": 1,
        "/announcements": 1,
        "/health": 1,
        "/route/map": 1,
    }


@pytest.mark.parametrize("of_use", [True, False])
def test_the_progress_says_whether_the_route_is_used(of_use, monkeypatch):
    route = route_of(np.zeros(2), np.array([0.0, 500.0]))
    progress = RouteProgress(route, True, 200.0, 4.0, 0.9, 75.0, of_use)
    monkeypatch.setattr(RouteFollower, "update", lambda *_: progress)
    written: dict[str, dict] = {}
    out = SimpleNamespace(write=lambda topic, _schema, _time_ns, values: written.update({topic: values}))
    flight(McapLog(out, PLANE, Tracker(TrackerSettings())))
    assert (written["/route"]["on_route"], written["/route"]["of_use"]) == (True, of_use)


def test_change_of_an_input_is_written_with_its_state(messages):
    _, _, content = messages["/health"][0]
    assert (content["input"], content["state"]) == ("laser", "stale")
    assert content["text"] == "no range from the laser for 20 s"
    assert content["previous_state_lasted_s"] == 5.5


def test_times_are_those_of_day(messages):
    _, time_ns, content = messages["/aircraft"][0]
    assert time_ns == round(BOOTED.timestamp()) * 10**9 - 400_000_000 + 10 * 10**9
    assert content["timestamp"] == {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}


def test_the_aircraft_points_along_its_course(messages):
    # Flying east, level: forward is x of the plane, so there is nothing to rotate.
    orientation = messages["/aircraft"][0][2]["pose"]["orientation"]
    assert orientation == pytest.approx({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}, abs=1e-12)
    fix = messages["/aircraft/fix"][0][2]
    assert (fix["latitude"], fix["longitude"], fix["altitude"]) == (47.4, 8.5, 488.0 + 120.0)
    assert fix["position_covariance_type"] == 0  # unknown: the vehicle does not report it


def test_the_target_comes_with_its_covariance(messages):
    schema, _, target = messages["/target"][-1]
    assert schema == "sidelong.Target"
    assert (target["east_m"], target["north_m"]) == pytest.approx((0.0, 200.0), abs=5.0)
    covariance = np.array(target["covariance"]).reshape(4, 4)
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    schema, _, fix = messages["/target/fix"][-1]
    assert schema == "foxglove.LocationFix"
    assert fix["position_covariance"][0] == covariance[0, 0]
    assert fix["position_covariance"][1] == fix["position_covariance"][3] == covariance[0, 1]
    assert fix["position_covariance"][4] == covariance[1, 1]
    assert fix["altitude"] == pytest.approx(488.0, abs=5.0)  # it stands at the height of home


def test_circles_and_the_plan_are_drawn(messages):
    assert [content["east_m"] for _, _, content in messages["/circle"]] == [100.0, 300.0]
    plan = messages["/plan"][0][2]
    assert plan["circle"]["east_m"] == 300.0
    assert plan["length_m"] == 200.0
    drawn = json.loads(messages["/plan/map"][0][2]["geojson"])["features"][0]["geometry"]["coordinates"]
    assert len(drawn) == 3 + 73


def drawn(messages, name: str) -> list[dict]:
    """Return the entities of a name in the order they came."""
    return [entity for _, _, update in messages["/scene"] for entity in update["entities"] if entity["id"] == name]


def test_the_scene_has_ellipse_sight_line_circles_and_plan(messages):
    ends = [(point["x"], point["y"], point["z"]) for point in drawn(messages, "sight")[-1]["lines"][0]["points"]]
    assert ends[0] == (0.0, 0.0, 120.0)
    assert ends[1] == pytest.approx((0.0, 200.0, 0.0), abs=3.0)
    target = messages["/target"][-1][2]
    covariance = np.array(target["covariance"]).reshape(4, 4)[:2, :2]
    edge = [
        (p["x"] - target["east_m"], p["y"] - target["north_m"])
        for p in drawn(messages, "ellipse")[-1]["lines"][0]["points"]
    ]
    assert np.einsum("ij,jk,ik->i", edge, np.linalg.inv(covariance), edge) == pytest.approx(-2.0 * math.log(0.05))
    assert [len(entity["lines"][0]["points"]) for entity in drawn(messages, "circle")] == [73, 73]
    assert {p["z"] for p in drawn(messages, "plan")[0]["lines"][0]["points"]} == {120.0}
    assert drawn(messages, "target")[-1]["spheres"][0]["pose"]["position"]["x"] == target["east_m"]


def test_the_aircraft_has_a_frame_in_the_plane(messages):
    transform = messages["/tf"][0][2]
    assert (transform["parent_frame_id"], transform["child_frame_id"]) == ("plane", "aircraft")
    assert transform["translation"] == {"x": 0.0, "y": 0.0, "z": 120.0}


def test_messages_are_what_foxglove_publishes(messages):
    json_format = pytest.importorskip("google.protobuf.json_format")
    pytest.importorskip("foxglove_schemas_protobuf", reason="the dev extra has Foxglove's schemas")
    seen = set()
    for several in messages.values():
        schema, _, content = several[-1]
        package, _, name = schema.partition(".")
        if package == "foxglove":
            kind = getattr(importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)
            json_format.ParseDict(as_protobuf(content), kind())  # raises for a field that there is not
            seen.add(name)
    assert seen == {"PoseInFrame", "LocationFix", "GeoJSON", "Log", "FrameTransform", "SceneUpdate"}


def as_protobuf(value):
    """Return a message with its times spelled as protobuf's JSON spells them."""
    match value:
        case {"sec": sec, "nsec": nsec, **rest} if not rest:
            return f"{sec}.{nsec:09}s" if sec == 0 else datetime.fromtimestamp(sec, UTC).isoformat()
        case dict():
            return {name: as_protobuf(item) for name, item in value.items()}
        case list():
            return [as_protobuf(item) for item in value]
    return value


def test_the_layout_shows_topics_that_are_there(messages):
    panels = json.loads(LAYOUT.read_text(encoding="utf-8"))["configById"]
    shown = {
        *panels["3D!scene"]["topics"],
        *panels["map!map"]["topicColors"],
        panels["map!map"]["followTopic"],
        panels["RosOut!announcements"]["topicToRender"],
    }
    assert shown <= set(messages)
    plotted = [path["value"] for name in panels if name.startswith("Plot!") for path in panels[name]["paths"]]
    for topic, _, field in (value.partition(".") for value in plotted):
        assert field in messages[topic][-1][2]


def test_without_the_package_it_reports_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(InputError, match=r"-m pip install mcap\."):
        McapWriter(tmp_path / "flight.mcap")
