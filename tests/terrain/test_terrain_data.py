"""The answering side of MAVLink's terrain protocol, checked against where its definition puts each post."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sidelong.app.autopilots.arduplane import ArduPlane
from sidelong.app.autopilots.autopilot import ParameterTable
from sidelong.app.config import Config
from sidelong.app.flight.preflight import checks
from sidelong.app.flight.streams import TerrainServer, answers
from sidelong.app.link.vehicle import Vehicle
from sidelong.app.terrain.elevation_data import ElevationData
from sidelong.sitl.settings import HomePosition, Settings
from sidelong.sitl.simulation import Simulation
from tests.messages import latest, message

HOME_DEG = 36.59, -84.24
CORNER_E7 = 365_500_000, -842_800_000
EVERY = (1 << 56) - 1


def request(mask: int = EVERY, spacing_m: int = 100, corner_e7: tuple[int, int] = CORNER_E7) -> dict:
    return {"lat": corner_e7[0], "lon": corner_e7[1], "grid_spacing": spacing_m, "mask": mask}


def test_each_post_has_the_height_of_its_place(hills_folder: Path) -> None:
    data = ElevationData(hills_folder)
    given = list(answers(request(), data))
    assert [one["gridbit"] for one in given] == list(range(56))
    rng = np.random.default_rng(1)
    for bit, post in zip(rng.integers(0, 56, 60).tolist(), rng.integers(0, 16, 60).tolist(), strict=True):
        north_m = 100.0 * (4 * (bit // 8) + post // 4)
        east_m = 100.0 * (4 * (bit % 8) + post % 4)
        latitude_deg, longitude_deg = CORNER_E7[0] * 1e-7, CORNER_E7[1] * 1e-7
        there_m = data.height_above_sea_m(
            latitude_deg + math.degrees(north_m / 6_378_100.0),
            longitude_deg + math.degrees(east_m / (6_378_100.0 * math.cos(math.radians(latitude_deg)))),
        )
        assert given[bit]["data"][post] == pytest.approx(there_m, abs=1.5)


def test_only_what_is_asked_for_and_known_is_reported(hills_folder: Path) -> None:
    data = ElevationData(hills_folder)
    assert [one["gridbit"] for one in answers(request(1 << 5 | 1 << 40), data)] == [5, 40]
    assert list(answers(request(corner_e7=(361_000_000, -849_000_000)), data)) == []  # void
    assert list(answers(request(corner_e7=(474_000_000, 85_000_000)), data)) == []  # no tile
    for damaged in (request(spacing_m=0), request(spacing_m=60_000), request(corner_e7=(910_000_000, 0))):
        assert list(answers(damaged, data)) == []


def test_a_vehicle_that_asks_is_answered(hills_folder: Path) -> None:
    class Link:
        system_id, own_id = 1, (245, 190)

        def __init__(self) -> None:
            self.sent: list[bytes] = []
            self.answered = asyncio.Event()

        async def send(self, name: str, fields: dict) -> None:
            assert name == "TERRAIN_DATA"
            self.sent.append(mavlink.MAVLink_terrain_data_message(**fields).pack(mavlink.MAVLink(None, 245, 190)))
            if len(self.sent) == 3:
                self.answered.set()

    async def asked() -> Link:
        link = Link()
        vehicle = Vehicle(link)  # type: ignore[arg-type]
        server = TerrainServer(vehicle, ElevationData(hills_folder))
        vehicle.take(message("TERRAIN_REQUEST", **request(0b1011)))
        await link.answered.wait()
        server.stop()
        before = asyncio.all_tasks()
        vehicle.take(message("TERRAIN_REQUEST", **request()))
        assert asyncio.all_tasks() == before  # none answers
        return link

    link = asyncio.run(asyncio.wait_for(asked(), 20.0))
    decoded = [mavlink.MAVLink(None).parse_buffer(frame)[0] for frame in link.sent]
    assert [one.gridbit for one in decoded] == [0, 1, 3]
    assert all(200 < height_m < 1100 for one in decoded for height_m in one.data)


def test_a_plane_without_heights_asks_and_then_reports_the_ground_below(hills_folder: Path) -> None:
    """The simulated ArduPlane asks for what is below it; its report agrees with the tiles, and is checked by them."""
    data = ElevationData(hills_folder)
    home_m = data.height_above_sea_m(*HOME_DEG)
    simulation = Simulation(Settings(home=HomePosition(*HOME_DEG, home_m), terrain=hills_folder, payload=None))
    simulation.connect("ground")
    received, speaks = mavlink.MAVLink(None), mavlink.MAVLink(None, 255, 190)
    stream = mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_EXTRA3, 2, 1)
    simulation.receive("ground", stream.pack(speaks))
    requests, reports = 0, []
    for second in range(1, 21):
        simulation.advance(float(second))
        for _, sent in simulation.take():
            for one in received.parse_buffer(sent) or ():
                if one.get_type() == "TERRAIN_REPORT":
                    reports.append(one)
                elif one.get_type() == "TERRAIN_REQUEST":
                    requests += 1
                    for fields in answers(one.to_dict(), data):
                        simulation.receive("ground", mavlink.MAVLink_terrain_data_message(**fields).pack(speaks))
    first, last = reports[0], reports[-1]
    assert first.spacing == 0 and first.pending > 0
    assert last.spacing == 100 and last.pending == 0 and 0 < requests < len(reports)
    assert last.terrain_height == pytest.approx(home_m, abs=10.0)  # its posts are coarser
    assert last.current_height == pytest.approx(home_m - last.terrain_height, abs=1.0)  # it stands at home's height


@pytest.mark.parametrize(("off_m", "spacing", "ready"), [(5.0, 100, [True]), (90.0, 100, [False]), (90.0, 0, [])])
def test_the_autopilots_own_data_are_compared_before_the_flight(
    hills_folder: Path, off_m: float, spacing: int, ready: list[bool]
) -> None:
    class Silent:
        system_id, only_mavlink_1, is_companion = 1, False, True

    reported_m = ElevationData(hills_folder).height_above_sea_m(*HOME_DEG) + off_m
    lat, lon = (round(1e7 * degrees) for degrees in HOME_DEG)
    fields = {"lat": lat, "lon": lon, "spacing": spacing, "terrain_height": reported_m}
    vehicle = Silent()
    vehicle.latest = latest(TERRAIN_REPORT=fields)  # type: ignore[attr-defined]
    config = Config(terrain={"folder": str(hills_folder)})  # type: ignore[arg-type]
    found = checks(config, vehicle, ArduPlane(), ParameterTable((), None, {}), None, ())  # type: ignore[arg-type]
    compared = [check for check in found if check.name == "terrain data"]
    assert [check.ready for check in compared] == ready
    assert all(f"{reported_m:.0f} m by the autopilot" in check.found for check in compared)
