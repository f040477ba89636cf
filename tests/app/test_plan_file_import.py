"""A .plan file of ours, read by MAVSDK's own importer, which only works while a vehicle is connected."""

import asyncio
from pathlib import Path

import pytest
from mavsdk.asyncio import Configuration, Mavsdk
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync

from sidelong.app.config import Config
from sidelong.app.flight.shell import SimulatedVehicles
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import Plan
from sidelong.mission.paper.transition import abcd
from sidelong.mission.upload.items import circle_item, plan_file, plan_items
from sidelong.mission.upload.mission_item import MissionItem

PLANE = LocalPlane(47.4, 8.5)
OUTLINE = [(-900.0, -900.0), (900.0, -900.0), (900.0, 900.0), (-900.0, 900.0)]


def items() -> tuple[MissionItem, ...]:
    present, new = Circle(0.0, 100.0, 65.0, False), Circle(430.0, 100.0, 65.0, False)
    return (circle_item(present, PLANE, 80.0), *plan_items(Plan(new, abcd(present, new)), PLANE, 80.0, 15.0))


async def imported(autopilot: str, text: str, truth: Path):
    config = Config.model_validate({"simulation": {"autopilot": autopilot, "speed": 1.0}})
    async with SimulatedVehicles([config], [truth], pytest.fail) as vehicle:
        instance = Mavsdk(Configuration.create_manual(245, 190, True))
        try:
            await instance.add_any_connection(vehicle.urls[0])
            system = await instance.first_autopilot(20.0)
            assert system is not None
            return await asyncio.wait_for(
                MissionRawAsync(system).import_qgroundcontrol_mission_from_string(text), 20.0
            )
        finally:
            instance.destroy()


MAV_AUTOPILOT = {"arduplane": 3, "px4": 12}


@pytest.mark.udp
@pytest.mark.parametrize("autopilot", ["px4", "arduplane"])
def test_mavsdk_reads_the_items_back(autopilot: str, tmp_path: Path) -> None:
    text = plan_file(items(), PLANE, 430.0, 15.0, MAV_AUTOPILOT[autopilot], [OUTLINE])
    data = asyncio.run(imported(autopilot, text, tmp_path / "truth.csv"))
    read = data.mission_items
    if autopilot == "arduplane":  # the importer puts home first, as ArduPilot wants it
        home, *read = read
        assert (home.x, home.y) == (474000000, 85000000)
    assert len(read) == len(items())
    for item, raw in zip(items(), read, strict=True):
        assert (raw.command, raw.frame, raw.autocontinue) == (item.command, item.frame, 1)
        assert (raw.param2, raw.param3) == (item.param2, item.param3)
        assert (raw.x, raw.y) == pytest.approx((item.x, item.y), abs=1.0)
        assert raw.z == pytest.approx(80.0)
