"""The flight of a fleet, read from its folder, and its report with links to the page of each aircraft."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, fields
from html import escape

from sidelong.app.analysis.score import Asked
from sidelong.app.analysis.summary import (
    AircraftSummary,
    FleetSummary,
    FlownAircraft,
    MissionTrack,
    TargetSummary,
    summarise_fleet,
)
from sidelong.app.config import validated
from sidelong.app.errors import InputError
from sidelong.app.fleet.coordination import FLEET_JOURNAL_TYPES
from sidelong.app.fleet.fleet_file import FleetFile
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.run_folder import FleetFolder, RunFolder
from sidelong.app.records.text_file import Progress
from sidelong.app.report import html
from sidelong.app.report.history import FlightRecord, read_flight, read_summary
from sidelong.mission.core.requirement import Requirement
from sidelong.mission.fleet.events import ClockReported, FleetAnnounce, RequirementChanged, VehicleReported
from sidelong.mission.viewpoint.watch_course import side_words


@dataclass(frozen=True, slots=True, eq=False)
class AircraftPart(FlownAircraft):
    flown: FlightRecord


@dataclass(frozen=True, slots=True, eq=False)
class FleetFlown:
    """The flight of a fleet: those of its aircraft that flew.

    asked: (since, requirement) of each target, in mission time; the first from -inf on. said: the coordinator's
    messages, in mission time.
    """

    name: str
    program: str
    asked: dict[str, list[tuple[float, Requirement]]]
    aircraft: tuple[AircraftPart, ...]
    announced: tuple[FleetAnnounce, ...]
    summary: FleetSummary


def read_fleet(folder: FleetFolder, progress: Progress = lambda _share: None) -> FleetFlown:
    """Read the folder of a fleet's run. Raises InputError naming the file at fault, or where nothing has flown."""
    journal = JournalReader(folder.journal, FLEET_JOURNAL_TYPES)
    fleet = validated(FleetFile, journal.header.config, f"{folder.journal}: its configuration cannot be used")
    offsets_s: dict[str, float] = {}
    tracks: dict[str, MissionTrack] = defaultdict(MissionTrack)
    announced: list[FleetAnnounce] = []
    asked = {name: [(-math.inf, first)] for name, first in fleet.asked.items()}
    for record in journal:
        match record:
            case ClockReported():
                offsets_s[record.name] = record.mission_time_s - record.time_s
            case VehicleReported() if record.name in offsets_s:
                at_s = record.state.time_s + offsets_s[record.name]
                tracks[record.name].add(at_s, record.state.east_m, record.state.north_m, record.height_m)
            case FleetAnnounce():
                announced.append(record)
            case RequirementChanged():
                asked[record.target].append((record.mission_time_s, record.requirement))
    names = [member.name for member in fleet.members if RunFolder(folder.path / member.name).journal.is_file()]
    names = [name for name in names if name in offsets_s]
    if not names:
        raise InputError(f"{folder.path} holds no flight: no clock of an aircraft was received.")
    aircraft = []
    for k, name in enumerate(names):
        flown = read_flight(folder.path / name, progress=lambda share, k=k: progress((k + share) / len(names)))  # type: ignore[misc]
        judged = flown.summary, flown.history.moments
        aircraft.append(AircraftPart(name, *judged, offsets_s[name], tracks[name], flown))
    # The figures of a run that was cut off are worth having all the same.
    if folder.summary.exists():
        summary = _written(folder)
    else:
        outcome = "; ".join(sorted({craft.summary.outcome for craft in aircraft}))
        by_truth = all(craft.flown.history.judged_by_truth for craft in aircraft)
        summary = summarise_fleet(aircraft, asked, outcome, "truth" if by_truth else "estimate")
    name = folder.path.resolve().name
    return FleetFlown(name, journal.header.program, asked, tuple(aircraft), tuple(announced), summary)


def _written(folder: FleetFolder) -> FleetSummary:
    values, name = folder.read_summary(), str(folder.summary)
    try:
        parts = ("targets", "aircraft")
        plain = {field.name: values[field.name] for field in fields(FleetSummary) if field.name not in parts}
        targets = tuple(TargetSummary(**target) for target in values.get("targets", ()))
        aircraft = tuple(
            AircraftSummary(craft["name"], read_summary(craft, name), craft.get("time_on_wanted_side"))
            for craft in values["aircraft"]
        )
    except (KeyError, TypeError) as error:
        raise InputError(f"{name}: a figure is missing or wrong; delete it to have it written again.") from error
    return FleetSummary(**plain, targets=targets, aircraft=aircraft)


def fleet_page(flown: FleetFlown, pages: Mapping[str, str]) -> str:
    """Return the page. pages: where each aircraft's own is, as seen from it."""
    begin_s = max(craft.flown.history.start_s + craft.offset_s for craft in flown.aircraft)  # all are watching
    words = {name: _asked_words(asked, begin_s) for name, asked in flown.asked.items()}
    wanted = "; ".join(f"{name} {own}" for name, own in words.items())
    links = ", ".join(f'<a href="{escape(page)}">{escape(name)}</a>' for name, page in pages.items())
    body = f"""<h1>Flight {escape(flown.name)}, {len(flown.aircraft)} aircraft</h1>
<p>Asked: watch {escape(wanted)}.
Recorded by {escape(flown.program)}. Each aircraft: {links}.</p>
{html.table(("", "all", *(craft.name for craft in flown.summary.aircraft)), flown.summary.rows(), "Summary")}
{_announced(flown)}"""
    return html.document(f"{flown.name}: flight report", body)


def _asked_words(asked: Asked, begin_s: float) -> str:
    words = [f"from the {side_words(own)} at {own.range_min_m:g} to {own.range_max_m:g} m" for _, own in asked]
    later = zip((at_s - begin_s for at_s, _ in asked[1:]), words[1:], strict=True)
    return words[0] + "".join(f", after {at_s:.0f} s {changed}" for at_s, changed in later)


def _announced(flown: FleetFlown) -> str:
    if not flown.announced:
        return ""
    start_s = min(craft.flown.history.start_s + craft.offset_s for craft in flown.aircraft)
    rows = ((f"{said.mission_time_s - start_s:.0f} s", said.name, said.text) for said in flown.announced)
    words = f"Announcements of the coordinator ({len(flown.announced)})"
    return html.folded(words, html.table(("time", "aircraft", "what"), rows, words))
