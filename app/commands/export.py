"""``sidelong export``: a recorded flight for other programs."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from app.commands.output import console, progress_bar
from app.link.modes import AUTOPILOT_PX4
from app.records.export import Format
from app.records.export import export as write
from app.records.log import open_log
from app.records.run_folder import RunFolder
from app.records.track import Flight, Mission
from app.report.sources import Flown, read_flight
from mission.core.plan import Plan
from mission.upload.items import plan_items
from mission.upload.line_tracking import arduplane, px4

_CONTEXT_MESSAGES = frozenset({"HEARTBEAT", "HOME_POSITION", "GLOBAL_POSITION_INT"})
_TRACKING = {"arduplane": arduplane, "px4": px4}


def export(
    source: Annotated[
        Path, typer.Argument(help="A run folder of ours, or a tlog, PX4 ULog or ArduPilot .bin.", show_default=False)
    ],
    wanted: Annotated[Format, typer.Option("--format", help="What to write.")] = Format.KML,
    out: Annotated[
        Path | None, typer.Option("--out", help="The file; otherwise beside the source.", show_default=False)
    ] = None,
    config: Annotated[Path | None, typer.Option(help="Configuration (TOML); a run folder has its own.")] = None,
) -> None:
    """Write a flight for other programs: its last mission (plan, waypoints) or its tracks (kml, geojson, csv, gpx).

    Examples: sidelong export runs/20261121T101500Z --format plan; sidelong export flight.tlog --format gpx
    """
    if out is None:
        out = source / f"flight.{wanted}" if source.is_dir() else source.with_suffix(f".{wanted}")
    progress, task = progress_bar(source.name)
    with progress:
        flown = read_flight(source, config=config, progress=lambda share: progress.update(task, completed=share))
    context = _Context()
    # A run folder's tlog tells what its journal does not: the autopilot, home and the time of day.
    log = open_log(RunFolder.open(source).tlog if source.is_dir() else source)
    for message in log.messages(_CONTEXT_MESSAGES):
        context.take(message.name, message.fields, message.received_s)
    write(_flight(flown, context), wanted, out)
    console.print(f"{wanted}: {out}", soft_wrap=True)


class _Context:
    """What a log tells beside the flight itself."""

    def __init__(self) -> None:
        self.autopilot = "arduplane"
        self.booted: datetime | None = None
        self.home_altitude_m: float | None = None

    def take(self, name: str, fields: Mapping[str, Any], received_s: float) -> None:
        if name == "HEARTBEAT" and fields["autopilot"] == AUTOPILOT_PX4:
            self.autopilot = "px4"
        elif name == "HOME_POSITION":
            self.home_altitude_m = fields["altitude"] * 1e-3
        elif name == "GLOBAL_POSITION_INT" and self.booted is None:
            self.booted = datetime.fromtimestamp(received_s - fields["time_boot_ms"] * 1e-3, UTC)


def _flight(flown: Flown, context: _Context) -> Flight:
    history, settings = flown.history, flown.config
    mission = None
    if history.circles:
        departed = [change.plan for change in history.plan_changes if change.departed_s is not None]
        last = departed[-1] if departed else Plan(history.circles[-1][1])
        tracking = _TRACKING[context.autopilot](settings.aircraft.airspeed_m_s)
        items = plan_items(last, history.plane, settings.aircraft.height_m, settings.planner.tolerance_m, tracking)
        fences = history.asked.keep_in, history.asked.keep_out
        mission = Mission(items, settings.aircraft.airspeed_m_s, context.autopilot, *fences)
    return Flight(
        flown.name,
        history.plane,
        history.positions,
        history.estimates,
        history.circles,
        mission,
        context.booted,
        context.home_altitude_m,
    )
