"""The command ``sitl``: the simulated vehicle alone, until interrupted."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from pydantic import ValidationError

from sidelong.sitl.binary import BinaryError, companions_of, print_ready, print_waiting, run_binaries, served_device
from sidelong.sitl.payload.companion import Companion, CompanionError, accompany
from sidelong.sitl.payload.devices import DEVICES, Address
from sidelong.sitl.protocol.radio import KeyFileError, read_key
from sidelong.sitl.server import Pace, serve
from sidelong.sitl.settings import (
    DEFAULT_STATIONS,
    MAX_VEHICLES,
    NEWEST,
    OLDEST,
    RUN_SETTINGS,
    STARTS_M,
    Flavour,
    RunSettings,
    Settings,
    in_a_row,
)
from sidelong.sitl.simulation import Simulation
from sidelong.sitl.world.airframe import WindVector
from sidelong.sitl.world.geodesy import HomePlane
from sidelong.sitl.world.hills import Hills, HillsError
from sidelong.sitl.world.motion import MOTIONS
from sidelong.sitl.world.track_file import TrackError, is_track_file
from sidelong.sitl.world.truth import TruthFile
from sidelong.sitl.world.turbulence import Level

_LINK, _RUN, _TARGET, _VEHICLE = (
    partial(typer.Option, rich_help_panel=name) for name in ("Link", "Run", "Target", "Vehicle")
)
_LINE_MAX = 100  # characters of a reported time
_OF_RUN = {field.name for field in fields(RunSettings)}
_HOME = "latitude_deg", "longitude_deg", "altitude_m"
_OPTION_OF_KEY = {
    "speed": "--speed",
    "duration_s": "--duration",
    "airspeed_m_s": "--airspeed",
    "targets": "--target",
    "speed_max_m_s": "--target-speed",
    "home": "--home",
    "flavour": "--autopilot",
}
_OPTION_OF = {
    BinaryError: "--binary",
    CompanionError: "--payload-for",
    HillsError: "--terrain",
    KeyFileError: "--set signing_key_file:",
    TrackError: "--target",
}


def run(
    autopilot: Annotated[
        str, _VEHICLE(help="Which autopilot it behaves like: arduplane or px4; several vehicles in turn: a,b.")
    ] = Flavour.ARDUPLANE,
    vehicles: Annotated[
        int | None, _VEHICLE(min=1, max=MAX_VEHICLES, help="Number of vehicles [the number of autopilots named]")
    ] = None,
    airspeed: Annotated[float, _VEHICLE(help="Cruise airspeed, m/s.")] = 15.0,
    home: Annotated[
        str | None, _VEHICLE(metavar="LAT,LON[,ALT]", help="Degrees and metres above sea [of the ground]")
    ] = None,
    binary: Annotated[
        list[Path] | None,
        _VEHICLE(
            metavar="PATH", help="Your own SITL program of the --autopilot instead of the simulated one; repeatable."
        ),
    ] = None,
    payload_for: Annotated[
        str | None,
        _VEHICLE(
            metavar="[ID@]URL",
            help="No vehicle, only laser, gimbal and target for a vehicle (or that one) at this URL.",
        ),
    ] = None,
    target: Annotated[
        list[str] | None,
        _TARGET(
            metavar="[NAME=]SPEC",
            help=f"Motion: {', '.join(MOTIONS)}, or a .gpx or .csv track [walk]; repeatable: several targets.",
        ),
    ] = None,
    target_speed: Annotated[float | None, _TARGET(help="Greatest speed, m/s [3; for tracks 6]")] = None,
    wind_speed: Annotated[float, _RUN(min=0.0, max=50.0, help="Wind speed, m/s.")] = 0.0,
    wind_from_deg: Annotated[float, _RUN(min=-360.0, max=360.0, help="Where the wind comes from, degrees.")] = 0.0,
    turbulence: Annotated[Level, _RUN(help="Dryden gusts of MIL-F-8785C.")] = Level.NONE,
    terrain: Annotated[
        Path | None, _RUN(metavar="DIR", help="Fly over the ground of these SRTM .hgt tiles [flat]")
    ] = None,
    speed: Annotated[float, _RUN(help="Simulated time over wall time.")] = 1.0,
    duration: Annotated[float | None, _RUN(metavar="S", help="Simulated seconds; endless if left out.")] = None,
    seed: Annotated[int, _RUN(min=0, help="Seed of all noise and of the target.")] = 0,
    truth: Annotated[
        list[Path] | None, _RUN(metavar="FILE", help="Write the true tracks as CSV; once for each vehicle.")
    ] = None,
    to: Annotated[
        list[str] | None,
        _LINK(
            metavar="HOST:PORT",
            help=f"Where to send to; repeatable [{' and '.join(DEFAULT_STATIONS)}; each of several vehicles has a "
            "port of its own from 14540 on]",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        _RUN("--set", metavar="KEY=VALUE", help="Any other setting; for one vehicle: NUMBER.KEY=VALUE; repeatable."),
    ] = None,
    settings: Annotated[
        Path | None, _RUN(metavar="FILE", help="All settings as JSON; -: the first line of standard input.")
    ] = None,
    while_input: Annotated[
        bool,
        _RUN("--while-input", help="End when standard input ends; wait for the time that a program writes there."),
    ] = False,
) -> None:
    """Fly a simulated vehicle that speaks MAVLink over UDP, with a laser and a gimbal on a moving target.

    For example:
      sidelong sitl --autopilot px4 --target walk --target-speed 4 --speed 10
      sidelong sitl --autopilot arduplane --set release=4.5
      sidelong sitl --vehicles 2 --autopilot arduplane,px4 --set 2.airspeed_m_s=20
      sidelong sitl --vehicles 2 --target boat=walk --target bike=straight --set 2.looks_at=1
      sidelong sitl --set payload.dropout_fraction=0.5 --set payload.latency_s=0.5 --set link.loss=0.1
      sidelong sitl --set device=siyi@127.0.0.1:37260        # a payload with its maker's protocol
      sidelong sitl --payload-for tcpout://127.0.0.1:5763    # laser and gimbal for your own SITL
      sidelong sitl --autopilot px4 --binary build/px4_sitl_default/bin/px4
    """
    programs = binary or []
    if settings is not None:
        tree = _tree_of(_input_line() if str(settings) == "-" else settings)
    else:
        flavours = autopilot.split(",")
        count = vehicles or max(len(flavours), len(programs))
        if len(flavours) > count:
            refuse("--vehicles", f"is {count}, and --autopilot names {len(flavours)}")
        if programs and count != len(programs):
            refuse("--binary", f"is given {len(programs)} times for {count} vehicles")
        if truth and len(truth) != count:
            refuse("--truth", f"is given {len(truth)} times for {count} vehicles")
        seen = [
            {"motion": motion, "speed_max_m_s": target_speed, "start_m": STARTS_M[k % len(STARTS_M)], "name": name}
            for k, (name, _, motion) in enumerate(spec.rpartition("=") for spec in target or ["walk"])
        ]
        first = {
            "seed": seed,
            "airspeed_m_s": airspeed,
            "wind": asdict(WindVector.blowing_from(wind_speed, math.radians(wind_from_deg))),
            "turbulence": turbulence,
            "targets": seen,
            "terrain": terrain,
            "home": None if home is None else dict(zip(_HOME, home.split(","), strict=False)),
            "home_on_ground": home is None or home.count(",") == 1,
        }
        each = [first | {"flavour": flavours[k % len(flavours)]} for k in range(count)]
        wanted = _validated({"vehicles": each, "speed": speed, "duration_s": duration}, _OPTION_OF_KEY)
        placed = []
        for k, one in enumerate(in_a_row(wanted.vehicles[0], count)):
            own_port = DEFAULT_STATIONS[0] if count == 1 else f"127.0.0.1:{14540 + k}"
            stations, file = tuple(to or (own_port, DEFAULT_STATIONS[1])), truth[k] if truth else None
            placed.append(replace(one, flavour=wanted.vehicles[k].flavour, truth=file, stations=stations))
        tree = RUN_SETTINGS.dump_python(replace(wanted, vehicles=tuple(placed)), mode="json", exclude_defaults=True)
    with _refusing(), ExitStack() as stack:
        wanted = _completed(_validated(_with_values(tree, set_ or []), {}))
        _fly(wanted, programs, payload_for, while_input or str(settings) == "-", stack)


def _fly(
    wanted: RunSettings, programs: Sequence[Path], payload_for: str | None, while_input: bool, stack: ExitStack
) -> None:
    each, pace = wanted.vehicles, Pace(wanted.speed) if while_input else None
    addresses = [[_address("--to", text) for text in own.stations] for own in each]
    device = _device_address(each)
    stopped = _stop_signal(pace)
    if programs or payload_for is not None:
        if len(each[0].targets) > 1:
            refuse("--target", "is given several times: only simulated vehicles can turn to another")
        if each[0].turbulence != Level.NONE:
            refuse("--turbulence", "is for simulated vehicles; set a parameter such as SIM_WIND_TURB of your own")
        if payload_for is not None and len(each) > 1:
            refuse("--vehicles", "goes with vehicles that are started here, not with --payload-for")
        number, at, url = (payload_for or "").rpartition("@")
        if at and not number.isdecimal():
            refuse("--payload-for", f"names the vehicle {number!r}; give its system id, from 1 to 250")
        companions = companions_of(each, int(number) if at else None)
        _write_truth(stack, companions, each)
        with served_device(companions[0], each[0].device, device) as exchange:
            if not url:
                run_binaries(companions, each, programs, wanted.speed, stopped, exchange)
                return
            accompany(
                companions[0],
                url,
                key=each[0].signing_key,
                on_ready=lambda vehicle_id: print_ready(vehicle_id, url),
                on_wait=print_waiting,
                on_turn=exchange,
                stopped=stopped,
            )
        return
    simulations = [Simulation(one) for one in each]
    _write_truth(stack, simulations, each)
    words = [f"ready system {own.system_id} component 1 {own.flavour} -> {', '.join(own.stations)}" for own in each]
    serve(
        list(zip(simulations, addresses, strict=True)),
        speed=wanted.speed,
        duration_s=math.inf if wanted.duration_s is None else wanted.duration_s,
        faults=wanted.link,
        on_ready=lambda: print(*words, sep="\n", flush=True),
        stopped=stopped,
        pace=pace,
        device_address=device,
    )


def _tree_of(text: bytes | Path) -> Any:
    try:
        return json.loads(text.read_bytes() if isinstance(text, Path) else text)
    except OSError as error:
        return refuse("--settings", f"{error.filename} cannot be read: {error.strerror}")
    except ValueError as error:
        return refuse("--settings", f"is no JSON: {error}")


def _validated(tree: Any, option_of: Mapping[str, str]) -> RunSettings:
    """Return the settings in plain values; the sentence of a wrong one names its option, else its key."""
    try:
        return RUN_SETTINGS.validate_python(tree)
    except ValidationError as error:
        first = error.errors()[0]
        names = [str(part) for part in first["loc"] if not isinstance(part, int) and part != "vehicles"]
        option = next((option_of[name] for name in reversed(names) if name in option_of), None)
        what = first["msg"][0].lower() + first["msg"][1:]
        return refuse(option or f"--set {'.'.join(names)}:", f"{what}, not {first['input']!r}")


def _with_values(tree: Any, assignments: Sequence[str]) -> Any:
    """Return the settings changed by each ``KEY=VALUE``: a key of the run, of vehicle ``NUMBER.KEY``, else of all."""
    tree.setdefault("vehicles", [{}])
    for assignment in assignments:
        key, given, value = assignment.partition("=")
        names = key.split(".")
        if not given or not all(names):
            refuse("--set", f"is KEY=VALUE, not {assignment!r}")
        parsed = None if value == "none" else _tree_of(value.encode()) if value[:1] in ("[", "{") else value
        if not _put(tree if names[0] in _OF_RUN else tree["vehicles"], names, parsed):
            refuse("--set", f"{assignment}: there is nothing of that number or name")
    return tree


def _put(branch: Any, names: Sequence[str], value: Any) -> bool:
    """Set a value; of a list in its element of that number, from 1, else in all. Return whether there is a place."""
    if isinstance(branch, list):
        if not names[0].isdecimal():
            return all(_put(one, names, value) for one in branch)
        chosen = branch[int(names[0]) - 1 : int(names[0])] if len(names) > 1 and int(names[0]) else []
        return bool(chosen) and _put(chosen[0], names[1:], value)
    if not isinstance(branch, dict):
        return False
    if len(names) == 1:
        branch[names[0]] = value
        return True
    return _put(branch.setdefault(names[0], [{}] if names[0] == "targets" else {}), names[1:], value)


def _completed(wanted: RunSettings) -> RunSettings:
    """Return the settings with what has to be read from files and the clock. Raises HillsError and KeyFileError."""
    key = None if wanted.signing_key_file is None else read_key(wanted.signing_key_file)
    now_s, completed = time.time(), []
    for one in wanted.vehicles:
        if one.release is not None and not OLDEST[one.flavour] <= one.release <= NEWEST[one.flavour]:
            releases = OLDEST[one.flavour], NEWEST[one.flavour], one.release
            least, newest, given = (".".join(map(str, release)) for release in releases)
            refuse("--set release", f"is {least} to {newest} for {one.flavour}, not {given}")
        if one.looks_at >= len(one.targets):
            refuse("--set looks_at", f"is {one.looks_at}; there are {len(one.targets)} targets, from 0 on")
        if math.hypot(one.wind.east_m_s, one.wind.north_m_s) > 0.9 * one.airspeed_m_s:
            refuse("--wind-speed", f"must be at most 0.9 times the airspeed, {0.9 * one.airspeed_m_s:g} m/s")
        for motion in (seen.motion for seen in one.targets):
            if motion not in MOTIONS and not is_track_file(Path(motion)):
                known = f"is one of {', '.join(MOTIONS)} or a track such as a .gpx or .csv file"
                refuse("--target", f"{known}, not {motion!r}")
        if one.home_on_ground and one.terrain is not None:
            home = one.home_or_default
            ground = Hills(one.terrain, HomePlane(home.latitude_deg, home.longitude_deg))
            one = replace(one, home=replace(home, altitude_m=ground.home_altitude_m))  # noqa: PLW2901
        completed.append(replace(one, signing_key=key, link_rate=wanted.speed, boot_unix_s=now_s))
    return replace(wanted, vehicles=tuple(completed))


def _device_address(each: Sequence[Settings]) -> Address | None:
    """Return where the payload with a port of its own listens; only a single vehicle has one."""
    named = [one for one in each if one.device]
    if not named:
        return None
    kind, _, address = named[0].device.partition("@")
    if len(each) > 1 or named[0].payload is None:
        refuse("--set device", "goes with one vehicle and its payload")
    if kind not in DEVICES:
        refuse("--set device", f"is KIND@HOST:PORT with a KIND of {', '.join(DEVICES)}, not {named[0].device!r}")
    return _address("--set device", address)


def _address(option: str, text: str) -> Address:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        refuse(option, f"must look like HOST:PORT, not {text!r}")
    try:
        return socket.gethostbyname(host), int(port)
    except OSError:
        return refuse(option, f"names the unknown host {host!r}")


def _write_truth(stack: ExitStack, writers: Sequence[Companion | Simulation], each: Sequence[Settings]) -> None:
    for writer, own in zip(writers, each, strict=True):
        if own.truth is None:
            continue
        try:
            opened = stack.enter_context(open(own.truth, "w", encoding="utf-8", opener=_opened_at_once))  # noqa: SIM115
        except OSError as error:
            refuse("--truth", f"{own.truth} cannot be written: {error.strerror}")
        writer.on_truth = TruthFile(opened, print_waiting).write


def _opened_at_once(path: str, flags: int) -> int:
    """Open a file, where a pipe without a reader is an error instead of a wait."""
    opened = os.open(path, flags | os.O_NONBLOCK, 0o666)
    os.set_blocking(opened, True)
    return opened


def _input_line() -> bytes:
    """Return the first line of standard input, unbuffered: times may follow it."""
    line = b""
    while not line.endswith(b"\n") and (data := os.read(0, 1)):
        line += data
    return line


def _stop_signal(pace: Pace | None = None) -> Callable[[], bool]:
    """Return a function that reports whether SIGINT or SIGTERM was received or, with pace, standard input closed.

    With pace, a program writes the simulation time it has processed to standard input, line by line.
    """
    received: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda caught, _frame: received.append(caught))

    def wait_for_end(pace: Pace) -> None:
        line = b""
        while data := os.read(0, 4096):  # not sys.stdin: its lock, held at the end, would be a fatal error
            *whole, line = (line[-_LINE_MAX:] + data).split(b"\n")
            with contextlib.suppress(ValueError, IndexError):
                pace.follow(float(whole[-1]), time.monotonic())
        received.append(0)

    if pace is not None:
        threading.Thread(target=wait_for_end, args=(pace,), daemon=True).start()
    return lambda: bool(received)


@contextlib.contextmanager
def _refusing() -> Iterator[None]:
    """End the program where something that a setting names cannot be used."""
    try:
        yield
    except tuple(_OPTION_OF) as error:
        refuse(_OPTION_OF[type(error)], str(error))


def refuse(option: str, reason: str) -> NoReturn:
    """End the program with exit code 2 and the reason."""
    print(f"sidelong: {option} {reason}", file=sys.stderr)
    raise typer.Exit(2)
