"""A plain MAVSDK script flies the simulated vehicle in a process of its own, as it would any vehicle."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("mavsdk_flight.py")
SPEED = 20

pytestmark = pytest.mark.udp


@pytest.fixture(params=["arduplane", "px4"])
def vehicle(request, tmp_path, free_port):
    """Yield the flavour, a MAVSDK URL, the process and the file of its truth."""
    port, truth = free_port(), tmp_path / "truth.csv"
    arguments = ["--autopilot", request.param, "--to", f"127.0.0.1:{port}", "--speed", str(SPEED), "--truth", truth]
    process = subprocess.Popen(
        [sys.executable, "-m", "sidelong.sitl", *map(str, arguments)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline().strip() == f"ready system 1 component 1 {request.param} -> 127.0.0.1:{port}"
        yield request.param, f"udpin://127.0.0.1:{port}", process, truth
    finally:
        process.kill()
        process.wait(10)


def test_mavsdk_uploads_arms_starts_follows_and_sets_the_current_item(vehicle):
    flavour, url, process, truth = vehicle
    flight = subprocess.run(
        [sys.executable, SCRIPT, flavour, url], capture_output=True, text=True, timeout=90, check=True
    )
    saw = json.loads(flight.stdout.splitlines()[-1])
    first = 1 if flavour == "arduplane" else 0
    assert saw["commands"] == [16, 22, 16, 16, 17][1 - first :]
    assert saw["seen"] == [first, first + 1, first + 2, first + 3, first + 1]
    assert saw["height_m"] == pytest.approx(80.0, abs=15.0)
    process.send_signal(signal.SIGTERM)
    assert process.wait(10) == 0
    assert len(truth.read_text().splitlines()) > 500
