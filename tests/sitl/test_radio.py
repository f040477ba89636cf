"""Several stations at once: each with its own sequence numbers, rates and answers."""

import math
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.settings import Flavour, PayloadSettings

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED


@pytest.fixture(params=list(Flavour))
def pair(request, simulate, station):
    ground = station(simulate(flavour=request.param))
    return ground, station(ground.simulation, alongside=ground, address="other", system_id=250)


def interval(ground, message_id, hertz):
    return ground.command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / hertz)


def rate_hz(ground, kind, seconds=10.0):
    before = len(ground.all(kind, 1))
    ground.run(seconds)
    return (len(ground.all(kind, 1)) - before) / seconds


def test_each_station_sees_unbroken_sequences_of_each_component(pair):
    ground, other = pair
    interval(ground, mavlink.MAVLINK_MSG_ID_ATTITUDE, 20.0)
    ground.run(30.0)
    for each in pair:
        for component in (1, mavlink.MAV_COMP_ID_GIMBAL):
            numbers = [f[4] for f in each.frames if f[6] == component]
            assert len(numbers) > 100
            assert all((b - a) % 256 == 1 for a, b in pairwise(numbers))
    assert len(ground.frames) > len(other.frames)


def test_every_frame_has_a_right_checksum(pair):
    ground, _ = pair
    ground.run(30.0)
    assert not ground.all("BAD_DATA")
    assert len(ground.received) == len(ground.frames)


def test_a_rate_is_changed_for_the_station_that_asks(pair):
    ground, other = pair
    usual_hz = rate_hz(other, "GLOBAL_POSITION_INT")
    assert interval(ground, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 25.0) == ACCEPTED
    ground.run(1.0)
    assert rate_hz(ground, "GLOBAL_POSITION_INT") == pytest.approx(25.0, rel=0.02)
    assert rate_hz(other, "GLOBAL_POSITION_INT") == pytest.approx(usual_hz)


def test_a_stream_can_be_stopped_and_put_back(pair):
    ground, _ = pair
    usual_hz = rate_hz(ground, "ATTITUDE")
    assert ground.command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 30, -1) == ACCEPTED
    assert rate_hz(ground, "ATTITUDE") == 0.0
    assert ground.command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 0) == ACCEPTED
    assert rate_hz(ground, "ATTITUDE") == pytest.approx(usual_hz, rel=0.02)


def test_unknown_messages_are_refused_as_by_the_real_ones(pair):
    ground, _ = pair
    px4 = ground.simulation.settings.flavour == Flavour.PX4
    expected = mavlink.MAV_RESULT_FAILED if px4 else mavlink.MAV_RESULT_DENIED
    assert interval(ground, 999, 1.0) == expected


@pytest.mark.parametrize(("limit_deg", "reported"), [(math.degrees(2.0), [(-2.0, 2.0)]), (180.0, [])])
@pytest.mark.parametrize("flavour", Flavour)
def test_the_autopilot_reports_the_pan_limits_of_its_gimbal(simulate, station, flavour, limit_deg, reported):
    ground = station(simulate(flavour=flavour, payload=PayloadSettings(pan_limit_deg=limit_deg)))
    ground.command_long(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION)
    assert [(one.yaw_min, one.yaw_max) for one in ground.all("GIMBAL_MANAGER_INFORMATION")] == reported


def test_only_the_asking_station_gets_an_answer(pair):
    ground, other = pair
    ground.command_long(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    assert ground.all("AUTOPILOT_VERSION")
    assert ground.all("COMMAND_ACK")
    assert not other.all("AUTOPILOT_VERSION")
    assert not other.all("COMMAND_ACK")


def test_an_unknown_command_is_unsupported(pair):
    assert pair[0].command_long(31010) == mavlink.MAV_RESULT_UNSUPPORTED


def test_commands_for_another_vehicle_are_passed_on_and_not_obeyed(pair):
    ground, other = pair
    other.heartbeat()
    ground.send(
        mavlink.MAVLink_command_long_message(7, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    )
    ground.run(0.1)
    assert not ground.all("COMMAND_ACK")
    assert other.last("COMMAND_LONG").get_srcSystem() == 255


def test_a_companion_is_received_by_stations_that_have_spoken(pair, station):
    ground, other = pair
    companion = station(ground.simulation, alongside=ground, address="companion", system_id=1, component_id=191)
    gps = mavlink.MAVLink_named_value_float_message(0, b"hello", 1.0)
    companion.send(gps)
    ground.run(0.1)
    assert not ground.all("NAMED_VALUE_FLOAT")
    ground.heartbeat()
    companion.send(gps)
    ground.run(0.1)
    received = ground.last("NAMED_VALUE_FLOAT")
    assert (received.get_srcSystem(), received.get_srcComponent()) == (1, 191)
    assert not other.all("NAMED_VALUE_FLOAT")


def test_a_station_that_came_on_its_own_is_forgotten_after_a_minute_of_silence(pair, station):
    ground, _ = pair
    stranger = station(ground.simulation, alongside=ground, address="stranger")
    ground.simulation.vehicle.radio.stations["stranger"].expected = False
    stranger.heartbeat()
    ground.run(100.0)
    assert "stranger" not in ground.simulation.vehicle.radio.stations
    stranger.heartbeat()
    ground.run(2.0)
    assert stranger.received[-1].get_srcSystem() == 1


def test_timesync_and_ping_are_answered(pair):
    ground, _ = pair
    ground.run(5.0)
    ground.send(mavlink.MAVLink_timesync_message(0, 123456))
    ground.send(mavlink.MAVLink_ping_message(42, 7, 0, 0))
    ground.run(0.1)
    answer = ground.last("TIMESYNC")
    assert answer.ts1 == 123456
    assert answer.tc1 == pytest.approx(5.0e9, abs=1e8)
    ping = next(m for m in ground.all("PING") if m.target_system == 255)
    assert (ping.time_usec, ping.seq) == (42, 7)


def test_garbage_and_broken_frames_are_skipped(pair):
    ground, _ = pair
    simulation = ground.simulation
    simulation.receive("ground", b"\xfd\x09\x00 not a frame \xfd\xff")
    frame = bytearray(
        mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(mavlink.MAVLink(None, 255, 190))
    )
    frame[-1] ^= 0xFF
    simulation.receive("ground", bytes(frame))
    ground.run(1.0)
    assert not ground.all("COMMAND_ACK")
    simulation.receive("ground", bytes(300))
    assert ground.command_long(mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == ACCEPTED
