"""Every command line of the documents, run as it stands there but for hosts, files and durations.

Each runs in a reader's folder with the files that the lines before have made. The end of what each printed
goes to standard output (pytest -s).
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.app.test_readme import ROOT, shown

SIDELONG = Path(sys.executable).parent / "sidelong"
DASK = Path(sys.executable).parent / "dask"
HOME, PRESET = "47.5,8.5", "parrot-disco"
SHORT = {
    "launch": ["--duration", "20", "--set", "simulation.speed=20"],
    "study": ["--runs", "2", "--duration", "60", "--jobs", "1"],
    "connect": ["--listen", "1"],
}
FLAVOURS = {":14540": "px4", ":14550": "px4", ":5760": "arduplane", ":5762": "arduplane"}
OWN_PROGRAM = os.environ.get("SIDELONG_PX4")
COMMANDS = [" ".join((name, *arguments.split())) for name, arguments in shown()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Return a reader's folder: configurations, a track, tracks, tiles."""
    made = tmp_path_factory.mktemp("reader")
    shutil.copy(ROOT / "tests/data/target-bike.gpx", made / "track.gpx")
    for name in ("tracks", "DIR"):
        (made / name).mkdir()
        time_s = np.arange(0.0, 300.0)
        rows = np.column_stack((time_s, 2.0 * time_s, 80.0 * np.sin(time_s / 40.0)))
        np.savetxt(made / name / "winding.csv", rows, "%.2f", ",", header="t_s,east_m,north_m", comments="")
    (made / "FOLDER").mkdir()
    posts = np.add.outer(300.0 + 60.0 * np.sin(np.arange(1201) / 15.0), 60.0 * np.cos(np.arange(1201) / 20.0))
    posts.astype(">i2").tofile(made / "FOLDER" / "N47E008.hgt")
    _done(["init", "mission.toml", "--preset", PRESET], made)
    _done(["init", "fleet.toml", "--fleet", "2"], made)
    (made / "new").mkdir()
    return made


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_readme_runs(command, folder):
    if "--binary PATH" in command and OWN_PROGRAM is None:
        pytest.skip("set SIDELONG_PX4 to the reader's own SITL program")
    with contextlib.ExitStack() as stack:
        words = _with_what_it_names(command, folder, stack)
        name = words[0]
        if name == "init":
            text = _done(words, folder / "new")
        elif name == "sitl":
            text = _for_a_while(words, folder)
        else:
            with_map = ["--set", "display.port=0"] if "--view" in words else []
            flown = name == "launch" and "--connect" in words
            short = SHORT["launch"][:2] if flown else SHORT.get(name, [])
            text = _done([*words, *with_map, *short], folder)
    print(f"\n$ sidelong {' '.join(words)}\n  " + "\n  ".join(text.strip().splitlines()[-3:]))
    for exported in re.findall(r"--(?:store|report|export) (\S+)", command):
        assert (folder / exported).stat().st_size > 0


def _with_what_it_names(command: str, folder: Path, stack: contextlib.ExitStack) -> list[str]:
    """Return the words with what is to be had here in place of what is named, started where it is a program."""
    text = command
    if "runs/" in command:
        _done(["launch", *SHORT["launch"], "--out", "read"], folder)
        text = re.sub(r"runs/\d{8}T\d{6}Z", str(max((folder / "read").iterdir())), command)
    for word, real in (
        ("NAME", PRESET),
        ("LAT,LON", HOME),
        ("S,W,N,E", "47.4,8.4,47.6,8.6"),
        ("0.0.0.0", "127.0.0.1"),
        ("10.0.0.7", "127.0.0.1"),
        ("10.0.0.8", "127.0.0.1"),
        ("serial:///dev/ttyUSB0:57600", "URL"),
        ("KEY", "plane.key"),
        ("PATH", OWN_PROGRAM or "PATH"),
    ):
        text = text.replace(word, real)
    if "tak.example.org" in text:
        text = text.replace("tls://tak.example.org:8089", f"tls://127.0.0.1:{_free_port()}")  # no one there: reported
    if "HOST:8786" in text:
        text = text.replace("HOST:8786", f"127.0.0.1:{_cluster(folder, stack)}")
    if "beacon" in text:
        stack.enter_context(_running([sys.executable, "-c", BEACON], folder))
    link = re.search(r"URL|(?:udpin|tcpout)://127.0.0.1(:\d+)", text)
    if link is not None:
        flavour = FLAVOURS.get(link[1], "arduplane")
        text = text.replace(link[0], _vehicle(flavour, "--payload-for" not in text, folder, stack))
    return shlex.split(text)


BEACON = """
import socket, time
from pymavlink.dialects.v20 import common as mavlink
encoder, port = mavlink.MAVLink(None, srcSystem=30), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
while True:
    place, rest = (474010000, 85010000, 480.0), ([0.0] * 3, [0.0] * 3, [1.0, 0, 0, 0], [0.0] * 3, [2.0, 0, 0], 0)
    port.sendto(mavlink.MAVLink_follow_target_message(0, 1, *place, *rest).pack(encoder), ("127.0.0.1", 6969))
    time.sleep(0.5)
"""


def _vehicle(flavour: str, payload: bool, folder: Path, stack: contextlib.ExitStack) -> str:
    port = _free_port()
    words = ["sitl", "--autopilot", flavour, "--speed", "5", "--to", f"127.0.0.1:{port}"]
    stack.enter_context(_running([SIDELONG, *words, *([] if payload else ["--set", "payload=none"])], folder))
    return f"udpin://127.0.0.1:{port}"


def _cluster(folder: Path, stack: contextlib.ExitStack) -> int:
    port = _free_port()
    local = ["--no-dashboard"]
    stack.enter_context(_running([DASK, "scheduler", "--host", "127.0.0.1", "--port", str(port), *local], folder))
    worker = ["worker", f"tcp://127.0.0.1:{port}", "--nthreads", "1", "--nworkers", "1", *local]
    stack.enter_context(_running([DASK, *worker], folder))
    return port


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@contextlib.contextmanager
def _running(command: list[object], folder: Path) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [str(word) for word in command],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


def _done(words: list[str], folder: Path) -> str:
    done = subprocess.run(
        [SIDELONG, *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


def _for_a_while(words: list[str], folder: Path) -> str:
    """Let what does not end on its own run, and interrupt it."""
    with _running([SIDELONG, *words], folder) as process:
        time.sleep(8.0)
        assert process.poll() is None, process.stdout.read() if process.stdout else ""
        process.send_signal(signal.SIGINT)
        text, _ = process.communicate(timeout=30.0)
    assert "Traceback" not in text
    return text
