"""``sidelong payload``: one payload driver alone, for tools that read MAVLink."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.commands.output import JsonOption, checked_output, console, say, write_json
from sidelong.app.config import Config, load_config
from sidelong.app.errors import FlightError, InputError
from sidelong.app.flight.payload_input import PayloadRunner, driver_of
from sidelong.app.link.transport import Transport, opened
from sidelong.app.network import NetworkAddress
from sidelong.app.payload.driver import Measured
from sidelong.app.payload.registry import KIND_NAMES, MAVLINK, read_payload
from sidelong.app.payload.session import COMPONENT, PayloadStatus, fields_of, packed, pan_words
from sidelong.app.process import run
from sidelong.estimators.rotations import sight_direction


def payload_values(status: PayloadStatus) -> dict[str, Any]:
    """Return the status as plain values, angles in degrees; None where something is not known."""
    direction = None if status.angles is None else sight_direction(status.angles.quaternion_wxyz)
    return {
        "model": status.identity.model or None,
        "firmware": status.identity.firmware or None,
        "has_laser": status.identity.has_laser,
        "pan_limits_deg": degrees_of(status.identity.pan_limits_rad),
        "range_hz": status.range_hz,
        "angles_hz": status.angles_hz,
        "round_trip_s": status.round_trip_s,
        "damaged_frames": status.damaged,
        "range_m": None if status.range is None else status.range.slant_range_m,
        "yaw_deg": None if direction is None else math.degrees(math.atan2(direction[1], direction[0])),
        "pitch_deg": None if direction is None else math.degrees(-math.asin(max(-1.0, min(1.0, direction[2])))),
        "angles_relative_to": None if status.angles is None else status.angles.frame,
        "height_ratio": status.height_ratio,
        "missing": list(status.missing),
    }


def payload_lines(name: str, status: PayloadStatus) -> list[str]:
    """Return what a payload measures and lacks, a line each, for the terminal."""
    values = payload_values(status)
    model = values["model"] or "model unknown"
    firmware = f", firmware {values['firmware']}" if values["firmware"] else ""
    delay = "" if status.round_trip_s is None else f", round trip {1000.0 * status.round_trip_s:.0f} ms"
    damaged = f", {status.damaged} damaged frames" if status.damaged else ""
    lines = [
        f"payload {name}: {model}{firmware}",
        f"  range at {status.range_hz:.1f} Hz, angles at {status.angles_hz:.1f} Hz{delay}{damaged}",
    ]
    now = []
    if status.range is not None and status.range_hz:
        now.append(f"range {values['range_m']:.1f} m")
    if status.angles is not None and status.angles_hz:
        frame = {"vehicle": "heading", "body": "airframe", "earth": "north"}[status.angles.frame]
        now.append(f"yaw {values['yaw_deg']:.1f}, pitch {values['pitch_deg']:.1f} degrees, relative to {frame}")
    if now:
        lines.append(f"  now: {', '.join(now)}")
    compared = "not compared (on the ground, or too few ranges)"
    if status.height_ratio is not None:
        compared = f"{status.height_ratio:.2f} times the autopilot's height above home"
    lines.append(f"  height by range and angles: {compared}")
    lines += [f"  {words}" for words in pan_words(status.identity.pan_limits_rad)]
    return lines + [f"  missing: {what}" for what in status.missing]


def degrees_of(limits_rad: tuple[float, float] | None) -> list[float] | None:
    return None if limits_rad is None else [round(math.degrees(limit_rad), 1) for limit_rad in limits_rad]


_STATUS_EVERY_S, _HEARTBEAT_EVERY_S = 5.0, 1.0


def payload(
    device: Annotated[
        str | None,
        typer.Argument(
            metavar="KIND://HOST[:PORT]", help=f"Also KIND:///dev/NAME[:BAUD]; {', '.join(KIND_NAMES[1:])}."
        ),
    ] = None,
    to: Annotated[str | None, typer.Option(metavar="udpout:HOST:PORT", help="Publish as MAVLink there.")] = None,
    config: Annotated[Path | None, typer.Option(help="Configuration (TOML) with a [payload].")] = None,
    system_id: Annotated[int, typer.Option(min=1, max=255, help="MAVLink system id to publish as.")] = 1,
    duration: Annotated[float | None, typer.Option(min=0.5, help="End after this long, s; else by Ctrl-C.")] = None,
    json: JsonOption = None,
) -> None:
    """Read one payload by its own protocol and print what it delivers; with --to, publish it as MAVLink.

    Published are DISTANCE_SENSOR and GIMBAL_DEVICE_ATTITUDE_STATUS of component 154, stamped with the time since the
    start. Nothing is commanded but what the payload needs to measure.

    For example:
      sidelong payload siyi://192.168.144.25
      sidelong payload siyi://192.168.144.25 --to udpout:127.0.0.1:14550
      sidelong payload viewpro:///dev/ttyUSB0:115200
    """
    checked_output(json)
    kind, url = (None, None) if device is None else read_payload("payload", device)
    settings = load_config(config, {"payload": {"kind": kind, "url": url}})
    if settings.payload.kind == MAVLINK:
        raise InputError("name a payload with a driver, such as siyi://HOST, or a --config with payload.kind.")
    target = None if to is None else _opened(to)
    status: dict[str, Any] = {}
    with contextlib.suppress(KeyboardInterrupt):
        run(_serve(settings, target, system_id, duration, status))
    write_json(json, status)
    if duration is not None and status and not status["angles_hz"]:
        raise FlightError(f"{settings.payload.kind}: {status['missing'][0]}.")


def _opened(to: str) -> Transport:
    try:
        host, port = NetworkAddress.read(to if "//" in to else to.replace(":", "://", 1), ["udpout"]).resolved("--to")
        return opened(f"udpout://{host}:{port}")
    except (OSError, ValueError) as error:
        raise InputError(f"--to {to!r:.80}: give udpout:HOST:PORT.") from error


async def _serve(
    settings: Config, target: Transport | None, system_id: int, duration_s: float | None, status: dict[str, Any]
) -> None:
    begun_s = time.monotonic()
    encoder = mavlink.MAVLink(None, system_id, COMPONENT)

    def publish(data: bytes | None) -> None:
        if target is not None and data is not None:
            encoder.seq = (encoder.seq + 1) % 256
            target.send(data)

    def measured(one: Measured, time_s: float) -> None:
        publish(packed(*fields_of(one, max(time_s - begun_s, 0.001)), encoder))

    name, url, session = driver_of(settings.payload, console.print)
    console.print(f"reading {name}; end with Ctrl-C")
    runner = PayloadRunner(url, session, 1.0, measured, console.print)
    running = asyncio.create_task(runner.run())
    try:
        next_status_s = begun_s + _STATUS_EVERY_S
        while duration_s is None or time.monotonic() < begun_s + duration_s:
            await asyncio.sleep(_HEARTBEAT_EVERY_S if duration_s is None else min(_HEARTBEAT_EVERY_S, duration_s))
            heartbeat = mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_GIMBAL, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
            )
            publish(heartbeat.pack(encoder))
            status.clear()
            status.update(payload_values(runner.status()))
            if time.monotonic() >= next_status_s:
                next_status_s += _STATUS_EVERY_S
                for line in payload_lines(name, runner.status()):
                    say(line)
    finally:
        for line in payload_lines(name, runner.status()):
            say(line)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        if target is not None:
            target.close()
