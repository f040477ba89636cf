"""The service through losses of what it needs: vehicle, payload, its own process, disk and network.

Run it in namespaces of its own, where it may mount a disk of a few megabytes and switch the network off:

    unshare --net --mount sh -c 'ip link set lo up; exec python -m pytest tests/bench/test_service_faults.py -s'

TIMES is how often each is lost (20 in the full campaign), half of them with each autopilot, in random states.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.run_folder import RunFolder
from tests.autopilot.conftest import vehicle_of  # noqa: F401  # a fixture
from tests.bench.test_service import Service
from tests.command_line import SIDELONG

pytestmark = [pytest.mark.udp, pytest.mark.timeout(3600)]

TIMES = int(os.environ.get("TIMES", "2"))
SPEED = 6.0
DISK_BYTES = 60_000_000
LOST_MAX_S = 1.0  # of the wall clock: what a kill may take from the records
STATES = ("ready", "watching", "yielded")
BY_PILOT = {"arduplane": 5, "px4": 0x00020000}
IS_OWN = [name for _, name in socket.if_nameindex()] == ["lo"]  # no other interface: a network namespace of its own
needs_own = pytest.mark.skipif(not IS_OWN, reason="run it in namespaces of its own, see the file's first lines")


class Day:
    """One vehicle and the service on board, through all cycles of one fault."""

    def __init__(self, vehicle, flavour, folder, seed):
        self.vehicle, self.flavour, self.folder = vehicle, flavour, folder
        self.rng = np.random.default_rng(seed)
        self.passed = 0
        self.killed: dict[Path, float] = {}  # the run that was written then, and the vehicle's time
        self.incomplete: set[str] = set()  # runs in which the disk was full
        subprocess.run([SIDELONG, "prepare"], check=True, capture_output=True)  # else the first start compiles
        self.service = Service(vehicle.url, folder)
        try:
            self.service.until("ready")
        except AssertionError:
            self.service.kill()
            raise

    def go_to(self, state):
        """Bring the service from any state to this one."""
        now = self.service.status["state"]
        if now == "ready" and state != "ready":
            self.watch()
        if now == "yielded" and state == "watching":
            self.watch()
        if now != "ready" and state == "ready":
            assert self.service.ask("release").returncode == 0
            self.service.until("ready")
        if state == "yielded" and now != "yielded":
            self.vehicle.do(lambda: self.vehicle.autopilot.set_mode(BY_PILOT[self.flavour]))
            self.service.until("yielded", None)

    def watch(self):
        """Ask for the watch once, and wait for it."""
        answer = self.service.ask("watch")
        assert answer.returncode == 0, (answer.stderr, self.service.announced[-2000:])
        self.service.until("watching")

    def settle(self, *states):
        """Wait until the service has been in one of these states, all checks passed, for a second."""
        deadline_s, since_s = time.monotonic() + 60.0, time.monotonic()
        while time.monotonic() - since_s < 1.0:
            status = self.service.status
            if status["state"] not in states or (status["state"] == "watching" and status["reason"]):
                since_s = time.monotonic()
            assert time.monotonic() < deadline_s, (status, self.service.announced[-2000:])
            time.sleep(0.1)
        return status["state"]

    def resume(self):
        """Watch on request, from whatever state it is in now."""
        if self.settle("ready", "watching", "yielded") != "watching":
            self.watch()
        self.vehicle.wait(5.0)
        self.settle("watching")
        self.passed += 1

    def end(self):
        """End the service, and return its runs."""
        self.go_to("ready")
        self.service.process.terminate()
        assert self.service.process.wait(60.0) == 0
        assert "Traceback" not in self.service.announced
        assert "fault of the program" not in self.service.announced
        return sorted(self.service.out.iterdir())


def vehicle_lost(day):
    """Switch the autopilot off in flight, and on again: it begins with its clock at zero, in another mode."""
    day.vehicle.deaf = True
    state, off_s = day.service.status["state"], day.rng.uniform(0.5, 12.0)
    day.vehicle.wait(off_s * SPEED)
    if off_s > 8.0 and state == "ready":
        day.service.until("waiting", None)
    day.vehicle.do(day.vehicle.simulation.reboot)
    day.vehicle.wait(3.0)
    day.vehicle.deaf = False
    day.settle(*(("ready",) if state == "ready" else ("yielded",)))


def payload_lost(day):
    """Switch laser and gimbal off, and on again."""
    state = day.service.status["state"]
    day.vehicle.do(day.vehicle.simulation.mute_payload)
    day.vehicle.wait(day.rng.uniform(0.5, 12.0) * SPEED)
    assert day.service.status["state"] == state  # an aircraft in flight is taken over without its payload, too
    day.vehicle.do(day.vehicle.simulation.muted.clear)
    day.settle(state)


def process_lost(day):
    """Kill the process, and start another one, as systemd does."""
    status = day.service.status
    if status["state"] != "ready":
        day.killed[Path(status["run"])] = day.vehicle.autopilot.now_s
    day.service.kill()
    day.service.process.wait(10.0)
    day.vehicle.wait(day.rng.uniform(0.0, 5.0) * SPEED)
    day.service = Service(day.vehicle.url, day.folder)
    day.settle("ready")


def disk_lost(day):
    """Fill the disk to the last byte, and free it after a while."""
    state, filler = day.service.status["state"], day.service.out / "filler"
    day.incomplete.add(day.service.status["run"])
    with filler.open("wb", buffering=0) as file:
        for size in (1 << 20, 1 << 10, 1):
            try:
                while True:
                    file.write(bytes(size))
            except OSError:
                continue
    if state == "ready":  # begin a watch on the full disk, too
        day.watch()
        day.incomplete.add(day.service.status["run"])
    day.vehicle.wait(day.rng.uniform(1.0, 5.0) * SPEED)
    day.settle("watching" if state == "ready" else state)
    if state == "watching":
        day.go_to("ready")
        assert day.service.status["records"]
    filler.unlink()


def network_lost(day):
    """Switch the network off, and on again."""
    state = day.service.status["state"]
    subprocess.run(["ip", "link", "set", "lo", "down"], check=True)
    try:
        day.vehicle.wait(day.rng.uniform(0.5, 12.0) * SPEED)
        assert day.service.status["state"] in (("ready", "waiting") if state == "ready" else (state,))
    finally:
        subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    day.settle(state)


@needs_own
@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
@pytest.mark.parametrize("fault", [vehicle_lost, payload_lost, process_lost, disk_lost, network_lost])
def test_watches_on_request_after(vehicle_of, tmp_path, fault, flavour):  # noqa: F811
    runs = tmp_path / "runs"
    runs.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "sidelong", runs], check=True)
    day = None
    try:
        day = Day(vehicle_of(flavour, speed=SPEED), flavour, tmp_path, len(fault.__name__))
        times, before = (TIMES + 1) // 2, time.monotonic()
        for _ in range(times):
            day.go_to(str(day.rng.choice(STATES)))
            day.vehicle.wait(day.rng.uniform(0.0, 20.0))
            fault(day)
            day.resume()
        folders = day.end()
        assert check_records(day, folders) == []
        print(f"{fault.__name__}, {flavour}: {day.passed} of {times} in {time.monotonic() - before:.0f} s")
    finally:
        if day is not None and day.service.process.poll() is None:
            day.service.kill()
        subprocess.run(["umount", "--lazy", runs], check=True)


def check_records(day, folders):
    """Return what is wrong with the records."""
    wrong = []
    for folder in folders:
        name = str(folder.relative_to(day.folder))
        if str(folder) in day.incomplete:
            continue
        journal = JournalReader(RunFolder(folder).journal, JOURNAL_TYPES)
        *_, last = journal
        if journal.damaged_lines:
            wrong.append(f"{name}: {journal.damaged_lines} damaged lines")
        if folder in day.killed:
            if day.killed[folder] - last.time_s > LOST_MAX_S * SPEED:
                wrong.append(f"{name}: the last {day.killed[folder] - last.time_s:.1f} s are missing")
        elif json.loads(RunFolder(folder).summary.read_text()).get("records_lost"):
            wrong.append(f"{name}: records are lost")
        verified = subprocess.run(
            [SIDELONG, "replay", folder, "--verify"], capture_output=True, text=True, check=False, timeout=300.0
        )
        if verified.returncode != 0:
            wrong.append(f"{name}: {verified.stdout[-400:]} {verified.stderr[-400:]}")
    return wrong
