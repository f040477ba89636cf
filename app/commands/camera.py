"""``sidelong camera``: track a target in a video and lead the gimbal, without flying."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sidelong.app.assembly import ground_of, stand_on_ground, tracker_of
from sidelong.app.commands.options import PayloadOption, SetOption, changed_keys
from sidelong.app.commands.output import console, say
from sidelong.app.config import Config, load_config
from sidelong.app.config_files import check_files
from sidelong.app.errors import InputError
from sidelong.app.flight.payload_input import payload_input
from sidelong.app.flight.session import connected
from sidelong.app.flight.streams import ask_for_streams
from sidelong.app.link.message import Message
from sidelong.app.link.transport import checked_url
from sidelong.app.link.vehicle import home_of
from sidelong.app.payload.registry import read_payload
from sidelong.app.process import run
from sidelong.app.records.sensing import Sensing
from sidelong.mission.core.events import Event

if TYPE_CHECKING:
    from sidelong.app.camera.runner import CameraRunner

_STATUS_EVERY_S, _ASK_EVERY_S = 5.0, 1.0


def camera(
    source: Annotated[str | None, typer.Argument(help="rtsp://, udp://, /dev/videoN or a file.")] = None,
    connect: Annotated[list[str] | None, typer.Option(help="MAVSDK URL of its vehicle; else link.url.")] = None,
    payload: PayloadOption = None,
    config: Annotated[Path | None, typer.Option(help="Configuration (TOML) with a [camera].")] = None,
    duration: Annotated[float | None, typer.Option(min=0.5, help="End after this long, s; else by Ctrl-C.")] = None,
    set_: SetOption = None,
) -> None:
    """Be the MAVLink camera of a vehicle: track what a station clicks in the video, and keep the gimbal on it.

    Nothing flies the aircraft. ``sidelong launch --payload rtsp://...`` does the same and flies by it.

    For example:
      sidelong camera rtsp://192.168.144.25:8554/main.264 --connect udpin://0.0.0.0:14540 --payload siyi://192.168.144.25
      sidelong camera /dev/video0 --connect udpin://0.0.0.0:14540 --set camera.stream=udp://127.0.0.1:5600
    """
    kind, url = (None, None) if payload is None else read_payload("--payload", payload)
    settings = load_config(
        config,
        changed_keys(
            set_,
            {"camera": {"source": source}, "link": {"urls": connect or None}, "payload": {"kind": kind, "url": url}},
        ),
    )
    if settings.camera.source is None:
        raise InputError("name the video, such as rtsp://HOST/PATH, or a --config with camera.source.")
    if not settings.link.connections:
        raise InputError("no vehicle is named; give --connect URL, or a --config with link.url.")
    check_files(settings)
    for link in settings.link.connections:
        checked_url(link)
    with contextlib.suppress(KeyboardInterrupt):
        run(_track(settings, duration))


async def _track(settings: Config, duration_s: float | None) -> None:
    from sidelong.app.camera.runner import CameraRunner, Here  # noqa: PLC0415  # an extra

    console.print(f"waiting for a heartbeat on {' and '.join(settings.link.connections)}")
    async with (
        connected(settings.link, console.print) as session,
        payload_input(settings, session.vehicle, console.print) as gimbal,
    ):
        await ask_for_streams(session.vehicle)
        tracker, home = tracker_of(settings), None
        console.print("waiting for the vehicle's position and home")
        while home is None or session.telemetry.plane is None:
            await asyncio.sleep(_ASK_EVERY_S)
            home = await home_of(session.vehicle)
        plane = session.telemetry.plane
        ground = ground_of(settings, plane, (home.latitude_deg, home.longitude_deg))
        stand_on_ground(tracker, settings, ground)
        sensing = Sensing(tracker)

        runner = CameraRunner(
            settings.camera,
            session.vehicle,
            tracker,
            ground,
            console.print,
            Here("sidelong camera", plane, home.altitude_m),
            point=None if gimbal is None else gimbal.point,
        )

        def take(_message: Message, event: Event | None, _admitted: Event | None) -> None:
            if event is not None:
                sensing.take(event)
                runner.camera.event(event)

        session.inputs.listeners.append(take)
        console.print("tracking: click the target in a station's picture; end with Ctrl-C")
        reporting = asyncio.create_task(_report(runner))
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(runner.run(), duration_s)
        reporting.cancel()


async def _report(runner: CameraRunner) -> None:
    while True:
        await asyncio.sleep(_STATUS_EVERY_S)
        latest = runner.camera.latest
        if latest is None:
            say("no picture with a position and an attitude of the gimbal yet")
        else:
            say(f"{latest.tracked.state}, confidence {latest.tracked.confidence:.0%}")
