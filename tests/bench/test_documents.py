"""A reader follows README, tutorials and how-tos: every command is run in order, as printed, in a copy's folder.

The folder looks as the README's installation leaves it: the program is `.venv/bin/sidelong`, and no `sidelong` is
on the path. What each command prints is compared in kind. Only `SIDELONG` shortens flights, studies and predictions,
and only `_prepared` replaces what a document leaves to the reader. `NOT_RUN` has what is not run, with the reason.

``python -m pytest tests/bench/test_documents.py -s`` takes about five minutes on an idle core.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.app.test_own_packages import NAMED, PlainTextDevice
from tests.bench.size import SMOKE
from tests.command_line import FEW_FLIGHTS

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "docs/payloads.md", "docs/routes.md")),
    *(file for folder in ("tutorials", "how-to") for file in sorted((ROOT / "docs" / folder).glob("*.md"))),
]
SIDELONG = f"""#!{sys.executable}
import sys
sys.path.append("packages")
name = next(iter(sys.argv[1:]), "")
sys.argv += {{
    "launch": ["--duration", "15"] + ["--set", "simulation.speed=20"] * ("--connect" not in sys.argv),
    "study": ["--runs", "1", "--duration", "60", "--jobs", "1"],
    "payload": ["--duration", "2"],
}}.get(name, [])
sys.argv += ["--set", "display.port=0"] * ("--view" in sys.argv)
{FEW_FLIGHTS}
"""
PIP = f"""#!/bin/sh
shift
exec {sys.executable} -m pip install --quiet --no-deps --no-build-isolation --no-index --target packages "$@"
"""
NOT_RUN = {
    r"-m venv|pip install -c": "the tests run in an installation",
    r"-m pytest": "this is one of the tests",
    r"sim_vehicle|make px4|:14540|:5760|--payload-for|--binary": "needs an autopilot: tests/autopilot flies it",
    r"serial://|192\.168\.\d+\.25|KIND://": "needs the vehicle or the payload that is named",
    r"video://|camera\.stream": "renders pictures for minutes: tests/camera flies it",
    r"ffplay": "another program",
    r"dask|--scheduler": "needs a cluster: tests/app/test_study_cluster.py",
    r"--benchmark|COMMAND": "takes a quarter of an hour: tests/app/test_study_benchmark.py",
}
PRINTED = {
    "check": r"predicted from .*feasible",
    "connect": r"\bready\b",
    "export": r"\.svg",
    "init": r"wrote \w+\.toml",
    "launch": r"outcome +completed.*\nrun folder: runs/\w+",
    "payload": r"250\.0 m.*-20\.0",
    "replay": r"time on side|same to the last bit|replay: http",
    "report": r"report\.html",
    "route": r"way points|wrote",
    "sitl": r"ready system 1 .* -> 127\.0\.0\.1:\d+",
    "study": r"time on side|on side, %",
    "terrain": r"\d %",
}
UNTIL_CTRL_C = {"sidelong sitl ": "ready", "replay .*--view": "replay: http"}  # and what is waited for


def commands_of(text: str) -> list[str]:
    """Return the commands of a document in order: lines of its blocks, and those between backticks with arguments."""
    found = re.findall(
        r"^ *```sh\n(.*?)^ *```|`((?:\.venv/bin/)?sidelong [a-z]+ [^`]+)`", text, re.DOTALL | re.MULTILINE
    )
    lines = [line for block, inline in found for line in block.replace("\\\n", " ").splitlines() or [inline]]
    return [command for line in lines if (command := " ".join(re.sub(r" #.*", "", line).split()))]


def reason_not_to_run(command: str) -> str:
    return next((reason for pattern, reason in NOT_RUN.items() if re.search(pattern, command)), "")


@pytest.fixture
def reader(tmp_path, monkeypatch):
    """Enter the folder of a reader who has installed the program, with the files that the documents name."""
    for folder in (".venv/bin", "tracks", "FOLDER", "runs"):
        (tmp_path / folder).mkdir(parents=True)
    for name, text in (("sidelong", SIDELONG), ("pip", PIP)):
        program = tmp_path / ".venv/bin" / name
        program.write_text(text, encoding="utf-8")
        program.chmod(0o755)
    for name in ("track.gpx", "ferry.gpx"):
        shutil.copy(ROOT / "tests/data/target-bike.gpx", tmp_path / name)
    shutil.copy(ROOT / "tests/data/px4-follow-walk-and-drive.tlog", tmp_path / "flight.tlog")
    time_s = np.arange(0.0, 120.0)
    rows = np.column_stack((time_s, 2.0 * time_s, 80.0 * np.sin(time_s / 40.0)))
    np.savetxt(tmp_path / "tracks/winding.csv", rows, "%.2f", ",", header="t_s,east_m,north_m", comments="")
    np.savetxt(
        tmp_path / "tracks/winding.route.csv", rows[::20, 1:], "%.2f", ",", header="east_m,north_m", comments=""
    )
    np.full((1201, 1201), 300, dtype=">i2").tofile(tmp_path / "FOLDER/N47E008.hgt")
    for name, value in {
        "PATH": "/usr/bin:/bin",
        "PYTHONPATH": ROOT,
        "PYTHONUNBUFFERED": 1,
        "BROWSER": "true",
    }.items():
        monkeypatch.setenv(name, str(value))
    monkeypatch.chdir(tmp_path)
    assert shutil.which("sidelong") is None


@pytest.mark.parametrize(
    "document", [ROOT / "docs/how-to/several-aircraft.md"] if SMOKE else DOCUMENTS, ids=lambda path: path.stem
)
@pytest.mark.usefixtures("reader")
def test_the_commands_of_a_document_run_as_printed(document, free_port):
    text = document.read_text(encoding="utf-8")
    for folder in map(Path, re.findall(r"pip install \./(\S+)", text)):  # a package of the reader
        folder.mkdir()
        for name, content in NAMED.findall(text):
            (folder / name).write_text(content, encoding="utf-8")
    with contextlib.ExitStack() as others:
        for command in commands_of(text):
            reason = reason_not_to_run(command)
            print(f"$ {command}{reason and '  # not run: '}{reason}", flush=True)
            if reason:
                continue
            assert command.startswith(".venv/bin/"), f"{command}: not on the reader's path"
            printed = _run(_prepared(command, others, free_port))
            assert re.search(PRINTED.get(command.split()[1], ""), printed, re.DOTALL), f"{command}\n{printed}"
            for written in re.findall(r"--(?:store|report|export|png) (\S+)", command):
                assert Path(written).stat().st_size > 0


def _prepared(command: str, others: contextlib.ExitStack, free_port) -> str:
    """Return a command with what is there in place of what the reader has to name, started or made if need be."""
    if "mission.toml" in command and " init " not in command and not Path("mission.toml").exists():
        _run(".venv/bin/sidelong init mission.toml")
    if re.search(r"\bRUN\b|runs/\d", command) and not any(Path("runs").iterdir()):
        _run(".venv/bin/sidelong launch")
    if "URL" in command:
        port, vehicle = free_port(), ".venv/bin/sidelong sitl --speed 5"
        if Path("mission.toml").exists() and '\nurl = "udp://192.168.' in (
            mission := Path("mission.toml").read_text()
        ):
            device = f"127.0.0.1:{free_port()}"  # the payload that it names is simulated, too
            Path("mission.toml").write_text(re.sub(r"192\.168\.[\d.]+:\d+", device, mission))
            vehicle += f" --set device=siyi@{device}"
        others.enter_context(_started(f"{vehicle} --to 127.0.0.1:{port}", "ready"))
        command = command.replace("URL", f"udpin://127.0.0.1:{port}")
    if "plaintext://192.168.0.9" in command:
        device = PlainTextDevice()
        others.callback(device.socket.close)
        command = command.replace("192.168.0.9", f"127.0.0.1:{device.port}")
    for pattern, real in (
        (r"\bRUN\b|runs/\d{8}T\d{6}Z", str(max(Path("runs").iterdir(), default=""))),
        (r"\bLOG\b", "flight.tlog"),
        (r"\bNAME\b", "parrot-disco"),
        (r"\bS,W,N,E\b", "47.1,8.1,47.9,8.9"),
        (r"\bLAT,LON\b", "47.5,8.5"),
        (r"(--from|--listen) 300", r"\1 5"),  # of a flight that is shorter here
        (r"(?:tak\.example\.org|10\.0\.0\.\d|0\.0\.0\.0):\d+", f"127.0.0.1:{free_port()}"),
    ):
        command = re.sub(pattern, real, command)
    return command


def _run(command: str) -> str:
    """Run a command, to its end or until it serves, and return what it printed."""
    until = next((line for pattern, line in UNTIL_CTRL_C.items() if re.search(pattern, command)), None)
    with _started(command, until) as (process, printed):
        if until is None:
            printed.append(process.stdout.read())
            assert process.wait() == 0, f"{command}\n{''.join(printed)}"
        return "".join(printed)


@contextlib.contextmanager
def _started(command: str, until: str | None) -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    """Start a command and wait for a line with these characters; it gets a Ctrl-C at the end."""
    process = subprocess.Popen(
        ["sh", "-c", command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    printed: list[str] = []
    try:
        while until is not None and until not in "".join(printed[-1:]):
            printed.append(process.stdout.readline())
            assert printed[-1], f"{command} has ended: {''.join(printed)}"
        yield process, printed
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGINT)
        rest, _ = process.communicate(timeout=60.0)
        assert "Traceback" not in "".join([*printed, rest or ""])
