"""``sidelong export``: a recorded flight for other programs."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from sidelong.app.assembly import tracker_of
from sidelong.app.commands.output import checked_file, console
from sidelong.app.commands.progress import share_progress
from sidelong.app.errors import InputError
from sidelong.app.records.export import MISSIONS, Format
from sidelong.app.records.export import export as write
from sidelong.app.records.klv import KlvLog
from sidelong.app.records.log import open_log
from sidelong.app.records.log_context import LogContext
from sidelong.app.records.mcap import LAYOUT, McapLog
from sidelong.app.records.mcap_writer import McapWriter
from sidelong.app.records.run_folder import FleetFolder, RunFolder
from sidelong.app.records.track import Flight, Mission
from sidelong.app.report.sources import Flown, feed, read_flight
from sidelong.mission.core.plan import Plan
from sidelong.mission.upload.items import plan_items


def export(
    source: Annotated[Path, typer.Argument(help="A run folder of ours, or a tlog, PX4 ULog or ArduPilot .bin.")],
    wanted: Annotated[Format, typer.Option("--format", help="What to write.")] = Format.KML,
    out: Annotated[Path | None, typer.Option("--out", help="The file; otherwise next to the source.")] = None,
    config: Annotated[Path | None, typer.Option(help="Configuration (TOML); a run folder has its own.")] = None,
) -> None:
    """Write a flight for other programs.

    Its last mission: plan, waypoints. Its tracks: kml, geojson, csv, gpx; a log without a target has the aircraft's.
    An animated picture of its last ten minutes: svg. All of it: mcap, for Foxglove and PlotJuggler. The metadata of a
    video: klv (MISB ST 0601). Of a fleet's run folder the tracks of all aircraft go into one file, and so does mcap.

    For example:
      sidelong export runs/20261121T101500Z --format plan
      sidelong export flight.tlog --format gpx
    """
    checked_file("--out", out)
    write_export(source, wanted, out, config)


def write_export(source: Path, wanted: Format, out: Path | None = None, config: Path | None = None) -> None:
    """Write a run folder or log in a format and print the file's name. Raises InputError."""
    if FleetFolder(source).journal.is_file():
        if config is not None:
            raise InputError(f"{source} is the run of a fleet: --config is for the folder of one aircraft in it.")
        _write_fleet(FleetFolder(source), wanted, out)
        return
    if out is None:
        out = source / f"flight.{wanted}" if source.is_dir() else source.with_suffix(f".{wanted}")
    with share_progress(f"reading {source.name}") as progress:
        flown = read_flight(source, config=config, progress=progress, target_needed=False)
    # A run folder's tlog holds what its journal lacks: the autopilot, home and the time of day.
    context = LogContext.of(open_log(RunFolder.open(source).tlog if source.is_dir() else source))
    with _whole(out) as partial:
        if wanted is Format.MCAP:
            _write_mcap(source, flown, context, partial)
        elif wanted is Format.KLV:
            _write_klv(source, flown, context, partial)
        else:
            write([_flight(flown, context)], wanted, partial)
    console.print(f"{wanted}: {out}", soft_wrap=True)
    if wanted is Format.MCAP:
        console.print(f"a layout for Foxglove (Import from file...): {LAYOUT}", soft_wrap=True)


def _write_fleet(folder: FleetFolder, wanted: Format, out: Path | None) -> None:
    """Write the tracks of all aircraft into one file; write single-aircraft formats into each aircraft's folder."""
    sources = {path.parent.name: path.parent for path in sorted(folder.path.glob("*/journal.jsonl"))}
    if wanted in MISSIONS or wanted is Format.KLV:
        if out is not None:
            raise InputError(
                f"{wanted} is of one aircraft: leave out --out, or give the folder of one of {folder.path}."
            )
        for source in sources.values():
            write_export(source, wanted)
        return
    out = folder.path / f"flight.{wanted}" if out is None else out
    flown = {}
    for name, source in sources.items():
        with share_progress(f"reading {name}") as progress:
            flown[name] = read_flight(source, progress=progress, target_needed=False)
    contexts = {name: LogContext.of(open_log(RunFolder(source).tlog)) for name, source in sources.items()}
    if not flown:
        raise InputError(f"{folder.path} holds no flight of an aircraft.")
    with _whole(out) as partial:
        if wanted is Format.MCAP:
            with contextlib.closing(McapWriter(partial, None)) as writer:
                for name, source in sources.items():
                    prefixed = writer.prefixed(f"/{name}", contexts[name].booted)
                    _feed_mcap(source, flown[name], contexts[name], prefixed, name)
        else:
            write([replace(_flight(one, contexts[name]), label=name) for name, one in flown.items()], wanted, partial)
    console.print(f"{wanted}: {out}", soft_wrap=True)


@contextlib.contextmanager
def _whole(out: Path) -> Iterator[Path]:
    """Yield the file to write: an interrupted export leaves the previous file unchanged. A pipe is written directly.

    Raises InputError if the file cannot be written.
    """
    whole = out.is_file() or not out.exists()
    partial = out.with_name(f"{out.name}.partial") if whole else out
    try:
        yield partial
        if whole:
            partial.replace(out)
    except OSError as error:
        raise InputError(f"{out} cannot be written ({error.strerror}); give another file to --out.") from error
    finally:
        if whole:
            partial.unlink(missing_ok=True)


def _write_mcap(source: Path, flown: Flown, context: LogContext, out: Path) -> None:
    with contextlib.closing(McapWriter(out, context.booted)) as writer:
        _feed_mcap(source, flown, context, writer, "aircraft")


def _feed_mcap(source: Path, flown: Flown, context: LogContext, writer: McapWriter, name: str) -> None:
    log = McapLog(writer, flown.history.plane, tracker_of(flown.config), context.home_altitude_m, name)
    with share_progress(f"writing {name}") as progress:
        feed(source, log, progress)


def _write_klv(source: Path, flown: Flown, context: LogContext, out: Path) -> None:
    if context.booted is None or context.home_altitude_m is None:
        raise InputError(f"{source} does not contain the time of day or the altitude of home, which KLV needs.")
    log = KlvLog(
        out, flown.name, flown.history.plane, tracker_of(flown.config), context.booted, context.home_altitude_m
    )
    try:
        with share_progress(f"writing {out.name}") as progress:
            feed(source, log, progress)
    finally:
        log.close()


def _flight(flown: Flown, context: LogContext) -> Flight:
    history, settings = flown.history, flown.config
    mission = None
    if history.circles:
        departed = [change.plan for change in history.plan_changes if change.departed_s is not None]
        last = departed[-1] if departed else Plan(history.circles[-1][1])
        tracking = context.autopilot.tracking(settings.aircraft.airspeed_m_s)
        items = plan_items(last, history.plane, settings.aircraft.height_m, settings.planner.tolerance_m, tracking)
        fences = history.asked.keep_in, history.asked.keep_out
        mission = Mission(items, settings.aircraft.airspeed_m_s, context.autopilot.mav_autopilot, *fences)
    return Flight(
        flown.name,
        history.plane,
        history.positions,
        history.estimates,
        history.circles,
        mission,
        context.booted,
        context.home_altitude_m,
        targets=history.targets,
        route=history.route,
    )
