"""The flight of a fleet, read from its folder: each aircraft's own, and the coordinator's messages."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, fields

from sidelong.app.analysis.score import Asked
from sidelong.app.errors import InputError
from sidelong.app.fleet.coordination import FLEET_JOURNAL_TYPES
from sidelong.app.fleet.fleet_file import FleetFile
from sidelong.app.fleet.summary import (
    AircraftSummary,
    FleetSummary,
    FlownAircraft,
    FlownTrack,
    TargetSummary,
    summarise_fleet,
)
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.mapped_file import Progress
from sidelong.app.records.run_folder import FleetFolder, RunFolder
from sidelong.app.report.sources import Flown, read_flight, read_summary
from sidelong.app.section import validated
from sidelong.mission.core.requirement import Requirement
from sidelong.mission.fleet.events import ClockReported, FleetAnnounce, RequirementChanged, VehicleReported


@dataclass(frozen=True, slots=True, eq=False)
class AircraftPart(FlownAircraft):
    """One aircraft's part, with its own flight."""

    flown: Flown


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
    tracks: dict[str, FlownTrack] = defaultdict(FlownTrack)
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
    summary = _written(folder) if folder.summary.exists() else _summed(asked, aircraft)
    name = folder.path.resolve().name
    return FleetFlown(name, journal.header.program, asked, tuple(aircraft), tuple(announced), summary)


def _written(folder: FleetFolder) -> FleetSummary:
    """Return the summary that the run wrote."""
    values, name = folder.read_summary(), str(folder.summary)
    try:
        parts = ("targets", "aircraft")
        plain = {field.name: values[field.name] for field in fields(FleetSummary) if field.name not in parts}
        targets = tuple(TargetSummary(**one) for one in values.get("targets", ()))
        aircraft = tuple(
            AircraftSummary(one["name"], read_summary(one, name), one.get("time_on_wanted_side"))
            for one in values["aircraft"]
        )
    except (KeyError, TypeError) as error:
        raise InputError(f"{name}: a figure is missing or wrong; delete it to have it written again.") from error
    return FleetSummary(**plain, targets=targets, aircraft=aircraft)


def _summed(asked: Mapping[str, Asked], aircraft: list[AircraftPart]) -> FleetSummary:
    by_truth = all(one.flown.history.judged_by_truth for one in aircraft)
    outcomes = sorted({one.summary.outcome for one in aircraft})
    return summarise_fleet(aircraft, asked, "; ".join(outcomes), "truth" if by_truth else "estimate")
