import json
import math
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
import pytest
from annotated_types import Len
from pydantic import BaseModel, ConfigDict

from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import Plan
from sidelong.mission.paper.transition import abcd
from sidelong.mission.upload.items import circle_item, plan_file, plan_items

PLANE = LocalPlane(47.0, 8.5)
PRESENT, NEW = Circle(0.0, 100.0, 65.0, False), Circle(430.0, 100.0, 65.0, False)
ITEMS = (circle_item(PRESENT, PLANE, 80.0), *plan_items(Plan(NEW, abcd(PRESENT, NEW)), PLANE, 80.0, 15.0))
KEEP_IN = [[(-900.0, -900.0), (900.0, -900.0), (900.0, 900.0), (-900.0, 900.0)]]
KEEP_OUT = [[(300.0, 300.0), (350.0, 300.0), (325.0, 350.0)]]


def test_it_is_a_plan_of_the_published_form() -> None:
    """The keys and versions are those of QGroundControl's description of the format."""
    plan = json.loads(plan_file(ITEMS, PLANE, 430.0, 15.0, 12, KEEP_IN, KEEP_OUT))
    assert (plan["fileType"], plan["version"]) == ("Plan", 1)
    assert set(plan) == {"fileType", "version", "groundStation", "mission", "geoFence", "rallyPoints"}
    mission = plan["mission"]
    assert (mission["version"], mission["firmwareType"], mission["vehicleType"]) == (2, 12, 1)
    assert mission["plannedHomePosition"] == [47.0, 8.5, 430.0]
    assert plan["rallyPoints"] == {"version": 2, "points": []}
    assert plan["geoFence"]["version"] == 2
    assert [polygon["inclusion"] for polygon in plan["geoFence"]["polygons"]] == [True, False]
    corners_m = [PLANE.east_north_m(*corner) for corner in plan["geoFence"]["polygons"][1]["polygon"]]
    assert np.array(corners_m) == pytest.approx(np.array(KEEP_OUT[0][::-1]))  # clockwise
    assert PublishedPlan.model_validate(plan).mission.items


class Strict(BaseModel):
    """No key more or less than QGroundControl's developer guide describes (Plan File Format)."""

    model_config = ConfigDict(extra="forbid", strict=True)


class SimpleItem(Strict):
    AMSLAltAboveTerrain: float | None
    Altitude: float
    AltitudeMode: Literal[1, 2, 3, 4]
    autoContinue: bool
    command: int
    doJumpId: int
    frame: int
    params: Annotated[list[float | None], Len(7, 7)]
    type: Literal["SimpleItem"]


class Mission(Strict):
    version: Literal[2]
    firmwareType: int
    vehicleType: int
    cruiseSpeed: float
    hoverSpeed: float
    globalPlanAltitudeMode: int
    plannedHomePosition: Annotated[list[float], Len(3, 3)]
    items: Annotated[list[SimpleItem], Len(1)]


class FencePolygon(Strict):
    version: Literal[1]
    inclusion: bool
    polygon: Annotated[list[Annotated[list[float], Len(2, 2)]], Len(3)]


class GeoFence(Strict):
    version: Literal[2]
    circles: Annotated[list[None], Len(0, 0)]
    polygons: list[FencePolygon]


class RallyPoints(Strict):
    version: Literal[2]
    points: list[Annotated[list[float], Len(3, 3)]]


class PublishedPlan(Strict):
    version: Literal[1]
    fileType: Literal["Plan"]
    groundStation: str
    mission: Mission
    geoFence: GeoFence
    rallyPoints: RallyPoints


def test_its_items_are_the_missions() -> None:
    written = json.loads(plan_file(ITEMS, PLANE, 430.0, 15.0, 3))["mission"]["items"]
    assert [item["doJumpId"] for item in written] == list(range(1, len(ITEMS) + 1))
    for item, record in zip(ITEMS, written, strict=True):
        assert (record["type"], record["command"], record["frame"]) == ("SimpleItem", item.command, item.frame)
        assert record["params"] == [0.0, item.param2, item.param3, 0.0, *item.latitude_longitude_deg, 80.0]
        assert (record["Altitude"], record["AltitudeMode"], record["autoContinue"]) == (80.0, 1, True)


def test_an_unused_parameter_is_null() -> None:
    item = replace(circle_item(NEW, PLANE, 80.0), param4=math.nan)
    written = json.loads(plan_file([item], PLANE, 430.0, 15.0, 12))["mission"]["items"]
    assert written[0]["params"][:4] == [0.0, 0.0, -65.0, None]
