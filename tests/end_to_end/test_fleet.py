"""A fleet as a person flies it: one ArduPlane and one PX4, simulated, over UDP on loopback."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.udp
SIDELONG = Path(sys.executable).parent / "sidelong"
FLEET = """
[simulation]
speed = 15.0
target = "straight"
[[aircraft]]
name = "plane"
[[aircraft]]
name = "wing"
autopilot = "px4"
"""


def sidelong(*arguments: object, timeout_s: float = 280.0) -> subprocess.CompletedProcess[str]:
    command = [str(SIDELONG), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Return the run folder and the summary of a short flight."""
    folder = tmp_path_factory.mktemp("fleet")
    (folder / "fleet.toml").write_text(FLEET, encoding="utf-8")
    done = sidelong(
        *("launch", folder / "fleet.toml", "--duration", 60, "--out", folder / "runs"),
        *("--json", folder / "summary.json"),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (run,) = (folder / "runs").iterdir()
    return run, json.loads((folder / "summary.json").read_text())


def test_both_watch_and_stay_apart(flown):
    _, summary = flown
    assert summary["outcome"] == "completed"
    assert summary["source"] == "truth"
    assert [one["name"] for one in summary["aircraft"]] == ["plane", "wing"]
    assert all(one["sightings"] > 300 and one["time_in_band"] > 0.9 for one in summary["aircraft"])
    assert summary["min_separation_m"] >= 50.0
    assert summary["time_in_band_any"] > 0.9
    each = [one["time_on_side"] for one in summary["aircraft"]]
    assert 0.0 <= summary["time_on_side_any"] <= 1.0
    assert summary["duration_s"] <= max(one["duration_s"] for one in summary["aircraft"]) + 1.0, each


def test_the_run_replays_to_the_last_bit(flown):
    run, _ = flown
    assert json.loads((run / "plane" / "summary.json").read_text())["outcome"] == "completed"
    done = sidelong("replay", run, "--verify", "--quiet")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("same to the last bit") == 3


def test_another_command_asks_for_the_folder_of_one(flown, tmp_path):
    run, _ = flown
    done = sidelong("export", run, "--format", "gpx", "--out", tmp_path / "flight.gpx")
    assert done.returncode == 2
    assert "folder of one aircraft" in done.stderr
    done = sidelong("export", run / "wing", "--format", "gpx", "--out", tmp_path / "flight.gpx")
    assert done.returncode == 0, done.stderr


def test_an_interrupt_winds_all_up(tmp_path):
    log = tmp_path / "log"
    process = subprocess.Popen(
        [str(SIDELONG), "launch", "--fleet", "2", "--speed", "15", "--out", str(tmp_path / "runs")],
        stdout=log.open("w"),
        stderr=subprocess.STDOUT,
    )
    deadline_s = time.monotonic() + 120.0
    while "taking off" not in log.read_text():
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < deadline_s, log.read_text()
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.wait(90.0) == 130, log.read_text()
    last = log.read_text().splitlines()[-1]
    assert last.startswith("sidelong: interrupted by SIGINT: aircraft-1: ")
    assert "aircraft-2: " in last
    (run,) = (tmp_path / "runs").iterdir()
    assert json.loads((run / "summary.json").read_text())["outcome"] == "interrupted"
