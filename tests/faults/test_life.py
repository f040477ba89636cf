"""Whatever ends a flight, or takes its output away: one sentence, the right exit code, whole records."""

from __future__ import annotations

import asyncio
import json
import os
import re
import resource
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from sidelong.app.flight.shell import Life
from tests.command_line import PROGRAM, runs_for
from tests.faults.interrupts import Interruption, left_of

pytestmark = pytest.mark.udp
SHORT = ("launch", "--planner", "paper", "--set", "simulation.speed=30", "--duration", "10", "--target", "straight")


@pytest.mark.parametrize(
    ("interruption", "announced"),
    [
        (Interruption(signal.SIGHUP, 0.0), "130 sidelong: interrupted."),
        (Interruption(signal.SIGINT, 0.0, "checking"), "nothing was commanded; no records are kept."),
        (Interruption(signal.SIGTERM, 0.1, "taking off", 5.0), "by SIGTERM: the aircraft flies to its first circle"),
        (Interruption(signal.SIGHUP, 0.5, "watched from now on"), "by SIGHUP: the aircraft goes on circling"),
    ],
    ids=["loading", "checking", "climbing", "watching"],
)
def test_a_signal_ends_it_in_order(tmp_path, interruption, announced):
    sentence, wrong = left_of(interruption, tmp_path)
    assert not wrong
    assert announced in sentence


def test_a_signal_breaks_off_what_is_computed_before_a_flight(tmp_path):
    command = [*PROGRAM, *SHORT, "--planner", "predictive", "--out", str(tmp_path / "runs")]
    # Without a cache the value table is computed again, and what computes it is compiled.
    nowhere = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | nowhere
    )
    assert process.stdout is not None
    try:
        assert any("compiling" in line for line in process.stdout)
        process.send_signal(signal.SIGTERM)
        rest, complaint = process.communicate(timeout=60.0)
    finally:
        process.kill()
    assert process.returncode == 130
    assert complaint == "sidelong: interrupted: nothing was commanded; no records are kept.\n"
    assert "starting" not in rest
    assert not list((tmp_path / "runs").iterdir())


def test_the_error_of_a_library_that_was_broken_off_is_not_reported():
    async def flown() -> None:
        life = Life(lambda: False, print)
        with life.handling_signals(), life.computing():
            try:
                signal.raise_signal(signal.SIGTERM)
            except KeyboardInterrupt:
                raise RuntimeError("left half-way") from None

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        with pytest.raises(KeyboardInterrupt):
            asyncio.run(flown())
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@pytest.mark.parametrize("begun", [True, False])
def test_a_signal_that_comes_after_a_flight_does_not_take_its_summary_away(begun):
    async def flown() -> str:
        with Life(lambda: begun, print).handling_signals():
            pass
        signal.raise_signal(signal.SIGINT)
        return "summary"

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        if begun:
            assert asyncio.run(flown()) == "summary"
        else:
            with pytest.raises(KeyboardInterrupt):
                asyncio.run(flown())
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_the_end_of_the_simulated_vehicle_ends_it(tmp_path):
    process = subprocess.Popen(
        [*PROGRAM, *SHORT, "--duration", "900", "--out", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        announced = [next(line for line in process.stdout if "watched from now on" in line)]
        (simulator,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        os.kill(int(simulator), signal.SIGKILL)
        rest, complaint = process.communicate(timeout=60.0)
    finally:
        process.kill()
    assert process.returncode == 1
    assert complaint == (
        "sidelong: the simulated vehicle has ended: it stopped with code -9; nothing flies any more.\n"
    )
    assert "outcome" in "".join(announced) + rest
    (run,) = tmp_path.iterdir()
    assert json.loads((run / "summary.json").read_text())["outcome"].startswith("failed: the simulated vehicle")


def flown(out: Path, stdout: int, **options: object) -> subprocess.CompletedProcess[str]:
    command = [*PROGRAM, *SHORT, "--out", str(out)]
    return subprocess.run(
        command, stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=100.0, check=False, **options
    )


def test_neither_a_full_terminal_nor_a_folder_that_vanishes_reaches_the_flight(tmp_path):
    out = tmp_path / "e6[" / "x]"  # what the terminal's library would take for markup
    command = [*PROGRAM, *SHORT, "--out", str(out)]
    with Path("/dev/full").open("w") as full:
        process = subprocess.Popen(command, stdout=full, stderr=subprocess.PIPE, text=True)
    try:
        while not list(out.glob("*/journal.jsonl")):
            assert runs_for(process, 0.05)
        (run,) = out.iterdir()
        shutil.rmtree(run)
        _, complaint = process.communicate(timeout=100.0)
    finally:
        process.kill()
    assert process.returncode == 1, complaint
    assert complaint.splitlines() == [
        f"sidelong: {run}/summary.json cannot be written (No such file or directory); the figures above are all "
        "there is.",
        f"sidelong: the terminal could not be written (No space left on device); see {run}.",
        f"sidelong: the flight has ended, but its records are incomplete: {run} was removed.",
    ]


def test_a_reader_that_goes_away_does_not_reach_the_flight(tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    done = flown(tmp_path, writing)
    os.close(writing)
    assert done.returncode == 0
    (run,) = tmp_path.iterdir()
    assert done.stderr == f"sidelong: the terminal could not be written (Broken pipe); see {run}.\n"
    assert json.loads((run / "summary.json").read_text())["outcome"] == "completed"


def test_records_that_find_no_room_do_not_reach_the_flight(tmp_path):
    def no_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    done = flown(tmp_path, subprocess.PIPE, preexec_fn=no_room)
    assert done.returncode == 1, done.stderr
    assert "recording has ended" in done.stdout
    assert "the flight goes on" in done.stdout
    assert "completed" in done.stdout
    assert re.search(r"records +incomplete: ", done.stdout)
    assert re.search(r"watched +[1-9]", done.stdout)
    assert "its records are incomplete" in done.stderr
    assert "Traceback" not in done.stderr + done.stdout


def test_a_disk_without_room_for_any_record_is_refused_before_anything_is_armed(tmp_path):
    def no_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10))

    done = flown(tmp_path, subprocess.PIPE, preexec_fn=no_room)
    assert done.returncode == 2
    assert done.stderr.startswith(f"sidelong: {tmp_path}")
    assert "takes no records (File too large)" in done.stderr
    assert "arming" not in done.stdout
    assert not list(tmp_path.iterdir())
