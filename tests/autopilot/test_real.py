"""Real autopilots, where their SITL programs are given; the simulated flavours fly the same.

SIDELONG_ARDUPLANE=/path/to/arduplane SIDELONG_PX4=/path/to/px4 python -m pytest tests/autopilot
"""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.timeout(900)  # they fly in little more than real time

SIDELONG = Path(sys.executable).with_name("sidelong")
SPEED, DURATION_S = 3, 300
AIRCRAFT = {"arduplane": (22, 80, 60), "px4": (15, 60, 45)}  # of the stock simulators: m/s, m, degrees


def program(flavour):
    name = f"SIDELONG_{flavour.upper()}"
    path = os.environ.get(name)
    if not path:
        pytest.skip(f"{name} does not name a SITL program")
    return path


@pytest.fixture(params=["arduplane", "px4"])
def flavour(request):
    return request.param


@pytest.fixture
def url(flavour, tmp_path):
    """Yield where the user's own program is met, with payload and target."""
    options = ["--autopilot", flavour, "--binary", program(flavour), "--speed", SPEED, "--target-speed", 4]
    sitl = subprocess.Popen(
        [SIDELONG, "sitl", *map(str, options), "--truth", tmp_path / "truth.csv"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        yield sitl.stdout.readline().split()[-1]
        sitl.send_signal(signal.SIGTERM)
        assert sitl.wait(20.0) == 0
    finally:
        sitl.kill()


@pytest.fixture
def config(flavour, tmp_path):
    airspeed_m_s, radius_m, bank_max_deg = AIRCRAFT[flavour]
    path = tmp_path / "mission.toml"
    path.write_text(
        f"[aircraft]\nairspeed_m_s = {airspeed_m_s}\nradius_m = {radius_m}\nbank_max_deg = {bank_max_deg}\n"
        "[requirement]\ntarget_speed_max_m_s = 4\n"
    )
    return path


@pytest.mark.autopilot
@pytest.mark.parametrize("guidance", ["mission", "command"])
def test_a_flight(flavour, url, config, guidance, tmp_path):
    options = ["--connect", url, "--guidance", guidance, "--duration", DURATION_S, "--quiet"]
    command = [SIDELONG, "launch", config, *map(str, options), "--out", tmp_path / "runs"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=400, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (run,) = (tmp_path / "runs").iterdir()
    summary = json.loads((run / "summary.json").read_text())
    assert summary["outcome"] == "completed"
    assert summary["time_in_band"] > 0.95
    assert summary["min_range_m"] > 90.0
    assert summary["upload_failures"] == 0


@pytest.mark.autopilot
def test_a_killed_application_is_started_again_and_takes_the_circle_over(flavour, url, config, tmp_path):
    command = [SIDELONG, "launch", config, "--connect", url, "--out", tmp_path / "runs"]
    first = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        for line in first.stdout:
            if "watched from now on" in line:
                break
    finally:
        first.kill()
        first.wait(10.0)
    done = subprocess.run([*command, "--duration", "20"], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "taking over the circle that is flown" in done.stdout
