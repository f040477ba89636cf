"""The command ``sitl``: the simulated vehicle alone, until interrupted."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from sitl.airframe import Wind
from sitl.binary import Binary, BinaryError
from sitl.companion import Companion, CompanionError, accompany
from sitl.geodesy import HomePlane
from sitl.hills import Hills, HillsError
from sitl.link import LinkFaults
from sitl.motion import MOTIONS
from sitl.pace import Pace
from sitl.server import Address, serve
from sitl.settings import (
    DEFAULT_HOMES,
    Flavour,
    GimbalFrame,
    Home,
    PayloadSettings,
    RangeMessage,
    Settings,
    TargetSettings,
)
from sitl.signing import KeyFileError, read_key
from sitl.simulation import Simulation
from sitl.track import TrackError
from sitl.truth import TruthFile
from sitl.world import MAX_VEHICLES, in_turn

_LINE_MAX = 100  # characters
_DEFAULT_STATIONS = ("127.0.0.1:14540", "127.0.0.1:14550")


def run(
    autopilot: Annotated[
        str, typer.Option(help="Which autopilot it behaves like: arduplane or px4; several vehicles in turn: a,b.")
    ] = Flavour.ARDUPLANE,
    vehicles: Annotated[
        int | None,
        typer.Option(min=1, max=MAX_VEHICLES, help="How many, about one target [as many as autopilots are named]"),
    ] = None,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[ID@]HOST:PORT",
            help=f"Where to send to, all vehicles or that one; repeatable [{' and '.join(_DEFAULT_STATIONS)}; "
            "each of several vehicles has a port of its own from 14540 on]",
        ),
    ] = None,
    speed: Annotated[float, typer.Option(help="Simulated over wall time.")] = 1.0,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="Simulated seconds; endless if left out.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of all noise and of the target.")] = 0,
    truth: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Write what really happened as CSV; once for each vehicle."),
    ] = None,
    home: Annotated[str | None, typer.Option(metavar="LAT,LON[,ALT]", help="Degrees and metres above sea.")] = None,
    airspeed: Annotated[str, typer.Option(help="Cruise airspeed, m/s; of several vehicles in turn: A,B.")] = "15",
    endurance: Annotated[
        str, typer.Option(metavar="S", help="So long a battery lasts, s; of several vehicles in turn: A,B.")
    ] = "10800",
    wind_speed: Annotated[float, typer.Option(help="m/s")] = 0.0,
    wind_from_deg: Annotated[float, typer.Option(help="Where the wind comes from, degrees.")] = 0.0,
    system_id: Annotated[
        int | None,
        typer.Option(min=1, max=250, help="Of the first vehicle, or of the one --payload-for is meant for [1]"),
    ] = None,
    target: Annotated[
        str, typer.Option(metavar="SPEC", help=f"Motion: {', '.join(MOTIONS)}, or a .gpx or .csv track.")
    ] = "walk",
    target_speed: Annotated[float | None, typer.Option(help="Greatest speed, m/s [3; for tracks 6]")] = None,
    target_start: Annotated[str, typer.Option(metavar="EAST,NORTH", help="Metres from home.")] = "250,300",
    target_skip: Annotated[
        float | None, typer.Option(metavar="S", help="Begin a track here [where it becomes lively]")
    ] = None,
    terrain: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Fly over the ground of these SRTM .hgt tiles [flat]")
    ] = None,
    payload: Annotated[bool, typer.Option(help="Laser and gimbal.")] = True,
    payload_for: Annotated[
        str | None,
        typer.Option(metavar="URL", help="No vehicle, only laser, gimbal and target for the vehicle at this URL."),
    ] = None,
    binary: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Your own SITL program of the --autopilot instead of the simulated one."),
    ] = None,
    range_sigma: Annotated[float, typer.Option(help="Laser noise, m.")] = 0.8,
    range_outliers: Annotated[float, typer.Option(help="Fraction of wrong ranges.")] = 0.02,
    range_message: Annotated[RangeMessage, typer.Option()] = RangeMessage.DISTANCE_SENSOR,
    gimbal_sigma_deg: Annotated[float, typer.Option(help="Gimbal noise, degrees.")] = 0.35,
    gimbal_yaw_bias_deg: Annotated[float, typer.Option(help="Constant gimbal error, degrees.")] = 0.4,
    gimbal_frame: Annotated[GimbalFrame, typer.Option(help="What its yaw is relative to.")] = GimbalFrame.EARTH,
    dropouts: Annotated[float, typer.Option(help="Fraction of the time without range.")] = 0.15,
    payload_latency_ms: Annotated[float, typer.Option(help="From measuring to sending.")] = 50.0,
    loss: Annotated[float, typer.Option(help="Fraction of packets lost, each way.")] = 0.0,
    delay_ms: Annotated[float, typer.Option(help="Wall-clock delay, each way.")] = 0.0,
    duplicate: Annotated[float, typer.Option(help="Fraction of packets doubled, each way.")] = 0.0,
    lose: Annotated[
        list[str] | None,
        typer.Option(metavar="ID@S", help="Let a vehicle vanish after so many simulated seconds; repeatable."),
    ] = None,
    require_signing: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Sign, and hear only what is signed with the key in this file."),
    ] = None,
    while_input: Annotated[
        bool,
        typer.Option(
            "--while-input",
            help="End when standard input does; go no further than a program that tells its time there.",
        ),
    ] = False,
) -> None:
    """Fly a simulated vehicle that speaks MAVLink over UDP, with a laser and a gimbal on a moving target.

    Example: sidelong sitl --autopilot px4 --target walk --target-speed 4 --speed 10 --truth truth.csv

    Several about one target: sidelong sitl --vehicles 2 --autopilot arduplane,px4

    A real vehicle's simulator gets the payload by: sidelong sitl --payload-for tcpout://127.0.0.1:5763
    or is started with it by: sidelong sitl --autopilot px4 --binary build/px4_sitl_default/bin/px4
    """
    flavours = [_flavour(name) for name in autopilot.split(",")]
    airspeeds_m_s = _numbers("--airspeed", airspeed, range(1, MAX_VEHICLES + 1), "A or A,B")
    endurances_s = _numbers("--endurance", endurance, range(1, MAX_VEHICLES + 1), "A or A,B")
    named = max(len(flavours), len(airspeeds_m_s), len(endurances_s))
    count = vehicles or named
    if named > count:
        _refuse("--vehicles", f"is {count}: more autopilots, airspeeds or endurances are named")
    if count > 1 and (payload_for is not None or binary is not None):
        _refuse("--vehicles", "goes with the simulated vehicles alone, not with --payload-for or --binary")
    _check_ranges(
        {
            "--speed": (speed, 0.0, 1000.0, False),
            "--duration": (math.inf if duration is None else duration, 0.0, math.inf, False),
            "--wind-speed": (wind_speed, 0.0, 0.9 * min(airspeeds_m_s), True),
            "--wind-from-deg": (wind_from_deg, -360.0, 360.0, True),
            "--target-speed": (0.0 if target_speed is None else target_speed, 0.0, 50.0, True),
            "--target-skip": (0.0 if target_skip is None else target_skip, 0.0, math.inf, True),
            "--range-sigma": (range_sigma, 0.0, 100.0, True),
            "--range-outliers": (range_outliers, 0.0, 1.0, True),
            "--gimbal-sigma-deg": (gimbal_sigma_deg, 0.0, 45.0, True),
            "--gimbal-yaw-bias-deg": (gimbal_yaw_bias_deg, -180.0, 180.0, True),
            "--dropouts": (dropouts, 0.0, 0.95, True),
            "--payload-latency-ms": (payload_latency_ms, 0.0, 10_000.0, True),
            "--loss": (loss, 0.0, 1.0, True),
            "--delay-ms": (delay_ms, 0.0, 60_000.0, True),
            "--duplicate": (duplicate, 0.0, 1.0, True),
        }
    )
    for airspeed_m_s in airspeeds_m_s:
        _check_ranges({"--airspeed": (airspeed_m_s, 5.0, 60.0, True)})
    _check_ranges({"--endurance": (min(endurances_s), 0.0, math.inf, False)})
    sensors = PayloadSettings(
        range_sigma,
        range_outliers,
        math.radians(gimbal_sigma_deg),
        math.radians(gimbal_yaw_bias_deg),
        dropouts,
        payload_latency_ms / 1000.0,
        range_message,
        gimbal_frame,
    )
    own_terrain = terrain if payload_for is None else None  # the home of another vehicle comes from its own words
    settings = Settings(
        flavour=flavours[0],
        system_id=system_id or 1,
        seed=seed,
        airspeed_m_s=airspeeds_m_s[0],
        wind=Wind.blowing_from(wind_speed, math.radians(wind_from_deg)),
        home=_home_on_ground(home, own_terrain, flavours[0]),
        target=TargetSettings(_motion(target), target_speed, _east_north(target_start), target_skip),
        payload=sensors if payload else None,
        signing_key=None if require_signing is None else _key(require_signing),
        link_rate=speed,
        boot_unix_s=time.time(),
        terrain=own_terrain,
    )
    ids = range(settings.system_id, settings.system_id + count)
    if truth and len(truth) != count:
        _refuse("--truth", f"is given {len(truth)} times for {count} vehicles")
    stations = _stations(to, ids)
    with ExitStack() as stack:
        try:
            alone = payload_for is None and binary is None
            simulations = [Simulation(one) for one in in_turn(settings, flavours, airspeeds_m_s, endurances_s, count)]
            companion = None if alone else Companion(sensors, settings.target, seed, terrain, system_id)
        except TrackError as error:
            _refuse("--target", str(error))
        except HillsError as error:
            _refuse("--terrain", str(error))
        for vehicle_id, lost_s in _lost(lose or [], ids):
            simulations[ids.index(vehicle_id)].lost_s = lost_s
        writers: list[Companion | Simulation] = [*simulations] if companion is None else [companion]
        for writer, path in zip(writers, truth or [], strict=False):
            try:
                file = TruthFile(stack.enter_context(path.open("w", encoding="utf-8")), _warn)
            except OSError as error:
                _refuse("--truth", f"{path} cannot be written: {error.strerror}")
            writer.on_truth = file.write
        if companion is not None and binary is not None:
            _run_binary(companion, flavours[0], binary, speed, settings.home, settings.signing_key)
            return
        if companion is not None and payload_for is not None:
            _accompany(companion, payload_for, _stop_signal(), settings.signing_key)
            return

        def tell_ready() -> None:
            for simulation, addresses in zip(simulations, stations, strict=True):
                where = ", ".join(f"{host}:{port}" for host, port in addresses)
                own = simulation.settings
                print(f"ready system {own.system_id} component 1 {own.flavour} -> {where}", flush=True)

        pace = Pace(speed) if while_input else None
        serve(
            list(zip(simulations, stations, strict=True)),
            speed=speed,
            duration_s=math.inf if duration is None else duration,
            faults=LinkFaults(loss, duplicate, delay_ms / 1000.0),
            on_ready=tell_ready,
            stopped=_stop_signal(pace),
            pace=pace,
        )


def _run_binary(
    companion: Companion, flavour: Flavour, path: Path, speed: float, home: Home | None, key: bytes | None
) -> None:
    stopped = _stop_signal()
    try:
        with Binary(flavour, path, speed, home) as binary:
            print(f"fly it by: sidelong launch --connect {binary.run.url}", flush=True)
            _accompany(companion, binary.run.payload_url, lambda: stopped() or binary.ended, key)
            if not stopped():
                raise BinaryError(binary.last_words)
    except BinaryError as error:
        _refuse("--binary", str(error))


def _accompany(companion: Companion, url: str, stopped: Callable[[], bool], key: bytes | None) -> None:
    try:
        accompany(
            companion,
            url,
            key=key,
            on_ready=lambda vehicle_id: print(
                f"ready system {vehicle_id} component 154 payload -> {url}", flush=True
            ),
            on_wait=lambda reason: print(reason, file=sys.stderr, flush=True),
            stopped=stopped,
        )
    except CompanionError as error:
        _refuse("--payload-for", str(error))
    except HillsError as error:
        _refuse("--terrain", str(error))


def _stop_signal(pace: Pace | None = None) -> Callable[[], bool]:
    """Return what tells whether SIGINT or SIGTERM has come since now, or standard input has ended where it counts.

    There a program may tell, line by line, what time of the simulation it has come to.
    """
    received: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda caught, _frame: received.append(caught))
    if pace is not None:

        def wait_for_end() -> None:
            line = b""
            while heard := os.read(0, 4096):  # not sys.stdin: its lock, held at the end, would be a fatal error
                *whole, line = (line[-_LINE_MAX:] + heard).split(b"\n")
                with contextlib.suppress(ValueError, IndexError):
                    pace.follow(float(whole[-1]), time.monotonic())
            received.append(0)

        threading.Thread(target=wait_for_end, daemon=True).start()
    return lambda: bool(received)


def _warn(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _check_ranges(values: dict[str, tuple[float, float, float, bool]]) -> None:
    for option, (value, least, greatest, min_included) in values.items():
        if not (least <= value <= greatest) or (value == least and not min_included):
            at_least = "at least" if min_included else "more than"
            most = "" if greatest == math.inf else f" and at most {greatest:g}"
            _refuse(option, f"must be {at_least} {least:g}{most}, not {value:g}")


def _motion(spec: str) -> str | Path:
    if spec in MOTIONS:
        return spec
    if Path(spec).suffix.lower() in (".gpx", ".csv"):
        return Path(spec)
    return _refuse("--target", f"is one of {', '.join(MOTIONS)} or a .gpx or .csv file, not {spec!r}")


def _flavour(name: str) -> Flavour:
    try:
        return Flavour(name)
    except ValueError:
        return _refuse("--autopilot", f"is one of {', '.join(Flavour)}, not {name!r}")


def _stations(to: list[str] | None, ids: Sequence[int]) -> list[list[Address]]:
    """Return where each vehicle sends to."""
    several = [f"{vehicle_id}@127.0.0.1:{14540 + number}" for number, vehicle_id in enumerate(ids)]
    named = to or (_DEFAULT_STATIONS if len(ids) == 1 else [*several, _DEFAULT_STATIONS[1]])
    stations: dict[int, list[Address]] = {vehicle_id: [] for vehicle_id in ids}
    for text in named:
        own, at, address = text.rpartition("@")
        for vehicle_id in (_vehicle_id("--to", own, ids),) if at else ids:
            stations[vehicle_id].append(_address(address))
    return list(stations.values())


def _lost(texts: list[str], ids: Sequence[int]) -> list[tuple[int, float]]:
    found = []
    for text in texts:
        own, _, time_text = text.partition("@")
        (time_s,) = _numbers("--lose", time_text, (1,), "ID@S")
        found.append((_vehicle_id("--lose", own, ids), time_s))
    return found


def _vehicle_id(option: str, text: str, ids: Sequence[int]) -> int:
    if not text.isdecimal() or int(text) not in ids:
        _refuse(option, f"names the vehicle {text!r}; there are {', '.join(map(str, ids))}")
    return int(text)


def _key(path: Path) -> bytes:
    try:
        return read_key(path)
    except KeyFileError as error:
        return _refuse("--require-signing", str(error))


def _home(text: str) -> Home:
    values = _numbers("--home", text, (2, 3), "LAT,LON[,ALT]")
    if not (abs(values[0]) < 89.0 and abs(values[1]) <= 180.0):
        _refuse("--home", f"needs a latitude within 89 and a longitude within 180 degrees, not {text!r}")
    return Home(values[0], values[1], values[2] if len(values) == 3 else 0.0)


def _home_on_ground(text: str | None, terrain: Path | None, flavour: Flavour) -> Home | None:
    """Return home as it was given, at the height of the ground there if it was given none."""
    home = None if text is None else _home(text)
    if terrain is None or (text is not None and text.count(",") == 2):
        return home
    home = home or DEFAULT_HOMES[flavour]
    try:
        hills = Hills(terrain, HomePlane(home.latitude_deg, home.longitude_deg))
    except HillsError as error:
        _refuse("--terrain", str(error))
    return replace(home, altitude_m=hills.home_altitude_m)


def _east_north(text: str) -> tuple[float, float]:
    east_m, north_m = _numbers("--target-start", text, (2,), "EAST,NORTH")
    return east_m, north_m


def _numbers(option: str, text: str, counts: Collection[int], form: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in counts or not all(math.isfinite(value) for value in values):
        _refuse(option, f"must look like {form} in numbers, not {text!r}")
    return values


def _address(text: str) -> Address:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        _refuse("--to", f"must look like HOST:PORT, not {text!r}")
    try:
        return socket.gethostbyname(host), int(port)
    except OSError:
        return _refuse("--to", f"names the unknown host {host!r}")


def _refuse(option: str, reason: str) -> NoReturn:
    print(f"{option} {reason}", file=sys.stderr)
    raise typer.Exit(2)
