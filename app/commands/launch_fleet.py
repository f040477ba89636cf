"""``sidelong launch`` of a fleet."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from datetime import UTC, datetime
from pathlib import Path

from sidelong.app.commands.flying import kept_if_armed, run_flight, warn_of_prediction
from sidelong.app.commands.output import console, say
from sidelong.app.commands.progress import table_progress
from sidelong.app.fleet.fleet_file import FleetFile
from sidelong.app.fleet.flight import FleetEnded, FleetFlight
from sidelong.app.fleet.panel import FleetPanel
from sidelong.app.fleet.view import FleetView
from sidelong.app.flight.life import Life
from sidelong.app.records.run_folder import FleetFolder
from sidelong.app.view.address import PageAddress
from sidelong.app.view.display import served


def fly_fleet(fleet: FleetFile, duration_s: float, out: Path, quiet: bool, address: PageAddress | None) -> FleetEnded:
    """Fly a fleet to its end; address: of the live map. Raises as ``launch`` does."""
    return run_flight(_fly(fleet, duration_s, out, quiet, address))


async def _fly(
    fleet: FleetFile, duration_s: float, out: Path, quiet: bool, address: PageAddress | None
) -> FleetEnded:
    folder = FleetFolder.create(out, datetime.now(UTC))
    with kept_if_armed(folder.path) as begun:
        async with _displayed(fleet, quiet, address) as (panel, view):
            flight = FleetFlight(fleet, folder, (view or panel).of, panel.note, duration_s)
            if view is not None:
                view.requests = flight
            life = begun(Life(lambda: flight.begun, panel.note))
            with life.heeding_signals():
                with life.computing():
                    for member in fleet.members:
                        warn_of_prediction(member.config, panel.note)
                return await flight.fly(life, table_progress(panel.note))


@contextlib.asynccontextmanager
async def _displayed(
    fleet: FleetFile, quiet: bool, address: PageAddress | None
) -> AsyncIterator[tuple[FleetPanel, FleetView | None]]:
    """Show the flight on the terminal, and in the browser if it has an address there."""
    with FleetPanel(console, quiet, len(fleet.target) > 1) as panel:
        if address is None:
            yield panel, None
            return
        sides = {name: asked.side for name, asked in fleet.asked.items()}
        page = FleetView(panel, {one.name: one.config for one in fleet.members}, address, sides)
        async with served(page, say) as view:
            yield panel, view
