"""What a line's departure proves, and what somebody else's mission looks like, at the boundary to the autopilot."""

import asyncio

import pytest

from app.autopilots.autopilot import Home, select_by_message
from app.autopilots.px4 import Px4
from app.delivery.mission_guidance import MissionItemBackend
from app.link.link import RawItem, UploadResult
from app.link.message import Message
from app.link.vehicle import Vehicle
from estimators.frames import LocalPlane
from mission.core.circle import Circle
from mission.core.events import UploadPlan
from mission.core.plan import Plan
from mission.core.requirement import Wind


class Wire:
    """A vehicle's side of the link: it answers the ``heeded``-th MISSION_SET_CURRENT, and streams its item."""

    system_id = 1

    def __init__(self, item, heeded=1):
        self.item, self.heeded, self.asked = item, heeded, 0
        self.held = ()

    async def messages(self):
        while True:
            await asyncio.sleep(0.01)
            fields = {"seq": self.item, "total": len(self.held), "mission_id": 0}
            yield Message("MISSION_CURRENT", 1, 1, fields, 0.0)

    async def send(self, name, fields):
        self.asked += 1
        if name == "MISSION_SET_CURRENT" and self.asked >= self.heeded:
            self.item = fields["seq"]

    async def upload(self, items, current, timeout_s):
        self.held = tuple(items)
        return UploadResult.ACCEPTED


def selected(wire, first, end):
    async def go():
        vehicle = Vehicle(wire)
        running = asyncio.create_task(vehicle.run())
        try:
            return await select_by_message(vehicle, first, end)
        finally:
            running.cancel()

    return asyncio.run(go())


def test_an_item_behind_the_wanted_line_proves_no_departure():
    wire = Wire(item=9, heeded=2)  # the present line stands behind the new one, and the first request is lost
    assert selected(wire, 1, 5)
    assert wire.asked == 2
    assert wire.item == 1


def test_a_vehicle_that_does_not_switch_is_not_believed_to():
    assert not selected(Wire(item=9, heeded=99), 1, 5)


@pytest.fixture
def guidance():
    clock = {"now_s": 0.0}
    wire = Wire(item=1)
    plane = LocalPlane(47.0, 8.0)
    made = MissionItemBackend(
        Vehicle(wire),
        Px4(),
        plane,
        Home(47.0, 8.0, 400.0),
        airspeed_m_s=15.0,
        height_m=100.0,
        tolerance_m=15.0,
        now_s=lambda: clock["now_s"],
    )
    line = made.line(Plan(Circle(0.0, 0.0, 60.0, True)))
    assert asyncio.run(made.load(line)) is UploadResult.ACCEPTED
    return made, clock


def current(seq, total):
    return Message("MISSION_CURRENT", 1, 1, {"seq": seq, "total": total, "mission_id": 0}, 0.0)


def test_another_mission_and_another_item_are_somebody_elses(guidance):
    made, clock = guidance
    total = len(made._vehicle.link.held)
    assert made.foreign(current(0, total)) is None
    clock["now_s"] = 10.0
    assert made.foreign(current(0, total)) is None
    assert "changed the mission" in made.foreign(current(0, total + 3))
    assert "item 3" in made.foreign(current(3, total))


def test_what_the_vehicle_says_right_after_an_upload_is_no_surprise(guidance):
    made, clock = guidance
    total = len(made._vehicle.link.held)
    clock["now_s"] = 1.0
    assert made.foreign(current(0, total + 3)) is None  # still told of the mission before
    assert made.foreign(current(0, total)) is None
    clock["now_s"] = 10.0
    assert made.foreign(current(0, total)) is None


@pytest.mark.parametrize(("goes_to", "switched"), [((47_0000000, 8_0010000), True), ((47_0000000, 8_0000000), False)])
def test_px4_tells_by_where_it_flies_to_unless_the_line_goes_on_there(goes_to, switched):
    """The vehicle's MISSION_CURRENT stays behind; its target does not."""
    line = (RawItem(17, 6, 0.0, 0.0, 60.0, 0.0, *goes_to, 100.0),)

    class Flying(Wire):
        async def messages(self):
            place = (47_0000000, 8_0000000)
            while True:
                await asyncio.sleep(0.01)
                place = goes_to if self.asked else place
                yield Message("POSITION_TARGET_GLOBAL_INT", 1, 1, {"lat_int": place[0], "lon_int": place[1]}, 0.0)

    async def go():
        vehicle = Vehicle(Flying(item=9, heeded=99))
        running = asyncio.create_task(vehicle.run())
        await asyncio.sleep(0.05)
        try:
            return await Px4().select(vehicle, 1, line)
        finally:
            running.cancel()

    assert asyncio.run(go()) is switched


def test_late_words_of_the_mission_and_the_line_before_are_no_surprise(guidance):
    """The vehicle's clock may run ahead of what is heard of it, but what is heard comes in order."""
    made, clock = guidance
    wire = made._vehicle.link
    before = len(wire.held)
    assert made.foreign(current(0, before)) is None
    clock["now_s"] = 10.0
    there = Circle(300.0, 0.0, 60.0, True)
    wire.heeded = 0

    async def swap():
        running = asyncio.create_task(made._vehicle.run())
        try:
            await made.prepare(UploadPlan(10.0, 1, Plan(there, None, 12.0), there, Plan(there), Wind(), ""))
            await made.depart(1)
        finally:
            running.cancel()

    asyncio.run(swap())
    clock["now_s"] = 20.0
    after = len(wire.held)
    assert made.foreign(current(0, before)) is None
    assert made.foreign(current(0, after)) is None
    assert made.foreign(current(1, after)) is None
    assert "item 0" in made.foreign(current(0, after))
    assert "changed the mission" in made.foreign(current(1, after + 5))
