"""``sidelong launch``: the flight of one aircraft or of a fleet, with its displays and its records."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from sidelong.app.analysis.summary import Summary
from sidelong.app.assembly import Prepared, prepared
from sidelong.app.commands.output import console, say, table_progress, warn
from sidelong.app.config import Config
from sidelong.app.errors import FlightError, InputError, Interrupted
from sidelong.app.fleet.fleet_file import FleetFile, planner_in_fleet
from sidelong.app.flight.loop import FlightDisplay
from sidelong.app.flight.recording import Recording
from sidelong.app.flight.shell import Coordinator, FlightEnded, FlyingAircraft, Life, Shell
from sidelong.app.process import interrupt_dropped, run
from sidelong.app.records.run_folder import FleetFolder, RunFolder
from sidelong.app.view.address import PageAddress
from sidelong.app.view.display import ViewDisplay, served
from sidelong.app.view.panel import Panel, keyboard_descriptor

_FLIGHTS = 4  # predicted before a launch: 3 s
_NOTHING_COMMANDED = "interrupted: nothing was commanded; no records are kept."


def fly_recorded(
    settings: Config, duration_s: float, out: Path, quiet: bool, address: PageAddress | None
) -> FlightEnded:
    """Fly an aircraft or a fleet to the end; address: of the live map. Raises Interrupted before any command."""
    try:
        return run(_recorded(settings, duration_s, out, quiet, address))
    except (asyncio.CancelledError, KeyboardInterrupt) as interrupted:
        raise Interrupted(_NOTHING_COMMANDED) from interrupted
    except Exception as error:
        if interrupt_dropped():  # before a flight alone: in it an interrupt raises nothing
            raise Interrupted(_NOTHING_COMMANDED) from error
        raise


async def _recorded(
    settings: Config, duration_s: float, out: Path, quiet: bool, address: PageAddress | None
) -> FlightEnded:
    fleet = settings if isinstance(settings, FleetFile) else None
    folder = (RunFolder if fleet is None else FleetFolder).create(out, datetime.now(UTC))
    configs = {"": settings} if fleet is None else {member.name: member.config for member in fleet.members}
    reserves = [False] if fleet is None else [member.reserve for member in fleet.members]
    life: Life | None = None
    aircraft: list[FlyingAircraft] = []
    try:
        async with _displayed(settings, configs, quiet, address) as (displays, note, view):
            coordinator: Coordinator | None = None
            if fleet is not None and isinstance(folder, FleetFolder):
                from sidelong.app.fleet.flight import FleetFlight  # noqa: PLC0415  # one aircraft needs no coordinator

                coordinator = flight = FleetFlight(fleet, folder, displays, note, table_progress(note))
                if view is not None:
                    view.requests = flight
            for (name, config), reserve in zip(configs.items(), reserves, strict=True):
                own = folder.make(name) if isinstance(folder, FleetFolder) else folder
                aircraft.append(_aircraft(config, own, displays[name], name, reserve))
            life = Life(lambda: any(craft.recording.begun for craft in aircraft), note)
            with life.handling_signals():
                try:
                    ended = await Shell(aircraft, duration_s, life, note, coordinator).fly()
                finally:
                    for craft in aircraft:
                        craft.recording.close()
                if view is not None:
                    view.show_end(ended.summary.rows(), ended.folder.path)
                if ended.is_internal:
                    warn(f"this is a fault of the program; {ended.aircraft}.")
                return _with_records_lost(ended, {craft.name: craft.recording.lost for craft in aircraft})
    except BaseException as error:
        if life is None or not life.was_armed:
            shutil.rmtree(folder.path, ignore_errors=True)
        if isinstance(error, asyncio.CancelledError) and life is not None and life.failure is not None:
            raise FlightError(life.failure) from None
        raise


def _aircraft(config: Config, folder: RunFolder, display: FlightDisplay, name: str, reserve: bool) -> FlyingAircraft:
    loop = asyncio.get_running_loop()

    def trouble(text: str) -> None:
        loop.call_soon_threadsafe(display.note, text)

    def prepare() -> Prepared:
        warn_of_prediction(config, display.note)  # a first flight does not wait for it: nothing is compiled
        return prepared(config, table_progress(display.note), display.note, planner_in_fleet(config))

    recording = Recording(folder, config, trouble)
    return FlyingAircraft(config, folder, recording, display, trouble, prepare, name, reserve)


def _with_records_lost(ended: FlightEnded, lost: dict[str, str]) -> FlightEnded:
    """Let summary and exit code report that records of a flight are incomplete; lost: why, '' if they are not."""
    words = "; ".join(f"{name}: {why}" if name else why for name, why in lost.items() if why)
    if not words:
        return ended
    summary = ended.summary
    if isinstance(summary, Summary):
        summary = replace(summary, records_lost=words)
    reason = ended.reason or FlightError(f"the flight has ended, but its records are incomplete: {words}.")
    return replace(ended, summary=summary, reason=reason)


Displayed = tuple[Mapping[str, FlightDisplay], Callable[[str], None], ViewDisplay | None]


@contextlib.asynccontextmanager
async def _displayed(
    settings: Config, configs: dict[str, Config], quiet: bool, address: PageAddress | None
) -> AsyncIterator[Displayed]:
    fleet = settings if isinstance(settings, FleetFile) else None
    keyboard = keyboard_descriptor() if fleet is None else None
    with Panel(console, quiet, keyboard, fleet is not None and len(fleet.target) > 1) as panel:
        displays = {name: panel.of(name) for name in configs}
        if address is None:
            yield displays, panel.note, None
            return
        sides = {} if fleet is None else {name: asked.side for name, asked in fleet.asked.items()}
        async with served(ViewDisplay(displays, configs, address, sides), say) as view:
            yield {name: view.of(name) for name in configs}, view.note if fleet is None else panel.note, view


def warn_of_prediction(config: Config, note: Callable[[str], object]) -> None:
    """Report what keeps a few simulated flights from the requirement; ``check`` flies more.

    This is left out where it would take up to a minute: before the first compilation, and with figures of eight.
    """
    from sidelong.app.study.prediction import predict  # noqa: PLC0415  # only once the options are checked
    from sidelong.app.study.study import is_compiled  # noqa: PLC0415  # likewise

    if not is_compiled(config.planner.name) or config.aircraft.aircraft().has_pan_limit:
        return  # a first flight does not wait for it
    try:
        prediction = predict(config, flights=_FLIGHTS)
    except InputError as error:  # of the study alone: the flight has been checked
        note(f"how well this requirement can be kept cannot be computed: {error}")
        return
    shortcoming = prediction.shortcoming(config)
    if shortcoming:
        note(f"warning: sidelong check refuses this configuration: {shortcoming}")
