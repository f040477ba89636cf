"""The command ``sitl``: the simulated vehicle alone, until interrupted."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from sidelong.sitl.binaries import companions_of, ready, run_binaries, served_device, waits
from sidelong.sitl.options import (
    DEFAULT_STATIONS,
    check_programs,
    check_ranges,
    device_of,
    flavour_of,
    home_on_ground,
    lost_at,
    numbers,
    refuse,
    refusing,
    releases_of,
    stations_of,
    targets_of,
    targets_seen,
)
from sidelong.sitl.payload.companion import Companion, accompany
from sidelong.sitl.payload.device_port import Address
from sidelong.sitl.payload.devices import DEVICES
from sidelong.sitl.protocol.link import LinkFaults
from sidelong.sitl.protocol.signing import read_key
from sidelong.sitl.server import Pace, serve
from sidelong.sitl.settings import (
    MAX_VEHICLES,
    STARTS_M,
    Flavour,
    GimbalFrame,
    PayloadSettings,
    RangeMessage,
    Settings,
    in_turn,
)
from sidelong.sitl.simulation import Simulation
from sidelong.sitl.world.airframe import Wind
from sidelong.sitl.world.motion import MOTIONS
from sidelong.sitl.world.truth import TruthFile

_LINK, _PAYLOAD, _RUN, _TARGET, _VEHICLE, _GROUND = (
    partial(typer.Option, rich_help_panel=name)
    for name in ("Link", "Payload", "Run", "Target", "Vehicle", "Wind and ground")
)
_LINE_MAX = 100  # characters


def run(
    autopilot: Annotated[
        str, _VEHICLE(help="Which autopilot it behaves like: arduplane or px4; several vehicles in turn: a,b.")
    ] = Flavour.ARDUPLANE,
    version: Annotated[
        str | None,
        _VEHICLE(
            help="Firmware release it behaves like, such as 4.5 [the newest]; of several vehicles in turn: A,B."
        ),
    ] = None,
    vehicles: Annotated[
        int | None, _VEHICLE(min=1, max=MAX_VEHICLES, help="Number of vehicles [the number of autopilots named]")
    ] = None,
    to: Annotated[
        list[str] | None,
        _LINK(
            metavar="[ID@]HOST:PORT",
            help=f"Where to send to, all vehicles or that one; repeatable [{' and '.join(DEFAULT_STATIONS)}; "
            "each of several vehicles has a port of its own from 14540 on]",
        ),
    ] = None,
    speed: Annotated[float, _RUN(help="Simulated time over wall time.")] = 1.0,
    duration: Annotated[float | None, _RUN(metavar="S", help="Simulated seconds; endless if left out.")] = None,
    seed: Annotated[int, _RUN(min=0, help="Seed of all noise and of the target.")] = 0,
    truth: Annotated[
        list[Path] | None, _RUN(metavar="FILE", help="Write the true tracks as CSV; once for each vehicle.")
    ] = None,
    home: Annotated[str | None, _VEHICLE(metavar="LAT,LON[,ALT]", help="Degrees and metres above sea.")] = None,
    airspeed: Annotated[str, _VEHICLE(help="Cruise airspeed, m/s; of several vehicles in turn: A,B.")] = "15",
    endurance: Annotated[
        str, _VEHICLE(metavar="S", help="Battery life, s; for several vehicles in turn: A,B.")
    ] = "10800",
    wind_speed: Annotated[float, _GROUND(help="Wind speed, m/s.")] = 0.0,
    wind_from_deg: Annotated[float, _GROUND(help="Where the wind comes from, degrees.")] = 0.0,
    system_id: Annotated[
        int | None,
        _VEHICLE(min=1, max=250, help="Of the first vehicle, or of the one --payload-for is meant for [1]"),
    ] = None,
    target: Annotated[
        list[str] | None,
        _TARGET(
            metavar="[NAME=]SPEC",
            help=f"Motion: {', '.join(MOTIONS)}, or a .gpx or .csv track [walk]; repeatable: several targets.",
        ),
    ] = None,
    target_speed: Annotated[
        list[float] | None, _TARGET(help="Greatest speed, m/s [3; for tracks 6]; of several targets in turn.")
    ] = None,
    target_start: Annotated[
        list[str] | None,
        _TARGET(
            metavar="EAST,NORTH",
            help=f"Metres from the first home [{STARTS_M[0][0]:g},{STARTS_M[0][1]:g}]; of several targets in turn.",
        ),
    ] = None,
    target_skip: Annotated[
        float | None, _TARGET(metavar="S", help="Begin a track here [where it becomes lively]")
    ] = None,
    looks_at: Annotated[
        str, _TARGET(metavar="N", help="Which target a payload sees first; of several vehicles in turn: 1,2.")
    ] = "1",
    terrain: Annotated[
        Path | None, _GROUND(metavar="DIR", help="Fly over the ground of these SRTM .hgt tiles [flat]")
    ] = None,
    payload: Annotated[bool, _PAYLOAD(help="Laser and gimbal.")] = True,
    device: Annotated[
        str | None,
        _PAYLOAD(
            metavar="KIND@HOST:PORT",
            help=f"Let the payload speak its maker's protocol, on a port of its own: {', '.join(DEVICES)}.",
        ),
    ] = None,
    payload_for: Annotated[
        str | None,
        _PAYLOAD(metavar="URL", help="No vehicle, only laser, gimbal and target for the vehicle at this URL."),
    ] = None,
    binary: Annotated[
        list[Path] | None,
        _VEHICLE(
            metavar="PATH", help="Your own SITL program of the --autopilot instead of the simulated one; repeatable."
        ),
    ] = None,
    logs: Annotated[
        Path | None,
        _VEHICLE(metavar="DIR", help="Keep the folders of --binary's programs, with their own logs, here."),
    ] = None,
    range_sigma: Annotated[float, _PAYLOAD(help="Laser noise, m.")] = 0.8,
    range_outliers: Annotated[float, _PAYLOAD(help="Fraction of wrong ranges.")] = 0.02,
    range_message: Annotated[
        RangeMessage, _PAYLOAD(help="Message that carries the range.")
    ] = RangeMessage.DISTANCE_SENSOR,
    gimbal_sigma_deg: Annotated[float, _PAYLOAD(help="Gimbal noise, degrees.")] = 0.35,
    gimbal_yaw_bias_deg: Annotated[float, _PAYLOAD(help="Constant gimbal error, degrees.")] = 0.4,
    gimbal_frame: Annotated[GimbalFrame, _PAYLOAD(help="What its yaw is relative to.")] = GimbalFrame.EARTH,
    pan_limit_deg: Annotated[
        float, _PAYLOAD(help="How far the gimbal pans to each side of the nose, degrees.")
    ] = 180.0,
    dropouts: Annotated[float, _PAYLOAD(help="Fraction of the time without range.")] = 0.15,
    payload_latency_ms: Annotated[float, _PAYLOAD(help="Time from measurement to sending, ms.")] = 50.0,
    loss: Annotated[float, _LINK(help="Fraction of packets lost, each way.")] = 0.0,
    delay_ms: Annotated[float, _LINK(help="Wall-clock delay, each way.")] = 0.0,
    duplicate: Annotated[float, _LINK(help="Fraction of packets doubled, each way.")] = 0.0,
    baud: Annotated[
        float, _LINK(help="Of a serial line, each way: what it cannot carry is late, then lost.", show_default=False)
    ] = math.inf,
    lose: Annotated[
        list[str] | None, _VEHICLE(metavar="ID@S", help="Lose a vehicle after this simulated time, s; repeatable.")
    ] = None,
    require_signing: Annotated[
        Path | None, _LINK(metavar="FILE", help="Sign, and accept only messages signed with the key in this file.")
    ] = None,
    while_input: Annotated[
        bool,
        _RUN("--while-input", help="End when standard input ends; wait for the time that a program writes there."),
    ] = False,
) -> None:
    """Fly a simulated vehicle that speaks MAVLink over UDP, with a laser and a gimbal on a moving target.

    For example:
      sidelong sitl --autopilot px4 --target walk --target-speed 4 --speed 10
      sidelong sitl --autopilot arduplane --version 4.5
      sidelong sitl --vehicles 2 --autopilot arduplane,px4
      sidelong sitl --vehicles 4 --target boat=walk --target bike=straight --looks-at 1,2
      sidelong sitl --payload-for tcpout://127.0.0.1:5763    # laser and gimbal for your own SITL
      sidelong sitl --autopilot px4 --binary build/px4_sitl_default/bin/px4
      sidelong sitl --autopilot arduplane,px4 --binary arduplane --binary px4
    """
    flavours = [flavour_of(name) for name in autopilot.split(",")]
    airspeeds_m_s = numbers("--airspeed", airspeed, range(1, MAX_VEHICLES + 1), "A or A,B")
    endurances_s = numbers("--endurance", endurance, range(1, MAX_VEHICLES + 1), "A or A,B")
    programs = binary or []
    named = max(len(flavours), len(airspeeds_m_s), len(endurances_s), len(programs))
    count = vehicles or named
    if named > count:
        refuse("--vehicles", f"is {count}: more autopilots, airspeeds or endurances are named")
    if count > 1 and payload_for is not None:
        refuse("--vehicles", "goes with vehicles that are started here, not with --payload-for")
    check_programs(programs, count, logs)
    device_kind, device_address = device_of(device, only=count == 1 and payload)
    check_ranges(
        {
            "--speed": (speed, 0.0, 1000.0, False),
            "--duration": (math.inf if duration is None else duration, 0.0, math.inf, False),
            "--wind-speed": (wind_speed, 0.0, 0.9 * min(airspeeds_m_s), True),
            "--wind-from-deg": (wind_from_deg, -360.0, 360.0, True),
            "--target-skip": (0.0 if target_skip is None else target_skip, 0.0, math.inf, True),
            "--range-sigma": (range_sigma, 0.0, 100.0, True),
            "--range-outliers": (range_outliers, 0.0, 1.0, True),
            "--gimbal-sigma-deg": (gimbal_sigma_deg, 0.0, 45.0, True),
            "--gimbal-yaw-bias-deg": (gimbal_yaw_bias_deg, -180.0, 180.0, True),
            "--pan-limit-deg": (pan_limit_deg, 0.0, 180.0, False),
            "--dropouts": (dropouts, 0.0, 1.0, True),
            "--payload-latency-ms": (payload_latency_ms, 0.0, 10_000.0, True),
            "--loss": (loss, 0.0, 1.0, True),
            "--delay-ms": (delay_ms, 0.0, 60_000.0, True),
            "--duplicate": (duplicate, 0.0, 1.0, True),
            "--baud": (baud, 1200.0, math.inf, True),
        }
    )
    targets = targets_of(target or ["walk"], target_speed or [None], target_start, target_skip)
    for airspeed_m_s in airspeeds_m_s:
        check_ranges({"--airspeed": (airspeed_m_s, 5.0, 60.0, True)})
    check_ranges({"--endurance": (min(endurances_s), 0.0, math.inf, False)})
    sensors = PayloadSettings(
        range_sigma,
        range_outliers,
        math.radians(gimbal_sigma_deg),
        math.radians(gimbal_yaw_bias_deg),
        dropouts,
        payload_latency_ms / 1000.0,
        range_message,
        gimbal_frame,
        math.radians(pan_limit_deg),
    )
    own_terrain = terrain if payload_for is None else None  # the home of another vehicle comes from its own words
    with refusing(), ExitStack() as stack:
        settings = Settings(
            flavour=flavours[0],
            system_id=system_id or 1,
            seed=seed,
            airspeed_m_s=airspeeds_m_s[0],
            wind=Wind.blowing_from(wind_speed, math.radians(wind_from_deg)),
            home=home_on_ground(home, own_terrain, flavours[0]),
            targets=targets,
            payload=sensors if payload else None,
            device=device_kind,
            signing_key=None if require_signing is None else read_key(require_signing),
            link_rate=speed,
            boot_unix_s=time.time(),
            terrain=own_terrain,
        )
        if len(programs) > 1 and settings.home is None:  # PX4's height control wants to start at sea level
            settings = replace(settings, home=replace(settings.home_or_default, altitude_m=0.0))
        ids = range(settings.system_id, settings.system_id + count)
        if truth and len(truth) != count:
            refuse("--truth", f"is given {len(truth)} times for {count} vehicles")
        stations = stations_of(to, ids)
        seen = targets_seen(looks_at, len(targets))
        each = in_turn(settings, flavours, airspeeds_m_s, endurances_s, count, seen, releases_of(version, flavours))
        alone = payload_for is None and not programs
        if not alone and len(targets) > 1:
            refuse("--target", "is given several times: only simulated vehicles can turn to another")
        simulations = [Simulation(one) for one in each] if alone else []
        companions = [] if alone else companions_of(each, sensors, terrain, system_id)
        for vehicle_id, lost_s in lost_at(lose or [], ids if alone else ()):
            simulations[ids.index(vehicle_id)].lost_s = lost_s
        _write_truth(stack, simulations or companions, truth or [])
        if not alone:
            _accompany(companions, each, programs, payload_for, speed, logs, device_address)
            return

        def report_ready() -> None:
            for simulation, addresses in zip(simulations, stations, strict=True):
                where = ", ".join(f"{host}:{port}" for host, port in addresses)
                own = simulation.settings
                print(f"ready system {own.system_id} component 1 {own.flavour} -> {where}", flush=True)

        pace = Pace(speed) if while_input else None
        serve(
            list(zip(simulations, stations, strict=True)),
            speed=speed,
            duration_s=math.inf if duration is None else duration,
            faults=LinkFaults(loss, duplicate, delay_ms / 1000.0, baud=baud),
            on_ready=report_ready,
            stopped=_stop_signal(pace),
            pace=pace,
            device_address=device_address,
        )


def _write_truth(stack: ExitStack, writers: Sequence[Companion | Simulation], paths: Sequence[Path]) -> None:
    for writer, path in zip(writers, paths, strict=False):
        try:
            opened = stack.enter_context(open(path, "w", encoding="utf-8", opener=_opened_at_once))  # noqa: SIM115
        except OSError as error:
            refuse("--truth", f"{path} cannot be written: {error.strerror}")
        writer.on_truth = TruthFile(opened, waits).write


def _opened_at_once(path: str, flags: int) -> int:
    """Open a file, where a pipe without a reader is an error instead of a wait."""
    opened = os.open(path, flags | os.O_NONBLOCK, 0o666)
    os.set_blocking(opened, True)
    return opened


def _accompany(
    companions: Sequence[Companion],
    settings: Sequence[Settings],
    programs: Sequence[Path],
    url: str | None,
    speed: float,
    logs: Path | None,
    device_address: Address | None,
) -> None:
    """Run the payloads of vehicles that are not ours: of these programs, or of the vehicle at a URL."""
    stopped = _stop_signal()
    with served_device(companions[0], settings[0].device, device_address) as exchange:
        if url is None:
            run_binaries(companions, settings, programs, speed, logs, stopped, exchange)
            return
        accompany(
            companions[0],
            url,
            key=settings[0].signing_key,
            on_ready=lambda vehicle_id: ready(vehicle_id, url),
            on_wait=waits,
            on_turn=exchange,
            stopped=stopped,
        )


def _stop_signal(pace: Pace | None = None) -> Callable[[], bool]:
    """Return a function that reports whether SIGINT or SIGTERM was received or, with pace, standard input closed.

    With pace, a program writes the simulation time it has processed to standard input, line by line.
    """
    received: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda caught, _frame: received.append(caught))
    if pace is not None:

        def wait_for_end() -> None:
            line = b""
            while data := os.read(0, 4096):  # not sys.stdin: its lock, held at the end, would be a fatal error
                *whole, line = (line[-_LINE_MAX:] + data).split(b"\n")
                with contextlib.suppress(ValueError, IndexError):
                    pace.follow(float(whole[-1]), time.monotonic())
            received.append(0)

        threading.Thread(target=wait_for_end, daemon=True).start()
    return lambda: bool(received)
