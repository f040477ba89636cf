"""The estimate back to the vehicle: how often, what, and never after a yield."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sidelong.app.flight.outputs import GimbalPointer
from sidelong.app.link.message import Message
from sidelong.app.link.vehicle import LinkError, Vehicle
from sidelong.estimators.estimate import TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Phase
from tests.messages import acknowledgement

PLANE = LocalPlane(47.4, 8.5)
ALTITUDE_M = 420.0
ENCODER = mavlink.MAVLink(None, 245, 190)


class LoopbackLink:
    """A link whose far end answers each command with ``result``; every message must be one MAVLink can carry."""

    system_id, own_id = 1, (245, 190)

    def __init__(self, result: int | None = mavlink.MAV_RESULT_ACCEPTED, broken: bool = False) -> None:
        self.result, self.broken = result, broken
        self.sent: list[tuple[str, dict]] = []
        self._inbox: asyncio.Queue[Message] = asyncio.Queue()

    async def send(self, name, fields):
        if self.broken:
            raise LinkError("the link is gone")
        self.sent.append((name, dict(fields)))
        kind = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        kind(**{key: value for key, value in fields.items() if key in kind.fieldnames}).pack(ENCODER)
        assert set(fields) <= set(kind.fieldnames)
        if name == "COMMAND_INT" and self.result is not None:
            await self._inbox.put(acknowledgement(fields["command"], self.result))

    async def messages(self):
        while True:
            yield await self._inbox.get()


@pytest.fixture
def snapshot(flight):
    for _, _, controller in flight(5.0):
        last = controller
    return last.snapshot()


def shown(link: LoopbackLink, *snapshots) -> list[str]:
    """Show the snapshots, letting what each starts come to its end; return what was reported."""
    announced: list[str] = []

    async def run() -> None:
        vehicle = Vehicle(link)
        pump = asyncio.create_task(vehicle.run())
        pointer = GimbalPointer(vehicle, PLANE, lambda *_place_m: ALTITUDE_M, announced.append)
        for snapshot in snapshots:
            pointer.show(snapshot)
            for _ in range(50):
                await asyncio.sleep(0)
        pump.cancel()

    asyncio.run(run())
    return announced


def names(link: LoopbackLink) -> list[str]:
    return [name for name, _ in link.sent]


def test_the_vehicle_is_reported_where_the_target_is_and_to_look_there(snapshot):
    link = LoopbackLink()
    assert shown(link, snapshot) == []
    (status_name, status), (command_name, command) = link.sent
    assert (status_name, command_name) == ("CAMERA_TRACKING_GEO_STATUS", "COMMAND_INT")
    assert (command["command"], command["frame"]) == (mavlink.MAV_CMD_DO_SET_ROI_LOCATION, 5)
    assert (command["x"], command["y"], command["z"]) == (status["lat"], status["lon"], ALTITUDE_M)
    estimate = snapshot.estimate
    at_m = PLANE.east_north_m(status["lat"] * 1e-7, status["lon"] * 1e-7)
    assert at_m == pytest.approx((estimate.east_m, estimate.north_m), abs=5.0)
    assert 0.1 < status["h_acc"] < 20.0
    assert status["tracking_status"] == 1


def test_once_a_second_at_most(snapshot):
    link = LoopbackLink()
    shown(link, *(replace(snapshot, time_s=snapshot.time_s + 0.1 * n) for n in range(25)))
    assert names(link).count("COMMAND_INT") == 3


@pytest.mark.parametrize("phase", [Phase.WAITING, Phase.YIELDED, Phase.ENDED])
def test_nothing_before_the_mission_or_after_a_yield(snapshot, phase):
    link = LoopbackLink()
    shown(link, replace(snapshot, phase=phase))
    assert link.sent == []


def test_a_yield_gives_up_the_command_under_way(snapshot):
    link = LoopbackLink(result=None)  # never answered: it would be sent again and again
    yielded = replace(snapshot, phase=Phase.YIELDED)

    async def run() -> None:
        vehicle = Vehicle(link)
        pointer = GimbalPointer(vehicle, PLANE, lambda *_place_m: ALTITUDE_M, pytest.fail)
        pointer.show(snapshot)
        for _ in range(50):
            await asyncio.sleep(0)
        others = asyncio.all_tasks() - {asyncio.current_task()}
        assert others
        pointer.show(yielded)
        await asyncio.wait_for(asyncio.gather(*others, return_exceptions=True), 10.0)

    asyncio.run(run())
    assert names(link) == ["CAMERA_TRACKING_GEO_STATUS", "COMMAND_INT"]


def test_a_lost_target_is_looked_for_where_it_is_predicted(snapshot):
    link = LoopbackLink()
    lost = replace(snapshot.estimate, quality=TrackQuality.LOST)
    shown(link, replace(snapshot, estimate=lost))
    assert names(link) == ["CAMERA_TRACKING_GEO_STATUS", "COMMAND_INT"]


def test_a_target_that_was_never_seen_is_not_pointed_at(snapshot):
    link = LoopbackLink()
    shown(link, replace(snapshot, estimate=None))
    assert link.sent == []


def test_a_vehicle_that_refuses_is_commanded_once_and_reported_the_place_on(snapshot):
    link = LoopbackLink(result=mavlink.MAV_RESULT_UNSUPPORTED)
    announced = shown(link, *(replace(snapshot, time_s=snapshot.time_s + n) for n in range(4)))
    assert len(announced) == 1
    assert "unsupported" in announced[0]
    assert names(link).count("COMMAND_INT") == 1
    assert names(link).count("CAMERA_TRACKING_GEO_STATUS") == 4


def test_a_link_that_is_gone_does_no_harm(snapshot):
    assert shown(LoopbackLink(broken=True), snapshot, replace(snapshot, time_s=snapshot.time_s + 2.0)) == []
