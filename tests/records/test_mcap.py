"""A flight as MCAP, read back by the mcap package."""

from __future__ import annotations

import json
import math
import sys
from datetime import UTC, datetime

import numpy as np
import pytest

from app.errors import InputError
from app.records.mcap import McapLog
from estimators.frames import LocalPlane
from estimators.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from estimators.tracker import Tracker, TrackerSettings
from mission.core.circle import Circle
from mission.core.events import Announce, ControlAcquired, PlanStatus, UploadPlan
from mission.core.path import Path as Line
from mission.core.plan import Plan
from mission.core.requirement import Wind

mcap_reader = pytest.importorskip("mcap.reader")

PLANE = LocalPlane(47.4, 8.5)
BOOTED = datetime(2026, 11, 21, 9, 0, 0, 600_000, tzinfo=UTC)
CIRCLE = Circle(100.0, 50.0, 80.0, clockwise=True)
MOVED = Circle(300.0, 50.0, 80.0, clockwise=True)
LINE = Line(*(np.array([0.0, 100.0, 200.0]) for _ in range(5)))


def flight(log: McapLog) -> None:
    """Ten seconds beside a target that stands 200 m north, 120 m below."""
    laser, gimbal = Source("DISTANCE_SENSOR", 154, 1, 100), Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
    down_rad = math.atan2(120.0, 200.0)
    sight = (math.cos(down_rad / 2), 0.0, -math.sin(down_rad / 2), 0.0)
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
    log.event(PlanStatus(16.0, 1, "departed"))


@pytest.fixture
def messages(tmp_path) -> dict[str, list]:
    log = McapLog(tmp_path / "flight.mcap", PLANE, Tracker(TrackerSettings()), pytest.fail, BOOTED)
    flight(log)
    log.close()
    found: dict[str, list] = {}
    with (tmp_path / "flight.mcap").open("rb") as file:
        for schema, channel, message in mcap_reader.make_reader(file).iter_messages():
            content = json.loads(message.data)
            assert set(json.loads(schema.data)["properties"]) == set(content)
            found.setdefault(channel.topic, []).append((schema.name, message.log_time, content))
    return found


def test_every_kind_of_thing_has_its_topic(messages):
    assert {topic: len(several) for topic, several in messages.items() if topic not in {"/sighting", "/target"}} == {
        "/aircraft": 101,
        "/aircraft/fix": 101,
        "/aircraft/numbers": 101,
        "/target/fix": len(messages["/target"]),
        "/circle": 2,
        "/circle/map": 2,
        "/plan": 1,
        "/plan/map": 1,
        "/said": 1,
    }
    assert len(messages["/sighting"]) > 90
    assert len(messages["/target"]) > 90


def test_times_are_those_of_day(messages):
    _, time_ns, content = messages["/aircraft"][0]
    assert time_ns == round(BOOTED.timestamp()) * 10**9 - 400_000_000 + 10 * 10**9
    assert content["timestamp"] == {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}


def test_the_aircraft_points_along_its_course(messages):
    # Flying east, level: forward is x of the plane, so there is nothing to rotate.
    orientation = messages["/aircraft"][0][2]["pose"]["orientation"]
    assert orientation == pytest.approx({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}, abs=1e-12)
    fix = messages["/aircraft/fix"][0][2]
    assert (fix["latitude"], fix["longitude"], fix["altitude"]) == (47.4, 8.5, 120.0)


def test_the_target_comes_with_its_covariance(messages):
    schema, _, target = messages["/target"][-1]
    assert schema == "sidelong.Target"
    assert (target["east_m"], target["north_m"]) == pytest.approx((0.0, 200.0), abs=5.0)
    covariance = np.array(target["covariance"]).reshape(4, 4)
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    schema, _, fix = messages["/target/fix"][-1]
    assert schema == "foxglove.LocationFix"
    assert fix["position_covariance"][0] == covariance[0, 0]
    assert fix["position_covariance"][4] == covariance[1, 1]


def test_circles_and_the_plan_are_drawn(messages):
    assert [content["east_m"] for _, _, content in messages["/circle"]] == [100.0, 300.0]
    plan = messages["/plan"][0][2]
    assert plan["circle"]["east_m"] == 300.0
    assert plan["length_m"] == 200.0
    drawn = json.loads(messages["/plan/map"][0][2]["geojson"])["features"][0]["geometry"]["coordinates"]
    assert len(drawn) == 3 + 73


def test_without_the_package_it_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(InputError, match=r"pip install 'sidelong\[mcap\]'"):
        McapLog(tmp_path / "flight.mcap", PLANE, Tracker(TrackerSettings()), pytest.fail)
