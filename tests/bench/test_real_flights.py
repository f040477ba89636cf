"""Your own SITL programs next to recorded targets, each flight next to the study of what its target did.

    export SIDELONG_ARDUPLANE=PATH SIDELONG_PX4=PATH SIDELONG_TARGETS=FOLDER
    python -m pytest tests/bench/test_real_flights.py -s

FOLDER holds tracks of 22 minutes and more as ``sidelong study --targets`` takes them, and they are played smoothed as
there: what a receiver of one point a second adds is no motion. Twenty minutes each, ArduPlane in a wind of 4 m/s,
RATE=4 times as fast as the clock: the programs do not wait for anyone, so the machine has to keep up. A flight is
judged from a minute after it was taken over, when it has come from home; the target waits for a PX4 to come up. The
study flies the very piece of track that the flight watched, DRAWS times, with the same aircraft; both are judged
alike. WIND=M_S is another wind for both. GUSTS=M_S is the standard deviation of ArduPlane's turbulence
(SIM_WIND_TURB); its study then flies in moderate gusts, whose vertical ones have 1.5 m/s. PX4 has none.
``-k px4-mission`` flies a part; RECORDS=FOLDER keeps the records. If NAME.route.csv (east_m, north_m) stands
next to a track, flight and study know it as the target's route. ``-k eights`` flies next to the first target with a
gimbal that pans 120 degrees to each side. JSBSIM_AIRCRAFT=FILE.xml and ``-k airframe`` fly ArduPlane on an airframe
of JSBSim (tests/autopilot/jsbsim_airframe.py), which may be worse by SIDE_AIRFRAME_MAX.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from sidelong.app.analysis.score import within_pan_limits
from sidelong.app.analysis.truth import Truth, read_truth
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.flight.shell import free_udp_port
from sidelong.app.records.journal import JournalReader
from sidelong.app.simulation.kinematic import STEP_S
from sidelong.app.study.judging import judged
from sidelong.app.study.recorded import RecordedTarget, recorded_targets, route_next_to
from sidelong.app.study.settings import StudySettings
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import ControlAcquired, PlanStatus, UploadPlan
from sidelong.sitl.payload.devices import OVER_TCP
from sidelong.sitl.settings import DEFAULT_HOMES, STARTS_M, Flavour
from sidelong.sitl.world.geodesy import HomePlane
from tests.autopilot.jsbsim_airframe import arduplane_on
from tests.autopilot.matrix import flight_row, upload_s
from tests.autopilot.real_vehicle import FLAVOURS, ROOT, Program, RealVehicle, arduplane_with, configured

RATE, DRAWS = float(os.environ.get("RATE", "4")), 5
DURATION_S = float(os.environ.get("DURATION", "1200"))
WIND_FROM_DEG = 270.0  # as the study's
COMING_S = 60.0  # from the circle at home: a study begins next to the target
PAN_LIMIT_DEG = 120.0
SIDE_MAX, SIDE_ROUTE_MAX, SIDE_AIRFRAME_MAX, MOVES_MAX, BAND_MIN, RANGE_MIN_M = 0.03, 0.02, 0.04, 1.5, 0.995, 95.0
_FILES = sorted(Path(os.environ.get("SIDELONG_TARGETS", "-")).glob("*.csv"))
TARGETS = [file for file in _FILES if not file.stem.endswith(".route") and file.stem != "manifest"]
# A cyclist would be out of sight before the simulated PX4, which circles at home until it climbs, has come.
WAITS_S = {"arduplane": 0.0, "px4": 150.0}
TARGET_SPEED_MAX_M_S, WIND_M_S = {"arduplane": 9.0, "px4": 7.0}, {"arduplane": 4.0, "px4": 0.0}
if "WIND" in os.environ:
    WIND_M_S = dict.fromkeys(WIND_M_S, float(os.environ["WIND"]))
GUSTS_M_S = float(os.environ.get("GUSTS", "0"))


@dataclass(frozen=True)
class Watched:
    """How well a target was watched: fractions 0..1, and moves an hour."""

    side: float
    band: float
    min_range_m: float
    moves: float
    quick: float

    def __str__(self) -> str:
        return (
            f"side {100 * self.side:5.1f} %  band {100 * self.band:5.1f} %  least {self.min_range_m:4.0f} m  "
            f"moves/h {self.moves:4.0f}, quick {self.quick:4.1f}"
        )


@dataclass(frozen=True)
class Flight:
    """A flight, and the folder of its records."""

    watched: Watched
    run: Path


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("target", TARGETS, ids=lambda path: path.stem)
@pytest.mark.parametrize(
    ("flavour", "guidance"),
    [
        pytest.param(one.values[0], guidance, id=f"{one.id}-{guidance}")
        for one in FLAVOURS
        for guidance in ("mission", "command")
        if guidance == "mission" or one.values[0] != "px4"
    ],
)
def test_a_flight_is_as_its_study_predicts(flavour, guidance, target, tmp_path, record_property):
    side_max = SIDE_MAX if route_of(target) is None else SIDE_ROUTE_MAX
    compared_with_its_study(flavour, guidance, target, tmp_path, record_property, side_max)


@pytest.mark.timeout(7200)
@pytest.mark.skipif("JSBSIM_AIRCRAFT" not in os.environ, reason="JSBSIM_AIRCRAFT names no aircraft")
@pytest.mark.parametrize("target", TARGETS, ids=lambda path: path.stem)
def test_an_airframe_of_jsbsim_is_flown_as_its_study_predicts(target, tmp_path, record_property):
    aircraft = Path(os.environ["JSBSIM_AIRCRAFT"])
    program = arduplane_on(Path(os.environ["SIDELONG_ARDUPLANE"]), aircraft, tmp_path / "airframe")
    compared_with_its_study(program, "mission", target, tmp_path, record_property, SIDE_AIRFRAME_MAX)


def compared_with_its_study(
    flavour: Program, guidance: str, target: Path, tmp_path: Path, record_property: Callable, side_max: float
) -> None:
    """Fly next to a target and study the same; side_max: by how much less of the time may be on side."""
    flight = fly(flavour, guidance, target, tmp_path)
    study = studied(flavour, tmp_path, known=route_of(target) is not None)
    if "RECORDS" in os.environ:
        shutil.copytree(tmp_path, Path(os.environ["RECORDS"]) / f"{flavour}-{guidance}-{target.stem}")
    print(f"\n{flavour} {guidance} {target.stem}\n  flown   {flight.watched}\n  studied {study}")
    watched = flight.watched
    cells = watched.side, watched.band, watched.moves, upload_s(flight.run / "journal.jsonl")
    record_property("flight", flight_row(f"{guidance}, {target.stem}", *cells))
    assert watched.side >= study.side - side_max
    assert watched.moves <= MOVES_MAX * study.moves
    assert watched.band >= BAND_MIN
    assert watched.min_range_m >= RANGE_MIN_M


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("flavour", FLAVOURS)
def test_eights_keep_a_target_within_pan_limits(flavour, tmp_path):
    flight = fly(flavour, "mission", TARGETS[0], tmp_path, pan_limit_deg=PAN_LIMIT_DEG)
    outside = beyond_pan_limits(tmp_path / "truth.csv", flight.run, flavour)
    print(f"\n{flavour} {TARGETS[0].stem}: beyond the pan limits {100 * outside:.1f} %\n  flown   {flight.watched}")
    assert outside < 0.75 * (1.0 - PAN_LIMIT_DEG / 180.0)  # circles cost that share of each lap
    assert flight.watched.band >= BAND_MIN
    assert flight.watched.min_range_m >= RANGE_MIN_M


def beyond_pan_limits(file: Path, run: Path, flavour: str) -> float:
    """Return the share of a flight in which the target was further from the nose than the gimbal pans."""
    log, _ = seen(read_truth(file), JournalReader(run / "journal.jsonl", JOURNAL_TYPES))
    air_m = np.gradient(log[:, 1:3], log[:, 0], axis=0) - (WIND_M_S[flavour], 0.0)  # the wind is from the west
    within = within_pan_limits(log[:, 1:3], log[:, 3:5], np.arctan2(*air_m.T), math.radians(PAN_LIMIT_DEG))
    return 1.0 - float(within.mean())


def fly(
    flavour: Program,
    guidance: str,
    target: Path,
    folder: Path,
    payload: str = "",
    pan_limit_deg: float = 180.0,
    duration_s: float = DURATION_S,
) -> Flight:
    """Fly next to a target; payload: the maker's protocol that laser and gimbal speak, "" is MAVLink."""
    played = folder / "target.csv"
    options, more = (
        [*simulated(flavour, played, folder / "truth.csv"), "--set", f"payload.pan_limit_deg={pan_limit_deg}"],
        "",
    )
    if payload:
        address = f"127.0.0.1:{free_udp_port()}"
        options += ["--set", f"device={payload}@{address}"]
        scheme = "tcp" if payload in OVER_TCP else "udp"
        more = f'[payload]\nkind = "{payload}"\nurl = "{scheme}://{address}"\n'
    requirement = (
        f"pan_limit_deg = {pan_limit_deg}\n[requirement]\ntarget_speed_max_m_s = {TARGET_SPEED_MAX_M_S[flavour]}\n"
    )
    configured(folder / "mission.toml", flavour, requirement + more)
    route, known = None, write_played(flavour, target, played).route
    if known is not None:
        home, (east_m, north_m) = DEFAULT_HOMES[Flavour(flavour)], STARTS_M[0]
        plane = HomePlane(home.latitude_deg, home.longitude_deg)
        at_m = zip(known.east_m + east_m, known.north_m + north_m, strict=True)
        route = np.array([plane.latitude_longitude_deg(*one) for one in at_m])
        np.savetxt(folder / "route.csv", route, "%.8f", ",", header="lat,lon", comments="")
    program = flavour
    if GUSTS_M_S and flavour == "arduplane" and flavour.path is not None:
        program = arduplane_with(flavour.path, folder / "arduplane", f"SIM_WIND_TURB {GUSTS_M_S:g}\n")
    run = flown(RealVehicle(program, *options), guidance, folder, duration_s, known=known is not None)
    truth, records = read_truth(folder / "truth.csv"), JournalReader(run / "journal.jsonl", JOURNAL_TYPES)
    log, changed_s = seen(truth, records, duration_s)
    piece = piece_of(log, target, folder)
    if route is not None:
        own = LocalPlane(*truth.positions_deg[:2, 0])
        at_m = np.array([own.east_north_m(*one) for one in route.tolist()])
        header = {"header": "east_m,north_m", "comments": ""}
        np.savetxt(piece.with_suffix(".route.csv"), at_m, "%.3f", ",", **header)
    return Flight(judged_as_studied(log, changed_s, piece), run)


def write_played(flavour: str, target: Path, file: Path) -> RecordedTarget:
    """Write a track as it is played, smoothed and after a wait; returns it without the wait."""
    (smooth,) = recorded_targets([target], math.inf, route_next_to).flown
    path_m = np.pad([smooth.east_m, smooth.north_m], ((0, 0), (round(2.0 * WAITS_S[flavour]), 0)), "edge")
    write_track(file, np.arange(path_m.shape[1]) * 0.5, *path_m)
    return smooth


def piece_of(log: np.ndarray, target: Path, folder: Path) -> Path:
    """Write the piece of track that a flight watched, and return its file."""
    piece = folder / "pieces" / f"{target.stem}.csv"
    piece.parent.mkdir()
    write_track(piece, log[::5, 0] - log[0, 0], log[::5, 3], log[::5, 4])
    return piece


def route_of(target: Path) -> Path | None:
    """Return the file with the target's route, NAME.route.csv next to it; None if there is none."""
    file = target.with_suffix(".route.csv")
    return file if file.is_file() else None


def write_track(file: Path, *columns: np.ndarray) -> None:
    np.savetxt(file, np.column_stack(columns), "%.3f", ",", header="t_s,east_m,north_m", comments="")


def simulated(flavour: str, target: Path, truth: Path) -> list[object]:
    """Return the options of the simulation."""
    options = {
        "--speed": RATE,
        "--target": target,
        "--set": "targets.skip_s=0",
        "--target-speed": TARGET_SPEED_MAX_M_S[flavour],
        "--wind-speed": WIND_M_S[flavour],
        "--wind-from-deg": WIND_FROM_DEG,
        "--truth": truth,
    }
    return [word for option in options.items() for word in option]


def flown(vehicle: RealVehicle, guidance: str, folder: Path, duration_s: float, *, known: bool) -> Path:
    """Fly, and return the folder of the run; known: with the route in the folder."""
    with vehicle, (folder / "reported.txt").open("w") as announced:
        command = [
            sys.executable,
            "-m",
            "sidelong.app",
            "launch",
            folder / "mission.toml",
            "--connect",
            vehicle.urls[0],
        ]
        command += ["--set", f"planner.guidance={guidance}", "--duration", duration_s, "--out", folder / "runs"]
        command += ["--route", folder / "route.csv"] if known else []
        done = subprocess.run(list(map(str, command)), stdout=announced, stderr=announced, cwd=ROOT, check=False)
    assert done.returncode == 0, (folder / "reported.txt").read_text()[-2000:]
    (run,) = (folder / "runs").iterdir()
    assert json.loads((run / "summary.json").read_text())["outcome"] == "completed"
    return run


def seen(truth: Truth, records: JournalReader, duration_s: float = DURATION_S) -> tuple[np.ndarray, list[float]]:
    """Return a flight's log (n, 6) as a study has it, once it came from home into the band, and when it moved.

    The same circle sent with another radius, as it is flown too wide or too tight, is no move.
    """
    begin_s, moved_s, moving = math.inf, [], set[int]()
    for record in records:
        if isinstance(record, ControlAcquired):
            begin_s = min(begin_s, record.time_s + COMING_S)
        elif isinstance(record, UploadPlan) and record.plan.circle != record.present.circle:
            moving.add(record.number)
        elif isinstance(record, PlanStatus) and record.stage == "departed" and record.number in moving:
            moved_s.append(record.time_s)
    log = since(truth, begin_s, duration_s)
    return log, [time_s for time_s in moved_s if time_s >= log[0, 0]]


def since(truth: Truth, begin_s: float, duration_s: float) -> np.ndarray:
    """Return the log (n, 6) of a flight since it came into the band after begin_s."""
    plane = LocalPlane(*truth.positions_deg[:2, 0])
    rows = [
        (m.time_s, m.aircraft_east_m, m.aircraft_north_m, m.target_east_m, m.target_north_m, 0.0)
        for m in truth.moments(plane, begin_s, begin_s + duration_s, STEP_S)
    ]
    log = np.array(rows)
    range_m = np.hypot(log[:, 1] - log[:, 3], log[:, 2] - log[:, 4])
    return log[np.argmax((range_m >= 100.0) & (range_m <= 500.0)) :]


def judged_as_studied(log: np.ndarray, changed_s: list[float], piece: Path) -> Watched:
    """Judge a flight as a study is judged."""
    tracks = recorded_targets([piece], math.inf).flown
    result = judged(StudySettings(tracks=tracks, runs=1), log, changed_s, [], keep_track=False)
    return Watched(
        result.time_on_side,
        result.time_in_band,
        result.min_range_m,
        result.moves_per_hour,
        result.reversals_per_hour,
    )


def studied(flavour: str, folder: Path, *, known: bool) -> Watched:
    """Return what a study makes of the piece of track, on average; the least range is the least of all draws."""
    words = [
        "--targets",
        "pieces",
        "--autopilot",
        flavour,
        "--set",
        f"simulation.wind_speed_m_s={WIND_M_S[flavour]}",
        "--set",
        f"study.noise_draws={DRAWS}",
    ]
    if GUSTS_M_S and flavour == "arduplane":
        words += ["--set", "simulation.turbulence=moderate"]
    command = [
        sys.executable,
        "-m",
        "sidelong.app",
        "study",
        "mission.toml",
        "--planner",
        "predictive",
        *map(str, words),
    ]
    command += ["--json", "study.json", *(["--routes"] if known else [])]
    subprocess.run(command, cwd=folder, env=os.environ | {"PYTHONPATH": str(ROOT)}, check=True, capture_output=True)
    found = json.loads((folder / "study.json").read_text())["planners"]["predictive"]
    names = ("time_on_side", "time_in_band", "min_range_m", "moves_per_hour", "reversals_per_hour")
    return Watched(*(found[name]["worst" if name == "min_range_m" else "mean"] for name in names))
