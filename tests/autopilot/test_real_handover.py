"""A pilot takes over from the service on a real autopilot, and hands back, where SITL programs are given.

SIDELONG_PROGRAMS=/path/to/programs python -m pytest tests/autopilot/test_real_handover.py -s

In real time. CYCLES is how often the aircraft is handed over and back.
"""

from __future__ import annotations

import json
import os
import socket
import time

import pytest
from pymavlink.dialects.v20 import all as mavlink

from tests.autopilot.changing_relay import ChangingRelay
from tests.autopilot.real_vehicle import FLAVOURS, RealVehicle, configured
from tests.bench.test_service import Service

pytestmark = [pytest.mark.autopilot, pytest.mark.timeout(1800)]

CYCLES = int(os.environ.get("CYCLES", "3"))
WATCHED = "watched from now on"
RESUMED_WITHIN_S = 10.0
WATCHED_S, PILOTS_S = 20.0, 15.0
PILOTS_MODE = {"arduplane": (5, 0), "px4": (4, 3)}  # FBWA; AUTO LOITER: its simulated pilot has no sticks


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_the_watch_is_resumed_after_each_of_three_takeovers(flavour, tmp_path):
    config = configured(tmp_path / "mission.toml", flavour, "[requirement]\ntarget_speed_max_m_s = 4\n")
    with (
        RealVehicle(flavour, "--target", "circle") as vehicle,
        ChangingRelay(vehicle.urls[0]) as relay,
        Service(relay.url, tmp_path, str(config)) as service,
    ):
        service.until("ready")
        assert service.ask("watch").returncode == 0
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


def asked(service, request):
    """Ask by the service's socket: a command would have to start first."""
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(service.socket)
        client.sendall(json.dumps({"request": request}).encode() + b"\n")
        client.makefile().readline()
