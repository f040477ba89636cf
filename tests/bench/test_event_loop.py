"""How long one callback blocks the event loop in flight, the first start on a machine included.

python -m pytest -s tests/bench/test_event_loop.py. Each flight begins with an empty compilation cache: about two
minutes of processor time. SIDELONG_SMOKE=1 flies with the machine's cache.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sidelong.estimators.frames import LocalPlane
from sidelong.sitl.settings import DEFAULT_HOMES, STARTS_M, Flavour
from tests.bench.size import SMOKE, size
from tests.terrain.conftest import HOME_DEG, write_hills

ROOT = Path(__file__).resolve().parents[2]
TRACK = ROOT / "app" / "study" / "tracks" / "hike_014.csv"
LONGEST_MS = 50.0
DURATION_S = size(300, 60, "DURATION_S")
FLIGHT = """
import asyncio, gc, json, sys, time
from sidelong.app.cli import run
from sidelong.app.flight.loop import ControlLoop
from sidelong.estimators.compiled import KERNELS

flying, taken, collections, flights, before, count = 0, {}, [0.0], 0, {}, 0
fly, call = ControlLoop.run, asyncio.Handle._run

async def counted(loop):
    global flying, flights
    if not flights:
        before.update((kernel, set(kernel.signatures)) for kernel in KERNELS)
    flying, flights = flying + 1, flights + 1
    try:
        await fly(loop)
    finally:
        flying -= 1

def collected(phase, info):
    global begun_s
    if phase == "start":
        begun_s = time.thread_time()
    elif flying:
        collections.append(time.thread_time() - begun_s)

def timed(handle):
    global count
    begun_s = time.thread_time()
    call(handle)
    taken_s = time.thread_time() - begun_s
    if flying:
        count += 1
        if len(taken) < 3 or taken_s > min(taken):  # all handles would be objects to search for garbage
            taken[taken_s] = name(handle)
            if len(taken) > 3:
                del taken[min(taken)]

def name(handle):
    task = getattr(handle._callback, "__self__", None)
    return task.get_coro().__qualname__ if isinstance(task, asyncio.Task) else str(handle)[:80]

ControlLoop.run, asyncio.Handle._run = counted, timed
gc.callbacks.append(collected)
code = run(sys.argv[1:])
late = [kernel.py_func.__name__ for kernel in KERNELS if set(kernel.signatures) - before.get(kernel, set())]
longest = sorted(taken.items(), reverse=True)
shown = [f"{1e3 * taken_s:.1f} ms in {where}" for taken_s, where in longest]
shown.append(f"longest collection of garbage {1e3 * max(collections):.1f} ms")
print(json.dumps([code, 1e3 * longest[0][0], count, late, shown]))
"""


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("flown", ["arduplane", "px4", "hills", "fleet", "route"])
def test_no_callback_blocks_the_loop_in_flight(flown, tmp_path):
    arguments = {
        "arduplane": ["--autopilot", "arduplane"],
        "px4": ["--autopilot", "px4"],
        "hills": ["--terrain", str(tmp_path), "--set", f"simulation.home={list(HOME_DEG)}"],
        "fleet": ["--fleet", "2", "--autopilot", "arduplane,px4"],
        "route": ["--target", str(TRACK), "--route", str(tmp_path / "route.csv")],
    }[flown]
    write_hills(tmp_path)
    way_m = np.loadtxt(TRACK, delimiter=",", skiprows=1, usecols=(1, 2)) + STARTS_M[0]
    home = DEFAULT_HOMES[Flavour.ARDUPLANE]
    plane = LocalPlane(home.latitude_deg, home.longitude_deg)
    way_deg = [plane.latitude_longitude_deg(*point) for point in way_m.tolist()]
    np.savetxt(tmp_path / "route.csv", way_deg, "%.8f", delimiter=",", header="lat,lon", comments="")
    cache = {} if SMOKE else {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = ["launch", *arguments, "--duration", str(DURATION_S), "--no-view", "--quiet", "--out", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-c", FLIGHT, *command],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | cache,
        capture_output=True,
        text=True,
        check=True,
    )
    code, longest_ms, count, late, shown = json.loads(done.stdout.splitlines()[-1])
    print(f"\n{flown}: {longest_ms:.1f} ms of processor time, the longest of {count} callbacks in flight; {shown}")
    assert code == 0, done.stdout
    assert late == []
    assert longest_ms <= LONGEST_MS
