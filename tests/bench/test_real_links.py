"""Real autopilots over good, bad, slow, signed and cut links; the simulated ones are flown so in test_links.py.

SIDELONG_ARDUPLANE=PATH SIDELONG_PX4=PATH python -m pytest tests/bench/test_real_links.py -s -k NAME

``signed`` flies 20 minutes with and without, ``swap`` plans again every few seconds over 50 ms with 5 and 20 % lost,
``restart`` and ``radio`` are over 57,600 baud, 5 %, 150 ms, ``cut`` cuts one of two links CUTS=50 times. All at the
speed of the clock but ``signed`` (SPEED=4): five to twenty minutes each, and may be flown next to each other.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from contextlib import ExitStack

import pytest

from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.records.journal import JournalReader
from sidelong.mission.core.events import ActivatePlan, PlanStatus, UploadPlan, Yield
from sidelong.sitl.settings import LinkFaults
from tests.autopilot.real_vehicle import FLAVOURS, ROOT, RealVehicle, configured
from tests.autopilot.relay import GOOD, Relay
from tests.bench.test_restart import AGAIN_MAX_S, RESTARTS, watching

SPEED, CUTS = int(os.environ.get("SPEED", "4")), int(os.environ.get("CUTS", "50"))
SWAPS_S, RADIO_S = int(os.environ.get("SWAPS_S", "900")), int(os.environ.get("RADIO_S", "600"))
SIGNED_MAX, RADIO_MAX = 0.01, 0.03  # of the time on the side
SWAP_MAX_S = 0.8
RADIO = LinkFaults(0.05, 0.0, 0.075, baud=57_600)
FEW = "[link]\nfew_messages = true\n"

pytestmark = pytest.mark.autopilot


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_signed_as_unsigned(tmp_path, flavour):
    key, flights, sides = tmp_path / "plane.key", {}, {}
    with ExitStack() as open_links:
        for name, demand in {"unsigned": (), "signed": ("--set", f"signing_key_file={key}")}.items():
            if demand:
                print(f"\n{flavour:9} {signed_up(key)}")
            vehicle = open_links.enter_context(RealVehicle(flavour, "--speed", SPEED, *demand))
            first = relay = open_links.enter_context(Relay(vehicle.urls[0]))
            if flavour == "arduplane":  # it takes what is unsigned on its first port, whatever its key
                relay = open_links.enter_context(Relay(vehicle.urls[1]))
            launch = [part for url in (relay.url, *vehicle.payload_urls) for part in ("--connect", url)]
            if demand:
                given, taken, again = (signed_up(key, first.url, *more) for more in ((), ("--remove",), ()))
                print(given, taken, again)
                assert "still takes what is unsigned" in given or flavour == "px4"
                assert "no longer signs" in taken
                launch += ["--set", f"link.signing_key_file={key}"]
            flights[name] = begun(tmp_path / name, flavour, launch, duration_s=1200)
        for name, flight in flights.items():
            assert flight.wait() == 0, name
            summary = json.loads((tmp_path / name / "summary.json").read_text())
            sides[name] = summary["time_on_side"]
            print(f"{name}: {summary}")
            assert summary["time_in_band"] > 0.99
        print(
            f"load {os.getloadavg()[0]:.1f}; --remove after it, in the air: {signed_up(key, first.url, '--remove')}"
        )
    assert sides["signed"] >= sides["unsigned"] - SIGNED_MAX


def signed_up(key, *arguments):
    """Return what ``sidelong sign`` reports."""
    command = [sys.executable, "-m", "sidelong.app", "sign", str(key)]
    command += ["--connect", *arguments, "--set", "link.heartbeat_timeout_s=60"] if arguments else []
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    return done.stdout + done.stderr


def begun(folder, flavour, launch, *, duration_s, more=""):
    """Begin a flight."""
    folder.mkdir()
    command = [
        sys.executable,
        "-m",
        "sidelong.app",
        "launch",
        configured(folder / "mission.toml", flavour, more),
        *launch,
    ]
    command += ["--duration", duration_s, "--out", folder / "runs", "--json", folder / "summary.json"]
    return subprocess.Popen(list(map(str, command)), cwd=ROOT, stdout=subprocess.DEVNULL)


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("loss", [0.05, 0.2])
def test_swap_over_a_lossy_link(tmp_path, flavour, loss):
    config = configured(tmp_path / "mission.toml", flavour, "[planner]\nname = 'paper'\n")
    with RealVehicle(flavour) as vehicle, Relay(vehicle.urls[0], LinkFaults(loss, 0.0, 0.025)) as relay:
        command = [sys.executable, "-m", "tests.bench.wandering", "launch", config, "--connect", relay.url]
        command += ["--duration", SWAPS_S, "--out", tmp_path / "runs"]
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, cwd=ROOT)
    announced = done.stdout + done.stderr
    assert done.returncode == 0, announced
    summary, events = recorded(tmp_path / "runs")
    begun_s, stages = {}, {}
    took_s = []
    for event in events:
        match event:
            case UploadPlan():
                begun_s[event.number] = event.time_s
            case PlanStatus(stage="ready"):
                took_s.append(event.time_s - begun_s[event.number])
    activated = {one.number for one in events if isinstance(one, ActivatePlan)}
    for one in events:
        if isinstance(one, PlanStatus) and one.number in activated:
            stages.setdefault(one.number, []).append(one.stage)
    unflown = [number for number in sorted(activated) if "departed" not in stages.get(number, [])]
    took_s.sort()
    print(
        f"\n{flavour:9} loss {loss:.0%}, load {os.getloadavg()[0]:.1f}: {len(activated)} plans activated, not "
        f"reported as flown {unflown}, {len(took_s)} uploads: median {statistics.median(took_s):.2f} s, the longest "
        f"{[round(one, 2) for one in took_s[-5:]]} s, too late {announced.count('too late')}, "
        f"failed {summary['upload_failures']}"
    )
    assert not [one for one in events if isinstance(one, Yield)]
    assert not [number for number in unflown if number != max(activated)]
    if loss == 0.05:
        assert statistics.median(took_s) <= SWAP_MAX_S


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_restart_over_a_slow_radio(tmp_path, flavour):
    config = configured(tmp_path / "mission.toml", flavour, FEW + "heartbeat_timeout_s = 60\n")
    with RealVehicle(flavour) as vehicle, Relay(vehicle.urls[0], RADIO) as relay:
        launch = [sys.executable, "-u", "-m", "sidelong.app", "launch", config, "--connect", relay.url]
        _, *again = [watching(launch, tmp_path / str(number)) for number in range(RESTARTS + 1)]
    took_s = [seconds for seconds, _ in again]
    print(f"\n{flavour:9} load {os.getloadavg()[0]:.1f}: watching again after {[round(one, 1) for one in took_s]} s")
    assert all(any("taking over the circle that is flown" in line for line in lines) for _, lines in again)
    assert max(took_s) <= AGAIN_MAX_S


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_whole_flight_over_a_slow_radio(tmp_path, flavour):
    flights, sides = {}, {}
    with ExitStack() as open_links:
        for name, faults, more in (("good", GOOD, ""), ("radio", RADIO, FEW)):
            vehicle = open_links.enter_context(RealVehicle(flavour))
            relay = open_links.enter_context(Relay(vehicle.urls[0], faults))
            launch = ["--connect", relay.url]
            flights[name] = begun(tmp_path / name, flavour, launch, duration_s=RADIO_S, more=more)
        for name, flight in flights.items():
            assert flight.wait() == 0, name
            summary = json.loads((tmp_path / name / "summary.json").read_text())
            sides[name] = summary["time_on_side"]
            print(f"\n{flavour:9} {name}: {summary}")
            assert summary["time_in_band"] == 1.0
    assert sides["radio"] >= sides["good"] - RADIO_MAX


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_one_of_two_links_is_cut(tmp_path, flavour):
    config = configured(tmp_path / "mission.toml", flavour)
    out = tmp_path / "runs"
    with (
        RealVehicle(flavour) as vehicle,
        Relay(vehicle.urls[0]) as first,
        Relay(vehicle.urls[1], seed=2) as second,
    ):
        command = [sys.executable, "-u", "-m", "sidelong.app", "launch", config, "--out", out]
        command += ["--connect", first.url, "--connect", second.url]
        flight = subprocess.Popen(list(map(str, command)), cwd=ROOT, stdout=subprocess.PIPE, text=True)
        announced = []
        for line in flight.stdout:
            announced.append(line)
            if "watched from now on" in line:
                break
        for number in range(CUTS):
            relay = (first, second)[number % 2]
            relay.cut = True
            time.sleep(2.0)
            relay.cut = False
            time.sleep(2.0)
        flight.terminate()
        announced.append(flight.communicate()[0])
    text = "".join(announced)
    summary, events = recorded(out)
    activated = {one.number for one in events if isinstance(one, ActivatePlan)}
    departed = {one.number for one in events if isinstance(one, PlanStatus) and one.stage == "departed"}
    print(
        f"\n{flavour:9} load {os.getloadavg()[0]:.1f}: {CUTS} cuts, {text.count('is bad: using')} changes of link, "
        f"{len(activated)} plans activated, {len(activated & departed)} reported as flown, "
        f"{text.count('too late')} too late\n{summary}"
    )
    assert not [one for one in events if isinstance(one, Yield)]
    for trouble in ("yielding", "link lost", "has restarted", "Traceback"):
        assert trouble not in text


def recorded(runs):
    """Return the summary and the journal's events of the one run in a folder."""
    (run,) = runs.iterdir()
    return json.loads((run / "summary.json").read_text()), list(JournalReader(run / "journal.jsonl", JOURNAL_TYPES))
