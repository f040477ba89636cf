"""The application as a process of its own, on a simulated vehicle whose fate the test holds in its hands."""

from __future__ import annotations

import itertools
import json
import math
import os
import queue
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.protocol.transfer import Item
from sidelong.sitl.server import serve
from sidelong.sitl.settings import Flavour, LinkFaults, Settings, TargetSettings
from sidelong.sitl.simulation import Simulation
from tests.command_line import PROGRAM, runs_for

SPEED = 20.0
RELATIVE = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
LIFE_S = int(os.environ.get("LIFE_S", "600"))  # of the application, at most
PATIENCE_S = 0.3 * LIFE_S
WIND_UP_S = 60.0  # the application's own bound
# Runs a program that the kernel ends after this many seconds, should its test not have lived to do it.
MORTAL = "import os, signal, sys; signal.alarm(int(sys.argv[1])); os.execv(sys.argv[2], sys.argv[2:])"
STATION_IDS = range(190, 195)  # MAVLink components of the application: ground station or companion
ROLE = os.environ.get("LINK_ROLE", "")
WRITING = {"MISSION_COUNT", "MISSION_WRITE_PARTIAL_LIST", "MISSION_ITEM_INT"}
COMMANDING = WRITING | {"COMMAND_LONG", "COMMAND_INT", "MISSION_SET_CURRENT", "SET_MODE"}


class Vehicle:
    """A simulated vehicle in a thread, circling at home when it begins, and everything that is commanded to it."""

    def __init__(
        self,
        flavour: str,
        ports: list[int],
        seed: int = 1,
        speed: float = SPEED,
        faults: LinkFaults | None = None,
        motion: str = "walk",
        **settings: Any,
    ) -> None:
        self.simulation = simulation = Simulation(
            Settings(
                flavour=Flavour(flavour),
                seed=seed,
                targets=(TargetSettings(motion, speed_max_m_s=4.0),),
                link_rate=speed,
                boot_unix_s=time.time(),
                **settings,
            )
        )
        self.autopilot = vehicle = simulation.vehicle
        self.mission_mode = 10 if flavour == "arduplane" else 0x04040000
        simulation.advance(30.0)
        if flavour == "px4":
            vehicle.parameters.set("MIS_TKO_LAND_REQ", 0)
        self.put_mission(self.circle_mission(50.0))
        vehicle.arm()
        vehicle.set_mode(self.mission_mode)
        while vehicle.craft.height_m < 95.0:
            simulation.advance(simulation.time_s + 1.0)
        self.ports, self._speed, self._faults = ports, speed, faults
        self.urls = [f"udpin://127.0.0.1:{port}" for port in ports]
        self.url = self.urls[0]
        self.cut: set[int] = set()  # ports of links that are silent both ways
        self.commanded: list[tuple[float, str]] = []  # (simulated time, message) from the application
        self.items_until_act = 0  # something happens when the application sends the item that ends the count
        self.deaf = False
        self._act = lambda: None
        self._work: queue.Queue = queue.Queue()
        self._ended = threading.Event()
        self._parser = mavlink.MAVLink(None)
        self._receive, self._take = simulation.receive, simulation.take
        simulation.receive, simulation.take = self._listen, self._talk
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def circle_mission(self, radius_m, east_m=0.0, north_m=0.0):
        latitude_deg, longitude_deg = self.autopilot.plane.latitude_longitude_deg(east_m, north_m)
        place = (round(latitude_deg * 1e7), round(longitude_deg * 1e7))
        home = Item(mavlink.MAV_CMD_NAV_WAYPOINT, 0, (0.0,) * 4, *place, self.autopilot.home.altitude_m)
        takeoff = Item(mavlink.MAV_CMD_NAV_TAKEOFF, RELATIVE, (15.0, 0.0, 0.0, 0.0), *place, 50.0)
        circle = Item(mavlink.MAV_CMD_NAV_LOITER_UNLIM, RELATIVE, (0.0, 0.0, radius_m, 0.0), *place, 100.0)
        return [takeoff, circle] if self.mission_mode != 10 else [home, takeoff, circle]

    def put_mission(self, items):
        """Store a mission as another station's upload would."""
        mission = self.autopilot.mission
        mission.begin(len(items))
        for index, item in enumerate(items):
            mission.put(index, item, current=index == 0)
        mission.finish()

    def do(self, action):
        """Let the simulation's thread do something, and return what it returns."""
        answer: queue.Queue = queue.Queue()
        self._work.put((action, answer))
        return answer.get(timeout=PATIENCE_S)

    def at_item(self, count, act):
        """Do something just before the count-th item from now on reaches the vehicle."""
        self._act, self.items_until_act = act, count

    def wait(self, seconds):
        """Wait for this much of the vehicle's time."""
        end_s = self.simulation.time_s + seconds
        deadline_s = time.monotonic() + PATIENCE_S
        while self.simulation.time_s < end_s:
            assert time.monotonic() < deadline_s, "the simulation does not go on"
            self.do(lambda: None)  # takes one of its steps

    def off_circle_m(self, centre_m):
        craft = self.autopilot.craft
        return math.hypot(craft.east_m - centre_m[0], craft.north_m - centre_m[1])

    def close(self):
        self._ended.set()
        self._thread.join(60.0)

    def _serve(self):
        stations = [("127.0.0.1", port) for port in self.ports]
        serve([(self.simulation, stations)], speed=self._speed, faults=self._faults, stopped=self._stopped)

    def _stopped(self):
        while not self._work.empty():
            action, answer = self._work.get()
            answer.put(action())
        return self._ended.is_set()

    def _listen(self, address, data):
        if self.deaf or address[1] in self.cut:
            return
        for message in self._parser.parse_buffer(bytes(data)) or ():
            kind = message.get_type()
            if message.get_srcComponent() in STATION_IDS and kind in COMMANDING:
                self.commanded.append((self.simulation.time_s, kind))
                if kind == "MISSION_ITEM_INT" and self.items_until_act:
                    self.items_until_act -= 1
                    if self.items_until_act == 0:
                        self._act()
        self._receive(address, data)

    def _talk(self):
        sent = self._take()
        return [] if self.deaf else [(address, data) for address, data in sent if address[1] not in self.cut]


class Application:
    """``sidelong launch`` on a vehicle; stdout: where to, its log by default. Use as ``with``: killed at its end."""

    def __init__(self, url, out, *options, program=PROGRAM, stdout=None):
        self.out = out
        arguments = ["launch", "--connect", url, "--duration", "3000", "--out", str(out), *options]
        arguments += ["--set", f"link.role={ROLE}"] if ROLE else []
        # A pipe that no one empties would stop it: the lines go into a file.
        self._log = out.with_suffix(".log")
        with self._log.open("w") as log:
            command = [sys.executable, "-c", MORTAL, str(LIFE_S), *program, *arguments]
            self.process = subprocess.Popen(command, stdout=stdout or log, stderr=log)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.kill()
        self.process.wait(60.0)

    @property
    def announced(self):
        return re.sub(r"\s+", " ", self._log.read_text())

    def wait_for(self, words, times=1, limit_s=PATIENCE_S):
        deadline_s = time.monotonic() + limit_s
        while self.announced.count(words) < times:
            assert runs_for(self.process, 0.05), self.announced
            assert time.monotonic() < deadline_s, f"never reported {words!r}: {self.announced}"

    def kill(self):
        os.kill(self.process.pid, signal.SIGKILL)

    @property
    def run(self):
        return sorted(self.out.iterdir())[-1]

    def end(self, number=signal.SIGINT):
        """Interrupt it, and return its summary."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        self.process.wait(WIND_UP_S + 10.0)
        assert "Traceback" not in self.announced
        return json.loads((self.run / "summary.json").read_text())


@pytest.fixture
def vehicle_of(free_port):
    made = []

    def make(flavour, seed=1, links=1, **options):
        made.append(Vehicle(flavour, [free_port() for _ in range(links)], seed, **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture
def launch(tmp_path):
    numbers = itertools.count()
    with ExitStack() as begun:
        yield lambda url, *options: begun.enter_context(Application(url, tmp_path / f"runs{next(numbers)}", *options))
