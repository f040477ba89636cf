"""``sidelong launch`` of one aircraft."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from sidelong.app.assembly import Prepared, prepared
from sidelong.app.commands.flying import kept_if_armed, run_flight, warn_of_prediction
from sidelong.app.commands.output import console, say, warn
from sidelong.app.commands.progress import table_progress
from sidelong.app.config import DEMONSTRATION, Config
from sidelong.app.errors import FlightError
from sidelong.app.flight.life import Life
from sidelong.app.flight.loop import FlightDisplay
from sidelong.app.flight.recording import Recording
from sidelong.app.flight.single import FlightEnded, fly_single
from sidelong.app.records.run_folder import RunFolder
from sidelong.app.view.address import PageAddress
from sidelong.app.view.display import ViewDisplay, served
from sidelong.app.view.panel import PanelDisplay
from sidelong.app.view.prompt import keyboard_descriptor


def fly_one(config: Config, duration_s: float, out: Path, quiet: bool, address: PageAddress | None) -> FlightEnded:
    """Fly one aircraft to its end; address: of the live map. Raises as ``launch`` does."""
    return run_flight(_recorded(config, duration_s, out, quiet, address))


async def _recorded(
    config: Config, duration_s: float, out: Path, quiet: bool, address: PageAddress | None
) -> FlightEnded:
    loop = asyncio.get_running_loop()
    folder = RunFolder.create(out, datetime.now(UTC))
    with kept_if_armed(folder.path) as begun:
        async with _displayed(config, quiet, address) as display:

            def note(text: str) -> None:
                loop.call_soon_threadsafe(display.note, text)

            def prepare() -> Prepared:
                warn_of_prediction(config, display.note)  # a first flight does not wait for it: nothing is compiled
                return prepared(config, table_progress(display.note), display.note)

            recording = Recording(folder, config, note)
            life = begun(Life(lambda: recording.begun, display.note))
            with life.heeding_signals():
                with contextlib.closing(recording):
                    ended = await fly_single(config, duration_s, folder, recording, display, life, note, prepare)
                if ended.is_internal:
                    warn(f"this is a fault of the program; {ended.aircraft}.")
                return _with_records_lost(ended, recording.lost)


def _with_records_lost(ended: FlightEnded, lost: str) -> FlightEnded:
    """Let summary and exit code report that records of a flight are incomplete; lost: why, '' if they are not."""
    if not lost:
        return ended
    reason = ended.reason or FlightError(f"the flight has ended, but its records are incomplete: {lost}.")
    return replace(ended, summary=replace(ended.summary, records_lost=lost), reason=reason)


@contextlib.asynccontextmanager
async def _displayed(config: Config, quiet: bool, address: PageAddress | None) -> AsyncIterator[FlightDisplay]:
    """Show the flight on the terminal, and in the browser if it has an address there."""
    with PanelDisplay(console, quiet, keyboard_descriptor(), calm=config.simulation.target == DEMONSTRATION) as panel:
        if address is None:
            yield panel
            return
        async with served(ViewDisplay(panel, config, address), say) as view:
            yield view
