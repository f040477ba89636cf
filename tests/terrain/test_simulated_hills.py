"""The simulation's ground is its own code; over the same tiles it has to be the same ground."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.analysis.truth import read_truth
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.terrain.ground import Ground
from sidelong.sitl.payload.companion import Companion
from sidelong.sitl.settings import HomePosition, PayloadSettings, Settings, TargetSettings
from sidelong.sitl.simulation import Simulation, target_motion
from sidelong.sitl.world.geodesy import HomePlane
from sidelong.sitl.world.hills import Hills, HillsError
from sidelong.sitl.world.truth import TruthFile, TruthRow

HOME_DEG = (36.59, -84.24)
HIDDEN_M, OPEN_M = (900.0, -2700.0), (250.0, 300.0)


@pytest.fixture(scope="module")
def hills(hills_folder: Path) -> Hills:
    return Hills(hills_folder, HomePlane(*HOME_DEG))


def test_both_grounds_are_the_same(hills: Hills, ground: Ground, plane: LocalPlane) -> None:
    off_m = []
    for east_m, north_m in np.random.default_rng(1).uniform(-5000.0, 5000.0, (200, 2)):
        there = plane.latitude_longitude_deg(east_m, north_m)
        off_m.append(hills.height_m(*HomePlane(*HOME_DEG).east_north_m(*there)) - ground.height_m(east_m, north_m))
    assert np.sqrt(np.mean(np.square(off_m))) < 1.0


def test_both_see_and_do_not_see_the_same(hills: Hills, ground: Ground) -> None:
    rng = np.random.default_rng(2)
    agreed = hidden = 0
    for _ in range(300):
        east_m, north_m = rng.uniform(-4000.0, 4000.0, 2)
        bearing_rad, range_m = rng.uniform(-math.pi, math.pi), rng.uniform(150.0, 600.0)
        target_m = hills.standing((float(east_m), float(north_m)))
        craft_m = (
            east_m + range_m * math.sin(bearing_rad),
            north_m + range_m * math.cos(bearing_rad),
            target_m[2] + 60.0,
        )
        sees = hills.sees_target(craft_m, target_m)
        hidden += not sees
        agreed += sees is ground.sees(craft_m, (target_m[0], target_m[1], target_m[2] + 1.0))
    assert hidden > 20
    assert agreed > 290


@pytest.mark.parametrize(("height_m", "expected"), [(0.0, True), (10.0, False)])
def test_a_payload_for_another_vehicle_is_tried_out_on_the_ground(
    hills_folder: Path, height_m: float, expected: bool
) -> None:
    """Hills between do not keep it from being received before take-off; in the air they do."""
    companion = Companion(
        PayloadSettings(dropout_fraction=0.0), target_motion(TargetSettings(start_m=OPEN_M), 1), 1, hills_folder
    )
    vehicle, home_e7 = mavlink.MAVLink(None, 1, 1), [round(1e7 * angle_deg) for angle_deg in HOME_DEG]
    listener = mavlink.MAVLink(None)
    for message in (
        mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3),
        mavlink.MAVLink_home_position_message(*home_e7, 449_000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0),
        mavlink.MAVLink_global_position_int_message(1000, *home_e7, 449_000, round(1e3 * height_m), 0, 0, 0, 0),
    ):
        (received,) = listener.parse_buffer(message.pack(vehicle))
        measured = companion.handle(received)
    assert bool(measured) is expected


def test_without_tiles_the_ground_is_flat() -> None:
    flat = Hills(None, HomePlane(47.4, 8.5))
    assert flat.height_m(1e4, -1e4) == 0.0
    assert flat.sees_target((0.0, 0.0, 100.0), flat.standing((500.0, 0.0)))


@pytest.mark.parametrize(
    ("home_deg", "words"), [((47.4, 8.5), "no height of home"), ((36.05, -84.95), "no height of home")]
)
def test_a_home_without_ground_is_reported(hills_folder: Path, home_deg: tuple[float, float], words: str) -> None:
    with pytest.raises(HillsError, match=words):
        Hills(hills_folder, HomePlane(*home_deg))


def test_damaged_tiles_are_reported(tmp_path: Path) -> None:
    (tmp_path / "N36W085.hgt").write_bytes(bytes(1000))
    with pytest.raises(HillsError, match="damaged"):
        Hills(tmp_path, HomePlane(*HOME_DEG))
    with pytest.raises(HillsError, match="no folder"):
        Hills(tmp_path / "none", HomePlane(*HOME_DEG))


def simulated(hills_folder: Path, target_m: tuple[float, float]) -> tuple[list[TruthRow], list[str]]:
    """Forty seconds of an aircraft put into the air over home."""
    settings = Settings(
        home=HomePosition(*HOME_DEG, 450.0),
        targets=(TargetSettings(motion="still", start_m=target_m),),
        terrain=hills_folder,
        payload=Settings().payload,
    )
    simulation = Simulation(settings)
    simulation.connect("ground")
    craft = simulation.vehicle.craft
    craft.height_m, craft.flying, craft.airspeed_m_s = 100.0, True, 15.0
    simulation.vehicle.armed = True
    simulation.vehicle.height_goal_m = 100.0
    rows: list[TruthRow] = []
    simulation.on_truth = rows.append
    parser = mavlink.MAVLink(None)
    given: list[str] = []
    for second in range(1, 41):
        simulation.advance(float(second))
        for _, data in simulation.take():
            given += [message.get_type() for message in parser.parse_buffer(data) or ()]
    return rows, given


def test_what_is_hidden_is_not_measured(hills_folder: Path) -> None:
    rows, given = simulated(hills_folder, HIDDEN_M)
    assert not any(row.in_sight for row in rows[-200:])
    assert "GIMBAL_DEVICE_ATTITUDE_STATUS" not in given[-500:]
    assert "DISTANCE_SENSOR" not in given[-500:]
    rows, given = simulated(hills_folder, OPEN_M)
    assert all(row.in_sight for row in rows[-200:])
    assert "DISTANCE_SENSOR" in given[-500:]


def test_truth_reports_clearance_and_sight(hills_folder: Path, hills: Hills, tmp_path: Path) -> None:
    rows, _ = simulated(hills_folder, OPEN_M)
    last = rows[-1]
    assert last.clearance_m == pytest.approx(last.aircraft_m[2] - hills.height_m(*last.aircraft_m[:2]))
    assert last.target_m[2] == pytest.approx(hills.height_m(*OPEN_M))
    assert last.slant_range_m == pytest.approx(math.dist(last.target_m, last.aircraft_m))
    with (tmp_path / "truth.csv").open("w") as file:
        writer = TruthFile(file)
        for row in rows:
            writer.write(row)
    in_sight, clearance_m = read_truth(tmp_path / "truth.csv").over_ground(10.0)
    assert in_sight == pytest.approx(np.mean([row.in_sight for row in rows if row.time_s >= 10.0]))
    assert clearance_m == pytest.approx(min(row.clearance_m for row in rows if row.time_s >= 10.0), abs=0.01)


def test_zipped_tiles_are_the_same_ground(tmp_path: Path, hills_folder: Path) -> None:
    with zipfile.ZipFile(tmp_path / "N36W085.hgt.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(hills_folder / "N36W085.hgt", "N36W085.hgt")
    plane = HomePlane(*HOME_DEG)
    places_m = [(0.0, 0.0), (500.0, -800.0), (-3000.0, 1200.0)]
    packed, plain = Hills(tmp_path, plane), Hills(hills_folder, plane)
    assert [packed.height_m(*place) for place in places_m] == [plain.height_m(*place) for place in places_m]
    (tmp_path / "N36W085.hgt.zip").write_bytes(b"PK" + bytes(100))
    with pytest.raises(HillsError, match="damaged"):
        Hills(tmp_path, plane)
