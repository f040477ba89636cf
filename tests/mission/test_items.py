import math
from dataclasses import replace

import pytest

from sidelong.app.autopilots.arduplane import ArduPlane
from sidelong.app.autopilots.px4 import Px4
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import Plan
from sidelong.mission.paper.transition import abcd
from sidelong.mission.upload.items import (
    FRAME_GLOBAL_RELATIVE_ALT,
    NAV_LOITER_UNLIM,
    NAV_WAYPOINT,
    UnflyableError,
    circle_item,
    plan_items,
)

arduplane, px4 = ArduPlane().tracking, Px4().tracking

PLANE = LocalPlane(47.0, 8.5)
PRESENT, NEW = Circle(0.0, 100.0, 65.0, True), Circle(430.0, 100.0, 65.0, True)


def test_a_circle_is_a_loiter_without_end_with_a_signed_radius() -> None:
    item = circle_item(Circle(100.0, -200.0, 62.5, False), PLANE, 80.0)
    assert (item.command, item.frame, item.z) == (NAV_LOITER_UNLIM, FRAME_GLOBAL_RELATIVE_ALT, 80.0)
    assert item.param3 == -62.5
    assert PLANE.east_north_m(*item.latitude_longitude_deg) == pytest.approx((100.0, -200.0), abs=0.01)
    assert circle_item(PRESENT, PLANE, 80.0).param3 == 65.0


def test_a_plan_that_is_only_a_circle_is_one_item() -> None:
    assert plan_items(Plan(NEW), PLANE, 80.0, 15.0) == (circle_item(NEW, PLANE, 80.0),)


def test_a_transition_is_a_few_waypoints_and_the_circle_that_needs_no_one() -> None:
    items = plan_items(Plan(NEW, abcd(PRESENT, NEW)), PLANE, 80.0, 15.0, px4(15.0))
    assert [item.command for item in items[:-1]] == [NAV_WAYPOINT] * (len(items) - 1)
    assert 2 <= len(items) - 1 <= 6
    assert items[-1] == circle_item(NEW, PLANE, 80.0)
    assert {item.param2 for item in items[:-1]} == {10.0}
    assert all(
        math.isfinite(value) for item in items for value in (item.param1, item.param2, item.param3, item.param4)
    )


def test_arduplane_reaches_the_first_waypoint_at_the_departure_and_px4_can_still_turn_to_it() -> None:
    path = abcd(PRESENT, NEW)
    for tracking, min_m, max_m in (
        (arduplane(15.0), 0.0, arduplane(15.0).switch_m),
        (px4(15.0), 30.0, 45.0),
    ):
        first = plan_items(Plan(NEW, path), PLANE, 80.0, 15.0, tracking)[0]
        first_m = PLANE.east_north_m(*first.latitude_longitude_deg)
        assert min_m < math.dist(first_m, (path.east_m[0], path.north_m[0])) < max_m


def test_a_precise_plan_is_flown_closer_than_the_tolerance() -> None:
    plan = Plan(NEW, abcd(PRESENT, NEW))
    coarse, precise = (plan_items(one, PLANE, 80.0, 15.0) for one in (plan, replace(plan, precise=True)))
    assert len(precise) > len(coarse)
    assert precise == plan_items(plan, PLANE, 80.0, 4.0)
    assert plan_items(replace(plan, precise=True), PLANE, 80.0, 3.0) == plan_items(plan, PLANE, 80.0, 3.0)


def test_a_tolerance_that_cannot_be_kept_is_refused_with_the_figure() -> None:
    with pytest.raises(UnflyableError, match="tolerance_m is 0"):
        plan_items(Plan(NEW, abcd(PRESENT, NEW)), PLANE, 80.0, 0.05)
