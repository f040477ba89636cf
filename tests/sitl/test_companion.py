"""The payload for someone else's vehicle, joined to one of ours."""

import io
import math
import socket
import threading
import time
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.payload.companion import Companion, CompanionError, _send, accompany
from sidelong.sitl.payload.devices import DEVICES
from sidelong.sitl.payload.payload import SimulatedPayload
from sidelong.sitl.protocol.radio import signing_time
from sidelong.sitl.settings import CameraSettings, PayloadSettings, Quirks, Settings, TargetSettings
from sidelong.sitl.simulation import camera_of, target_motion
from sidelong.sitl.world.airframe import quaternion

RANGE_REQUEST = bytes.fromhex("5566010000000015d196")  # of SIYI
EXACT = PayloadSettings(0.0, 0.0, 0.0, 0.0, 0.0)
WALK = target_motion(TargetSettings(), 1)


@pytest.fixture
def flown(simulate, station):
    ground = station(simulate(payload=None))
    companion = Companion(EXACT, target_motion(TargetSettings(motion="straight"), 1), seed=1)
    rows = []
    companion.on_truth = rows.append
    ground.run(25.0)
    ground.command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 1e5)
    ground.fly(ground.takeoff(80.0), ground.loiter(200.0, 200.0, 80.0, 80.0))
    ground.run(90.0)
    measured = [m for message in ground.received for m in companion.handle(message)]
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
        slant_m = math.dist(row.target_m, row.aircraft_m)
        assert lasers[round(row.time_s * 1000)].current_distance / 100.0 == pytest.approx(slant_m, abs=0.006)


def test_it_waits_for_home(simulate, station):
    ground = station(simulate(payload=None))
    companion = Companion(EXACT, WALK, seed=1)
    ground.run(15.0)
    assert companion.wants_home
    assert not [m for message in ground.received for m in companion.handle(message)]


def test_its_camera_is_turned_by_the_gimbal_manager_and_takes_pictures(simulate, station):
    pytest.importorskip("av", reason="the extra video is not installed")
    ground, cameras, pictures = station(simulate(payload=None)), [], []

    def made(hills):
        cameras.append(camera_of(Settings(camera=CameraSettings(width_px=160, height_px=90)), 1, hills))
        cameras[0].on_picture = lambda time_s, picture: pictures.append((time_s, picture.shape))
        return cameras[0]

    companion = Companion(EXACT, WALK, seed=1, camera=made)
    ground.run(20.0)
    ground.command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 2e4)
    ground.run(5.0)
    wanted = list(quaternion(0.0, math.radians(-40.0), math.radians(70.0)))
    commands = [
        mavlink.MAVLink_gimbal_device_set_attitude_message(1, 154, flags, q, *(math.nan,) * 3)
        for flags, q in ((mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK, wanted), (0, [math.nan] * 4))
    ]
    request = mavlink.MAVLink_command_long_message(
        1, 154, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION, *(0.0,) * 6
    )
    for message in (*commands, request):
        message.get_srcSystem, message.get_srcComponent = lambda: 1, lambda: 1
    received = list(ground.received)
    first = next(k for k, message in enumerate(received) if message.get_type() == "HOME_POSITION") + 1
    sent = [
        m for message in (*received[:first], *commands, request, *received[first:]) for m in companion.handle(message)
    ]
    assert sent[0].get_type() == "GIMBAL_DEVICE_INFORMATION"
    assert {message.get_type() for message in sent[1:]} == {"GIMBAL_DEVICE_ATTITUDE_STATUS"}
    assert math.degrees(cameras[0].yaw_rad) == pytest.approx(70.0, abs=0.1)
    assert math.degrees(cameras[0].pitch_rad) == pytest.approx(-40.0, abs=0.1)
    assert pictures[-1][1] == (90, 160, 3)
    assert len(pictures) == pytest.approx(15.0 * pictures[-1][0], rel=0.2)
    assert len(sent) < len(ground.all("GLOBAL_POSITION_INT"))


def test_its_device_answers_in_place_of_mavlink_and_sees_the_present_position(simulate, station):
    ground = station(simulate(payload=None))
    siyi = DEVICES["siyi"](Quirks(), np.random.default_rng(1))
    companion = Companion(EXACT, WALK, seed=1, device=siyi)
    rows = []
    companion.on_truth = rows.append
    assert companion.receive_device(RANGE_REQUEST) == []
    ground.run(25.0)
    ground.command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 2e4)
    ground.fly(ground.takeoff(80.0), ground.loiter(200.0, 200.0, 80.0, 80.0))
    ground.run(60.0)
    assert [m for message in ground.received for m in companion.handle(message)] == []
    positions = ground.all("GLOBAL_POSITION_INT")
    assert len(rows) < 0.5 * len(positions)  # measured at 10 Hz, seen at each position
    (answer,) = companion.receive_device(RANGE_REQUEST)
    range_m = int.from_bytes(answer[8:10], "little") / 10.0
    assert range_m == pytest.approx(math.dist(rows[-1].target_m, rows[-1].aircraft_m), abs=3.0)


@pytest.mark.parametrize("url", ["127.0.0.1:14550", "serial:///dev/ttyS0:57600", "tcpout://127.0.0.1"])
def test_a_wrong_url_is_reported(url):
    with pytest.raises(CompanionError, match="must look like"):
        accompany(Companion(EXACT, WALK, seed=1), url)


def vehicle_heartbeat(system_id, key=None):
    mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
    if key is not None:
        mav.signing.secret_key, mav.signing.sign_outgoing = key, True
        mav.signing.timestamp = signing_time(time.time())
    return mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(mav)


def test_it_waits_for_a_vehicle_and_joins_it_again_after_it_has_gone():
    waited, ready, done = [], [], threading.Event()
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    first_wait = threading.Event()

    def on_wait(reason):
        waited.append(reason)
        first_wait.set()

    work = threading.Thread(
        target=accompany,
        args=(Companion(EXACT, WALK, seed=1), f"tcpout://127.0.0.1:{port}"),
        kwargs={"on_wait": on_wait, "on_ready": ready.append, "stopped": done.is_set},
    )
    work.start()
    try:
        assert first_wait.wait(60.0)
        with socket.socket() as server:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            server.bind(("127.0.0.1", port))
            server.listen()
            server.settimeout(60.0)
            for _ in range(2):
                link, _ = server.accept()
                link.settimeout(60.0)
                link.sendall(vehicle_heartbeat(7))
                received = link.recv(4096)
                while b"\x07\x9a" not in received:  # speaks as component 154 of system 7
                    received += link.recv(4096)
                link.close()
    finally:
        done.set()
        work.join(60.0)
    assert not work.is_alive()
    assert ready == [7, 7]
    assert "refused" in waited[0]
    assert "closed the connection" in waited[1]


@contextmanager
def met_by_udp(**options):
    """Yield what a vehicle receives from a payload that has received its heartbeat, frame by frame."""
    done, ready = threading.Event(), []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        vehicle.settimeout(60.0)
        url = f"udpout://127.0.0.1:{vehicle.getsockname()[1]}"
        work = threading.Thread(
            target=accompany,
            args=(Companion(EXACT, WALK, seed=1), url),
            kwargs={"on_ready": ready.append, "stopped": done.is_set} | options,
        )
        work.start()
        try:
            _, address = vehicle.recvfrom(4096)
            vehicle.sendto(vehicle_heartbeat(7, options.get("key")), address)
            yield (vehicle.recvfrom(4096)[0] for _ in range(1000))
        finally:
            done.set()
            work.join(60.0)
    assert ready == [7]


def test_it_speaks_first_to_a_vehicle_that_answers_whom_it_has_received():
    with met_by_udp() as frames:
        assert any(frame[5:7] == b"\x07\x9a" for frame in frames)  # system and component that it speaks as


def test_it_signs_from_the_first_frame_to_the_last(monkeypatch):
    monkeypatch.delenv("MAVLINK20", raising=False)
    with met_by_udp(key=bytes(range(32))) as frames:
        frame = next(frame for frame in frames if frame[5:7] == b"\x07\x9a")
    assert frame[2] == mavlink.MAVLINK_IFLAG_SIGNED


def test_its_frames_go_straight_to_the_application_too():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as application:
        application.bind(("127.0.0.1", 0))
        application.settimeout(60.0)
        with met_by_udp(straight_to=application.getsockname()):
            assert any(application.recv(4096)[5:7] == b"\x07\x9a" for _ in range(100))


def test_its_signatures_follow_the_clock(monkeypatch):
    """They passed for too old a minute after it had begun."""
    mav, begun_s = mavlink.MAVLink(io.BytesIO(), 1, 154), 1.8e9
    mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = bytes(32), True, signing_time(begun_s)
    monkeypatch.setattr("sidelong.sitl.payload.companion.time", SimpleNamespace(time=lambda: begun_s + 120.0))
    _send(SimpleNamespace(mav=mav), SimulatedPayload.heartbeat())
    stamp = int.from_bytes(mav.file.getvalue()[-12:-6], "little")
    assert stamp == signing_time(begun_s + 120.0)


def test_the_target_goes_on_from_where_it_is_when_the_vehicle_reboots(flown):
    ground, companion, rows, _ = flown
    before = rows[-1]
    ground.simulation.reboot()
    received = len(ground.received)
    ground.run(4.0)
    ground.command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 1e5)
    ground.run(3.0)
    for message in ground.received[received:]:
        companion.handle(message)
    after = rows[-1]
    assert after.time_s < before.time_s
    moved_m = math.dist(after.target_m, before.target_m)
    assert moved_m < 10.0 * 3.0
