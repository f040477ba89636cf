"""A pilot takes over from the service on a real autopilot, and hands back, where SITL programs are given.

SIDELONG_PROGRAMS=/path/to/programs python -m pytest tests/autopilot/test_real_handover.py -s

In real time. CYCLES is how often the aircraft is handed over and back. TAKEOVERS is how often a station selects a
mode at a random moment, every second time soon after an order, REAL_SPEED times as fast as the clock, drawn by SEED.
"""

from __future__ import annotations

import json
import math
import os
import random
import re
import socket
import threading
import time
from contextlib import contextmanager, nullcontext

import pytest
from pymavlink.dialects.v20 import all as mavlink

from tests.autopilot.changing_relay import ChangingRelay
from tests.autopilot.conftest import COMMANDING
from tests.autopilot.real_vehicle import FLAVOURS, RealVehicle, configured
from tests.bench.test_service import PATIENCE_S, Service

pytestmark = [pytest.mark.autopilot, pytest.mark.timeout(1800)]

CYCLES = int(os.environ.get("CYCLES", "3"))
TAKEOVERS = int(os.environ.get("TAKEOVERS", "16"))
SPEED, SEED = float(os.environ.get("REAL_SPEED", "3")), os.environ.get("SEED", "1")
WATCHED = "watched from now on"
RESUMED_WITHIN_S = 10.0
WATCHED_S, PILOTS_S = 20.0, 15.0
FAILSAFE_WITHIN_S = 20.0  # both time-outs are shorter
INT32, INT8 = mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_INT8
LINK_FAILSAFE = {  # values as they go over the link
    "arduplane": (("FS_GCS_ENABL", 1.0, INT8), ("FS_LONG_ACTN", 1.0, INT8)),
    "px4": (("NAV_DLL_ACT", 2.8e-45, INT32), ("COM_DL_LOSS_T", 1.4e-44, INT32)),  # 2, and 10 s
}
LINK_REASON = {"arduplane": "GCS Failsafe On", "px4": "GCS connection loss"}
REASON_WITHIN_S = 3.0
PILOTS_MODE = {"arduplane": (5, 0), "px4": (4, 3)}  # FBWA; AUTO LOITER: its simulated pilot has no sticks


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_the_watch_is_resumed_after_each_of_three_takeovers(flavour, tmp_path):
    config = configured(tmp_path / "mission.toml", flavour, "[requirement]\ntarget_speed_max_m_s = 4\n")
    with (
        RealVehicle(flavour, "--target", "circle") as vehicle,
        ChangingRelay(vehicle.urls[0]) as relay,
        Service(relay.url, tmp_path, str(config)) as service,
    ):
        begun(service)
        service.wait_for(WATCHED)
        took_s = []
        for cycle in range(CYCLES):
            time.sleep(WATCHED_S)
            mission_mode = relay.mode
            relay.command(mavlink.MAV_CMD_DO_SET_MODE, 1, *PILOTS_MODE[flavour])
            assert "flight mode was changed" in service.until("yielded", None)["reason"]
            time.sleep(PILOTS_S)
            assert relay.mode != mission_mode
            begin_s = time.monotonic()
            asked(service, "watch")
            service.wait_for(WATCHED, times=cycle + 2)
            while relay.mode != mission_mode and time.monotonic() - begin_s <= RESUMED_WITHIN_S:
                time.sleep(0.05)  # its heartbeat comes once a second
            took_s.append(time.monotonic() - begin_s)
            assert relay.mode == mission_mode
        print(f"{flavour}: circling again after {', '.join(f'{one:.1f}' for one in took_s)} s")
        assert service.ask("release").returncode == 0
        service.until("ready")
        service.process.terminate()
        assert service.process.wait(60.0) == 0
        assert "Traceback" not in service.announced
    assert max(took_s) <= RESUMED_WITHIN_S


STATIONS_MODES = {
    "arduplane": {"RTL": (11, 0), "LOITER": (12, 0), "FBWA": (5, 0), "CRUISE": (7, 0)},
    "px4": {"RTL": (4, 5), "HOLD": (4, 3), "POSITION": (3, 0), "LAND": (4, 6)},
}
YIELDED_WITHIN_S, KEPT_S, ORDER_WITHIN_S, SOON_S = 2.0, 4.0, 40.0, 2.0


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_no_mode_that_a_station_selects_is_taken_back(flavour, tmp_path):
    more = '[requirement]\ntarget_speed_max_m_s = 4\n[link]\ntake_over_from = ["RTL", "LAND", "failsafe"]\n'
    config, chance = configured(tmp_path / "mission.toml", flavour, more), random.Random(f"{flavour} {SEED}")
    sticks = mavlink.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0)
    modes = STATIONS_MODES[flavour]
    cases = [(name, soon) for soon in (True, False) for name in modes] * math.ceil(TAKEOVERS / (2 * len(modes)))
    chance.shuffle(cases)
    with (
        RealVehicle(flavour, "--target", "circle", "--speed", SPEED) as vehicle,
        ChangingRelay(vehicle.urls[0]) as relay,
        Service(relay.url, tmp_path, str(config)) as service,
        # PX4 refuses Position without; ArduPlane does not arm with a throttle that is not idle.
        said(relay, sticks, 0.2 / SPEED) if flavour == "px4" else nullcontext(),
    ):
        service.until("ready")
        asked(service, "watch")
        service.wait_for(WATCHED)
        took_s, taken_back, refused, after_order = {}, [], 0, 0
        for name, soon in cases[:TAKEOVERS]:
            wait(relay, chance.uniform(1.0, 8.0))
            if soon:
                before, begin_ms = relay.commanded["MISSION_SET_CURRENT"], relay.time_boot_ms
                while relay.commanded["MISSION_SET_CURRENT"] == before and since_s(relay, begin_ms) < ORDER_WITHIN_S:
                    time.sleep(0.005)
                after_order += relay.commanded["MISSION_SET_CURRENT"] > before
                wait(relay, chance.uniform(0.0, SOON_S))
            own_mode, begin_ms = relay.mode, relay.time_boot_ms
            answer = relay.command(mavlink.MAV_CMD_DO_SET_MODE, 1, *modes[name])
            if answer.result != mavlink.MAV_RESULT_ACCEPTED:
                refused += 1
                continue
            until_yielded(service)
            took_s.setdefault(name, []).append(since_s(relay, begin_ms))
            commanded = sum(relay.commanded[kind] for kind in COMMANDING - {"COMMAND_LONG"})
            wait(relay, KEPT_S)
            sent = sum(relay.commanded[kind] for kind in COMMANDING - {"COMMAND_LONG"}) - commanded
            if relay.mode == own_mode or sent or service.status["state"] != "yielded":
                taken_back.append((name, relay.mode, sent))
            watched = service.announced.count(WATCHED)
            asked(service, "watch")
            service.wait_for(WATCHED, times=watched + 1)
        each = ", ".join(f"{name} {len(one)} (at most {max(one):.1f} s)" for name, one in sorted(took_s.items()))
        late = sum(one > YIELDED_WITHIN_S for times_s in took_s.values() for one in times_s)
        print(f"{flavour}: yielded to {each}, {late} of them late;", end=" ")
        print(f"{after_order} within {SOON_S:g} s of an order;", end=" ")
        print(f"{refused} refused by the autopilot; taken back: {taken_back}")
        assert taken_back == []
        assert max(map(max, took_s.values())) <= YIELDED_WITHIN_S


def begun(service):
    """Ask for the first watch until it begins: it is refused while the laser has no echo, which may last 8 s."""
    deadline_s = time.monotonic() + PATIENCE_S
    while service.ask("watch").returncode != 0:
        assert time.monotonic() < deadline_s, service.announced
        time.sleep(1.0)


def since_s(relay, begin_ms):
    """Return how much of the vehicle's time has passed."""
    return (relay.time_boot_ms - begin_ms) / 1000.0


def wait(relay, seconds):
    """Wait for this much of the vehicle's time."""
    begin_ms, deadline_s = relay.time_boot_ms, time.monotonic() + PATIENCE_S
    while since_s(relay, begin_ms) < seconds:
        assert time.monotonic() < deadline_s, "the simulation does not go on"
        time.sleep(0.005)


def until_yielded(service):
    deadline_s = time.monotonic() + PATIENCE_S
    while service.status["state"] != "yielded":
        assert time.monotonic() < deadline_s, (service.status, service.announced)
        time.sleep(0.02)


@contextmanager
def ground_station(relay):
    """Send heartbeats of a ground station inside the context."""
    with said(relay, mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3), 1.0):
        yield


@contextmanager
def said(relay, message, every_s):
    """Send a message as another station inside the context."""
    silent = threading.Event()

    def talk():
        while not silent.wait(every_s):
            relay.say(message)

    talking = threading.Thread(target=talk)
    talking.start()
    try:
        yield
    finally:
        silent.set()
        talking.join()


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_the_failsafe_of_a_silent_ground_station_takes_the_aircraft(flavour, tmp_path):
    more = '[requirement]\ntarget_speed_max_m_s = 4\n[link]\ntake_over_from = ["RTL", "failsafe"]\n'
    config = configured(tmp_path / "mission.toml", flavour, more)
    with (
        RealVehicle(flavour, "--target", "circle") as vehicle,
        ChangingRelay(vehicle.urls[0]) as relay,
        Service(relay.url, tmp_path, str(config)) as service,
    ):
        with ground_station(relay):
            begun(service)
            service.wait_for(WATCHED)
            for name, value, kind in LINK_FAILSAFE[flavour]:
                relay.set_parameter(name, value, kind)
            time.sleep(WATCHED_S)
            assert service.until("watching", None)["state"] == "watching"
            own_mode = relay.mode
        silent_s = time.monotonic()
        while relay.mode == own_mode:
            assert time.monotonic() < silent_s + FAILSAFE_WITHIN_S, "the failsafe does not begin"
            time.sleep(0.05)
        began_s = time.monotonic() - silent_s
        service.wait_for("by a failsafe of the autopilot: ")
        print(f"{flavour}: the failsafe began {began_s:.1f} s after the last heartbeat")
        time.sleep(REASON_WITHIN_S)
        reason = service.until("yielded", None)["reason"]
        print(reason)
        assert re.search(LINK_REASON[flavour], reason)
        with ground_station(relay):
            commanded = sum(relay.commanded[kind] for kind in COMMANDING - {"COMMAND_LONG"})
            time.sleep(PILOTS_S)
            assert service.until("yielded", None)["state"] == "yielded"
            assert sum(relay.commanded[kind] for kind in COMMANDING - {"COMMAND_LONG"}) == commanded
            asked(service, "watch")
            service.wait_for(WATCHED, times=2)
            begin_s = time.monotonic()
            while relay.mode != own_mode:
                assert time.monotonic() < begin_s + RESUMED_WITHIN_S
                time.sleep(0.05)  # its heartbeat comes once a second
        service.process.terminate()
        assert service.process.wait(60.0) == 0
        assert "Traceback" not in service.announced


def asked(service, request):
    """Ask by the service's socket: a command would have to start first."""
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(service.socket)
        client.sendall(json.dumps({"request": request}).encode() + b"\n")
        client.makefile().readline()
