"""``sidelong replay``: a recorded flight through the same filter and planner."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from rich.table import Table
from rich.text import Text

from sidelong.app.analysis.replay import (
    JournalReplay,
    Proposals,
    Replayed,
    announcements,
    log_events,
    require_sightings,
)
from sidelong.app.analysis.summary import Summary, SummaryCollector, describe_calibration, summarise
from sidelong.app.analysis.truth import Truth, read_truth
from sidelong.app.assembly import Prepared, mission_controller_of, prepared
from sidelong.app.autopilots.registry import autopilot_by_name
from sidelong.app.commands.options import (
    MAP,
    OUTPUT,
    ConfigOption,
    Overrides,
    PlannerOption,
    SetOption,
    TruthOption,
    changed_keys,
)
from sidelong.app.commands.output import (
    JsonOption,
    checked_output,
    console,
    say,
    share_progress,
    table_progress,
    warn_of_log,
    write_json,
)
from sidelong.app.config import Config, check_flyable, load_config, validated, with_values
from sidelong.app.errors import FlightError, InputError
from sidelong.app.fleet.fleet_file import FleetFile, planner_in_fleet
from sidelong.app.flight.recording import JOURNAL_TYPES, journalled_config
from sidelong.app.records.journal import Header, JournalReader
from sidelong.app.records.run_folder import FleetFolder, RunFolder, recording
from sidelong.app.view.address import page_address
from sidelong.app.view.frames import SPEED_MAX, Frames, serve_replay
from sidelong.app.view.panel import clock
from sidelong.app.view.state import StateEncoder
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.present import Present
from sidelong.mission.core.events import ControlAcquired
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.exchange.mission_controller import MissionController


class _Asked(NamedTuple):
    """How a recording is replayed. config, changes: in place of the flight's own configuration, and of its values."""

    config: Path | None
    changes: Overrides
    truth: Truth | None
    verify: bool
    quiet: bool


def replay(
    log: Annotated[Path, typer.Argument(help="A run folder of ours, or a log: tlog, PX4 ULog, ArduPilot .bin.")],
    truth: TruthOption = None,
    config: ConfigOption = None,
    planner: PlannerOption = None,
    set_: SetOption = None,
    what_if: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE", help="Fly on with another value.")] = None,
    from_: Annotated[float, typer.Option("--from", min=0.0, help="What if from this time on, s of the watch.")] = 0.0,
    verify: Annotated[bool, typer.Option("--verify", help="Compare every decision with the flight's.")] = False,
    view: Annotated[bool, MAP("--view", help="Show the replay on a live map in the browser.")] = False,
    view_speed: Annotated[float, MAP(min=0.1, max=SPEED_MAX, help="Recorded over wall time, with --view.")] = 10.0,
    quiet: Annotated[bool, OUTPUT("--quiet", help="Print the summary only.")] = False,
    json: JsonOption = None,
) -> None:
    """Run the filter and the planner over a recorded flight: show its decisions and the error of the estimate.

    With --view, a page plays the flight. With --what-if, a simulated aircraft flies on with other values, from a
    moment of the recording and next to the recorded target; its summary is printed next to the flown one.

    For example:
      sidelong replay runs/20261121T100000Z --verify
      sidelong replay runs/20261121T100000Z --view --what-if aircraft.radius_m=80 --from 300
      sidelong replay flight.tlog --truth flight.truth.csv
    """
    checked_output(json)
    changes = changed_keys(set_, {"planner": {"name": planner}})
    with_values(Config(), {"planner": {"name": planner}}, "--planner")  # a wrong name is reported as of this option
    log = recording(log)
    if verify and (view or what_if):
        raise InputError("--verify compares with the flight; give it without --view and --what-if.")
    judged_by = None if truth is None else read_truth(truth)  # a wrong file is reported before any computation
    shown = with_values(Config(), {"display": changes.pop("display", {})}, "--set").display
    address = page_address(view, shown)
    asked = _Asked(config, changes, judged_by, verify, quiet)
    fleet = FleetFolder(log)
    if fleet.journal.is_file():
        if view or config is not None:
            raise InputError(f"{log} is the run of a fleet; give one aircraft's folder with --view or --config.")
        write_json(json, _replay_fleet(fleet, asked))
        return
    folder = RunFolder.open(log) if log.is_dir() else None
    if folder is None and (verify or what_if):
        option, holds = ("--verify", "decisions") if verify else ("--what-if", "statement of how it was flown")
        raise InputError(f"{log}: {option} needs a run folder of ours; a log holds no {holds}.")
    frames = None if address is None else Frames()
    flown_on = None if what_if is None else _WhatIf(changed_keys(what_if), from_)
    if folder is None:
        settings = load_config(config, changes)  # a wrong --set is reported before any computation
        check_flyable(settings)
        # A page shows the decisions without other values, and those with them alongside.
        flown = settings if frames is None else load_config(config)
        result = _replay_log(log, flown, judged_by, quiet, frames)
    else:
        flown = settings = _flown(folder, asked)
        result = _replay_run(folder, asked, frames, flown_on)
    if flown_on is None:
        console.print(result.table())
        write_json(json, result.as_json())
    else:
        _print_both(result, flown_on.summary)
        write_json(json, {"flown": result.as_json(), "what_if": flown_on.summary.as_json()})
    if address is None or frames is None:
        return
    name, other = f"replay of {log.name}", None if flown_on is None else flown_on.frames
    if not frames.times_s:
        raise InputError(f"{name}: there is nothing to show, it contains no position of the vehicle.")
    if settings != flown:
        other = Frames()
        _replay_log(log, settings, None, True, other)
    serve_replay(frames, other, flown, address, name, view_speed, say, _film(folder))


def _replay_fleet(folder: FleetFolder, asked: _Asked) -> dict[str, Any]:
    from sidelong.app.fleet.coordination import (  # noqa: PLC0415
        FLEET_JOURNAL_TYPES,
        compare_coordination,
        coordinator_of,  # it takes half a second to load
    )

    advice = f"{folder.journal}: its configuration cannot be used; replay the aircraft by themselves"
    fleet = validated(FleetFile, JournalReader(folder.journal, FLEET_JOURNAL_TYPES).header.config, advice)
    aircraft = []
    for member in fleet.members:
        own = RunFolder(folder.path / member.name)
        if not own.journal.is_file():
            console.print(f"{member.name}: it did not fly")
            continue
        console.print(f"{member.name}:")
        summary = _replay_run(own, asked)
        console.print(summary.table())
        aircraft.append({"name": member.name, **summary.as_json()})
    if not aircraft:
        raise InputError(f"{folder.path} holds no flight of an aircraft.")
    compared = None
    if asked.verify:
        with share_progress(folder.path.name) as progress:
            journal = JournalReader(folder.journal, FLEET_JOURNAL_TYPES, progress)
            steps = compare_coordination(coordinator_of(fleet, table_progress(console.print)), journal)
        if steps.difference is not None:
            raise FlightError(f"{folder.path}: the coordinator's replay differs from the flight {steps.difference}")
        compared = steps.compared
        say(f"{compared} commands of the coordinator compared: {steps.sameness()}")
    return {"aircraft": aircraft, "coordinator_commands_compared": compared}


def _film(run: RunFolder | None) -> Any:
    """Return what shows a flight's video on the page, None if there is none that can be shown."""
    if run is None or not run.video.is_file():
        return None
    try:
        from sidelong.app.camera.video import VideoReplay  # noqa: PLC0415  # an extra

        return VideoReplay(run.video).shown
    except (ImportError, OSError, ValueError) as error:
        say(f"{run.video} cannot be shown: {error}")
        return None


def _flown(folder: RunFolder, asked: _Asked) -> Config:
    config = asked.config
    return load_config(config) if config else journalled_config(JournalReader(folder.journal, JOURNAL_TYPES))


def _changed(flown: Config, config: Path | None, changes: Overrides) -> Config:
    """Return the configuration with other values, which have to be flyable; that of a flight is accepted as it is."""
    settings = with_values(flown, changes, "--set")
    if config is not None or settings != flown:
        check_flyable(settings)
    return settings


def _replay_log(path: Path, settings: Config, truth: Truth | None, quiet: bool, frames: Frames | None) -> Summary:
    from sidelong.app.link.telemetry import Telemetry  # noqa: PLC0415  # a run of ours is read without
    from sidelong.app.records.log import open_log  # noqa: PLC0415

    log = open_log(path)
    telemetry = Telemetry()
    made = prepared(settings, table_progress(console.print), console.print)
    with share_progress(path.name) as progress:
        messages = log.messages(telemetry.wanted, progress)
        events = log_events(messages, telemetry)
        first = list(itertools.islice(events, 1))
        # A log does not hold the home position: the first position of an aircraft on the ground is near it.
        controller = made.controller(telemetry.plane)
        if frames is not None:
            frames.plane = telemetry.plane
        judged = _Judged(settings, controller, quiet)
        replayed = Proposals(controller).follow(itertools.chain(first, events))
        judged.follow(
            replayed if frames is None else frames.noted(replayed, _encoder(settings, controller), proposals=True)
        )
    warn_of_log(path, log.context().warning)
    require_sightings(controller.tracker, telemetry, log)
    result = judged.summary(truth, telemetry.plane, judged.first_estimate_s)
    console.print(describe_calibration(controller.tracker.calibration, controller.tracker.delays))
    say(f"plans proposed: {result.uploads}; a log of another program flies none of them")
    return replace(result, uploads=0, upload_failures=0)


def _replay_run(
    folder: RunFolder, asked: _Asked, frames: Frames | None = None, what_if: _WhatIf | None = None
) -> Summary:
    truth, verify, quiet = asked.truth, asked.verify, asked.quiet
    with share_progress(folder.path.name) as progress:
        journal = JournalReader(folder.journal, JOURNAL_TYPES, progress)
        flown = _flown(folder, asked)
        settings = _changed(flown, asked.config, asked.changes)
        if verify and settings != flown:
            raise InputError("--verify compares like with like; leave out --planner, --set and --config.")
        plane = journal.header.plane
        controller = _prepared(settings).controller(plane, journal.header.home_deg)
        judged = _Judged(settings, controller, quiet or verify, of_a_flight=True)
        if what_if is not None:
            judged.wanted_s = what_if.from_s
        compares = settings == flown and (verify or not quiet)
        # Nothing depends on the exchange but what it sends, and that only a comparison reads.
        mission = _exchange_of(settings, controller, journal.header) if compares else None
        steps = JournalReplay(controller, mission, compares=compares)
        replayed = steps.run(journal)
        if frames is not None:
            frames.plane = plane
        judged.follow(replayed if frames is None else frames.noted(replayed, _encoder(settings, controller)))
    if verify:
        if journal.damaged_lines:  # by which the replay may differ, too
            raise FlightError(
                f"{journal.path}: {journal.damaged_lines} damaged lines were passed over, so the flight cannot be "
                "verified; use an undamaged copy, or leave out --verify."
            )
        if steps.difference is not None:
            raise FlightError(f"{folder.path}: the replay differs from the flight {steps.difference}")
        say(f"{steps.compared} decisions and commands compared: {steps.sameness()}")
    elif steps.difference is not None and not quiet:
        console.print(Text(f"first difference from the flight {steps.difference}"))
    if settings != flown:
        say("the summary is of the path as flown: other values change only what is decided")
    if truth is None and folder.truth.is_file():
        truth = read_truth(folder.truth)
    start_s = judged.engaged_s if judged.engaged_s is not None else judged.first_estimate_s
    if journal.damaged_lines:
        say(f"{journal.damaged_lines} damaged lines of the journal were passed over")
    truncated = folder.truncated()
    if truncated:
        at = clock(max(controller.time_s - (start_s or 0.0), 0.0))
        say(f"the record ends early, at {at}: {truncated}")
    if what_if is not None:
        start_s = what_if.fly(settings, JournalReader(folder.journal, JOURNAL_TYPES), judged, truth)
    return judged.summary(truth, plane, start_s)


class _WhatIf:
    """Flies a recorded flight on with other values, from a time of the watch; sets ``summary`` and ``frames``."""

    summary: Summary
    frames: Frames

    def __init__(self, changes: Overrides, from_s: float) -> None:
        self._changes, self.from_s = changes, from_s

    def fly(self, flown: Config, journal: JournalReader, judged: _Judged, truth: Truth | None) -> float:
        """Fly to the end of the recording; return when it left it, on the vehicle's clock."""
        from sidelong.app.study.closed_loop import FlownOn, follow_readings, recorded_motion  # noqa: PLC0415  # a simulation

        header, begin = journal.header, judged.wanted
        autopilot, plane = autopilot_by_name(header.autopilot), header.plane
        if autopilot is None or plane is None or header.home_deg is None:
            raise InputError("--what-if: the journal does not state the autopilot and the place; it is too old.")
        if begin is None:
            raise InputError(f"--from {self.from_s:g}: the recorded watch is shorter; give a lower time.")
        config = _changed(flown, None, self._changes)
        moments, _ = judged.collector.moments(truth, plane, begin.time_s)
        if len(moments) < 2:
            raise InputError(f"--from {self.from_s:g}: nothing is known of the target after it; give a lower time.")
        controller = _prepared(config).controller(plane, header.home_deg)
        own = config, controller, autopilot, plane, header.home_altitude_m or 0.0
        follow_readings(controller, judged.controller.tracker, journal, begin.time_s)
        wind, bias_rad = judged.controller.snapshot().wind, judged.controller.tracker.calibration.yaw_bias_rad
        flight = FlownOn(*own, begin, wind, recorded_motion(moments, begin.time_s), bias_rad)
        self.frames = Frames(plane=plane, is_flown=True)
        other = _Judged(config, controller, True, of_a_flight=True)
        other.follow(self.frames.noted(flight.steps(), _encoder(config, controller)))
        self.summary = other.summary(flight.truth, plane, begin.time_s)
        return begin.time_s


def _print_both(flown: Summary, what_if: Summary) -> None:
    table = Table("", "as flown", "what if", box=None, pad_edge=False)
    others = dict(what_if.rows())
    for name, value in flown.rows():
        table.add_row(name, value, others.get(name, ""))
    console.print(table)


def _prepared(settings: Config) -> Prepared:
    return prepared(settings, table_progress(console.print), console.print, planner_in_fleet(settings))


def _exchange_of(settings: Config, controller: StandoffController, header: Header) -> MissionController | None:
    """Return the core with the exchange of a flight; None for a journal that does not hold that."""
    autopilot = autopilot_by_name(header.autopilot)
    if autopilot is None or header.plane is None or header.home_deg is None or header.home_altitude_m is None:
        return None
    home = Home(*header.home_deg, header.home_altitude_m)
    return mission_controller_of(settings, controller, autopilot, header.plane, home)


def _encoder(settings: Config, controller: StandoffController) -> StateEncoder:
    encoder = StateEncoder(settings.aircraft.airspeed_m_s, settings.aircraft.height_m)
    encoder.ground = controller.surroundings.ground
    return encoder


class _Judged:
    """Follows a replay: prints its messages, and gathers the values of the summary."""

    def __init__(
        self, settings: Config, controller: StandoffController, quiet: bool, of_a_flight: bool = False
    ) -> None:
        self._of_a_flight = of_a_flight
        self.first_estimate_s: float | None = None
        self.engaged_s: float | None = None
        self.controller, self._quiet = controller, quiet
        self.wanted_s = math.inf  # since watching began
        self.wanted: Present | None = None  # the state then
        self.collector = SummaryCollector(settings.requirement.requirement())
        self.collector.ground = controller.surroundings.ground

    def follow(self, steps: Iterable[Replayed]) -> None:
        for step in steps:
            if step.estimate is None or step.estimate.time_s > self.collector.judged_s:
                snapshot = step.snapshot()
                self.collector.observe(snapshot)
                if self.wanted is None and snapshot.time_s - (self.engaged_s or math.inf) >= self.wanted_s:
                    self.wanted = snapshot if snapshot.aircraft and snapshot.phase.in_control else None
                if self.first_estimate_s is None and step.estimate is not None:
                    self.first_estimate_s = snapshot.time_s
            if self.engaged_s is None and isinstance(step.event, ControlAcquired):
                self.engaged_s = step.event.time_s
            if not self._quiet:
                for announced in announcements(step.commands):
                    console.print(Text(f"{self._since(announced.time_s):>7}  {announced.text}"))

    def _since(self, time_s: float) -> str:
        """Return the time as displayed in flight; for a log, the time of the vehicle's clock."""
        if not self._of_a_flight:
            return clock(time_s)
        return "" if self.engaged_s is None else clock(max(time_s - self.engaged_s, 0.0))

    def summary(self, truth: Truth | None, plane: LocalPlane | None, start_s: float | None) -> Summary:
        if truth is not None and plane is not None:
            moments, _ = self.collector.moments(None, None, -math.inf)
            places = [(moment.time_s, moment.aircraft_east_m, moment.aircraft_north_m) for moment in moments]
            truth.require_same_flight(places, plane)
        return summarise(
            self.collector,
            self.controller.snapshot(),
            truth=truth,
            plane=plane,
            start_s=start_s if start_s is not None else -math.inf,
            tracker=self.controller.tracker,
            outcome="replayed",
        )
