"""Twenty minutes of an ArduPlane and a PX4 on one target, judged by the truth of both.

``python -m pytest tests/bench/test_fleet.py -s``; SPEED=4 (times the clock) and SEED=1 may be set. With
SIDELONG_ARDUPLANE=PATH and SIDELONG_PX4=PATH your own SITL programs fly the first test, at the clock's speed by
default: they do not wait for each other, so the machine has to keep up.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from sidelong.app.analysis.score import judge_moments
from sidelong.app.analysis.truth import Truth, read_truth
from sidelong.app.config import load_config
from sidelong.app.flight.shell import free_udp_port
from sidelong.estimators.frames import LocalPlane
from tests.autopilot.real_vehicle import AIRCRAFT

PROGRAMS = [os.environ.get(f"SIDELONG_{flavour.upper()}", "") for flavour in AIRCRAFT]
SPEED, SEED = float(os.environ.get("SPEED", "1" if all(PROGRAMS) else "4")), int(os.environ.get("SEED", "1"))
DURATION_S = float(os.environ.get("DURATION", "1200"))
REQUIREMENT = load_config(None).requirement.requirement()
_LEAST_M, _STEP_S = 50.0, 0.1
_SAME_TARGET_M = 10.0  # the two of a fair flight see the target no farther apart
_CLOCKS_EVERY_S, _DISTINCT_BY_M = 30.0, 15.0  # two clocks are compared where the target goes that far in the meantime

FLEET = """
[[aircraft]]
name = "plane"
url = "{}"
{}
[[aircraft]]
name = "wing"
url = "{}"
{}
"""


class World:
    """The simulation with both vehicles, and a fleet file that leads to them. lose: as ``sidelong sitl`` takes it."""

    def __init__(self, folder: Path, *lose: str) -> None:
        self.folder, self.truths = folder, [folder / "plane.csv", folder / "wing.csv"]
        self.fleet_file = folder / "fleet.toml"
        self.own = own = all(PROGRAMS) and not lose
        ports = [free_udp_port(), free_udp_port()]
        options = [f'--set={number}.stations=["127.0.0.1:{port}"]' for number, port in enumerate(ports, 1)]
        options += ["--set={}.lost_s={}".format(*one.split("@")) for one in lose]
        if own:
            options = [f"--binary={program}" for program in PROGRAMS]
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-m", "sidelong.sitl", "--autopilot", ",".join(AIRCRAFT), "--speed", f"{SPEED:g}"),
                *("--seed", str(SEED), "--while-input", *options),
                *(f"--truth={truth}" for truth in self.truths),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        output = self._process.stdout
        assert output is not None
        if own:
            urls = list(
                itertools.islice((found[1] for line in output if (found := re.match('url = "(.*)"', line))), 2)
            )
            stock = ["airspeed_m_s = {}\nradius_m = {}\nbank_max_deg = {}".format(*AIRCRAFT[one]) for one in AIRCRAFT]
        else:
            assert output.readline().startswith("ready")
            urls, stock = [f"udpin://127.0.0.1:{port}" for port in ports], ["", ""]
        printed = [word for pair in zip(urls, stock, strict=True) for word in pair]
        self.fleet_file.write_text(FLEET.format(*printed), encoding="utf-8")

    def end(self) -> None:
        self._process.terminate()
        self._process.wait(20.0)

    @property
    def time_s(self) -> float:
        """The latest time of the truth."""
        with self.truths[0].open("rb") as file:
            file.seek(-2000, os.SEEK_END)
            return float(file.read().split(b"\n")[-2].split(b",")[0])

    def wait_until(self, time_s: float) -> None:
        while self.time_s < time_s:
            time.sleep(0.2)


class Launched:
    """One run of the program."""

    def __init__(self, world: World, duration_s: float) -> None:
        self.log = world.folder / f"launch-{time.monotonic_ns()}.log"
        self.begin_s = world.time_s if world.truths[0].stat().st_size > 4000 else 0.0
        command = [Path(sys.executable).parent / "sidelong", "launch", world.fleet_file]
        command += ["--duration", f"{duration_s:g}", "--out", world.folder / "runs"]
        self.process = subprocess.Popen(
            [*map(str, command), "--json", str(world.folder / "summary.json")],
            stdout=self.log.open("w"),
            stderr=subprocess.STDOUT,
        )

    def wait_for(self, pattern: str, count: int, wall_s: float = 600.0) -> None:
        deadline_s = time.monotonic() + wall_s
        while len(re.findall(pattern, self.log.read_text())) < count:
            assert self.process.poll() is None, self.log.read_text()
            assert time.monotonic() < deadline_s, self.log.read_text()
            time.sleep(0.1)


@pytest.fixture
def world(tmp_path, request):
    with contextlib.ExitStack() as stack:

        def make(*lose: str) -> World:
            made = World(tmp_path, *lose)
            stack.callback(made.end)
            return made

        yield make


def on_clock_of(one: Truth, other: Truth, times_s: np.ndarray) -> np.ndarray:
    """Return what times the other's clock reported at times of the one's: when each had the target at the same place.

    Programs of one's own count from their own starts, and fall behind the clock by a little all the time. Fails where
    they have the target at two places whatever their clocks.
    """
    plane = LocalPlane(*one.positions_deg[:2, 0])

    def target_m(truth: Truth, at_s: np.ndarray) -> np.ndarray:
        deg = np.column_stack([np.interp(at_s, truth.time_s, column) for column in truth.positions_deg[:2]])
        return np.array([plane.east_north_m(*place) for place in deg])

    known: list[tuple[float, float]] = []
    for begin_s in np.arange(times_s[0], min(times_s[-1], one.time_s[-1]) - _CLOCKS_EVERY_S, _CLOCKS_EVERY_S):
        at_s = np.arange(begin_s, begin_s + _CLOCKS_EVERY_S, 1.0)
        seen_m = target_m(one, at_s)
        if np.ptp(seen_m, axis=0).max() < _DISTINCT_BY_M:
            continue  # it stands, at whatever time
        apart_m = {s: float(np.abs(target_m(other, at_s + s) - seen_m).max()) for s in np.arange(-60.0, 60.0, 0.25)}
        ahead_s = min(apart_m, key=apart_m.__getitem__)
        assert apart_m[ahead_s] <= _SAME_TARGET_M, "one program fell behind the other: each has the target elsewhere"
        known.append((float(at_s.mean()), float(ahead_s)))
    assert known, "the target has not moved"
    return times_s + np.interp(times_s, *np.transpose(known))


def judged(world: World, begin_s: float, end_s: float) -> tuple[float, float, float]:
    """Return the share of time on the required side by at least one, the longest time without, and the separation.

    Times are those of the first one's clock.
    """
    truths = [read_truth(path) for path in world.truths]
    plane, on_side, places = LocalPlane(*truths[0].positions_deg[2:, 0]), [], []
    times_s = np.arange(begin_s, min(end_s, truths[0].time_s[-1]), _STEP_S)
    for path, truth in zip(world.truths, truths, strict=True):
        own_s = on_clock_of(truths[0], truth, times_s) if world.own and truth is not truths[0] else times_s
        found = judge_moments(truth.at_each(own_s, plane), [(-math.inf, REQUIREMENT)])
        flags = np.zeros(len(own_s), bool)  # nothing is known of one which is lost
        flags[np.searchsorted(own_s, found.time_s)] = found.on_side
        on_side.append(flags)
        rows = np.genfromtxt(path, delimiter=",", names=True, usecols=("time_boot_s", "uav_relative_alt_m"))
        flat = np.array([plane.east_north_m(*deg) for deg in truth.positions_deg[2:].T])
        place = [np.interp(own_s, truth.time_s, column) for column in flat.T]
        place.append(np.interp(own_s, rows["time_boot_s"], rows["uav_relative_alt_m"]))
        known = own_s <= truth.time_s[-1]
        places.append(np.where(known[:, None], np.column_stack(place), np.nan))
    any_side = np.logical_or(*on_side)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], ~any_side, [0])).astype(int)))
    longest_s = float((edges[1::2] - edges[::2]).max() * _STEP_S) if edges.size else 0.0
    return float(any_side.mean()), longest_s, float(np.nanmin(np.linalg.norm(places[0] - places[1], axis=1)))


def printed(world: World, name: str, begin_s: float, end_s: float) -> tuple[float, float]:
    share, longest_s, separation_m = judged(world, begin_s, end_s)
    print(
        f"\n{name}, {end_s - begin_s:.0f} s at {SPEED:g} x, seed {SEED}: required side by at least one "
        f"{100.0 * share:.2f} %, longest without {longest_s:.1f} s, separation {separation_m:.0f} m"
    )
    return share, separation_m


@pytest.mark.timeout(3600)
def test_the_program_is_killed_half_way_and_takes_both_over_again(world):
    flown = world()
    first = Launched(flown, 2.0 * DURATION_S)
    first.wait_for("circling: the target is watched", 2)
    both_s = flown.time_s
    begin_s = both_s + 60.0  # each has got to its side
    flown.wait_until(begin_s + 0.5 * DURATION_S)
    first.process.kill()
    first.process.wait()
    killed_s = flown.time_s
    second = Launched(flown, 0.5 * DURATION_S)
    second.wait_for("circling: the target is watched", 2)
    print(f"\nboth taken over again {flown.time_s - killed_s:.1f} s of the vehicles' time after the kill")
    assert second.process.wait() == 0, second.log.read_text()
    printed(flown, "from when both watched", both_s, begin_s + DURATION_S)
    share, separation_m = printed(flown, "killed half-way", begin_s, begin_s + DURATION_S)
    assert separation_m >= _LEAST_M
    assert share >= 0.9, "the goal is 0.99"
    summary = json.loads((flown.folder / "summary.json").read_text())
    assert [one["name"] for one in summary["aircraft"]] == ["plane", "wing"]
    for run in sorted((flown.folder / "runs").iterdir()):
        verify = [str(Path(sys.executable).parent / "sidelong"), "replay", str(run), "--verify", "--quiet"]
        done = subprocess.run(verify, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


@pytest.mark.timeout(3600)
def test_one_aircraft_is_lost_half_way_and_the_other_closes_the_gap(world):
    lost_s = 250.0 + 0.5 * DURATION_S
    flown = world(f"2@{lost_s:g}")
    only = Launched(flown, DURATION_S)
    only.wait_for("circling: the target is watched", 2)
    begin_s = flown.time_s + 60.0
    only.wait_for("wing: is out", 1, wall_s=2.0 * lost_s / SPEED)
    print(f"\ntold as out {flown.time_s - lost_s:.1f} s of the vehicles' time after it was lost")
    flown.wait_until(lost_s + 60.0)
    assert only.process.wait() == 0, only.log.read_text()
    _, separation_m = printed(flown, "before one was lost", begin_s, lost_s)
    printed(flown, "after it", lost_s, flown.time_s - 5.0)
    share, longest_s, _ = judged(flown, lost_s + 60.0, flown.time_s - 5.0)
    print(f"from 60 s after it: {100.0 * share:.2f} % by the remaining one, longest without {longest_s:.1f} s")
    assert separation_m >= _LEAST_M
