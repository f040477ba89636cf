"""``sidelong replay`` of a fleet's run: each aircraft separately, then the coordinator's messages to them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, cast, get_args

from sidelong.app.analysis.replay import Comparison
from sidelong.app.analysis.summary import Summary
from sidelong.app.commands.output import console, say
from sidelong.app.commands.progress import progress_bar, table_progress
from sidelong.app.config import validated
from sidelong.app.errors import FlightError, InputError
from sidelong.app.fleet.assembly import coordinator_of
from sidelong.app.fleet.coordination import FLEET_JOURNAL_TYPES
from sidelong.app.fleet.fleet_file import FleetFile
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.run_folder import FleetFolder, RunFolder
from sidelong.mission.fleet.coordinator import FleetCoordinator
from sidelong.mission.fleet.events import FleetCommand, FleetEvent


def replay_fleet(folder: FleetFolder, replay_one: Callable[[RunFolder], Summary], verify: bool) -> dict[str, Any]:
    """Replay a fleet's run; ``replay_one`` replays an aircraft's. Returns what ``--json`` writes.

    Raises FlightError if the coordinator's output differs from the flight's.
    """
    progress, task = progress_bar(folder.path.name)
    journal = JournalReader(folder.journal, FLEET_JOURNAL_TYPES, lambda share: progress.update(task, completed=share))
    advice = f"{folder.journal}: its configuration cannot be used; replay the aircraft by themselves"
    fleet = validated(FleetFile, journal.header.config, advice)
    aircraft = []
    for member in fleet.members:
        own = RunFolder(folder.path / member.name)
        if not own.journal.is_file():
            console.print(f"{member.name}: it did not fly")
            continue
        console.print(f"{member.name}:")
        summary = replay_one(own)
        console.print(summary.table())
        aircraft.append({"name": member.name, **summary.as_json()})
    if not aircraft:
        raise InputError(f"{folder.path} holds no flight of an aircraft.")
    compared = None
    if verify:
        with progress:
            steps = compare_coordination(coordinator_of(fleet, table_progress(console.print)), journal)
        if steps.difference is not None:
            raise FlightError(f"{folder.path}: the coordinator's replay differs from the flight {steps.difference}")
        compared = steps.compared
        say(f"{compared} commands of the coordinator compared: {steps.sameness()}")
    return {"aircraft": aircraft, "coordinator_commands_compared": compared}


def compare_coordination(coordinator: FleetCoordinator, records: Iterable[object]) -> Comparison:
    """Step a coordinator through its journal, and compare its commands."""
    comparison, commands = Comparison(), get_args(FleetCommand)
    for record in records:
        if isinstance(record, commands):
            comparison.flown(record)
        else:
            comparison.replayed(record, coordinator.step(cast(FleetEvent, record)))
    return comparison
