"""One run of a study with several aircraft on one target: joint decisions on a joint estimate, or a law with phases.

Roles, advice and plans are those of the coordinator that flies (:mod:`sidelong.mission.fleet.coordinator`). The joint
estimate is that of its filter in a compiled loop, without the exclusion of faulty payloads.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial

import numpy as np

from sidelong.app.simulation.airframe import KinematicAircraft
from sidelong.app.study import fleet_kernel as kernel
from sidelong.app.study.flight import StopWatch, flown_plan, true_estimate
from sidelong.app.study.flight_kernel import (
    CHANGES,
    COMING,
    COMMAND_PER_M,
    DEPARTURE_S,
    PRESENT,
    Flight,
    Target,
    new_flight,
    take_plan,
)
from sidelong.app.study.joint_sight import JointSight
from sidelong.app.study.judging import STEP_S, RunResult, judged, shares_of_any
from sidelong.app.study.run import START_RANGE_M, aircraft_on, first_circle, scene
from sidelong.app.study.settings import StudySettings
from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.settings import TrackerSettings
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.fleet import FleetAdvice, NeighbourPlanned
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.fleet.coordinator import FleetCoordinator, FleetTarget
from sidelong.mission.fleet.events import (
    ClockReported,
    FleetEvent,
    PlansReported,
    TargetRouteGiven,
    Tell,
    Tick,
    VehicleLost,
    VehicleReported,
)
from sidelong.mission.fleet.team import IN_TEAM
from sidelong.mission.fleet.team_planner import TeamPlanner
from sidelong.mission.fleet.vehicle import FleetMember
from sidelong.mission.geometry.progress import circling_of, line_of
from sidelong.mission.laws.phased import phased
from sidelong.mission.predictive.planner import PredictivePlanner
from sidelong.mission.predictive.value_table import ValueTable
from sidelong.mission.route.progress_kernel import fresh_progress
from sidelong.mission.route.route import event_of, route_from

_STEPS = 10  # of a second, after which all decide
_CHI2_95 = 5.991
_TARGET = "target"
_REPORTED_BEFORE_S = 0.01


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
    """What several aircraft came to together. on_side_any, in_band_any: shares of time by at least one of them.

    min_separation_m: the least distance of two aircraft in three dimensions; handovers: of the required side.
    position_error_m: root mean square of the joint estimate; in_ellipse: share of it within 95 %; 0 and 1 with
    perfect sensors. aircraft: each scored as if it were alone. logs (aircraft, n, 6) as judged.
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
    """One aircraft of the run."""

    name: str
    height_m: float
    flight: Flight
    body: KinematicAircraft
    planner: TeamPlanner
    airspeed_m_s: float
    lost: bool = False

    @property
    def state(self) -> AircraftState:
        return AircraftState(*self.flight.body[:6].tolist())

    @property
    def busy(self) -> bool:
        return bool(self.flight.counts[COMING] > 0)

    def plan(self, coming: bool = False) -> Plan:
        """Return the plan that is flown, or the one that comes."""
        which = self.flight.counts[PRESENT]
        departure_s = float(self.flight.numbers[DEPARTURE_S]) if coming or not self.busy else 0.0
        return flown_plan(self.flight, 1 - which if coming else which, departure_s)


class FleetRun:
    """One run with all aircraft of the requirement. Target and noise depend on the seed and ``number`` only."""

    def __init__(self, settings: StudySettings, number: int, table: ValueTable) -> None:
        self._settings, self._scene = settings, scene(settings, number)
        self._steps = round(self._scene.duration_s / STEP_S)
        time_s = np.add.accumulate(np.append(0.0, np.full(self._steps - 1, STEP_S)))
        self._target = Target(np.ascontiguousarray(self._scene.target.sampled(time_s)), np.zeros((1, 3)))
        self._members = self._set_up(table)
        heights_m = [member.height_m for member in self._members]
        self._handovers = 0
        self._estimate: TargetEstimate | None = None
        self._sight = None if settings.perfect_sensors else JointSight(settings, self._scene, heights_m, self._steps)
        self._watch = StopWatch(1)
        self._errors: list[tuple[float, float]] = []
        aircraft, requirement = settings.aircraft(), settings.requirement()
        self._coordinator = FleetCoordinator(
            [FleetMember(one.name, aircraft, TrackerSettings(), one.height_m) for one in self._members],
            [FleetTarget(_TARGET, requirement)],
            lambda _name, flown, wanted: TeamPlanner(PredictivePlanner(flown, wanted, table, IN_TEAM)),
            estimate_of=lambda _target, _time_s: self._estimate,
        )
        self._planners = {one.name: one.planner for one in self._members}
        for name in self._planners:
            self._step(ClockReported(name, 0.0, 0.0, 0.01))
        if self._scene.route is not None:
            self._step(TargetRouteGiven(_TARGET, event_of(self._scene.route, 0.0)))

    def fly(self, planner: FleetPlannerName, losses: Sequence[Loss]) -> FleetResult:
        """Fly with joint decisions, or a law that holds the aircraft at equal phases about the target."""
        if planner is FleetPlannerName.JOINT:
            return self._flown(self._decide, _STEPS, losses)
        steered = partial(
            phased,
            clockwise=self._settings.requirement().side.clockwise,
            airspeed_m_s=self._settings.aircraft().airspeed_m_s,
            constant_speed=planner is FleetPlannerName.FORMATION,
        )

        def steer(estimate: TargetEstimate) -> None:
            states = [member.state for member in self._members]
            for member, (curvature_per_m, airspeed_m_s) in zip(
                self._members, self._watch(lambda: steered(states, estimate)), strict=True
            ):
                member.flight.numbers[COMMAND_PER_M], member.airspeed_m_s = curvature_per_m, airspeed_m_s

        return self._flown(steer, 2, ())

    # -- the run ---------------------------------------------------------------------------------------------

    def _flown(self, decide: Callable[[TargetEstimate], None], steps: int, losses: Sequence[Loss]) -> FleetResult:
        at = 0
        while at < self._steps:
            time_s = float(self._members[0].flight.body[0])
            for loss in losses:
                member = self._members[loss.aircraft]
                if time_s >= loss.time_s and not member.lost:
                    member.lost = True
                    self._step(VehicleLost(member.name, time_s, "lost in this study", yielded=True))
            self._estimate = self._estimated(at, time_s)
            if self._estimate is not None:
                decide(self._estimate)
            for member in self._members:
                frame = member.body.frame(STEP_S)._replace(airspeed_m_s=member.airspeed_m_s)
                kernel.fly_on(member.flight, self._target, frame, steps)
            if self._sight is not None:
                until = min(at + steps, self._steps)
                logs = np.stack([member.flight.log[at:until] for member in self._members])
                self._sight.see(logs, [not member.lost for member in self._members], self._target, at, until)
            at += steps
        return self._result()

    def _estimated(self, step: int, time_s: float) -> TargetEstimate | None:
        truth = self._target.sampled[step]
        if self._sight is None:
            return true_estimate(time_s, truth)
        found = self._sight.estimate(time_s)
        if found is not None:
            off = np.array((found.east_m - truth[0], found.north_m - truth[1]))
            self._errors.append((float(off @ off), float(off @ np.linalg.solve(found.covariance[:2, :2], off))))
        return found

    def _decide(self, estimate: TargetEstimate) -> None:
        """Let the coordinator assign the roles, and each aircraft decide by its advice."""
        time_s, settings = round(estimate.time_s, 3), self._settings
        flying = [member for member in self._members if not member.lost]
        before = self._coordinator.primary(_TARGET)
        for member in flying:
            self._planned(member)
            # Before the tick, so that the roles go by the same moment of all.
            self._step(
                VehicleReported(
                    *(member.name, time_s - _REPORTED_BEFORE_S, member.state, member.height_m, True),
                    *(settings.latency_s, settings.wind),
                )
            )
        self._step(Tick(time_s))
        self._handovers += before is not None and self._coordinator.primary(_TARGET) != before
        for member in flying:
            if not member.busy:
                arguments = member.state, estimate, member.plan(), settings.wind, settings.latency_s
                plan = self._watch(partial(member.planner.decide, *arguments)).plan
                if plan is not None:
                    take_plan(member.flight, plan.departure_s, *line_of(plan))
                    self._planned(member)

    def _planned(self, member: _Member) -> None:
        self._step(PlansReported(member.name, member.plan(), member.plan(coming=True) if member.busy else None))

    def _step(self, event: FleetEvent) -> None:
        for command in self._coordinator.step(event):
            match command:
                case Tell(name, RouteGiven() as given):
                    route = route_from(given)
                    self._planners[name].follow(route, fresh_progress(route.east_m.size))
                case Tell(name, FleetAdvice() | NeighbourPlanned() as news):
                    self._planners[name].advise(news)

    def _result(self) -> FleetResult:
        settings, logs = self._settings, np.stack([member.flight.log for member in self._members])
        changes = [one.flight.changed_s[: one.flight.counts[CHANGES]].tolist() for one in self._members]
        results = tuple(judged(settings, *of, [], False) for of in zip(logs, changes, strict=True))
        side, side_now, band = shares_of_any(settings, logs)
        squared = np.array(self._errors) if self._errors else np.zeros((1, 2))
        return FleetResult(
            side,
            side_now,
            band,
            _separation_m(logs, [member.height_m for member in self._members]),
            min(result.min_range_m for result in results),
            self._handovers,
            math.sqrt(float(squared[:, 0].mean())),
            float((squared[:, 1] < _CHI2_95).mean()),
            results,
            np.asarray(self._watch.taken_s, np.float32),
            logs,
        )

    def _set_up(self, table: ValueTable) -> list[_Member]:
        """Set the aircraft up in turn on the required and the opposite side, each in a height layer of its own."""
        settings, flown = self._settings, self._scene
        requirement, aircraft = settings.requirement(), settings.aircraft()
        members = []
        for k in range(settings.config.requirement.fleet_size):
            side = requirement.side if k % 2 == 0 else requirement.side.opposite
            circle = first_circle(settings, flown, side, START_RANGE_M + k // 2 * aircraft.radius_m)
            body, height_m = (
                aircraft_on(settings, flown, circle),
                settings.config.aircraft.height_m + k * settings.layer_m,
            )
            members.append(
                _Member(
                    f"aircraft {k + 1}",
                    height_m,
                    new_flight(body.body, circling_of(circle), height_m, (1, 1), self._steps, 1),
                    body,
                    TeamPlanner(PredictivePlanner(aircraft, requirement, table, IN_TEAM)),
                    aircraft.airspeed_m_s,
                )
            )
        return members


def run_fleet(
    settings: StudySettings,
    number: int,
    table: ValueTable,
    planner: FleetPlannerName = FleetPlannerName.JOINT,
    losses: Sequence[Loss] = (),
) -> FleetResult:
    """Fly one run. losses count for joint decisions only."""
    return FleetRun(settings, number, table).fly(planner, losses)


def _separation_m(logs: FloatArray, heights_m: Sequence[float]) -> float:
    """Return the least distance of two aircraft, in three dimensions."""
    least_m = math.inf
    for a, b in itertools.combinations(range(len(heights_m)), 2):
        apart_m = float(np.linalg.norm(logs[a, :, 1:3] - logs[b, :, 1:3], axis=1).min())
        least_m = min(least_m, math.hypot(apart_m, heights_m[a] - heights_m[b]))
    return least_m
