"""The payload for someone else's vehicle, joined to one of ours."""

import math

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sitl.companion import Companion, CompanionError, accompany
from sitl.settings import PayloadSettings, TargetSettings

EXACT = PayloadSettings(0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture
def flown(simulate, station):
    ground = station(simulate(payload=None))
    companion = Companion(EXACT, TargetSettings(motion="straight"), seed=1)
    rows = []
    companion.on_truth = rows.append
    ground.run(25.0)
    ground.command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 1e5)
    ground.fly(ground.takeoff(80.0), ground.loiter(200.0, 200.0, 80.0, 80.0))
    ground.run(90.0)
    measured = [m for message in ground.heard for m in companion.handle(message)]
    return ground, companion, rows, measured


def test_it_finds_the_vehicle_and_measures_at_each_of_its_positions(flown):
    ground, companion, rows, measured = flown
    assert companion.vehicle_id == 1
    lasers = [m for m in measured if m.get_type() == "DISTANCE_SENSOR"]
    assert len(rows) == len(lasers) > 800
    stamps = {m.time_boot_ms for m in ground.all("GLOBAL_POSITION_INT")}
    assert {m.time_boot_ms for m in lasers} <= stamps


def test_its_ranges_are_those_between_its_truth(flown):
    _, _, rows, measured = flown
    lasers = {m.time_boot_ms: m for m in measured if m.get_type() == "DISTANCE_SENSOR"}
    for row in rows[-50:]:
        offset_m = [t - a for t, a in zip(row.target_m, row.aircraft_m, strict=False)]
        slant_m = math.hypot(*offset_m, row.aircraft_m[2])
        assert lasers[round(row.time_s * 1000)].current_distance / 100.0 == pytest.approx(slant_m, abs=0.006)


def test_it_waits_for_home(simulate, station):
    ground = station(simulate(payload=None))
    companion = Companion(EXACT, TargetSettings(), seed=1)
    ground.run(15.0)
    assert companion.wants_home
    assert not [m for message in ground.heard for m in companion.handle(message)]


@pytest.mark.parametrize("url", ["127.0.0.1:14550", "serial:///dev/ttyS0:57600", "tcpout://127.0.0.1"])
def test_a_wrong_url_is_told(url):
    with pytest.raises(CompanionError, match="must look like"):
        accompany(Companion(EXACT, TargetSettings(), seed=1), url)
