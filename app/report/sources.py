"""Where a history comes from: a run folder's journal, or a recorded tlog."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pydantic import TypeAdapter, ValidationError

from sidelong.app.analysis.replay import require_sightings
from sidelong.app.analysis.score import from_band, judge_moments, score
from sidelong.app.analysis.summary import Summary
from sidelong.app.analysis.truth import read_truth
from sidelong.app.assembly import fence_outlines, ground_of, tracker_of
from sidelong.app.config import Config, load_config
from sidelong.app.errors import InputError
from sidelong.app.flight.recording import JOURNAL_TYPES, journalled_config
from sidelong.app.link.telemetry import Telemetry
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.log import LogContext, RecordedLog, open_log
from sidelong.app.records.run_folder import RunFolder, recording
from sidelong.app.records.text_file import Progress, unseen
from sidelong.app.report.history import FlightHistory, FlightRequirements, HistoryBuilder, estimate_errors
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import Event, StepOutput

_SUMMARY = TypeAdapter(Summary)


@dataclass(frozen=True, slots=True, eq=False)
class FlightRecord:
    """A flight to report on."""

    name: str
    program: str
    config: Config
    history: FlightHistory
    summary: Summary
    damaged_lines: int = 0
    context: LogContext | None = None
    """What else a log contains; a run folder has its own."""


def read_flight(
    path: Path,
    truth: Path | None = None,
    config: Path | None = None,
    progress: Progress = unseen,
    *,
    target_needed: bool = True,
    warn: Callable[[str], object] = lambda _words: None,
) -> FlightRecord:
    """Read a run folder or a log; ``truth`` and ``config`` take the place of what a run folder has itself.

    ``warn`` receives what keeps a log from being that of one fixed wing's flight, '' if nothing does.

    Raises InputError for what is neither, or holds no flight, or no sighting of a target where one is needed.
    """
    path = recording(path)
    if path.is_dir():
        return _run(RunFolder.open(path), truth, config, progress)
    return _log(path, truth, config, progress, target_needed, warn)


class Sink(Protocol):
    """What a flight's events and commands can be fed to, in order."""

    def event(self, event: Event) -> None: ...

    def command(self, command: StepOutput) -> None: ...


def feed(path: Path, sink: Sink, progress: Progress = unseen) -> None:
    """Feed a run folder or a log that ``read_flight`` has read to something else. Raises InputError."""
    if path.is_dir():
        _feed_journal(JournalReader(RunFolder(path).journal, JOURNAL_TYPES, progress), sink)
    else:
        _feed_log(open_log(path), Telemetry(), sink, progress)


def _feed_journal(journal: JournalReader, sink: Sink) -> None:
    for record in journal:
        if isinstance(record, StepOutput):
            sink.command(record)
        else:
            sink.event(record)


def _feed_log(log: RecordedLog, telemetry: Telemetry, sink: Sink, progress: Progress = unseen) -> None:
    for message in log.messages(telemetry.wanted, progress):
        event = telemetry.event(message)
        if event is not None:
            sink.event(event)


def _run(folder: RunFolder, truth: Path | None, config: Path | None, progress: Progress) -> FlightRecord:
    reader = JournalReader(folder.journal, JOURNAL_TYPES, progress)
    if reader.header.plane is None:
        raise InputError(f"{folder.path} holds no flight: it ended before the vehicle's position was known.")
    settings = load_config(config) if config is not None else journalled_config(reader)
    builder = HistoryBuilder(tracker_of(settings))
    _feed_journal(reader, builder)
    if truth is None and folder.truth.exists():
        truth = folder.truth
    history = _built(builder, settings, folder.path, reader.header.plane, truth, reader.header.home_deg)
    truncated = folder.truncated()
    if truncated:  # what there is of it is worth having
        end_s = history.positions[-1].time_s - history.start_s
        result = summary_of(history, f"the record ends early, at {end_s:.0f} s: {truncated}")
    else:
        result = read_summary(folder.read_summary(), str(folder.summary))
    name = folder.path.resolve().name
    return FlightRecord(name, reader.header.program, settings, history, result, reader.damaged_lines)


def _log(
    path: Path,
    truth: Path | None,
    config: Path | None,
    progress: Progress,
    target_needed: bool,
    warn: Callable[[str], object],
) -> FlightRecord:
    settings = load_config(config)
    telemetry = Telemetry()
    tracker = tracker_of(settings)
    builder = HistoryBuilder(tracker)
    log = open_log(path)
    _feed_log(log, telemetry, builder, progress)
    context = log.context()
    warn(context.warning)
    if target_needed:
        require_sightings(tracker, telemetry, log)
    history = _built(builder, settings, path, telemetry.plane, truth)
    program, result = context.firmware or context.autopilot.name, summary_of(history, "recorded log")
    return FlightRecord(path.name, program, settings, history, result, context=context)


def _built(
    builder: HistoryBuilder,
    config: Config,
    path: Path,
    plane: LocalPlane | None,
    truth: Path | None,
    home_deg: tuple[float, float] | None = None,
) -> FlightHistory:
    if plane is None or len(builder.positions) < 2:
        raise InputError(f"{path} holds no flight: it contains fewer than two positions of the vehicle.")
    ground = None
    with suppress(InputError):  # its data are not at hand any more
        ground = ground_of(config, plane, home_deg)
    keep_in, keep_out = (tuple(map(tuple, outlines)) for outlines in fence_outlines(config, plane))
    requirement, airframe = config.requirement.requirement(), config.aircraft.aircraft()
    wanted = FlightRequirements(requirement, airframe, keep_in, keep_out, ground)
    true = None if truth is None else read_truth(truth)
    if true is not None:
        true.require_same_flight([(one.time_s, one.east_m, one.north_m) for one in builder.positions], plane)
    return builder.build(wanted, plane, true)


def summary_of(history: FlightHistory, outcome: str) -> Summary:
    """Return the summary of a flight that left none: it was cut off, or it is another system's log."""
    asked, changes = history.requirements, history.plan_changes
    moments = from_band(history.moments, asked)
    judged = judge_moments(moments, asked)
    departures_s = [change.departed_s for change in changes if change.departed_s is not None]
    errors = estimate_errors(history)
    if history.judged_by_truth:
        scored = score(judged, "truth", departures_s)
    else:
        known = np.array([one.known for one in moments], dtype=bool)
        scored = score(judged, "estimate", departures_s, history.end_s, known)
    return Summary(
        **asdict(scored),
        uploads=len(changes),
        upload_failures=sum(bool(change.failed) for change in changes),
        sightings=len(history.sightings),
        rejected=sum(not outcome.accepted for outcome in history.sightings),
        estimate_rmse_m=None if errors is None else float(np.sqrt(np.mean(np.square(errors.error_m)))),
        outcome=outcome,
    )


def read_summary(values: dict[str, Any], name: str) -> Summary:
    """Return the summary that a run wrote, without what later programs add. Raises InputError by ``name``."""
    try:
        return _SUMMARY.validate_python(values, strict=False)
    except ValidationError as error:
        field = ".".join(map(str, error.errors()[0]["loc"]))
        raise InputError(f"{name}: its {field} is missing or wrong; delete it to have it written again.") from error
