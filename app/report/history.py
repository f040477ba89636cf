"""A flight as arrays and lists, read from a run folder or a log: what a report is made of.

A journal has no estimates: the same readings go through the same tracker again. A foreign log has no commands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from pydantic import TypeAdapter, ValidationError

from sidelong.app.analysis.replay import require_sightings
from sidelong.app.analysis.score import Breaches, Judgement, Moment, from_band, judge_moments, score
from sidelong.app.analysis.summary import Summary
from sidelong.app.analysis.truth import Truth, read_truth
from sidelong.app.assembly import fence_outlines, ground_of, tracker_of
from sidelong.app.config import Config, load_config
from sidelong.app.errors import InputError
from sidelong.app.flight.recording import JOURNAL_TYPES, journalled_config
from sidelong.app.link.telemetry import Telemetry
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.log import LogContext, RecordedLog, open_log
from sidelong.app.records.run_folder import RunFolder, recording
from sidelong.app.records.sensing import Sensing
from sidelong.app.records.text_file import Progress, unseen
from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import PositionReading
from sidelong.estimators.sensing.sighting import SightingOutcome
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.control.mission_change import requirement_after
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import (
    Announce,
    ControlAcquired,
    End,
    Event,
    HealthChanged,
    MissionChange,
    OperatorRequest,
    PlanStatus,
    RouteGiven,
    StepOutput,
    UploadPlan,
    WindReported,
    Yield,
)
from sidelong.mission.core.fleet import FleetAdvice
from sidelong.mission.core.inputs import UNFULFILLED, Input, InputState
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side
from sidelong.mission.route.route import Route, RouteFollower, RouteProgress, follower_of

_MOVES = "moving"  # how the reason of a decision to move begins


def clock(time_s: float) -> str:
    """Return a time as minutes:seconds; a negative one as 0:00."""
    whole_s = round(max(time_s, 0.0))
    return f"{whole_s // 60}:{whole_s % 60:02d}"


Outline = tuple[tuple[float, float], ...]  # corners (east, north), m

_AIRCRAFT_STEP_S = 0.2
_CURVATURE_SPAN_S = 1.0
_ESTIMATE_STEP_S = 1.0
_TRUTH_STEP_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class AircraftTrack:
    """Arrays of shape (n,), in order of time."""

    time_s: FloatArray
    east_m: FloatArray
    north_m: FloatArray
    course_rad: FloatArray
    ground_speed_m_s: FloatArray


@dataclass(frozen=True, slots=True)
class ReportedChange:
    """How a plan fared: None for what did not happen. failed: why, '' if it did not."""

    plan: Plan
    prepared_s: float
    ready_s: float | None = None
    departed_s: float | None = None
    failed: str = ""


@dataclass(frozen=True, slots=True)
class FlightRequirements:
    requirement: Requirement
    airframe: Aircraft
    keep_in: tuple[Outline, ...] = ()
    keep_out: tuple[Outline, ...] = ()
    ground: Ground | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FlightHistory:
    """A flight or a replayed log, by the vehicle's clock; ``start_s`` is when watching began.

    moments: by the truth where there is one, else by the estimates. requirements: (since, requirement), from -inf on.
    targets: of each estimate its target's name, '' without a fleet. progress: (time, progress on the route).
    """

    asked: FlightRequirements
    start_s: float
    positions: tuple[PositionReading, ...]
    aircraft: AircraftTrack
    estimates: tuple[TargetEstimate, ...]
    targets: tuple[str, ...]
    sightings: tuple[SightingOutcome, ...]
    moments: tuple[Moment, ...]
    judged_by_truth: bool
    truth: Truth | None
    plane: LocalPlane
    circles: tuple[tuple[float, Circle], ...]
    plan_changes: tuple[ReportedChange, ...]
    requirements: tuple[tuple[float, Requirement], ...]
    announced: tuple[Announce, ...]
    route: Route | None = None
    progress: tuple[tuple[float, RouteProgress], ...] = ()
    wind: WindReported | None = None

    @property
    def requirement(self) -> Requirement:
        return self.asked.requirement

    @property
    def moves(self) -> tuple[Announce, ...]:
        return tuple(one for one in self.announced if one.kind == "decision" and one.text.startswith(_MOVES))

    @property
    def judged(self) -> Judgement:
        """How each of the moments was; without an observation angle where inputs were missing or contradictory."""
        judged = judge_moments(self.moments, self.requirements)
        known = np.array([one.known for one in self.moments], dtype=bool)
        return replace(judged, observation_rad=np.where(known, judged.observation_rad, math.nan))

    @property
    def end_s(self) -> float:
        return float(self.aircraft.time_s[-1])


class HistoryBuilder:
    """Takes a run's events and commands in order (it is a ``Log``) and gives its history."""

    def __init__(self, tracker: Tracker) -> None:
        self._sensing = Sensing(tracker)
        self.positions: list[PositionReading] = []
        self._seen: list[tuple[TargetEstimate, str, bool]] = []  # with the target's name; whether inputs were sound
        self._breaches, self._out = Breaches(), set[Input]()
        self._target = ""
        self.sightings: list[SightingOutcome] = []
        self._circles: list[tuple[float, Circle]] = []
        self._changes: dict[int, ReportedChange] = {}
        self._wishes: list[OperatorRequest | MissionChange] = []
        self._announced: list[Announce] = []
        self._start_s: float | None = None
        self._in_hand = False
        self._follower: RouteFollower | None = None
        self._progress: list[tuple[float, RouteProgress]] = []
        self._wind: WindReported | None = None

    def event(self, event: Event) -> None:
        """Feed an event of the flight, in order."""
        admitted, outcomes = self._sensing.take(event)
        self.sightings += outcomes
        match admitted:
            case PositionReading():
                self._position(admitted)
            case ControlAcquired():
                self._start_s = admitted.time_s if self._start_s is None else self._start_s
                self._circles.append((admitted.time_s, admitted.circle))
                self._in_hand = True
            case PlanStatus():
                self._plan_status(admitted)
            case WindReported():
                self._wind = admitted
            case RouteGiven():
                self._follower, self._progress = follower_of(admitted), []
            case FleetAdvice(turn_payload=False):
                self._target = admitted.target
            case OperatorRequest(action="side", side=Side()) | MissionChange() if self._in_hand:
                self._wishes.append(admitted)

    def command(self, command: StepOutput) -> None:
        match command:
            case UploadPlan():
                self._changes[command.number] = ReportedChange(command.plan, command.time_s)
            case Announce():
                self._announced.append(command)
            case HealthChanged():
                self._announced.append(command.announcement)
                if command.input in UNFULFILLED:
                    of_input = {command.input}
                    self._out = self._out - of_input if command.state is InputState.OK else self._out | of_input
                    self._breaches.note(command.time_s, bool(self._out))
            case Yield() | End():
                self._announced.append(command.announcement)
                self._in_hand = False

    def _position(self, reading: PositionReading) -> None:
        if not self.positions or reading.time_s >= self.positions[-1].time_s + _AIRCRAFT_STEP_S:
            self.positions.append(reading)
        last_s = self._seen[-1][0].time_s if self._seen else -math.inf
        if reading.time_s >= last_s + _ESTIMATE_STEP_S:
            estimate = self._sensing.tracker.estimate(reading.time_s)
            if estimate is not None:
                self._seen.append((estimate, self._target, not self._sensing.unknown))
                progress = None if self._follower is None else self._follower.update(estimate)
                if progress is not None:
                    self._progress.append((estimate.time_s, progress))

    def _plan_status(self, event: PlanStatus) -> None:
        change = self._changes.get(event.number)
        if change is None:
            return
        if event.stage == "ready":
            change = replace(change, ready_s=event.time_s)
        elif event.stage == "departed":
            change = replace(change, departed_s=event.time_s)
            self._circles.append((event.time_s, change.plan.circle))
        elif event.stage == "failed":
            change = replace(change, failed=event.detail or "failed")
        self._changes[event.number] = change

    def build(self, asked: FlightRequirements, plane: LocalPlane, truth: Truth | None) -> FlightHistory:
        """Return the history so far; there must be at least two positions."""
        rows = [(p.time_s, p.east_m, p.north_m, p.velocity_east_m_s, p.velocity_north_m_s) for p in self.positions]
        time_s, east_m, north_m, east_m_s, north_m_s = np.array(rows).T
        aircraft = AircraftTrack(
            time_s, east_m, north_m, np.arctan2(east_m_s, north_m_s), np.hypot(east_m_s, north_m_s)
        )
        start_s = self._start_s
        if start_s is None:  # no takeover: the log begins where the target is first seen
            start_s = self._seen[0][0].time_s if self._seen else float(time_s[0])
        # What is seen before the fleet has named its target is of the first one named.
        first = next((name for _, name, _ in self._seen if name), "")
        seen = [(one, name or first, sound) for one, name, sound in self._seen]
        moments = () if truth is None else tuple(truth.moments(plane, start_s, float(time_s[-1]), _TRUTH_STEP_S))
        watched = [of for of in seen if of[0].time_s >= start_s]
        at_s = [one.time_s for one, _, _ in watched]
        here_m = zip(*(np.interp(at_s, time_s, place_m).tolist() for place_m in (east_m, north_m)), strict=True)
        known = zip(here_m, watched, strict=True)
        judged = moments or tuple(Moment.by_estimate(e, n, one, name, sound) for (e, n), (one, name, sound) in known)
        return FlightHistory(
            asked,
            start_s,
            tuple(self.positions),
            aircraft,
            tuple(one for one, _, _ in seen),
            tuple(name for _, name, _ in seen),
            tuple(self.sightings),
            tuple(self._breaches.applied(judged)),
            bool(moments),
            truth,
            plane,
            tuple(self._circles),
            tuple(self._changes.values()),
            tuple(self._requirements(asked.requirement)),
            tuple(self._announced),
            None if self._follower is None else self._follower.route,
            tuple(self._progress),
            self._wind,
        )

    def _requirements(self, requirement: Requirement) -> Iterator[tuple[float, Requirement]]:
        yield -math.inf, requirement
        for change in self._wishes:
            if isinstance(change, MissionChange):
                requirement = requirement_after(change, requirement)
            elif requirement.sector is None and change.side is not None:
                requirement = replace(requirement, side=change.side)
            yield change.time_s, requirement


def curvature_per_m(aircraft: AircraftTrack) -> tuple[FloatArray, FloatArray]:
    """Return times and the curvature of the flown line over the ground, positive to the right, shapes (n,)."""
    turned_rad = np.unwrap(aircraft.course_rad)
    before_s, after_s = aircraft.time_s - _CURVATURE_SPAN_S / 2, aircraft.time_s + _CURVATURE_SPAN_S / 2
    inside = (before_s >= aircraft.time_s[0]) & (after_s <= aircraft.time_s[-1])
    before_rad, after_rad = (np.interp(at_s, aircraft.time_s, turned_rad) for at_s in (before_s, after_s))
    speed_m_s = np.maximum(aircraft.ground_speed_m_s, 1.0)  # on the ground a course is noise
    return aircraft.time_s[inside], ((after_rad - before_rad) / _CURVATURE_SPAN_S / speed_m_s)[inside]


class EstimateErrors(NamedTuple):
    """Arrays of shape (n,). radius95_m: long half axis of the 95 % ellipse; nees: chi-square (2) if consistent."""

    time_s: FloatArray
    error_m: FloatArray
    radius95_m: FloatArray
    nees: FloatArray


def estimate_errors(history: FlightHistory) -> EstimateErrors | None:
    """Return the errors where truth and estimate are both known; None without a truth."""
    if history.truth is None:
        return None
    rows = []
    for one in history.estimates:
        true = history.truth.at(one.time_s, history.plane)
        if true is None:
            continue
        miss_m = np.array([one.east_m - true.target_east_m, one.north_m - true.target_north_m])
        nees = float(miss_m @ np.linalg.solve(one.covariance[:2, :2], miss_m))
        rows.append((one.time_s, math.hypot(*miss_m), one.ellipse_95.semi_major_m, nees))
    return EstimateErrors(*np.array(rows).T) if rows else None


_SUMMARY = TypeAdapter(Summary)


@dataclass(frozen=True, slots=True, eq=False)
class FlightRecord:
    name: str
    program: str
    config: Config
    history: FlightHistory
    summary: Summary
    damaged_lines: int = 0
    context: LogContext | None = None  # what else a log contains; a run folder has its own


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
    settings, telemetry, log = load_config(config), Telemetry(), open_log(path)
    tracker = tracker_of(settings)
    builder = HistoryBuilder(tracker)
    _feed_log(log, telemetry, builder, progress)
    context = log.context()
    warn(context.warning)
    if target_needed:
        require_sightings(tracker, telemetry, log)
    history = _built(builder, settings, path, telemetry.plane, truth)
    program, result = context.firmware or context.autopilot.name, summary_of(history, "recorded log")
    return FlightRecord(path.name, program, settings, history, result, context=context)


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
