"""The page against the clock: how soon it is up, how often it is told, and what it costs the control loop.

Flown on the simulated vehicle in real processes, with the page open in Chromium. Figures go to standard output
(pytest -s).
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
import time
from datetime import UTC, datetime
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
from rich.console import Console

from app.assembly import watch_of
from app.config import Config
from app.flight import Flight, connected
from app.recording import Recording
from app.records.run_folder import RunFolder
from app.simulated import SimulatedVehicle
from app.view.address import Address
from app.view.display import ViewDisplay
from app.view.panel import PanelDisplay

CONFIG = Config.model_validate({"planner": {"name": "paper"}, "simulation": {"speed": 5.0}})
FLOWN_S = 100.0  # of the vehicle's time
PROBE_S = 0.005
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--remote-debugging-port=0"),
)


def shown() -> ViewDisplay:
    requirement = CONFIG.requirement.requirement()
    return ViewDisplay(PanelDisplay(Console(), requirement, quiet=True), CONFIG, Address(port=0))


def test_the_page_is_up_within_5_s():
    begin_s = time.monotonic()
    with shown() as display:
        assert urlopen(display.url).status == 200
        up_s = time.monotonic() - begin_s
    print(f"page up after {up_s:.2f} s")
    assert up_s < 5.0


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """Return the loop's delays, s, without and with the page, and the times at which the page was told, s."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    folder = tmp_path_factory.mktemp("runs")
    without, _ = asyncio.run(_flown(folder, with_page=False))
    with_page, told_s = asyncio.run(_flown(folder, with_page=True))
    return without, with_page, told_s


def test_the_page_is_told_at_least_five_times_a_second(flights):
    told_s = flights[2]
    rate_hz = (len(told_s) - 1) / (told_s[-1] - told_s[0])
    print(f"{rate_hz:.1f} states a second, longest gap {1e3 * np.diff(told_s).max():.0f} ms")
    assert rate_hz >= 5.0


def test_the_control_loop_is_not_held_up(flights):
    without_ms, with_ms = (1e3 * np.percentile(delays_s, 99) for delays_s in flights[:2])
    print(f"delay of the loop, p99: {without_ms:.2f} ms without the page, {with_ms:.2f} ms with it")
    assert with_ms - without_ms < 5.0


async def _flown(parent: Path, *, with_page: bool) -> tuple[list[float], list[float]]:
    run = RunFolder.create(parent, datetime.now(UTC))
    recording = Recording(run, CONFIG, pytest.fail)
    delays_s: list[float] = []
    told_s: list[float] = []
    async with contextlib.AsyncExitStack() as stack:
        stack.callback(recording.close)
        display = PanelDisplay(Console(), CONFIG.requirement.requirement(), quiet=True)
        if with_page:
            display = stack.enter_context(shown())
            await stack.enter_async_context(_browser(display.url, parent / "profile"))
            stack.enter_context(_running(_listen(display.url, told_s)))
        vehicle = await stack.enter_async_context(SimulatedVehicle(CONFIG, run.truth))
        session = await stack.enter_async_context(connected(vehicle.url, 10.0, recording.frame))
        stack.enter_context(_running(_probe(delays_s)))
        flight = Flight(session, CONFIG, watch_of(CONFIG), recording, display, FLOWN_S)
        await flight.fly(run.truth, asyncio.Event())
    return delays_s, told_s


async def _probe(delays_s: list[float]) -> None:
    """Note how much later than asked for the loop comes back to a task: so long an event would wait."""
    while True:
        due_s = time.monotonic() + PROBE_S
        await asyncio.sleep(PROBE_S)
        delays_s.append(time.monotonic() - due_s)


async def _listen(url: str, told_s: list[float]) -> None:
    """Read the page's stream as a second page would, and note when states come."""
    host, port = url.removeprefix("http://").rstrip("/").split(":")
    reader, writer = await asyncio.open_connection(host, int(port), limit=1 << 22)
    writer.write(f"GET /events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
    try:
        while line := await reader.readline():
            if line.startswith(b"data: ") and "state" in json.loads(line.removeprefix(b"data: ")):
                told_s.append(time.monotonic())
    finally:
        writer.close()


@contextlib.contextmanager
def _running(work):
    task = asyncio.ensure_future(work)
    yield
    task.cancel()


@contextlib.asynccontextmanager
async def _browser(url: str, profile: Path):
    quiet = asyncio.subprocess.DEVNULL
    process = await asyncio.create_subprocess_exec(
        CHROMIUM, *FLAGS, f"--user-data-dir={profile}", "--window-size=1400,860", url, stdout=quiet, stderr=quiet
    )
    yield
    process.terminate()
    await process.wait()
