"""``sidelong launch`` of a fleet."""

from __future__ import annotations

import asyncio
import shutil
from datetime import UTC, datetime
from pathlib import Path

from app.commands.output import console, table_progress
from app.errors import FlightError, Interrupted
from app.fleet_file import FleetFile
from app.flight.fleet_flight import FleetEnded, FleetFlight
from app.flight.flight import Sharing
from app.flight.life import Life
from app.records.run_folder import FleetFolder
from app.shutdown import run
from app.view.fleet_panel import FleetPanel


def fly_fleet(fleet: FleetFile, duration_s: float, out: Path, quiet: bool, sharing: Sharing) -> FleetEnded:
    """Fly a fleet to its end. Raises as ``launch`` does."""
    try:
        return run(_fly(fleet, duration_s, out, quiet, sharing))
    except (asyncio.CancelledError, KeyboardInterrupt) as interrupted:
        raise Interrupted("interrupted: nothing was commanded; no records are kept.") from interrupted


async def _fly(fleet: FleetFile, duration_s: float, out: Path, quiet: bool, sharing: Sharing) -> FleetEnded:
    folder = FleetFolder.create(out, datetime.now(UTC))
    keep, life = False, None
    try:
        with FleetPanel(console, quiet) as panel:
            flight = FleetFlight(fleet, folder, panel.of, panel.note, duration_s, sharing)
            life = Life(lambda: flight.begun, panel.note)
            with life.heeding_signals():
                try:
                    ended = await flight.fly(life, table_progress(panel.note))
                    keep = True
                    return ended
                finally:
                    keep |= life.was_armed
    except asyncio.CancelledError:
        if life is not None and life.failure is not None:
            raise FlightError(life.failure) from None
        raise
    finally:
        if not keep:
            shutil.rmtree(folder.path, ignore_errors=True)  # nothing has flown: leave nothing half-written
