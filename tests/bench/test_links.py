"""Signed links and slow radios against the plain, good link: python -m pytest tests/bench/test_links.py -s -k NAME

``hostile`` sends HOSTILE=100000 frames of each kind that must not be let in, at a flight by the clock; ``signed`` and
``radio`` fly the same target with and without, for 20 and 10 minutes, SEEDS=3 times. Some minutes each and flavour.
"""

from __future__ import annotations

import itertools
import json
import os
import socket
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.commands.sign import sign
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.flight.shell import free_udp_port
from sidelong.app.link.signing import signing_time
from sidelong.app.records.journal import JournalReader
from sidelong.estimators.sensing.readings import PositionReading
from sidelong.mission.core.events import Yield

HOSTILE, SEEDS = int(os.environ.get("HOSTILE", "100000")), int(os.environ.get("SEEDS", "3"))
SIGNED_MAX, RADIO_MAX = 0.01, 0.03  # of the time on the side
FRAMES_PER_S = 1500
FAR_M = 10_000.0
RADIO = ("--set", "link.baud=57600", "--set", "link.loss=0.05", "--set", "link.delay_s=0.075")  # each way
ROOT = Path(__file__).parents[2]
MANUAL = {"arduplane": (3, 0), "px4": (12, 1 << 16)}  # as a heartbeat reports it: autopilot, custom mode


def flown(folder, flavour, sitl=(), launch=(), on_watching=lambda _port: None):
    """Fly the simulated vehicle over a link of its own; return the summary and the journal's file."""
    port, summary = free_udp_port(), folder / "summary.json"
    vehicle = subprocess.Popen(
        [sys.executable, "-m", "sidelong.sitl", "--autopilot", flavour, "--to", f"127.0.0.1:{port}", *map(str, sitl)],
        stdout=subprocess.DEVNULL,
        cwd=ROOT,
    )
    command = [
        sys.executable,
        "-u",
        "-m",
        "sidelong.app",
        "launch",
        *launch,
        "--connect",
        f"udpin://127.0.0.1:{port}",
    ]
    command += ["--out", folder / "runs", "--json", summary]
    try:
        flight = subprocess.Popen(
            list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT
        )
        lines = []
        for line in flight.stdout:
            lines.append(line)
            if "watched from now on" in line:
                on_watching(port)
        assert flight.wait() == 0, "".join(lines[-20:])
    finally:
        vehicle.terminate()
        vehicle.wait(10.0)
    (run,) = (folder / "runs").iterdir()
    return json.loads(summary.read_text()), run / "journal.jsonl"


def attacker(flavour, secret, link_id, behind_s):
    """Yield frames that would end the flight if they were accepted; secret None: unsigned."""
    mav = mavlink.MAVLink(None, 1, 1)
    mav.signing.secret_key, mav.signing.link_id, mav.signing.sign_outgoing = secret, link_id, secret is not None
    autopilot, mode = MANUAL[flavour]
    messages = (
        mavlink.MAVLink_heartbeat_message(1, autopilot, 81, mode, 4, 3),
        mavlink.MAVLink_global_position_int_message(1, 0, 0, 600_000, 100_000, 0, 0, 0, 0),
        mavlink.MAVLink_mission_current_message(63),
        mavlink.MAVLink_command_ack_message(176, 4),
    )
    for message in itertools.cycle(messages):
        mav.signing.timestamp = signing_time(time.time() - behind_s)
        yield bytes(message.pack(mav))


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_hostile_frames_reach_nothing(tmp_path, flavour):
    key = tmp_path / "plane.key"
    sign(key)
    secret = bytes.fromhex(key.read_text().strip())
    kinds = [
        attacker(flavour, None, 0, 0.0),
        attacker(flavour, bytes(32), 0, 0.0),
        attacker(flavour, secret, 0, 30.0),
        attacker(flavour, secret, 9, 0.0),
    ]

    def attack(port):
        to, begun_s = ("127.0.0.1", port), time.monotonic()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
            for number in range(HOSTILE):
                for kind in kinds:
                    sending.sendto(next(kind), to)
                time.sleep(max(0.0, begun_s + 4 * number / FRAMES_PER_S - time.monotonic()))

    attacks = []

    def begin(port):
        attacks.append(threading.Thread(target=attack, args=(port,)))
        attacks[0].start()

    duration_s = 4 * HOSTILE / FRAMES_PER_S + 30.0
    launch = ("--set", f"link.signing_key_file={key}", "--duration", f"{duration_s:.0f}")
    summary, journal = flown(tmp_path, flavour, ("--set", f"signing_key_file={key}"), launch, begin)
    attacks[0].join()
    events = list(JournalReader(journal, JOURNAL_TYPES))
    places = [event for event in events if isinstance(event, PositionReading)]
    (link,) = summary["links"]
    print(
        f"\n{flavour:9} {HOSTILE} frames of each of 4 kinds, refused {link['refused']}, loop of {len(places)} ticks"
    )
    assert summary["outcome"] == "completed"
    assert summary["time_in_band"] == 1.0
    assert len(link["refused"]) == len(kinds)
    assert max(abs(one.east_m) + abs(one.north_m) for one in places) < FAR_M
    assert not [event for event in events if isinstance(event, Yield)]


def sides(tmp_path, flavour, speed, ways):
    """Return the time on the side and in the band of each way of flying, over the seeds."""
    figures = {}
    for name, (sitl, launch) in ways.items():
        flights = []
        for seed in range(1, SEEDS + 1):
            folder = tmp_path / f"{name}-{seed}"
            folder.mkdir()
            flights.append(flown(folder, flavour, ("--seed", seed, "--speed", speed, *sitl), launch)[0])
        figures[name] = [(one["time_on_side"], one["time_in_band"]) for one in flights]
        print(f"\n{flavour:9} {name}: on side {[f'{side:.3f}' for side, _ in figures[name]]}", end="")
    print()
    return {name: [statistics.mean(column) for column in zip(*rows, strict=True)] for name, rows in figures.items()}


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_a_signed_flight_watches_as_an_unsigned_one(tmp_path, flavour):
    key = tmp_path / "plane.key"
    sign(key)
    launch = ("--duration", 1200)
    ways = {
        "unsigned": ((), launch),
        "signed": (("--set", f"signing_key_file={key}"), (*launch, "--set", f"link.signing_key_file={key}")),
    }
    mean = sides(tmp_path, flavour, 4, ways)
    assert mean["signed"][0] >= mean["unsigned"][0] - SIGNED_MAX


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_a_whole_flight_over_a_slow_radio(tmp_path, flavour):
    config = tmp_path / "radio.toml"
    config.write_text("[link]\nfew_messages = true\n")
    launch = ("--duration", 600)
    mean = sides(tmp_path, flavour, 1, {"good": ((), launch), "radio": (RADIO, (config, *launch))})
    assert mean["radio"][1] == 1.0
    assert mean["radio"][0] >= mean["good"][0] - RADIO_MAX
