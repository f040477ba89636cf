"""A flight in small: the real control step, flown by an aircraft that follows its plans exactly."""

from __future__ import annotations

import math
import shutil
import socket
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from sidelong.app.assembly import prepared
from sidelong.app.config import Config
from sidelong.app.flight.recording import Recording
from sidelong.app.planners.planner_kind import PlannerKind
from sidelong.app.records.run_folder import RunFolder
from sidelong.estimators import compiled
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import (
    ActivatePlan,
    ControlAcquired,
    Event,
    ModeReported,
    PlanStatus,
    StepOutput,
    UploadPlan,
)
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.predictive import planner
from tests.plan_track import PlanTrack

LASER, GIMBAL = Source("DISTANCE_SENSOR", 154, 1, 100), Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
HEIGHT_M, GRAVITY_M_S2 = 100.0, 9.80665
PLANE = LocalPlane(47.4, 8.5)
UPLOAD_S, START_S = 0.4, 100.0
SIZES, SCHEMES = ((1920, 1080), (1280, 800), (390, 844)), ("light", "dark")  # of windows of the page


def target_at(time_s: float) -> tuple[float, float]:
    """East at 3 m/s, after 150 s northeast."""
    since_s = time_s - START_S
    after_s = max(since_s - 150.0, 0.0)
    return 3.0 * (since_s - after_s) + 2.1 * after_s, 2.1 * after_s


def steps(
    controller: StandoffController, config: Config, duration_s: float
) -> Iterator[tuple[Event, tuple[StepOutput, ...]]]:
    """Fly; yield each event with the commands it led to. Uploads take 0.4 s and always succeed."""
    rng = np.random.default_rng(5)
    airframe = config.aircraft.aircraft()
    circle = Circle(0.0, 250.0, airframe.radius_m, True)
    start = AircraftState(START_S, 0.0, 250.0 + airframe.radius_m, math.pi / 2, airframe.airspeed_m_s, 0.0)
    track = PlanTrack(Plan(circle, None, START_S), start, airframe.airspeed_m_s)
    due: list[tuple[float, PlanStatus]] = []
    plans: dict[int, Plan] = {}

    def events(time_s: float) -> Iterator[Event]:
        state, target = track.state_at(time_s), target_at(time_s)
        east_m, north_m = target[0] - state.east_m, target[1] - state.north_m
        velocity = (
            state.ground_speed_m_s * math.sin(state.course_rad),
            state.ground_speed_m_s * math.cos(state.course_rad),
        )
        bank_rad = math.atan(state.ground_speed_m_s**2 * state.curvature_per_m / GRAVITY_M_S2)
        yield AttitudeReading(time_s, bank_rad, 0.0, state.course_rad)
        yield PositionReading(time_s, state.east_m, state.north_m, HEIGHT_M, *velocity, 0.0)
        yaw_rad = math.atan2(east_m, north_m) + rng.normal(0.0, 0.006)
        pitch_rad = -math.atan2(HEIGHT_M, math.hypot(east_m, north_m)) + rng.normal(0.0, 0.006)
        cy, sy, cp, sp = (
            math.cos(yaw_rad / 2),
            math.sin(yaw_rad / 2),
            math.cos(pitch_rad / 2),
            math.sin(pitch_rad / 2),
        )
        yield GimbalReading(time_s, (cp * cy, -sp * sy, sp * cy, cp * sy), "earth", GIMBAL)
        slant_m = math.hypot(east_m, north_m, HEIGHT_M) + rng.normal(0.0, 0.8)
        yield RangeReading(time_s, slant_m, LASER, quality=0.9)

    def handled(event: Event) -> tuple[Event, tuple[StepOutput, ...]]:
        commands = controller.step(event)
        for command in commands:
            if isinstance(command, UploadPlan):
                plans[command.number] = command.plan
                due.append(
                    (command.time_s + UPLOAD_S, PlanStatus(command.time_s + UPLOAD_S, command.number, "ready"))
                )
            elif isinstance(command, ActivatePlan):
                due.append((command.time_s, PlanStatus(command.time_s, command.number, "departed")))
        return event, commands

    yield handled(ModeReported(START_S, "AUTO", True))
    yield handled(ControlAcquired(START_S, circle, "AUTO"))
    for tick in range(round(duration_s * 10)):
        time_s = START_S + tick / 10
        for event in events(time_s):
            yield handled(event)
        while due and due[0][0] <= time_s:
            report = due.pop(0)[1]
            if report.stage == "departed":
                now = track.state_at(time_s)
                track = PlanTrack(plans[report.number], now, airframe.airspeed_m_s, before=track)
            yield handled(report)


@pytest.fixture(scope="session")
def config() -> Config:
    return Config.model_validate({"planner": {"name": "paper"}})


@pytest.fixture(scope="session")
def flight(config) -> Callable[[float], Iterator[tuple[Event, tuple[StepOutput, ...], StandoffController]]]:
    def fly(duration_s: float):
        controller = prepared(config).controller()
        for event, commands in steps(controller, config, duration_s):
            yield event, commands, controller

    return fly


@pytest.fixture(scope="session")
def run_folder(config, flight, tmp_path_factory) -> Path:
    """Return the folder of a flight of 300 s, without a summary: as if it had been cut off."""
    folder = RunFolder.create(tmp_path_factory.mktemp("runs"), datetime(2026, 11, 21, 9, 30, tzinfo=UTC))
    recording = Recording(folder, config, pytest.fail)
    recording.begin(PLANE, (47.4, 8.5))
    rows = ["time_boot_s,target_lat_deg,target_lon_deg,uav_lat_deg,uav_lon_deg"]
    for event, commands, _ in flight(300.0):
        recording.write(event)
        for command in commands:
            recording.write(command)
        if isinstance(event, PositionReading):
            target = PLANE.latitude_longitude_deg(*target_at(event.time_s))
            aircraft = PLANE.latitude_longitude_deg(event.east_m, event.north_m)
            rows.append(",".join(f"{value:.9f}" for value in (event.time_s, *target, *aircraft)))
    recording.close()
    folder.truth.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder.path


@pytest.fixture(scope="session")
def run_of_autopilot(config, flight, tmp_path_factory) -> Path:
    """Return the run folder of a flight of 240 s whose journal states the autopilot."""
    folder = RunFolder.create(tmp_path_factory.mktemp("runs"), datetime(2026, 11, 21, 9, 30, tzinfo=UTC))
    recording = Recording(folder, config, pytest.fail)
    recording.begin(PLANE, (47.4, 8.5), "ArduPlane", 0.0)
    for event, commands, _ in flight(240.0):
        recording.write(event)
        for command in commands:
            recording.write(command)
    recording.close()
    return folder.path


@pytest.fixture(scope="module")
def browser():
    """Return a headless Chromium that asks no one for anything; skips where there is none.

    While it is there its event loop counts as running: no other test module may meet it.
    """
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    executable = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if executable is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    flags = [
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        # One process for all pages, not one for each: starting them takes a quarter of the time.
        "--in-process-gpu",
        "--renderer-process-limit=1",
        "--disable-site-isolation-trials",
        "--disable-features=site-per-process,IsolateOrigins,Translate,MediaRouter,OptimizationHints",
    ]
    with playwright.sync_playwright() as running:
        launched = running.chromium.launch(executable_path=executable, args=flags)
        yield launched
        launched.close()


def recorded(
    folder: RunFolder,
    config: Config,
    duration_s: float,
    more: dict[float, Event],
    kind: PlannerKind | None = None,
) -> list[StepOutput]:
    """Fly and record; ``more`` are events by the time at which they come. Return the commands."""
    controller, recording = prepared(config, kind=kind).controller(), Recording(folder, config, pytest.fail)
    recording.begin(PLANE, (47.4, 8.5))
    announced: list[StepOutput] = []

    def note(event: Event, commands: tuple[StepOutput, ...]) -> None:
        recording.write(event)
        for command in commands:
            recording.write(command)
        announced.extend(commands)

    for event, commands in steps(controller, config, duration_s):
        note(event, commands)
        one = more.pop(round(controller.time_s, 1), None)
        if one is not None:
            note(one, controller.step(one))
    recording.close()
    assert not more
    return announced


@pytest.fixture
def small_tables(monkeypatch, tmp_path):
    """Let value tables be small, and kept for this test alone."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(compiled.FOLDER.parent))  # only the table is computed, nothing compiled
    whole = planner.table_configuration
    monkeypatch.setattr(
        planner, "table_configuration", lambda *known: replace(whole(*known), cells=4, improvements=(1, 1))
    )


@pytest.fixture
def receiver():
    """Return a UDP socket of the loopback."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(60.0)
        yield receiver


@pytest.fixture
def snapshot(flight):
    """Return what a display is shown after 5 s of a flight."""
    for _, _, controller in flight(5.0):
        last = controller
    return last.snapshot()
