"""Studies with several aircraft on one target: closed loops under one coordinator, or a law with phases.

Each aircraft flies the product's own core; roles, advice and the joint estimate are those of the coordinator that
flies, fed by each core's reports as in flight.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from sidelong.app.simulation.target import TargetTruth
from sidelong.app.study.closed_loop import OnTicks, StudiedAircraft
from sidelong.app.study.judging import OF_FLEETS, ON_FLAT_GROUND, RunResult, decision_ms, judged, shares_of_any
from sidelong.app.study.laws import SteeredAircraft, fly_steered
from sidelong.app.study.report import targets_json
from sidelong.app.study.scene import START_RANGE_M, StopWatch, StudyScene, first_circle, payload_of, scene
from sidelong.app.study.settings import StudySettings
from sidelong.app.study.study import Workers, parallel
from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.sensing.sighting import AnySighting
from sidelong.estimators.tracking.joint_track import JointTrack
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import Event
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import AircraftState, PlanCheck
from sidelong.mission.core.requirement import Aircraft, Requirement
from sidelong.mission.exchange.mission_controller import InboundEvent, Output
from sidelong.mission.fleet.coordinator import FleetCoordinator, FleetTarget
from sidelong.mission.fleet.events import ClockReported, FleetEvent, TargetRouteGiven, Tick, VehicleEvent, VehicleLost
from sidelong.mission.fleet.reports import FleetReporter
from sidelong.mission.fleet.team_planner import IN_TEAM, TeamPlanner
from sidelong.mission.fleet.vehicle import FleetMember
from sidelong.mission.laws.course_field import phased
from sidelong.mission.predictive.planner import PredictivePlanner
from sidelong.mission.predictive.value_table import ValueTable
from sidelong.mission.route.route import event_of

_CHI2_95 = 5.991
_TARGET = "target"
_TICK_S, _JUDGED_S = 0.5, 1.0
_CLOCK_SIGMA_S = 0.01


class FleetPlannerName(StrEnum):
    """How the aircraft are steered: by sidelong's joint decisions, or by phase-holding laws of the literature."""

    JOINT = "joint"
    FIELD = "phased field"
    FORMATION = "circular formation"


@dataclass(frozen=True, slots=True)
class Loss:
    """Loss of one aircraft at a moment: it flies on alone, detects nothing, and the others ignore it."""

    aircraft: int
    time_s: float


@dataclass(frozen=True, slots=True, eq=False)
class FleetResult:
    """What several aircraft came to together; _any: shares of time by at least one of them.

    min_separation_m: in three dimensions; position_error_m: RMS of the joint estimate; in_ellipse: share of it within
    95 %. aircraft: each scored as if it were alone. logs (aircraft, n, 6 or more) as judged.
    """

    time_on_side_any: float
    time_on_side_any_now: float
    time_in_band_any: float
    min_separation_m: float
    min_range_m: float
    handovers: int
    position_error_m: float
    in_ellipse: float
    aircraft: tuple[RunResult, ...]
    decision_s: np.ndarray
    logs: FloatArray


@dataclass(slots=True)
class _Member:
    """One aircraft of the run. waiting: what is to be put into its core."""

    member: FleetMember
    craft: StudiedAircraft
    reporter: FleetReporter
    waiting: deque[Event] = field(default_factory=deque)
    lost: bool = False

    def fly_on(self) -> None:
        """Move its clock by one tick; a lost aircraft flies its last plan."""
        craft, vehicle = self.craft, self.craft.simulated
        if self.lost:
            vehicle.advance(vehicle.time_s + vehicle.tick_s)
            vehicle.take()
            return
        craft.step()
        while self.waiting:
            craft.put(self.waiting.popleft())


class _Errors:
    def __init__(self) -> None:
        self._squared: list[tuple[float, float]] = []

    def note(self, found: TargetEstimate | None, truth: TargetTruth) -> None:
        if found is not None:
            off = np.array((found.east_m - truth.east_m, found.north_m - truth.north_m))
            self._squared.append((float(off @ off), float(off @ np.linalg.solve(found.covariance[:2, :2], off))))

    @property
    def shares(self) -> tuple[float, float]:
        """Root mean square of the position error, m, and the share within 95 %; NaN without an estimate."""
        squared = np.array(self._squared or [(math.nan, math.nan)])
        return math.sqrt(float(squared[:, 0].mean())), float((squared[:, 1] < _CHI2_95).mean())


class FleetRun:
    """One run with all aircraft of the requirement. Target and noise depend on the seed and ``number`` only."""

    def __init__(self, settings: StudySettings, number: int, table: ValueTable) -> None:
        self._settings, self._scene, self._table = settings, scene(settings, number), table
        self._target = OnTicks(self._scene.target, self._scene.duration_s)
        self._errors, self._handovers = _Errors(), 0
        self._members = [self._member(*of) for of in _starts(settings, self._scene)]
        self._by_name = {one.member.name: one for one in self._members}
        self._coordinator = FleetCoordinator(
            [one.member for one in self._members],
            [FleetTarget(_TARGET, settings.requirement())],
            lambda _name, flown, wanted: TeamPlanner(PredictivePlanner(flown, wanted, table, IN_TEAM)),
        )
        for one in self._members:
            ahead_s = one.craft.simulated.time_s - one.craft.telemetry.now_s
            self._step(ClockReported(one.member.name, 0.0, ahead_s, _CLOCK_SIGMA_S))
        if self._scene.route is not None:
            self._step(TargetRouteGiven(_TARGET, event_of(self._scene.route, 0.0)))

    def _member(self, name: str, height_m: float, circle: Circle, noise_rng: np.random.Generator) -> _Member:
        settings = self._settings

        def make_planner(aircraft: Aircraft, requirement: Requirement, plans: PlanCheck) -> TeamPlanner:
            planned = PredictivePlanner(
                aircraft, requirement, self._table, IN_TEAM, check=plans.cleared, sight=plans.sight
            )
            return TeamPlanner(planned)

        own = settings.config.aircraft.model_copy(update={"height_m": height_m})
        config = settings.config.model_copy(update={"aircraft": own})
        craft = StudiedAircraft(settings, self._scene, self._target, circle, noise_rng, make_planner, config=config)
        listed = FleetMember(name, settings.aircraft(), payload_of(settings)[1], height_m)
        member = _Member(listed, craft, FleetReporter(name))

        def stepped(event: InboundEvent, outputs: tuple[Output, ...]) -> None:
            for news in member.reporter.after(craft.controller, event, outputs, craft.simulated.time_s):
                self._step(news)

        craft.listeners.append(stepped)
        return member

    def fly(self, losses: Sequence[Loss] = ()) -> FleetResult:
        """Fly to the end of the scene; the aircraft of ``losses`` leave at their times."""
        vehicle, ticked_s = self._members[0].craft.simulated, -math.inf
        while vehicle.time_s < self._scene.duration_s - 1e-6:
            time_s = vehicle.time_s
            for loss in losses:
                member = self._members[loss.aircraft]
                if time_s >= loss.time_s and not member.lost:
                    member.lost = True
                    self._step(VehicleLost(member.member.name, time_s, "lost in this study", yielded=True))
            for member in self._members:
                member.fly_on()
            if vehicle.time_s >= ticked_s + _TICK_S - 1e-6:
                self._tick(vehicle.time_s)
                ticked_s = vehicle.time_s
        logs = np.stack([member.craft.log(self._scene) for member in self._members])
        changes = [member.craft.departed_s for member in self._members]
        heights_m = [one.member.height_m for one in self._members]
        taken_s = [taken for member in self._members for taken in member.craft.watch.taken_s]
        return _result(self._settings, logs, heights_m, changes, taken_s, self._errors, self._handovers)

    def _tick(self, time_s: float) -> None:
        before = self._coordinator.primary(_TARGET)
        self._step(Tick(time_s))
        self._handovers += before is not None and self._coordinator.primary(_TARGET) != before
        if time_s % _JUDGED_S < _TICK_S:
            self._errors.note(self._coordinator.estimate(_TARGET), self._target.at(time_s))

    def _step(self, event: FleetEvent) -> None:
        for command in self._coordinator.step(event):
            if isinstance(command, VehicleEvent):
                self._by_name[command.name].waiting.append(command.event)


def _starts(settings: StudySettings, flown: StudyScene) -> list[tuple[str, float, Circle, np.random.Generator]]:
    """Return name, height, first circle and noise of each aircraft: in turn on the required and the opposite side."""
    requirement, height_m = settings.requirement(), settings.config.aircraft.height_m
    count, found = settings.config.requirement.fleet_size, []
    for k, noise_rng in enumerate(flown.sensor_rng.spawn(count)):
        side = requirement.side if k % 2 == 0 else requirement.side.opposite
        circle = first_circle(settings, flown, side, START_RANGE_M + k // 2 * settings.aircraft().radius_m)
        found.append((f"aircraft {k + 1}", height_m + k * settings.layer_m, circle, noise_rng))
    return found


def _fly_phased(settings: StudySettings, number: int, planner: FleetPlannerName) -> FleetResult:
    flown, watch, errors = scene(settings, number), StopWatch(), _Errors()
    starts = _starts(settings, flown)
    crafts = [SteeredAircraft(settings, flown, circle, height_m, rng) for _, height_m, circle, rng in starts]
    (_, assumed), target = payload_of(settings), OnTicks(flown.target, flown.duration_s)
    joint = JointTrack({name: assumed for name, *_ in starts})

    def estimate(time_s: float, seen: Sequence[Sequence[AnySighting]]) -> TargetEstimate | None:
        for (name, *_), sightings in zip(starts, seen, strict=True):
            for sighting in sightings:
                joint.add(name, sighting)
        found = joint.estimate(time_s)
        if time_s % _JUDGED_S < _TICK_S / 5.0:
            errors.note(found, target.at(time_s))
        return found

    steered = partial(
        phased,
        clockwise=settings.requirement().side.clockwise,
        airspeed_m_s=settings.aircraft().airspeed_m_s,
        constant_speed=planner is FleetPlannerName.FORMATION,
    )

    def steer(states: Sequence[AircraftState], found: TargetEstimate) -> list[tuple[float, float]]:
        return watch(lambda: steered(states, found))

    logs = fly_steered(flown, crafts, estimate, steer)
    heights_m = [height_m for _, height_m, *_ in starts]
    return _result(settings, logs, heights_m, [[] for _ in crafts], watch.taken_s, errors, 0)


def run_fleet(
    settings: StudySettings,
    number: int,
    table: ValueTable,
    planner: FleetPlannerName = FleetPlannerName.JOINT,
    losses: Sequence[Loss] = (),
) -> FleetResult:
    """Fly one run. losses count for joint decisions only."""
    if planner is FleetPlannerName.JOINT:
        return FleetRun(settings, number, table).fly(losses)
    return _fly_phased(settings, number, planner)


def _result(
    settings: StudySettings,
    logs: FloatArray,
    heights_m: Sequence[float],
    changes: Sequence[Sequence[float]],
    taken_s: Sequence[float],
    errors: _Errors,
    handovers: int,
) -> FleetResult:
    results = tuple(judged(settings, *of, [], False) for of in zip(logs, changes, strict=True))
    return FleetResult(
        *shares_of_any(settings, logs),
        _separation_m(logs, heights_m),
        min(result.min_range_m for result in results),
        handovers,
        *errors.shares,
        results,
        np.asarray(taken_s, np.float32),
        logs,
    )


def _separation_m(logs: FloatArray, heights_m: Sequence[float]) -> float:
    least_m = math.inf
    for a, b in itertools.combinations(range(len(heights_m)), 2):
        apart_m = float(np.linalg.norm(logs[a, :, 1:3] - logs[b, :, 1:3], axis=1).min())
        least_m = min(least_m, math.hypot(apart_m, heights_m[a] - heights_m[b]))
    return least_m


Fleets = Mapping[FleetPlannerName, Sequence[FleetResult]]


def fly_fleets(
    settings: StudySettings,
    table: ValueTable,
    workers: Workers,
    progress: Callable[[int], None],
    planners: Sequence[FleetPlannerName] = tuple(FleetPlannerName),
) -> Fleets:
    """Fly all runs with each planner; ``progress`` is called with 1 after each run."""
    tasks = ((settings, number, table, planner) for number in settings.numbers for planner in planners)
    found: dict[tuple[FleetPlannerName, int], FleetResult] = {}
    with closing(parallel(workers, run_fleet, tasks)) as flying:
        for (_, number, _, planner), result in flying:
            found[planner, number] = result
            progress(1)
    return {planner: [found[planner, number] for number in settings.numbers] for planner in planners}


def fleet_table(fleets: Fleets) -> Table:
    """Return mean and worst of each measure, a column for each planner."""
    table = Table("mean/worst", *fleets, box=box.SIMPLE_HEAD)
    for of in OF_FLEETS:
        table.add_row(of.label, *(of.cell(values_of(runs, of.name)) for runs in fleets.values()))
    return table


def values_of(runs: Sequence[object], name: str) -> np.ndarray:
    """Return one value of each run (n,), NaN where it has none."""
    return np.array([getattr(run, name) for run in runs], float)


def fleet_json(settings: StudySettings, fleets: Fleets) -> dict[str, Any]:
    """Return results of each planner and the choice of targets for ``--json``."""
    return {
        "planners": {planner.value: _figures(runs) for planner, runs in fleets.items()},
        "fleet": settings.config.requirement.fleet_size,
        **targets_json(settings),
    }


def _figures(runs: Sequence[FleetResult]) -> dict[str, Any]:
    each = zip(*(run.aircraft for run in runs), strict=True)
    return {
        **{of.name: of.spread(values_of(runs, of.name)) for of in OF_FLEETS},
        "decision_ms": decision_ms(np.concatenate([run.decision_s for run in runs])),
        "aircraft": [{of.name: of.spread(values_of(own, of.name)) for of in ON_FLAT_GROUND} for own in each],
    }
