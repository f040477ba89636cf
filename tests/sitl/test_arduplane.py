"""ArduPlane as it was observed: missions, modes, commands, failsafe."""

import math

import pytest
from pymavlink.dialects.v20 import all as mavlink

AUTO, RTL, LOITER, GUIDED, FBWA, MANUAL = 10, 11, 12, 15, 5, 0
ACCEPTED, FAILED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_FAILED


@pytest.fixture
def ground(simulate, station):
    return station(simulate(payload=None))


def circling(ground, radius_m=100.0):
    """Airborne on a circle, item 2."""
    ground.fly(ground.takeoff(60.0), ground.loiter(300.0, 300.0, radius_m, 60.0))
    ground.run_until(lambda: ground.simulation.vehicle.mission.index == 2)
    ground.run(60.0)


def reposition(ground, east_m, north_m, *params, height_m=60.0, frame=6):
    x, y = ground.e7(east_m, north_m)
    return ground.command_int(mavlink.MAV_CMD_DO_REPOSITION, *params, frame=frame, x=x, y=y, z=height_m)


def test_it_cannot_be_armed_right_after_boot(ground):
    ground.run(5.0)
    assert ground.arm() == FAILED
    ground.run(20.0)
    assert ground.arm() == ACCEPTED
    assert ground.last("SYS_STATUS").onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK


def test_the_heartbeat_is_that_of_an_armed_fixed_wing_in_auto(ground):
    circling(ground)
    heartbeat = ground.last("HEARTBEAT", 1)
    assert (heartbeat.type, heartbeat.autopilot, heartbeat.base_mode) == (1, 3, 217)
    assert (heartbeat.custom_mode, heartbeat.system_status) == (AUTO, 4)


def test_whatever_is_uploaded_as_item_0_becomes_home(ground):
    ground.run(25.0)
    items = ground.mission(ground.loiter(300.0, 300.0, 100.0))
    items[0] = ground.item(0, mavlink.MAV_CMD_NAV_TAKEOFF, current=True)
    ground.upload(items)
    home = ground.download()[0]
    assert (home.command, home.frame, home.x) == (mavlink.MAV_CMD_NAV_WAYPOINT, 0, -353632621)
    assert home.z == pytest.approx(584.09)


def test_a_loiter_comes_back_in_whole_metres_and_relative(ground):
    ground.run(25.0)
    loiter = ground.loiter(300.0, 300.0, -87.9, 60.129)
    turns = ground.item(0, mavlink.MAV_CMD_NAV_LOITER_TURNS, params=(3.0, 0.0, 333.0, 1.0))
    ground.upload(ground.mission(loiter, turns))
    _, stored, stored_turns = ground.download()
    assert (stored.param3, stored.frame) == (-87.0, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT)
    assert stored.z == pytest.approx(60.12)
    assert (stored_turns.param1, stored_turns.param3) == (3.0, 330.0)


def test_a_mission_that_ends_in_a_waypoint_ends_in_rtl(ground):
    ground.fly(ground.takeoff(60.0), ground.waypoint(300.0, 300.0, 60.0))
    ground.run_until(lambda: ground.mode() == RTL)
    assert ground.last("MISSION_CURRENT").mission_state == mavlink.MISSION_STATE_COMPLETE


def test_an_upload_in_auto_changes_nothing_until_an_item_is_made_current(ground):
    circling(ground)
    ground.upload(ground.mission(ground.takeoff(60.0), ground.loiter(900.0, 300.0, 100.0, 60.0)))
    ground.run(60.0)
    assert ground.simulation.vehicle.navigator.goal.east_m == pytest.approx(300.0, abs=0.1)
    assert ground.command_long(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 2) == ACCEPTED
    ground.run(1.0)
    assert ground.simulation.vehicle.navigator.goal.east_m == pytest.approx(900.0, abs=0.1)


@pytest.mark.parametrize("by_command", [False, True])
def test_a_leg_begins_here_by_the_message_and_at_the_goal_before_by_the_command(ground, by_command):
    circling(ground)
    items = ground.takeoff(60.0), ground.loiter(300.0, 300.0, 100.0, 60.0), ground.waypoint(300.0, 3000.0, 60.0)
    ground.upload(ground.mission(*items, ground.loiter(300.0, 3000.0, 100.0, 60.0)))
    craft = ground.simulation.vehicle.craft
    ground.run_until(lambda: craft.east_m > 395.0)
    if by_command:
        assert ground.command_long(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 3) == ACCEPTED
    else:
        ground.send(mavlink.MAVLink_mission_set_current_message(1, 1, 3))
    ground.run(45.0)
    off_m = craft.east_m - 300.0  # of the line between the two
    assert off_m < 15.0 if by_command else off_m > 40.0


def test_leaving_auto_and_coming_back_reads_the_item_again(ground):
    circling(ground)
    ground.upload(ground.mission(ground.takeoff(60.0), ground.loiter(900.0, 300.0, 100.0, 60.0)))
    ground.set_mode(LOITER)
    ground.set_mode(AUTO)
    ground.run(1.0)
    assert ground.simulation.vehicle.navigator.goal.east_m == pytest.approx(900.0, abs=0.1)


def test_an_upload_that_is_cut_leaves_a_mixture(ground):
    circling(ground)
    new = ground.mission(*(ground.loiter(100.0 * i, 0.0, 50.0, 60.0) for i in range(1, 5)))
    ground.send(mavlink.MAVLink_mission_count_message(1, 1, 5, 0))
    for sequence in range(3):
        ground.run(0.04)
        ground.send(new[sequence])
    ground.run(10.0)
    assert ground.last("MISSION_ACK").type == mavlink.MAV_MISSION_OPERATION_CANCELLED
    assert [round(item.param3) for item in ground.download()] == [0, 50, 50]


def test_a_mission_shorter_than_the_current_index_ends_in_rtl_when_the_waypoint_is_done(ground):
    ground.fly(ground.takeoff(60.0), *(ground.waypoint(300.0 * i, 0.0, 60.0) for i in range(1, 6)))
    ground.run_until(lambda: ground.simulation.vehicle.mission.index == 4)
    ground.upload(ground.mission(ground.takeoff(60.0), ground.loiter(0.0, 0.0, 80.0, 60.0)))
    ground.run(2.0)
    assert ground.mode() == AUTO
    ground.run_until(lambda: ground.mode() == RTL, limit_s=60.0)


def test_the_mission_cannot_be_cleared_while_it_flies(ground):
    circling(ground)
    ground.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 0))
    ground.run(0.1)
    assert ground.last("MISSION_ACK").type == mavlink.MAV_MISSION_ERROR
    ground.set_mode(LOITER)
    ground.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 0))
    ground.run(0.1)
    assert ground.last("MISSION_ACK").type == mavlink.MAV_MISSION_ACCEPTED
    assert ground.download() == []


def test_items_can_be_written_one_by_one(ground):
    circling(ground)
    ground.send(mavlink.MAVLink_mission_write_partial_list_message(1, 1, 2, 2, 0))
    ground.run(0.04)
    assert ground.last("MISSION_REQUEST").seq == 2
    changed = ground.loiter(700.0, 0.0, 60.0, 60.0)
    changed.seq = 2
    ground.send(changed)
    ground.run(0.1)
    assert ground.last("MISSION_ACK").type == mavlink.MAV_MISSION_ACCEPTED
    assert [round(item.param3) for item in ground.download()] == [0, 0, 60]


@pytest.mark.parametrize(("yaw", "clockwise"), [(0.0, True), (math.nan, True), (1.0, False)])
def test_reposition_turns_by_its_fourth_parameter(ground, yaw, clockwise):
    circling(ground)
    assert reposition(ground, 600.0, 300.0, -1, 1, 80.0, yaw) == ACCEPTED
    ground.run(60.0)
    assert ground.mode() == GUIDED
    assert (ground.simulation.vehicle.craft.roll_rad > 0) is clockwise
    mean_m, _, _ = ground.radii_m((600.0, 300.0), 40.0)
    assert mean_m == pytest.approx(91.0, abs=2.0)


def test_a_negative_reposition_radius_is_acknowledged_and_ignored(ground):
    circling(ground)
    assert reposition(ground, 600.0, 300.0, -1, 1, 80.0, 0.0) == ACCEPTED
    assert reposition(ground, 600.0, 300.0, -1, 1, -60.0, 0.0) == ACCEPTED
    ground.run(60.0)
    assert ground.simulation.vehicle.craft.roll_rad > 0
    mean_m, _, _ = ground.radii_m((600.0, 300.0), 40.0)
    assert mean_m == pytest.approx(91.0, abs=2.0)


def test_reposition_needs_a_frame_and_the_flag_to_leave_auto(ground):
    circling(ground)
    long_result = ground.command_long(mavlink.MAV_CMD_DO_REPOSITION, -1, 1, 80, 0, -35.0, 149.0, 60.0)
    assert long_result == mavlink.MAV_RESULT_UNSUPPORTED
    assert reposition(ground, 600.0, 300.0, -1, 0, 80.0, 0.0) == FAILED
    assert reposition(ground, 200_000.0, 0.0, -1, 1, 80.0, 0.0) == ACCEPTED


def test_orbit_is_unsupported(ground):
    circling(ground)
    assert ground.command_int(mavlink.MAV_CMD_DO_ORBIT, 80.0, frame=5) == mavlink.MAV_RESULT_UNSUPPORTED


def test_by_default_nothing_happens_when_the_ground_falls_silent(ground):
    circling(ground)
    ground.heartbeat()
    ground.run(120.0)
    assert ground.mode() == AUTO


def test_with_the_failsafe_on_it_returns_after_five_seconds_and_stays(ground):
    circling(ground)
    ground.simulation.vehicle.parameters.set("FS_GCS_ENABL", 1)
    ground.simulation.vehicle.parameters.set("FS_LONG_ACTN", 1)
    for _ in range(5):
        ground.heartbeat()
        ground.run(1.0)
    assert ground.mode() == AUTO
    ground.run(6.0)
    assert ground.mode() == RTL
    ground.heartbeat()
    ground.run(2.0)
    assert ground.mode() == RTL


def test_only_the_heartbeats_of_the_configured_station_count(simulate, station):
    ground = station(simulate(payload=None))
    other = station(ground.simulation, alongside=ground, address="other", system_id=190)
    circling(ground)
    ground.simulation.vehicle.parameters.set("FS_GCS_ENABL", 1)
    ground.simulation.vehicle.parameters.set("FS_LONG_ACTN", 1)
    ground.heartbeat()
    for _ in range(8):
        other.heartbeat()
        ground.run(1.0)
    assert ground.mode() == RTL


def test_item_types_are_flown_in_order(ground):
    ground.fly(
        ground.takeoff(60.0),
        ground.item(0, mavlink.MAV_CMD_NAV_LOITER_TURNS, 300.0, 0.0, 60.0, (1.0, 0.0, 60.0, 0.0)),
        ground.item(0, mavlink.MAV_CMD_NAV_LOITER_TO_ALT, 300.0, 300.0, 90.0, (0.0, -60.0, 0.0, 0.0)),
        ground.item(0, mavlink.MAV_CMD_NAV_LOITER_TIME, 300.0, 600.0, 90.0, (20.0, 0.0, 60.0, 0.0)),
        ground.item(0, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH),
    )
    ground.run_until(lambda: ground.mode() == RTL)
    assert [m.seq for m in ground.all("MISSION_ITEM_REACHED")] == [1, 2, 3, 4]
    assert ground.simulation.vehicle.craft.height_m > 85.0


def test_it_lands_and_disarms(ground):
    ground.fly(
        ground.takeoff(60.0),
        ground.waypoint(0.0, 600.0, 50.0),
        ground.item(0, mavlink.MAV_CMD_NAV_LAND, 0.0, 0.0, 0.0),
    )
    ground.run_until(lambda: not ground.simulation.vehicle.armed)
    craft = ground.simulation.vehicle.craft
    ground.run(10.0)
    assert craft.ground_speed_m_s == 0.0
    assert craft.height_m == 0.0


def test_airspeed_can_be_ordered_within_limits(ground):
    circling(ground)
    assert ground.command_long(mavlink.MAV_CMD_DO_CHANGE_SPEED, 0, 18.0) == ACCEPTED
    assert ground.command_long(mavlink.MAV_CMD_DO_CHANGE_SPEED, 0, 99.0) == FAILED
    ground.run(20.0)
    assert ground.last("VFR_HUD").airspeed == pytest.approx(18.0, abs=0.1)


def test_data_streams_can_be_requested_by_group(ground):
    ground.run(1.0)
    ground.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_EXTRA1, 10, 1))
    ground.run(1.0)
    before = len(ground.all("ATTITUDE"))
    ground.run(10.0)
    assert len(ground.all("ATTITUDE")) - before == pytest.approx(100, abs=1)
