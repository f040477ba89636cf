"""Each documented way to begin and end a watch, end to end: the service as a process, MAVSDK, a live vehicle.

    python -m pytest tests/bench/test_ways_in.py -s

PRESSES is how often each way is used, 0 to 5 s apart. After each burst the service has to do what was requested last.
"""

from __future__ import annotations

import json
import os
import random
import re
import socket
import time
from functools import partial
from urllib.request import Request, urlopen

import pytest

from tests.autopilot.conftest import vehicle_of  # noqa: F401  # a fixture
from tests.bench.test_service import PATIENCE_S, Service
from tests.serve.test_ways_in import FUNCTION, HIGH, LOW, SENDERS, TARGETS, Station, Transmitter

pytestmark = [pytest.mark.udp, pytest.mark.timeout(0)]

PRESSES = int(os.environ.get("PRESSES", "20"))
SPEED, APART_S, BURST = 4.0, 5.0, 4
LASTS_S = 1.2  # a movement of a switch or a mode counts after some seconds of the vehicle's time
SELECTED = {"arduplane": (12, "LOITER"), "px4": (0x00020000, "ALTCTL")}
BY_PILOT = {"arduplane": 5, "px4": 0x00030000}


def ask(service, request):
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(service.socket)
        client.sendall(json.dumps({"request": request}).encode() + b"\n")
        return json.loads(client.makefile().readline())["accepted"]


class Ways:
    """What a person presses, for one service and its vehicle; each way takes whether the watch is to begin."""

    def __init__(self, service, vehicle, flavour, chance):
        self._service, self._vehicle, self._flavour, self._chance = service, vehicle, flavour, chance
        self._station, self.transmitter = Station(vehicle.ports[0]), None

    def socket(self, begin):
        assert ask(self._service, "watch" if begin else "release")

    def page(self, begin):
        """The page of a watch resumes and ends it, that of the service begins and releases one."""
        state = self._service.status["state"]
        begins = "resume" if state == "yielded" else "watch"
        action = begins if begin else self._chance.choice(("end", "release"))
        where = re.search(r"http://([\d.:]+)/", self._service.announced)[1]
        headers = {"Origin": f"http://{where}", "Content-Type": "application/json"}
        body = json.dumps({"action": action}).encode()
        with urlopen(Request(f"http://{where}/press", body, headers)) as answer:
            assert answer.status == 202

    def rc(self, begin):
        self.transmitter.move(2000 if begin else 1000)
        time.sleep(LASTS_S)

    def mode(self, begin):
        mode = SELECTED[self._flavour][0] if begin else BY_PILOT[self._flavour]
        self._vehicle.do(partial(self._vehicle.autopilot.set_mode, mode))
        time.sleep(LASTS_S if begin else 0.0)

    def aux(self, begin):
        pick = self._chance.choice
        self._station.press(HIGH if begin else LOW, pick(TARGETS), pick(SENDERS), pick((True, False)))


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
@pytest.mark.parametrize("way", ["socket", "page", "rc", "mode", "aux"])
def test_each_press_is_obeyed(vehicle_of, tmp_path, way, flavour):  # noqa: F811
    chance = random.Random(f"{way} {flavour}")
    vehicle = vehicle_of(flavour, speed=SPEED)
    switch = {"rc": "rc_channel=9", "mode": f"flight_mode={SELECTED[flavour][1]}"}.get(
        way, f"aux_function={FUNCTION}"
    )
    view = ("--view", "--set", "display.port=0") if way == "page" else ()
    given = ("--set", f"control.{switch}", "--set", "requirement.target_speed_max_m_s=4", *view)
    with Service(vehicle.url, tmp_path, *given) as service:
        ways = Ways(service, vehicle, flavour, chance)
        if way == "rc":
            ways.transmitter = Transmitter(vehicle)
        press, off = getattr(ways, way), ("yielded",) if way == "mode" else ("ready",)
        if way == "mode":
            press(False)
        service.until("ready")
        time.sleep(LASTS_S)
        requested, wrong = False, 0
        for number in range(1, PRESSES + 1):
            requested = not requested
            press(requested)
            time.sleep(chance.uniform(0.0, APART_S) * chance.choice((0.0, 1.0, 1.0)))
            if number % BURST and number < PRESSES:
                continue
            until_settled(service, requested, off)
            time.sleep(1.0)
            wrong += not settled(service.status, requested, off)
            if chance.random() < 0.5:  # one more, so that bursts begin in both states
                requested = not requested
                press(requested)
                until_settled(service, requested, off)
        print(f"\n{way}, {flavour}: {PRESSES} presses, {service.status['watches']} watches, {wrong} wrong at last")
        assert wrong == 0
        assert "Traceback" not in service.announced


def settled(status, requested, off):
    state = status["state"]
    if not requested:
        return state in (*off, "ready")
    return state == "watching" and not status["reason"].startswith(("the watch begins", "taking", "ending"))


def until_settled(service, requested, off):
    """Wait until the service has done what was requested for a second: a press needs a moment to arrive."""
    deadline_s, looks = time.monotonic() + PATIENCE_S, 0
    while looks < 10:
        looks = looks + 1 if settled(service.status, requested, off) else 0
        assert time.monotonic() < deadline_s, (requested, service.status, service.announced)
        time.sleep(0.1)
