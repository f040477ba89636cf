"""MAVProxy itself next to the simulated vehicle: a whole session of it, without an error."""

from __future__ import annotations

import importlib.util
import queue
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

pytestmark = [
    pytest.mark.udp,
    pytest.mark.skipif(importlib.util.find_spec("MAVProxy") is None, reason="MAVProxy is not installed"),
]

SPEED = 10
MODULES = "log,wp,rally,fence,param,arm,mode,misc,cmdlong"
ANSWER_S = 20.0
# PX4 reports no health of a geofence that is off, which MAVProxy calls a breach with every PX4.
ERROR = re.compile(r"error|timed out|failed|unable|denied|unsupported|unexpected|traceback|exception", re.IGNORECASE)

WAYPOINTS = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t{lat}\t{lon}\t500\t1
1\t0\t3\t22\t15\t0\t0\t0\t{lat}1\t{lon}\t60\t1
2\t0\t3\t16\t0\t0\t0\t0\t{lat}1\t{lon}1\t90\t1
3\t0\t3\t17\t0\t0\t60\t0\t{lat}1\t{lon}2\t90\t1
"""
HOMES_DEG = {"arduplane": ("-35.363", "149.165"), "px4": ("47.397", "8.545")}
MODES = {  # of PX4, MAVProxy's own `mode NAME` never leaves it
    "arduplane": {"LOITER": "mode LOITER", "AUTO": "mode AUTO", "RTL": "mode RTL"},
    "px4": {
        "RTL": "long DO_SET_MODE 1 4 5",
        "MISSION": "long DO_SET_MODE 1 4 4",
        "LOITER": "long DO_SET_MODE 1 4 3",
    },
}


class Session:
    """MAVProxy at its prompt. ``lines`` is all that it has reported."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process, self.lines = process, []
        self._new: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self._new.put(line.rstrip())

    def expect(self, *patterns: str) -> list[str]:
        """Wait for a line of each pattern, in any order; return them as they came."""
        wanted, found, until_s = list(patterns), [], time.monotonic() + ANSWER_S
        while wanted:
            try:
                line = self._new.get(timeout=max(until_s - time.monotonic(), 0.01))
            except queue.Empty:
                raise AssertionError(f"no {wanted} in:\n" + "\n".join(self.lines[-40:])) from None
            self.lines.append(line)
            met = next((pattern for pattern in wanted if re.search(pattern, line)), None)
            if met is not None:
                wanted.remove(met)
                found.append(line)
        return found

    def do(self, command: str, *patterns: str) -> list[str]:
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        return self.expect(*patterns)


@pytest.fixture(params=["arduplane", "px4"])
def session(request, tmp_path, free_port) -> Iterator[tuple[str, Session]]:
    port = free_port()
    vehicle = [sys.executable, "-m", "sidelong.sitl", "--autopilot", request.param, "--to", f"127.0.0.1:{port}"]
    station = [sys.executable, "-u", "-m", "MAVProxy.mavproxy", f"--master=udpin:127.0.0.1:{port}", "--nowait"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    sitl = subprocess.Popen([*vehicle, "--speed", str(SPEED), "--while-input"], **pipes)
    latitude, longitude = HOMES_DEG[request.param]
    (tmp_path / "wp.txt").write_text(WAYPOINTS.format(lat=latitude, lon=longitude))
    (tmp_path / "rally.txt").write_text(f"RALLY {latitude} {longitude} 100.0 50.0 0.0 0\n")
    corners = [("0", "0"), ("1", "1"), ("1", "9"), ("9", "9"), ("9", "1"), ("1", "1")]
    (tmp_path / "fence.txt").write_text("".join(f"{latitude}{a} {longitude}{b}\n" for a, b in corners))
    mavproxy = subprocess.Popen(
        [
            *station,
            f"--state-basedir={tmp_path}",
            "--default-modules=log,wp,rally,fence,param,arm,mode,misc,cmdlong",
        ],
        **pipes,
        stderr=subprocess.STDOUT,
        cwd=tmp_path,
    )
    try:
        yield request.param, Session(mavproxy)
    finally:
        for process in (mavproxy, sitl):
            process.kill()
            process.wait(10)


def taken(station, flavour, command, kind):
    """Say it until it is taken. MAVProxy acknowledges no list that it has read: PX4 is busy with it for 5 s more."""
    while "ACCEPTED" not in (found := station.do(command, f"TYPE_{kind}: (ACCEPTED|ERROR)|IGN CLEAR CMD: Busy")[0]):
        assert flavour == "px4"
        station.lines.remove(found)
        station.expect("Operation timeout")


def test_a_whole_session_goes_without_an_error(session):
    flavour, station = session
    station.expect("online system 1", "Received [0-9]+ parameters")
    name = {"arduplane": "RTL_ALTITUDE", "px4": "RTL_RETURN_ALT"}[flavour]
    station.do(f"param set {name} 77")
    while not station.do(f"param show {name}", rf"{name} +[\d.]+")[0].endswith(" 77.0"):
        assert station.process.poll() is None
    if flavour == "px4":
        station.do("param set MIS_TKO_LAND_REQ 0")  # as it comes PX4 drops a mission without a landing
    station.do("wp load wp.txt", "TYPE_MISSION: ACCEPTED")
    station.do("wp list", r"17 [36] .* p3=60\.0", "Saved 4 waypoints")
    taken(station, flavour, "fence load fence.txt", "FENCE")
    station.do("fence list", "Saved [1-9] fence items")
    taken(station, flavour, "rally load rally.txt", "RALLY")
    station.do("rally list", "Saved 1 rally items")
    for mode, command in MODES[flavour].items():
        station.do(command, f"Mode {mode}")
    station.do("arm throttle", "ARMED")
    station.do("disarm", "DISARMED")
    for kind in ("fence", "rally", "wp"):
        taken(station, flavour, f"{kind} clear", "MISSION" if kind == "wp" else kind.upper())
    station.do("reboot", "PREFLIGHT_REBOOT_SHUTDOWN: ACCEPTED")
    assert [line for line in station.lines if ERROR.search(line)] == []
