"""``sidelong launch`` of one aircraft."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from sidelong.app.analysis.summary import Summary
from sidelong.app.analysis.truth import truth_if_whole
from sidelong.app.assembly import controller_of
from sidelong.app.commands.expected import warn_of_prediction
from sidelong.app.commands.flying import kept_if_armed, run_flight
from sidelong.app.commands.output import console, warn
from sidelong.app.commands.progress import table_progress
from sidelong.app.config import DEMONSTRATION, Config
from sidelong.app.errors import FlightError, InputError, Interrupted
from sidelong.app.flight.display import FlightDisplay
from sidelong.app.flight.flight import Flight, Sharing, connected
from sidelong.app.flight.life import Life, describe_aircraft
from sidelong.app.flight.link_log import ClockRate, link_log
from sidelong.app.flight.payload_input import payload_input
from sidelong.app.flight.recording import Recording
from sidelong.app.flight.simulated import SimulatedVehicles
from sidelong.app.link.discovery import SETTLING_S
from sidelong.app.records.run_folder import RunFolder
from sidelong.app.view.address import Address
from sidelong.app.view.display import ViewDisplay, served
from sidelong.app.view.panel import PanelDisplay
from sidelong.app.view.prompt import keyboard_descriptor


@dataclass(frozen=True, slots=True)
class FlightEnded:
    """How a flight ended. reason: the error to report and to exit with, None after a regular end."""

    folder: RunFolder
    summary: Summary
    reason: Exception | None


def fly_one(
    config: Config, duration_s: float, out: Path, quiet: bool, point_gimbal: bool, address: Address | None
) -> FlightEnded:
    """Fly one aircraft to its end; address: of the live map. Raises as ``launch`` does."""
    return run_flight(_recorded(config, duration_s, out, quiet, Sharing(point_gimbal), address))


async def _recorded(
    config: Config, duration_s: float, out: Path, quiet: bool, sharing: Sharing, address: Address | None
) -> FlightEnded:
    loop = asyncio.get_running_loop()
    folder = RunFolder.create(out, datetime.now(UTC))
    with kept_if_armed(folder.path) as begun:
        async with _displayed(config, quiet, address) as display:

            def note(text: str) -> None:
                loop.call_soon_threadsafe(display.note, text)

            recording = Recording(folder, config, note)
            life = begun(Life(lambda: recording.begun, display.note))
            with life.heeding_signals():
                with contextlib.closing(recording):
                    ended = await _fly(config, duration_s, folder, recording, display, sharing, life, note)
                return _with_records_lost(ended, recording.lost)


def _with_records_lost(ended: FlightEnded, lost: str) -> FlightEnded:
    """Let summary and exit code report that records of a flight are incomplete; lost: why, '' if they are not."""
    if not lost:
        return ended
    reason = ended.reason or FlightError(f"the flight has ended, but its records are incomplete: {lost}.")
    return replace(ended, summary=replace(ended.summary, records_lost=lost), reason=reason)


@contextlib.asynccontextmanager
async def _displayed(config: Config, quiet: bool, address: Address | None) -> AsyncIterator[FlightDisplay]:
    """Show the flight on the terminal, and in the browser if it has an address there."""
    with PanelDisplay(console, quiet, keyboard_descriptor(), calm=config.simulation.target == DEMONSTRATION) as panel:
        if address is None:
            yield panel
            return
        async with served(ViewDisplay(panel, config, address), partial(console.print, soft_wrap=True)) as view:
            yield view


async def _fly(
    config: Config,
    duration_s: float,
    folder: RunFolder,
    recording: Recording,
    display: FlightDisplay,
    sharing: Sharing,
    life: Life,
    note: Callable[[str], None],
) -> FlightEnded:
    async with contextlib.AsyncExitStack() as stack:
        with life.computing():
            controller = controller_of(config, table_progress(display.note), display.note)
            warn_of_prediction(config, display.note)
        urls, truth, simulated = config.link.connections, None, None
        if not urls:
            display.note(f"starting a simulated {config.simulation.autopilot} and its target")
            simulated = SimulatedVehicles([config], [folder.truth], life.fail)
            await stack.enter_async_context(simulated)
            urls, truth = simulated.urls, folder.truth
        display.note(f"connecting to {' and '.join(urls)}")
        link = config.link
        session = await stack.enter_async_context(
            connected(
                urls,
                link.heartbeat_timeout_s,
                recording.frame,
                link.signing_key_file,
                note,
                system_id=link.system_id if link.connections else None,
                settling_s=SETTLING_S if link.connections else 0.0,
            )
        )
        display.note(f"connected to {session.autopilot.name}, system {session.vehicle.system_id}")
        recording.follow(session.vehicle.system_id)
        simulated_url = None if simulated is None else simulated.payload_url
        payload = await stack.enter_async_context(
            payload_input(config, session.vehicle, display.note, recording.frame, simulated_url)
        )
        life.watch(session.vehicle)
        flight = Flight(session, config, controller, recording, display, duration_s, sharing, payload)
        if simulated is not None:
            pace = asyncio.create_task(simulated.keep_pace(lambda: flight.come_to_s))
            stack.callback(pace.cancel)
        clock_rate = ClockRate(lambda: session.telemetry.now_s)
        try:
            async with link_log(session.vehicle.link, folder.links, clock_rate, note):
                outcome, error = await flight.fly(life.stopped), None
        except Exception as raised:
            if not life.was_armed and not isinstance(raised, FlightError):
                raise
            outcome, error = f"failed: {raised}", raised
        links = tuple(report.as_json(clock_rate.mean) for report in session.vehicle.link.reports())
        aircraft = describe_aircraft(
            session.vehicle, session.autopilot, controller.snapshot(), simulated=truth is not None
        )
    # Only now, with the simulated vehicle ended, is its truth file whole.
    if life.failure is not None:
        outcome = f"failed: {life.failure}"
    summary = replace(flight.summary(outcome, truth_if_whole(truth, controller.time_s, display.note)), links=links)
    if life.failure is not None:
        return FlightEnded(folder, summary, FlightError(life.failure))
    if life.signal_name is not None:
        return FlightEnded(folder, summary, Interrupted(f"interrupted by {life.signal_name}: {aircraft}."))
    if isinstance(error, FlightError | InputError):
        return FlightEnded(folder, summary, FlightError(f"{error} Now {aircraft}."))
    if error is not None:
        warn(f"this is a fault of the program; {aircraft}.")
    return FlightEnded(folder, summary, error)
