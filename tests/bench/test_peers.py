"""What operators do without sidelong, flown by your own SITL programs next to recorded targets, and sidelong as well.

    SIDELONG_ARDUPLANE=PATH SIDELONG_PX4=PATH RECORDS=FOLDER python -m pytest tests/bench/test_peers.py -s

A station takes off, or takes over from sidelong if it needs its estimate. Then it flies as the peer does,
for DURATION=840 s, RATE=4 times as fast as the clock; wind, track, aircraft and judge are those of
``tests/bench/test_real_flights.py``. The table has all flights in RECORDS, so that ``-k`` flies a part of them.
SIDELONG_TARGETS: a folder of other tracks of 16 minutes and more. FOLLOW_SCRIPT: ArduPilot's Lua script; by default
the one in the source tree of the program, which needs its stock simulator's parameters there as well.

The circles around the target have a radius of 200 m, which keeps the band while the target moves less than 100 m. The
follow script flies its own offset to the required side. Beacons are exact, and report once a second.
"""

from __future__ import annotations

import json
import math
import os
import shlex
import shutil
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.analysis.truth import read_truth
from sidelong.app.flight.shell import free_udp_port
from sidelong.estimators.frames import LocalPlane
from tests.autopilot.changing_relay import ChangingRelay
from tests.autopilot.conftest import PATIENCE_S, Application
from tests.autopilot.real_vehicle import AIRCRAFT, FLAVOURS, Program, RealVehicle, configured
from tests.bench import test_real_flights as real

DURATION_S = real.DURATION_S if "DURATION" in os.environ else 840.0
OWN = Path(__file__).parents[2] / "app" / "study" / "tracks"
TARGETS = real.TARGETS or [OWN / f"{name}.csv" for name in ("run_011", "run_015", "tractor_003", "boat_010")]
PROGRAMS = {str(one.values[0]): one.values[0] for one in FLAVOURS}
HEIGHT_M, AROUND_M, ASIDE_M = 100.0, 200.0, 250.0
SLOW_M_S = 0.5  # an operator reads no course from a slower target
BEACON_ID = 42
GUIDED, TAKEOFF = 15, 13
READY_TRIES, POSITION_HZ = 400, 10.0
FOLLOW_PARAMETERS = {
    "SCR_ENABLE": 1,
    "FOLL_ENABLE": 1,
    "FOLL_SYSID": BEACON_ID,
    "FOLL_DIST_MAX": 0,  # no limit
    "FOLL_OFS_TYPE": 1,  # relative to the target's heading: forward, right, down
    "FOLL_OFS_X": 0,
    "FOLL_OFS_Y": -ASIDE_M,
    "FOLL_OFS_Z": -HEIGHT_M,
    "FOLL_ALT_TYPE": 0,
}
WATCHED = "watched from now on"


@dataclass(frozen=True)
class Seen:
    """Where the target is, and its velocity."""

    latitude_deg: float
    longitude_deg: float
    east_m_s: float
    north_m_s: float


class TrueTarget:
    """The target's position as an exact beacon reports it: the newest second of the truth."""

    def __init__(self, truth: Path) -> None:
        self._truth = truth

    def now(self) -> Seen:
        """Return the newest position."""
        with self._truth.open("rb") as file:
            file.seek(-min(4000, file.seek(0, os.SEEK_END)), os.SEEK_END)
            rows = [list(map(float, line.split(b",")[:5])) for line in file.read().split(b"\n")[1:-1]]
        first, last = rows[max(-11, -len(rows))], rows[-1]
        span_s = max(last[0] - first[0], 0.1)
        return Seen(*last[3:5], (last[1] - first[1]) / span_s, (last[2] - first[2]) / span_s)


class Estimate:
    """The estimate of sidelong, as an operator reads it on the page."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", free_udp_port()))
        self._socket.setblocking(False)
        self.url = "udp://127.0.0.1:{1}".format(*self._socket.getsockname())
        self._parser = mavlink.MAVLink(None)
        self._seen: Seen | None = None

    def now(self) -> Seen:
        """Return the newest one."""
        while True:
            try:
                data = self._socket.recv(2048)
            except BlockingIOError:
                break
            for message in self._parser.parse_buffer(data) or ():
                if message.get_type() == "FOLLOW_TARGET":
                    north_m_s, east_m_s, _ = message.vel
                    self._seen = Seen(message.lat / 1e7, message.lon / 1e7, east_m_s, north_m_s)
        assert self._seen is not None, "sidelong sends no estimate"
        return self._seen


class Station(ChangingRelay):
    """The station that flies the peer. left: the direction of the target's left side, once it has moved."""

    home_altitude_m = height_m = 0.0
    left = (-1.0, 0.0)

    def _note(self, message: mavlink.MAVLink_message) -> None:
        super()._note(message)
        if message.get_type() == "GLOBAL_POSITION_INT":
            self.height_m = 1e-3 * message.relative_alt
            self.home_altitude_m = 1e-3 * message.alt - self.height_m

    @property
    def now_s(self) -> float:
        """Time on the vehicle's clock."""
        return self.time_boot_ms / 1000.0

    def insist(self, command: int, *params: float) -> None:
        """Command until it is accepted: the autopilot may not be ready yet."""
        for _ in range(READY_TRIES):
            answer = self.command(command, *params)
            if (answer.command, answer.result) == (command, mavlink.MAV_RESULT_ACCEPTED):
                return
            time.sleep(0.2)
        raise AssertionError(f"command {command} was not accepted")

    def take_off(self, flavour: str) -> None:
        """Take off to the height of the flight, and circle there."""
        self.insist(
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 1e6 / POSITION_HZ
        )
        self.wait_until(lambda: self.time_boot_ms > 0)
        if flavour == "arduplane":
            self.set_parameter("TKOFF_ALT", HEIGHT_M)
            self.insist(mavlink.MAV_CMD_DO_SET_MODE, 1, TAKEOFF, 0)
        else:
            altitude_m = self.home_altitude_m + HEIGHT_M
            self.insist(mavlink.MAV_CMD_NAV_TAKEOFF, math.nan, 0, 0, *3 * (math.nan,), altitude_m)
        self.insist(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        self.wait_until(lambda: self.height_m > HEIGHT_M - 10.0)

    def wait_until(self, met: Callable[[], bool]) -> None:
        """Wait for the vehicle."""
        end_s = time.monotonic() + PATIENCE_S
        while not met():
            assert time.monotonic() < end_s
            time.sleep(0.05)

    def circle(self, command: int, latitude_deg: float, longitude_deg: float, *params: float) -> None:
        """Command a circle in the frame that both autopilots accept."""
        at = round(latitude_deg * 1e7), round(longitude_deg * 1e7), self.home_altitude_m + HEIGHT_M
        frame = mavlink.MAV_FRAME_GLOBAL_INT
        message = mavlink.MAVLink_command_int_message(self.system_id, 1, frame, command, 0, 0, *params, *at)
        assert self.ask(message, "COMMAND_ACK").result == mavlink.MAV_RESULT_ACCEPTED

    def reposition(self, latitude_deg: float, longitude_deg: float, radius_m: float) -> None:
        """Command a loiter; PX4 takes its radius from a parameter."""
        self.circle(mavlink.MAV_CMD_DO_REPOSITION, latitude_deg, longitude_deg, -1.0, 1.0, radius_m, 0.0)

    def beacon(self, target: Seen) -> None:
        """Send a beacon's report, as ArduPilot's follow library takes it."""
        course_deg = math.degrees(math.atan2(target.east_m_s, target.north_m_s)) % 360.0
        message = mavlink.MAVLink_global_position_int_message(
            *(self.time_boot_ms, round(target.latitude_deg * 1e7), round(target.longitude_deg * 1e7)),
            *(round(1e3 * self.home_altitude_m), 0, round(100 * target.north_m_s), round(100 * target.east_m_s), 0),
            round(100 * course_deg),
        )
        self._send_to_vehicle(bytes(message.pack(mavlink.MAVLink(None, BEACON_ID, 1))))


def follow(station: Station, target: Seen) -> None:
    station.beacon(target)


def loiter(station: Station, target: Seen) -> None:
    station.reposition(target.latitude_deg, target.longitude_deg, AROUND_M)


def orbit(station: Station, target: Seen) -> None:
    at = target.latitude_deg, target.longitude_deg
    station.circle(mavlink.MAV_CMD_DO_ORBIT, *at, AROUND_M, math.nan, 0.0, math.nan)


def offset(station: Station, target: Seen) -> None:
    """Put the loiter to the left of the target, by its course."""
    speed_m_s = math.hypot(target.east_m_s, target.north_m_s)
    if speed_m_s > SLOW_M_S:
        station.left = -target.north_m_s / speed_m_s, target.east_m_s / speed_m_s
    plane = LocalPlane(target.latitude_deg, target.longitude_deg)
    at = plane.latitude_longitude_deg(ASIDE_M * station.left[0], ASIDE_M * station.left[1])
    station.reposition(*at, AIRCRAFT["arduplane"][1])


@dataclass(frozen=True)
class Peer:
    """How a peer flies.

    Attributes:
        act: does what it does once in every_s of the vehicle's clock.
        by_estimate: whether it reads sidelong's estimate; otherwise it needs a beacon.
        commands: whether act is an operator's command.
    """

    flavour: str
    text: str
    act: Callable[[Station, Seen], None]
    every_s: float
    by_estimate: bool = False
    commands: bool = True


PEERS = {
    "follow": Peer("arduplane", "ArduPlane's follow script, offset to the side", follow, 1.0, commands=False),
    "loiter": Peer("arduplane", "ArduPlane, loiter set again each 10 s", loiter, 10.0),
    "operator": Peer("arduplane", "ArduPlane, loiter on the required side each 30 s", offset, 30.0, by_estimate=True),
    "px4-orbit": Peer("px4", "PX4, orbit set again each 10 s", orbit, 10.0),
    "px4-loiter": Peer("px4", "PX4, loiter set again each 10 s", loiter, 10.0),
}
SIDELONG = {"sidelong": ("arduplane", "sidelong, ArduPlane"), "px4-sidelong": ("px4", "sidelong, PX4")}


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    return Path(os.environ["RECORDS"]) if "RECORDS" in os.environ else tmp_path_factory.mktemp("records")


@pytest.mark.parametrize("target", TARGETS, ids=lambda path: path.stem)
@pytest.mark.parametrize("name", [*PEERS, *SIDELONG])
def test_a_peer_next_to_a_target(name, target, records, tmp_path):
    if name in SIDELONG:
        watched = real.fly(PROGRAMS[SIDELONG[name][0]], "mission", target, tmp_path, duration_s=DURATION_S).watched
        commands_per_hour = watched.moves
    else:
        watched, commands_per_hour = fly(PEERS[name], target, tmp_path)
    print(f"\n{name} {target.stem}: {watched}")
    kept = records / f"{name}-{target.stem}"
    shutil.copytree(tmp_path, kept, dirs_exist_ok=True)
    figures = asdict(watched) | {"commands_per_hour": commands_per_hour, "duration_s": DURATION_S}
    (kept / "watched.json").write_text(json.dumps(figures))


def test_the_table(records):
    columns = "flown", "needs a beacon", "on side, mean / worst", "in band, mean / worst", "least range", "commands/h"
    print("", f"| {' | '.join(columns)} |", "|" + " --- |" * len(columns), sep="\n")
    texts = {name: (one.text, "no" if one.by_estimate else "yes") for name, one in PEERS.items()}
    texts |= {name: (text, "no") for name, (_, text) in SIDELONG.items()}
    rows = {}
    for name, (text, beacon) in texts.items():
        found = [json.loads(file.read_text()) for file in sorted(records.glob(f"{name}-*/watched.json"))]
        if found:
            rows[name] = found
            side, band = ([100.0 * one[key] for one in found] for key in ("side", "band"))
            shares = " | ".join(f"{sum(one) / len(one):.1f} / {min(one):.1f} %" for one in (side, band))
            least_m = min(one["min_range_m"] for one in found)
            commands = sum(one["commands_per_hour"] for one in found) / len(found)
            print(f"| {text} ({len(found)} flights) | {beacon} | {shares} | {least_m:.0f} m | {commands:.0f} |")
    assert rows or not any(one.path for one in PROGRAMS.values())


def fly(peer: Peer, target: Path, folder: Path) -> tuple[real.Watched, float]:
    """Fly a peer; returns how well it watched, and commands an hour."""
    program, truth = PROGRAMS[peer.flavour], folder / "truth.csv"
    real.write_played(peer.flavour, target, folder / "target.csv")
    if peer.act is follow and program.path is not None:
        program = with_script(program, folder)
    requirement = f"[requirement]\ntarget_speed_max_m_s = {real.TARGET_SPEED_MAX_M_S[peer.flavour]}\n"
    config = configured(folder / "mission.toml", peer.flavour, requirement)
    estimate, station = Estimate(), Station("udpin://127.0.0.1:0")
    with ExitStack() as begun:
        if peer.by_estimate:  # first, since the target does not wait for it
            more = ("--set", f"sharing.follow_target={estimate.url}")
            flight = begun.enter_context(Application(station.url, folder / "runs", str(config), *more))
            flight.wait_for("connecting to")
        vehicle = begun.enter_context(
            RealVehicle(program, *real.simulated(peer.flavour, folder / "target.csv", truth))
        )
        station.meet(vehicle.urls[0])
        begun.enter_context(station)
        if peer.by_estimate:
            flight.wait_for(WATCHED)
        else:
            station.take_off(peer.flavour)
        source = estimate if peer.by_estimate else TrueTarget(truth)
        if peer.act is follow:
            station.set_parameter("GFOLL_ENABLE", 1.0)
            station.command(mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED, 0)
        elif peer.flavour == "px4":
            station.set_parameter("NAV_LOITER_RAD", AROUND_M)
        begin_s, count = station.now_s, 0
        while (now_s := station.now_s) < begin_s + real.COMING_S + DURATION_S:
            if now_s >= begin_s + count * peer.every_s:
                peer.act(station, source.now())
                count += 1
            time.sleep(0.01)
        assert station.armed
    log = real.since(read_truth(truth), begin_s + real.COMING_S, DURATION_S)
    watched = real.judged_as_studied(log, [], real.piece_of(log, target, folder))
    return watched, 3600.0 / peer.every_s if peer.commands else 0.0


def with_script(program: Program, folder: Path) -> Program:
    """Return the program with ArduPilot's follow script and its parameters in the folder that it runs in."""
    tree = program.path.resolve().parents[3]
    scripts = tree / "libraries" / "AP_Scripting" / "examples"
    script = Path(os.environ.get("FOLLOW_SCRIPT", scripts / "plane_guided_follow.lua"))
    if not script.is_file():
        pytest.skip(f"FOLLOW_SCRIPT names no file, and {script} is not there")
    parameters = folder / "follow.parm"
    parameters.write_text("".join(f"{name} {value}\n" for name, value in FOLLOW_PARAMETERS.items()))
    stock, words = tree / "Tools" / "autotest" / "models" / "plane.parm", [script, parameters, program.path.resolve()]
    script_word, parameters_word, program_word = (shlex.quote(str(word)) for word in words)
    wrapper = folder / "arduplane"
    wrapper.write_text(
        "#!/bin/sh\nset -e\nmkdir scripts\n"
        f"cp {script_word} scripts/\n"
        f"cat {shlex.quote(str(stock))} own.parm {parameters_word} > all.parm\nmv all.parm own.parm\n"
        f'exec {program_word} "$@"\n'
    )
    wrapper.chmod(0o755)
    return Program("arduplane", wrapper, program.label)
