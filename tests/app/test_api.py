"""The documented program that runs a watch of its own, against the simulated vehicle."""

from __future__ import annotations

import asyncio
import contextlib
import re
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest

import sidelong
from sidelong.app.assembly import prepared
from sidelong.app.config import Config
from sidelong.app.flight.recording import Recording
from sidelong.app.flight.shell import FlyingAircraft, Life, Shell
from sidelong.app.records.run_folder import RunFolder

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.udp
def test_the_example_watches_and_ends(tmp_path):
    program = DOCS / "examples" / "watch_from_a_program.py"
    ran = subprocess.run([sys.executable, program], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    places = re.findall(r"^target at (-?\d+\.\d{6}), (-?\d+\.\d{6}), \d\.\d m/s$", ran.stdout, re.MULTILINE)
    assert len(places) == 5
    assert "outcome: ended: ended by the operator" in ran.stdout
    (run,) = (tmp_path / "runs").iterdir()
    assert {"journal.jsonl", "flight.tlog", "summary.json"} <= {file.name for file in run.iterdir()}


@pytest.mark.udp
def test_a_flight_that_is_stopped_while_the_vehicle_is_checked_takes_nothing_over(tmp_path):
    config, folder = Config(), RunFolder.create(tmp_path, datetime.now(UTC))

    async def stopped():
        with contextlib.closing(Recording(folder, config, print)) as recording:
            life = Life(lambda: recording.begun, print)
            life.stopped.set()
            display = sidelong.Watch(folder.path, lambda _text: None)
            aircraft = FlyingAircraft(config, folder, recording, display, print, lambda: prepared(config))
            return await Shell([aircraft], None, life, print).fly()

    ended = asyncio.run(stopped())
    assert ended.summary.outcome == "interrupted"
    assert "TakeoverRequested" not in folder.journal.read_text()


@pytest.mark.parametrize(
    ("config", "url", "words"),
    [
        ({"requirement": {"side": "up"}}, None, "side"),
        ({"aircraft": {"radius_m": 50.0}}, "udp://:14540", "udp"),
        ({"route": {"file": "none.gpx"}}, None, "route.file: none.gpx"),
    ],
)
def test_a_wrong_configuration_is_refused_in_a_sentence(tmp_path, config, url, words):
    async def fly():
        async with sidelong.watch(config, url=url, out=tmp_path) as watch:
            async for _ in watch.snapshots():
                pass

    with pytest.raises(sidelong.InputError, match=words):
        asyncio.run(fly())


@pytest.mark.parametrize(("given", "words"), [
    ({"config": "none.toml"}, "none.toml: cannot be read"),
    ({"duration_s": float("nan")}, "duration_s: nan s"),
    ({"duration_s": -5.0}, "duration_s: -5 s"),
])  # fmt: skip
def test_a_wrong_argument_is_refused_in_a_sentence(tmp_path, given, words):
    async def fly():
        async with sidelong.watch(**given, out=str(tmp_path)):
            pass

    with pytest.raises(sidelong.InputError, match=words):
        asyncio.run(fly())


def test_requests_before_a_flight_are_refused(tmp_path):
    async def ask():
        watch = sidelong.Watch(tmp_path, print)
        watch.resume()

    with pytest.raises(sidelong.FlightError, match="nothing is flown yet"):
        asyncio.run(ask())
