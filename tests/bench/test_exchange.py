"""Plan changes over bad links: how many are reported as flown, and flights over UDP repeated to the last bit.

python -m pytest tests/bench/test_exchange.py -s; CHANGES=200 and FLIGHTS=20 set how many. More of the rules of
tests/exchange/test_rules.py: EXAMPLES=500 STEPS=20 python -m pytest tests/exchange/test_rules.py.
"""

from __future__ import annotations

import importlib.util
import statistics
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from sidelong.app.flight.shell import free_udp_port
from sidelong.mission.core.events import ActivatePlan, Announce, PlanStatus, UploadPlan, Yield
from sidelong.sitl.settings import LinkFaults
from tests.bench.size import size

CHANGES, FLIGHTS = size(50, 1, "CHANGES"), size(4, 0, "FLIGHTS")
OPEN_S = 5.0  # a plan activated so shortly before the end may not have departed yet
SIDELONG = Path(sys.executable).with_name("sidelong")
HARNESS = Path(__file__).parents[1] / "exchange" / "conftest.py"


@pytest.fixture(scope="module")
def harness():
    """Return the flights of tests/exchange, on one clock that waits for no one."""
    spec = importlib.util.spec_from_file_location("exchange_harness", HARNESS)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
@pytest.mark.parametrize(
    ("loss", "duplicate", "delay_s"),
    [(0.0, 0.0, 0.01), (0.05, 0.05, 0.1), (0.05, 0.0, 1.0), (0.05, 0.0, 0.025), (0.2, 0.0, 0.025)],
)
def test_plan_changes_are_reported_as_they_are_flown(harness, flavour, loss, duplicate, delay_s):
    activated, announced, late, yields, uploads, seed = 0, Counter(), 0, 0, Counter(), 0
    took_s: list[float] = []
    while activated < CHANGES:
        seed += 1
        flight = harness.Flight(flavour, seed=seed, faults=LinkFaults(loss, duplicate, delay_s))
        assert flight.run(300.0, lambda flight=flight: flight.has_control)
        flight.run(size(400, 40))
        flight.spoil(LinkFaults())
        flight.run(15.0)
        end_s = flight.autopilot.now_s - OPEN_S
        numbers = {one.number for one in flight.found(ActivatePlan) if one.time_s < end_s}
        statuses = flight.found(PlanStatus)
        activated += len(numbers)
        announced.update(one.stage for one in statuses if one.number in numbers)
        uploads.update(one.stage for one in statuses if one.number not in numbers or one.stage == "ready")
        yields += len(flight.found(Yield))
        took_s += durations_s(flight)
        uploads["too late"] += sum("too late" in one.text for one in flight.found(Announce))
        failed = {one.number for one in statuses if one.stage == "failed"} & numbers
        late += len(failed & {one.number for one in statuses if one.stage == "departed"})
    print(
        f"\n{flavour:9} loss {loss:4.0%} delay {delay_s:5.3f} s each way: {activated} plans activated, "
        f"{announced['departed']} reported as flown ({announced['unconfirmed']} asked about, {late} late), "
        f"{uploads['ready']} uploads of {uploads['ready'] + uploads['failed']}, {uploads['too late']} too late, "
        f"median {statistics.median(took_s):.2f} s, most {max(took_s):.2f} s, {yields} yields"
    )
    assert announced["departed"] == activated
    assert yields == 0


def durations_s(flight):
    """Return how long each upload took until its plan was ready."""
    begun_s = {one.number: one.time_s for one in flight.found(UploadPlan)}
    return [one.time_s - begun_s[one.number] for one in flight.found(PlanStatus) if one.stage == "ready"]


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
@pytest.mark.parametrize(("loss", "delay_s"), [(0.0, 0.01), (0.1, 0.3)])
def test_one_of_two_links_is_cut(harness, flavour, loss, delay_s):
    counts, seeds, cuts = Counter(), size(5, 1), size(50, 2)
    for seed in range(1, seeds + 1):
        flight = harness.TwoLinkFlight(flavour, seed=seed, faults=LinkFaults(loss, 0.0, delay_s))
        assert flight.run(300.0, lambda flight=flight: flight.has_control)
        for number in range(cuts):
            flight.cut = number % 2
            flight.run(2.0)
            flight.cut = None
            flight.run(2.0)
        flight.spoil(LinkFaults())
        flight.run(15.0)
        statuses = flight.found(PlanStatus)
        numbers = {one.number for one in flight.found(ActivatePlan)}
        counts["changes"] += flight.changes
        counts["activated"] += len(numbers)
        counts["departed"] += sum(one.stage == "departed" for one in statuses)
        counts["ready"] += sum(one.stage == "ready" for one in statuses)
        counts["uploads failed"] += sum(one.stage == "failed" and one.number not in numbers for one in statuses)
        counts["late"] += sum(
            "too late" in one.text or "does not depart" in one.text for one in flight.found(Announce)
        )
        counts["yields"] += len(flight.found(Yield))
    print(f"\n{flavour:9} both {loss:4.0%}, {delay_s:5.3f} s each way, {seeds} x {cuts} cuts: {dict(counts)}")
    assert counts["yields"] == 0
    assert counts["departed"] == counts["activated"]


@pytest.mark.parametrize("seed", range(1, FLIGHTS + 1))
def test_a_flight_over_a_bad_link_is_repeated_to_the_last_bit(tmp_path, seed):
    flavour, guidance = (("arduplane", "mission"), ("px4", "mission"), ("arduplane", "command"))[seed % 3]
    port = free_udp_port()
    options = ["--autopilot", flavour, "--to", f"127.0.0.1:{port}", "--seed", seed, "--speed", 4, "--target-speed", 4]
    faults = ["--set", "link.loss=0.05", "--set", "link.delay_s=0.1", "--set", "link.duplicate=0.05"]
    vehicle = subprocess.Popen(
        [sys.executable, "-m", "sidelong.sitl", *map(str, options + faults)], stdout=subprocess.DEVNULL
    )
    try:
        command = [SIDELONG, "launch", "--connect", f"udpin://127.0.0.1:{port}", "--duration", "200", "--quiet"]
        command += ["--set", f"planner.guidance={guidance}", "--out", tmp_path / "runs"]
        flown = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    finally:
        vehicle.terminate()
        vehicle.wait(10.0)
    assert flown.returncode == 0, flown.stdout + flown.stderr
    (run,) = (tmp_path / "runs").iterdir()
    done = subprocess.run([SIDELONG, "replay", run, "--verify"], capture_output=True, text=True, check=False)
    print(f"\n{flavour} {guidance} seed {seed}: {done.stdout.splitlines()[0] if done.stdout else done.stderr}")
    assert done.returncode == 0, done.stdout + done.stderr
