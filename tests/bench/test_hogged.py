"""Plan changes while other processes hog the processor: how many are reported as flown.

python -m pytest tests/bench/test_hogged.py -s; CHANGES=200 of each autopilot take about ten minutes, at SPEED=4 times
the clock, next to HOGS=2 processes that do nothing but count. The simulation does not wait for the program here.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.flight.shell import free_udp_port
from sidelong.app.records.journal import JournalReader
from sidelong.mission.core.events import ActivatePlan, PlanStatus, Yield

CHANGES, SPEED, HOGS = (
    int(os.environ.get(name, most)) for name, most in (("CHANGES", 200), ("SPEED", 4), ("HOGS", 2))
)
ROOT = Path(__file__).parents[2]
FLIGHT_S = int(os.environ.get("FLIGHT_S", "900"))


@pytest.fixture
def hogged():
    """Keep the processor busy in the meantime."""
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(HOGS)]
    yield
    for hog in hogs:
        hog.kill()
        hog.wait()


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_plan_changes_at_a_hogged_processor_are_reported_as_they_are_flown(hogged, tmp_path, flavour):
    announced, activated, open_at_the_end, reasons, flights = Counter(), 0, 0, [], 0
    while activated < CHANGES:
        flights += 1
        events = list(flown(flavour, flights, tmp_path / str(flights)))
        numbers = [one.number for one in events if isinstance(one, ActivatePlan)]
        departed = {one.number for one in events if isinstance(one, PlanStatus) and one.stage == "departed"}
        announced.update(one.stage for one in events if isinstance(one, PlanStatus) and one.number in numbers)
        open_at_the_end += bool(numbers) and numbers[-1] not in departed  # the flight's time was over
        activated += len(numbers)
        reasons += [one.reason for one in events if isinstance(one, Yield)]
    print(
        f"\n{flavour:9} {HOGS} hogs, load {os.getloadavg()[0]:.1f}, {SPEED} x: {flights} flights, {activated} plans "
        f"activated, {announced['departed']} announced as flown ({announced['unconfirmed']} asked about, "
        f"{announced['failed']} at first refused, {open_at_the_end} open at the end), yields: {reasons}"
    )
    assert not reasons
    assert announced["departed"] + open_at_the_end >= activated


def flown(flavour, seed, out):
    port = free_udp_port()
    options = ["--autopilot", flavour, "--to", f"127.0.0.1:{port}", "--seed", seed, "--speed", SPEED]
    vehicle = subprocess.Popen(
        [sys.executable, "-m", "sidelong.sitl", *map(str, options)], stdout=subprocess.DEVNULL, cwd=ROOT
    )
    try:
        launch = ["launch", "--connect", f"udpin://127.0.0.1:{port}", "--planner", "paper", "--quiet"]
        command = [sys.executable, "-m", "tests.bench.wandering", *launch, "--duration", str(FLIGHT_S), "--out", out]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=1800, check=False)
    finally:
        vehicle.terminate()
        vehicle.wait(10.0)
    assert done.returncode == 0, done.stdout + done.stderr
    (run,) = out.iterdir()
    return JournalReader(run / "journal.jsonl", JOURNAL_TYPES)
