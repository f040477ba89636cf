import json
import math
from dataclasses import replace

import pytest

from estimators.frames import LocalPlane
from mission.core.circle import Circle
from mission.core.plan import Plan
from mission.geometry.transition import abcd
from mission.upload.items import circle_item, plan_items
from mission.upload.plan_file import plan_file

PLANE = LocalPlane(47.0, 8.5)
PRESENT, NEW = Circle(0.0, 100.0, 65.0, False), Circle(430.0, 100.0, 65.0, False)
ITEMS = (circle_item(PRESENT, PLANE, 80.0), *plan_items(Plan(NEW, abcd(PRESENT, NEW)), PLANE, 80.0, 15.0))
KEEP_IN = [[(-900.0, -900.0), (900.0, -900.0), (900.0, 900.0), (-900.0, 900.0)]]
KEEP_OUT = [[(300.0, 300.0), (350.0, 300.0), (325.0, 350.0)]]


def test_it_is_a_plan_of_the_published_form() -> None:
    """The keys and versions are those of QGroundControl's description of the format."""
    plan = json.loads(plan_file(ITEMS, PLANE, 430.0, 15.0, "px4", KEEP_IN, KEEP_OUT))
    assert (plan["fileType"], plan["version"]) == ("Plan", 1)
    assert set(plan) == {"fileType", "version", "groundStation", "mission", "geoFence", "rallyPoints"}
    mission = plan["mission"]
    assert (mission["version"], mission["firmwareType"], mission["vehicleType"]) == (2, 12, 1)
    assert mission["plannedHomePosition"] == [47.0, 8.5, 430.0]
    assert plan["rallyPoints"] == {"version": 2, "points": []}
    assert plan["geoFence"]["version"] == 2
    assert [polygon["inclusion"] for polygon in plan["geoFence"]["polygons"]] == [True, False]
    corner_m = PLANE.east_north_m(*plan["geoFence"]["polygons"][1]["polygon"][2])
    assert corner_m == pytest.approx((325.0, 350.0))


def test_its_items_are_the_missions() -> None:
    written = json.loads(plan_file(ITEMS, PLANE, 430.0, 15.0, "arduplane"))["mission"]["items"]
    assert [item["doJumpId"] for item in written] == list(range(1, len(ITEMS) + 1))
    for item, record in zip(ITEMS, written, strict=True):
        assert (record["type"], record["command"], record["frame"]) == ("SimpleItem", item.command, item.frame)
        assert record["params"] == [0.0, item.param2, item.param3, 0.0, item.latitude_deg, item.longitude_deg, 80.0]
        assert (record["Altitude"], record["AltitudeMode"], record["autoContinue"]) == (80.0, 1, True)


def test_an_unused_parameter_is_null() -> None:
    item = replace(circle_item(NEW, PLANE, 80.0), param4=math.nan)
    written = json.loads(plan_file([item], PLANE, 430.0, 15.0, "px4"))["mission"]["items"]
    assert written[0]["params"][:4] == [0.0, 0.0, -65.0, None]
