"""``sidelong export``: a recorded flight for other programs."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from sidelong.app.assembly import tracker_of
from sidelong.app.autopilots.registry import AUTOPILOTS, autopilot_by_name
from sidelong.app.commands.options import ConfigOption
from sidelong.app.commands.output import checked_file, say, share_progress, warn_of_log, writing
from sidelong.app.errors import InputError
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.records.export import MISSIONS, FlownTrack, Format, Mission
from sidelong.app.records.export import export as write
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.klv import KlvLog, UasMetadata
from sidelong.app.records.log import LogContext, open_log
from sidelong.app.records.mcap import LAYOUT, McapLog, McapWriter
from sidelong.app.records.run_folder import FleetFolder, RunFolder, recording
from sidelong.app.records.text_file import whole_file
from sidelong.app.report.history import FlightRecord, Sink, feed, read_flight
from sidelong.mission.core.plan import Plan
from sidelong.mission.upload.items import plan_items

_REASON_MAX = 100  # characters


def export(
    source: Annotated[Path, typer.Argument(help="A run folder of ours, or a tlog, PX4 ULog or ArduPilot .bin.")],
    wanted: Annotated[Format, typer.Option("--format", help="What to write.")] = Format.KML,
    out: Annotated[Path | None, typer.Option("--out", help="The file; otherwise next to the source.")] = None,
    config: ConfigOption = None,
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
    with _in_words(source):
        write_export(recording(source), wanted, out, config)


@contextlib.contextmanager
def _in_words(source: Path) -> Iterator[None]:
    """Turn what values of a recording that no flight has lead to, in any format, into InputError."""
    try:
        yield
    except (ArithmeticError, LookupError, TypeError, ValueError, struct.error) as error:
        reason = f"{error}".partition("\n")[0][:_REASON_MAX] or type(error).__name__
        raise InputError(f"{source}: has values that cannot be exported ({reason}); give another one.") from error


def write_export(source: Path, wanted: Format, out: Path | None = None, config: Path | None = None) -> None:
    """Write a run folder or log in a format and print the file's name. Raises InputError.

    The tracks of a fleet's aircraft go into one file, formats of one aircraft into each aircraft's folder.
    """
    fleet = FleetFolder(source)
    sources = {"": source}
    if fleet.journal.is_file():
        if config is not None:
            raise InputError(f"{source} is the run of a fleet: --config is for the folder of one aircraft in it.")
        sources = {path.parent.name: path.parent for path in sorted(fleet.path.glob("*/journal.jsonl"))}
        if wanted in MISSIONS or wanted is Format.KLV:
            if out is not None:
                raise InputError(f"{wanted} is of one aircraft: leave out --out, or give one's folder.")
            for folder in sources.values():
                write_export(folder, wanted)
            return
        if not sources:
            raise InputError(f"{fleet.path} holds no flight of an aircraft.")
    if out is None:
        out = source / f"flight.{wanted}" if source.is_dir() else source.with_suffix(f".{wanted}")
    aircraft = [_aircraft(name, path, config) for name, path in sources.items()]
    with writing(out, "--out"), whole_file(out) as partial:
        if wanted is Format.MCAP:
            _write_mcap(aircraft, partial)
        elif wanted is Format.KLV:
            _write_klv(aircraft[0], partial)
        else:
            write([_flight(craft) for craft in aircraft], wanted, partial)
    say(f"{wanted}: {out}")
    if wanted is Format.MCAP and not fleet.journal.is_file():
        say(f"a layout for Foxglove (Import from file...): {LAYOUT}")


class _Aircraft(NamedTuple):
    name: str
    source: Path
    flown: FlightRecord
    context: LogContext

    def feed(self, sink: Sink) -> None:
        with share_progress(f"writing {self.name or self.source.name}") as progress:
            feed(self.source, sink, progress)


def _aircraft(name: str, source: Path, config: Path | None) -> _Aircraft:
    with share_progress(f"reading {name or source.name}") as progress:
        warn = partial(warn_of_log, source)
        flown = read_flight(source, config=config, progress=progress, target_needed=False, warn=warn)
    return _Aircraft(name, source, flown, flown.context or _context(RunFolder.open(source)))


def _context(run: RunFolder) -> LogContext:
    if run.tlog.is_file():  # it has the time of day, which the journal lacks
        return open_log(run.tlog).context()
    header = JournalReader(run.journal, JOURNAL_TYPES).header
    return LogContext(autopilot_by_name(header.autopilot) or AUTOPILOTS[0], header.home_altitude_m)


def _write_mcap(aircraft: list[_Aircraft], out: Path) -> None:
    with contextlib.closing(McapWriter(out)) as writer:
        for craft in aircraft:
            tracker, plane, context = tracker_of(craft.flown.config), craft.flown.history.plane, craft.context
            craft.feed(McapLog(writer, plane, tracker, context.booted, context.home_altitude_m, craft.name))


def _write_klv(one: _Aircraft, out: Path) -> None:
    booted, home_altitude_m, flown = one.context.booted, one.context.home_altitude_m, one.flown
    if booted is None or home_altitude_m is None:
        raise InputError(f"{one.source} does not contain the time of day or the altitude of home, which KLV needs.")
    metadata = UasMetadata(flown.name, flown.history.plane, booted, home_altitude_m, flown.config.camera.view_rad())
    with contextlib.closing(KlvLog(out, metadata, tracker_of(flown.config))) as log:
        one.feed(log)


def _flight(one: _Aircraft) -> FlownTrack:
    history, settings, context = one.flown.history, one.flown.config, one.context
    mission = None
    if history.circles:
        departed = [change.plan for change in history.plan_changes if change.departed_s is not None]
        last = departed[-1] if departed else Plan(history.circles[-1][1])
        tracking = context.autopilot.tracking(settings.aircraft.airspeed_m_s)
        items = plan_items(last, history.plane, settings.aircraft.height_m, settings.planner.tolerance_m, tracking)
        fences = history.asked.keep_in, history.asked.keep_out
        mission = Mission(items, settings.aircraft.airspeed_m_s, context.autopilot.mav_autopilot, *fences)
    return FlownTrack(
        one.flown.name,
        history.plane,
        history.positions,
        history.estimates,
        history.circles,
        mission,
        context.booted,
        context.home_altitude_m,
        one.name,
        history.targets,
        history.route,
    )
