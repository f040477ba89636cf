"""A flight as arrays and lists: what the figures and tables of a report are made of.

The journal holds what the vehicle reported and what was commanded, not the estimates: the same readings go through
the same tracker again and give the same estimates. A log of another system's flight has no commands.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sidelong.app.analysis.score import Breaches, Judgement, Moment, judge_moments
from sidelong.app.analysis.truth import Truth
from sidelong.app.records.sensing import Sensing
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
from sidelong.mission.route.progress import RouteFollower, RouteProgress, follower_of
from sidelong.mission.route.route import Route

_MOVES = "moving"  # how the reason of a decision to move begins


def clock(time_s: float) -> str:
    """Return a time as minutes:seconds."""
    whole_s = round(max(time_s, 0.0))
    return f"{whole_s // 60}:{whole_s % 60:02d}"


Outline = tuple[tuple[float, float], ...]
"""Corners (east, north), m."""

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
    """What the flight was asked to keep, and with which aircraft."""

    requirement: Requirement
    airframe: Aircraft
    keep_in: tuple[Outline, ...] = ()
    keep_out: tuple[Outline, ...] = ()
    ground: Ground | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FlightHistory:
    """A flight or a replayed log. Times are the vehicle's; ``start_s`` is when watching began.

    moments: aircraft and target together, by the truth where there is one, by the estimates else.
    requirements: (since, requirement), from -inf on: a person may change it. targets: of each estimate its target's
    name, '' where there is no fleet. route: expected of the target; progress: (time, progress along it), each second.
    wind: as last reported.
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
        """The announced decisions to move the circle."""
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
        self._estimates: list[TargetEstimate] = []
        self._targets: list[str] = []  # of each estimate
        self._breaches, self._out = Breaches(), set[Input]()
        self._known: list[bool] = []  # whether the inputs of each estimate were sound
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
        """Take an event."""
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
        """Take a command."""
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
                what = Announce(command.time_s, "yield", f"yielded: {command.reason}")
                if isinstance(command, End):
                    what = Announce(command.time_s, "end", f"ended: {command.reason}")
                self._announced.append(what)
                self._in_hand = False

    def _position(self, reading: PositionReading) -> None:
        if not self.positions or reading.time_s >= self.positions[-1].time_s + _AIRCRAFT_STEP_S:
            self.positions.append(reading)
        last_s = self._estimates[-1].time_s if self._estimates else -math.inf
        if reading.time_s >= last_s + _ESTIMATE_STEP_S:
            estimate = self._sensing.tracker.estimate(reading.time_s)
            if estimate is not None:
                self._estimates.append(estimate)
                self._targets.append(self._target)
                self._known.append(not self._sensing.unknown)
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
        aircraft = _track(self.positions)
        start_s = self._start_s
        if start_s is None:  # no takeover: the log begins where the target is first seen
            start_s = self._estimates[0].time_s if self._estimates else float(aircraft.time_s[0])
        # What is seen before the fleet has named its target is of the first one named.
        first = next(filter(None, self._targets), "")
        targets = [name or first for name in self._targets]
        end_s = float(aircraft.time_s[-1])
        moments = () if truth is None else tuple(truth.moments(plane, start_s, end_s, _TRUTH_STEP_S))
        judged = moments or _estimated_moments(self._estimates, targets, self._known, aircraft, start_s)
        return FlightHistory(
            asked,
            start_s,
            tuple(self.positions),
            aircraft,
            tuple(self._estimates),
            tuple(targets),
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


def _track(positions: list[PositionReading]) -> AircraftTrack:
    time_s, east_m, north_m, velocity_e, velocity_n = np.array(
        [(p.time_s, p.east_m, p.north_m, p.velocity_east_m_s, p.velocity_north_m_s) for p in positions]
    ).T
    return AircraftTrack(
        time_s, east_m, north_m, np.arctan2(velocity_e, velocity_n), np.hypot(velocity_e, velocity_n)
    )


def _estimated_moments(
    estimates: list[TargetEstimate], targets: list[str], known: list[bool], aircraft: AircraftTrack, start_s: float
) -> tuple[Moment, ...]:
    return tuple(
        Moment.by_estimate(
            float(np.interp(one.time_s, aircraft.time_s, aircraft.east_m)),
            float(np.interp(one.time_s, aircraft.time_s, aircraft.north_m)),
            one,
            target,
            sound,
        )
        for one, target, sound in zip(estimates, targets, known, strict=True)
        if one.time_s >= start_s
    )


def curvature_per_m(aircraft: AircraftTrack) -> tuple[FloatArray, FloatArray]:
    """Return times and the curvature of the flown line over the ground, positive to the right, shapes (n,)."""
    turned_rad = np.unwrap(aircraft.course_rad)
    before_s, after_s = aircraft.time_s - _CURVATURE_SPAN_S / 2, aircraft.time_s + _CURVATURE_SPAN_S / 2
    inside = (before_s >= aircraft.time_s[0]) & (after_s <= aircraft.time_s[-1])
    before_rad, after_rad = (np.interp(at_s, aircraft.time_s, turned_rad) for at_s in (before_s, after_s))
    speed_m_s = np.maximum(aircraft.ground_speed_m_s, 1.0)  # on the ground a course is noise
    return aircraft.time_s[inside], ((after_rad - before_rad) / _CURVATURE_SPAN_S / speed_m_s)[inside]


class EstimateErrors(NamedTuple):
    """Arrays of shape (n,). radius95_m is the long half axis of the 95 % ellipse.

    nees: normalised error squared, chi-square with two degrees of freedom where the estimate is consistent.
    """

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
