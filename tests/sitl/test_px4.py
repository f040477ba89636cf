"""PX4 as it was observed: missions, modes, commands, failsafe."""

import math

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.settings import Flavour

MISSION, HOLD, RTL, TAKEOFF, POSCTL = 0x04040000, 0x03040000, 0x05040000, 0x02040000, 0x00030000
ACCEPTED = mavlink.MAV_RESULT_ACCEPTED


@pytest.fixture
def ground(simulate, station):
    return station(simulate(flavour=Flavour.PX4, payload=None))


def circling(ground, radius_m=80.0):
    """Airborne on a circle, item 1."""
    ground.fly(ground.takeoff(60.0), ground.loiter(300.0, 300.0, radius_m, 60.0))
    ground.run_until(lambda: ground.simulation.vehicle.mission.index == 1)
    ground.run(60.0)


def orbit(ground, east_m, north_m, radius_m, frame=5):
    x, y = ground.e7(east_m, north_m)
    altitude_m = ground.simulation.vehicle.home.altitude_m + 60.0
    return ground.command_int(
        mavlink.MAV_CMD_DO_ORBIT, radius_m, math.nan, 0, math.nan, frame=frame, x=x, y=y, z=altitude_m
    )


def landing(ground):
    """Return the end of a mission that the default requirements accept."""
    return (
        ground.item(0, mavlink.MAV_CMD_DO_LAND_START),
        ground.item(0, mavlink.MAV_CMD_NAV_LOITER_TO_ALT, 700.0, 0.0, 40.0, (0.0, 80.0, 0.0, 0.0)),
        ground.item(0, mavlink.MAV_CMD_NAV_LAND, 0.0, 0.0, 0.0),
    )


def test_it_can_be_armed_after_eight_seconds(ground):
    ground.run(4.0)
    assert ground.arm() == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    ground.run(5.0)
    assert ground.arm() == ACCEPTED


def test_the_heartbeat_is_that_of_an_armed_fixed_wing_in_mission(ground):
    circling(ground)
    heartbeat = ground.last("HEARTBEAT", 1)
    assert (heartbeat.type, heartbeat.autopilot, heartbeat.base_mode) == (1, 12, 157)
    assert (heartbeat.custom_mode, heartbeat.system_status) == (MISSION, 4)


def test_item_0_is_a_real_item_and_the_takeoff_ends_above_its_height(ground):
    ground.fly(ground.takeoff(60.0), ground.loiter(300.0, 300.0, 80.0, 60.0))
    ground.run_until(lambda: bool(ground.all("MISSION_ITEM_REACHED")))
    assert ground.last("MISSION_ITEM_REACHED").seq == 0
    assert ground.simulation.vehicle.craft.height_m > 60.0
    assert ground.last("MISSION_CURRENT").seq == 1


def test_a_mission_without_landing_is_acknowledged_but_not_flown(ground):
    ground.run(10.0)
    assert ground.upload(ground.mission(ground.takeoff(60.0), ground.loiter(300.0, 300.0, 80.0))) == ACCEPTED
    assert ground.arm() == ACCEPTED
    assert ground.set_mode(MISSION) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    ground.run(2.0)
    assert ground.mode() == HOLD
    assert any("Switching to Mission is currently not available" in text for text in ground.texts())
    assert not ground.simulation.vehicle.craft.flying


@pytest.mark.parametrize(
    ("away_m", "height_m", "announced"),
    [
        (75.0, 40.0, "the landing point must be outside the orbit radius"),
        (300.0, 40.0, "the landing glide slope is steeper than the vehicle setting of 5.0 degrees"),
        (700.0, 0.0, "the approach waypoint must be above the landing point"),
    ],
)
def test_a_landing_no_plane_can_fly_is_acknowledged_and_then_refused(ground, away_m, height_m, announced):
    ground.run(10.0)
    approach = ground.item(0, mavlink.MAV_CMD_NAV_LOITER_TO_ALT, away_m, 0.0, height_m, (0.0, 80.0, 0.0, 0.0))
    begin, _, land = landing(ground)
    items = ground.mission(ground.takeoff(60.0), ground.loiter(300.0, 300.0, 80.0, 60.0), begin, approach, land)
    assert ground.upload(items) == ACCEPTED
    ground.run(0.1)
    assert any(announced[:30] in text for text in ground.texts())
    assert ground.command_long(mavlink.MAV_CMD_MISSION_START) == mavlink.MAV_RESULT_DENIED


def test_mission_start_is_denied_without_a_valid_mission(ground):
    ground.run(10.0)
    assert ground.command_long(mavlink.MAV_CMD_MISSION_START) == mavlink.MAV_RESULT_DENIED


def test_with_a_landing_at_its_end_a_mission_flies(ground):
    ground.run(10.0)
    items = ground.mission(ground.takeoff(60.0), ground.loiter(300.0, 300.0, 80.0, 60.0), *landing(ground))
    assert ground.upload(items) == ACCEPTED
    ground.arm()
    ground.set_mode(MISSION)
    ground.run(60.0)
    assert ground.mode() == MISSION
    assert ground.last("MISSION_CURRENT").seq == 1


def test_an_infeasible_upload_drops_a_flying_mission_to_hold(ground):
    ground.run(10.0)
    ground.upload(ground.mission(ground.takeoff(60.0), ground.loiter(300.0, 300.0, 80.0, 60.0), *landing(ground)))
    ground.arm()
    ground.set_mode(MISSION)
    ground.run(60.0)
    assert ground.upload(ground.mission(ground.loiter(0.0, 0.0, 80.0, 60.0))) == ACCEPTED
    ground.run(1.5)
    assert ground.mode() == HOLD


def test_after_an_infeasible_mission_the_good_one_needs_a_second(ground):
    ground.run(10.0)
    ground.upload(ground.mission(ground.takeoff(60.0)))
    good = ground.mission(ground.takeoff(60.0), ground.loiter(300.0, 300.0, 80.0, 60.0), *landing(ground))
    ground.upload(good)
    ground.arm()
    ground.set_mode(MISSION)
    ground.run(0.5)
    assert ground.simulation.vehicle.mode == HOLD
    ground.run(1.0)
    ground.set_mode(MISSION)
    ground.run(1.0)
    assert ground.mode() == MISSION


def test_an_upload_is_flown_at_once_from_the_current_item(ground):
    circling(ground)
    items = ground.mission(ground.loiter(0.0, 0.0, 80.0, 60.0), ground.loiter(600.0, 0.0, -80.0, 60.0))
    items[0].current, items[1].current = 0, 1
    ground.upload(items)
    ground.run(0.1)
    assert ground.simulation.vehicle.navigator.goal.east_m == pytest.approx(600.0, abs=0.1)
    assert ground.last("MISSION_CURRENT").seq == 1


def test_an_identical_upload_changes_nothing(ground):
    circling(ground)
    again = ground.mission(ground.takeoff(60.0), ground.loiter(300.0, 300.0, 80.0, 60.0))
    acknowledged = ground.upload(again)
    ground.run(1.0)
    assert acknowledged == ACCEPTED
    assert ground.last("MISSION_CURRENT").seq == 1


def test_an_abandoned_upload_leaves_the_old_mission(ground):
    circling(ground)
    ground.send(mavlink.MAVLink_mission_count_message(1, 1, 4, 0))
    ground.send(ground.loiter(0.0, 0.0, 50.0))
    ground.run(8.0)
    assert [item.command for item in ground.download()] == [22, 17]
    assert ground.mode() == MISSION


@pytest.mark.parametrize("command", [mavlink.MAV_CMD_NAV_LOITER_TURNS, mavlink.MAV_CMD_DO_JUMP])
def test_unknown_items_are_refused(ground, command):
    ground.run(10.0)
    items = ground.mission(ground.takeoff(60.0), ground.item(0, command))
    assert ground.upload(items) == mavlink.MAV_MISSION_UNSUPPORTED


def test_partial_writes_are_ignored(ground):
    circling(ground)
    received = len(ground.all("MISSION_REQUEST_INT"))
    ground.send(mavlink.MAVLink_mission_write_partial_list_message(1, 1, 1, 1, 0))
    ground.run(1.0)
    assert len(ground.all("MISSION_REQUEST_INT")) == received


def test_items_come_back_with_integer_frames_and_their_radius_unrounded(ground):
    ground.run(10.0)
    ground.upload(ground.mission(ground.takeoff(60.0), ground.loiter(300.0, 300.0, -87.5, 60.125)))
    stored = ground.download()[1]
    assert stored.frame == mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    assert (stored.param3, stored.z) == (-87.5, 60.125)


def test_the_current_item_is_set_by_message_and_not_by_command(ground):
    ground.fly(ground.takeoff(60.0), ground.loiter(300.0, 300.0, 80.0, 60.0), ground.loiter(600.0, 0.0, 80.0, 60.0))
    ground.run_until(lambda: ground.simulation.vehicle.mission.index == 1)
    assert ground.command_long(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 2) == mavlink.MAV_RESULT_UNSUPPORTED
    ground.send(mavlink.MAVLink_mission_set_current_message(1, 1, 2))
    ground.run(0.1)
    assert ground.last("MISSION_CURRENT").seq == 2
    assert ground.simulation.vehicle.navigator.goal.east_m == pytest.approx(600.0, abs=0.1)


@pytest.mark.parametrize("frame", [0, 3, 6])
def test_command_int_is_above_sea_level_in_any_frame(ground, frame):
    circling(ground)
    assert orbit(ground, 600.0, 300.0, 80.0, frame=frame) == ACCEPTED
    height_m = ground.simulation.vehicle.navigator.goal.height_m
    assert orbit(ground, 600.0, 300.0, 80.0, frame=5) == ACCEPTED
    assert ground.simulation.vehicle.navigator.goal.height_m == height_m


def test_an_orbit_is_flown_in_hold_and_reported(ground):
    circling(ground)
    assert orbit(ground, 600.0, 300.0, -70.0) == ACCEPTED
    ground.run(40.0)
    assert ground.mode() == HOLD
    assert ground.last("ORBIT_EXECUTION_STATUS").radius == -70.0
    mean_m, _, _ = ground.radii_m((600.0, 300.0), 30.0)
    assert mean_m == pytest.approx(70.0, abs=0.3)
    assert ground.last("MISSION_CURRENT").mission_state == mavlink.MISSION_STATE_PAUSED


def test_reposition_ignores_its_radius(ground):
    circling(ground)
    x, y = ground.e7(600.0, 300.0)
    altitude_m = ground.simulation.vehicle.home.altitude_m + 60.0
    result = ground.command_int(
        mavlink.MAV_CMD_DO_REPOSITION, -1, 1, -40.0, math.nan, frame=5, x=x, y=y, z=altitude_m
    )
    assert result == ACCEPTED
    ground.run(40.0)
    mean_m, _, _ = ground.radii_m((600.0, 300.0), 30.0)
    assert mean_m == pytest.approx(80.0, abs=0.3)
    assert ground.simulation.vehicle.craft.roll_rad > 0


def test_by_default_nothing_happens_when_the_ground_falls_silent(ground):
    circling(ground)
    ground.heartbeat()
    ground.run(120.0)
    assert ground.mode() == MISSION


def test_with_the_failsafe_on_it_holds_and_then_returns(ground):
    circling(ground)
    ground.simulation.vehicle.parameters.set("NAV_DLL_ACT", 2)
    ground.heartbeat()
    ground.run(9.0)
    assert ground.mode() == MISSION
    ground.run(2.5)
    assert ground.mode() == HOLD
    ground.run(5.0)
    assert ground.mode() == RTL
    ground.heartbeat()
    ground.run(2.0)
    assert ground.mode() == RTL


def test_a_takeoff_by_command_ends_in_hold(ground):
    ground.run(10.0)
    altitude_m = ground.simulation.vehicle.home.altitude_m + 50.0
    nan = math.nan
    ground.arm()
    assert ground.command_long(mavlink.MAV_CMD_NAV_TAKEOFF, nan, nan, nan, nan, nan, nan, altitude_m) == ACCEPTED
    assert ground.simulation.vehicle.mode == TAKEOFF
    ground.run_until(lambda: ground.simulation.vehicle.mode == HOLD, limit_s=60.0)
    assert ground.simulation.vehicle.craft.height_m > 45.0


def test_timed_loiters_and_heights_end_items_and_the_mission_ends_in_hold(ground):
    ground.fly(
        ground.takeoff(60.0),
        ground.item(0, mavlink.MAV_CMD_NAV_LOITER_TIME, 300.0, 0.0, 60.0, (15.0, 0.0, -60.0, 0.0)),
        ground.item(0, mavlink.MAV_CMD_NAV_LOITER_TO_ALT, 300.0, 300.0, 90.0, (0.0, 60.0, 0.0, 0.0)),
        ground.waypoint(0.0, 300.0, 90.0),
    )
    ground.run_until(lambda: ground.simulation.vehicle.mode == HOLD)
    ground.run(1.5)
    assert list(dict.fromkeys(m.seq for m in ground.all("MISSION_ITEM_REACHED"))) == [0, 1, 2, 3]
    assert ground.last("MISSION_CURRENT").mission_state == mavlink.MISSION_STATE_COMPLETE


def test_it_lands_and_disarms(ground):
    ground.fly(ground.takeoff(60.0), ground.waypoint(0.0, 600.0, 50.0), *landing(ground))
    ground.run_until(lambda: not ground.simulation.vehicle.armed)
    assert ground.simulation.vehicle.craft.height_m == 0.0


def test_acknowledgement_and_current_message_carry_the_mission_s_checksum(ground):
    circling(ground)
    mission_id = ground.simulation.vehicle.mission.mission_id.to_bytes(4, "little")
    current = next(f for f in reversed(ground.frames) if f[7] == mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)
    ack = next(f for f in ground.frames if f[7] == mavlink.MAVLINK_MSG_ID_MISSION_ACK)
    assert mission_id != bytes(4)
    assert current[10 + 6 : 10 + 10] == mission_id
    assert ack[10 + 4 : 10 + 8] == mission_id
