"""One run of a study with several aircraft on one target: joint decisions, a joint estimate, height layers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.study.airframe import KinematicAircraft
from app.study.judging import STEP_S, FloatArray, RunResult, judged, shares_of_any
from app.study.pilots import PlanFollower, StopWatch
from app.study.run import BANK_RESERVE, START_RANGE_M, sensing_of
from app.study.scene import Scene, scene
from app.study.sensors import Sensing
from app.study.settings import StudySettings
from estimators.estimate import TargetEstimate
from estimators.fusion import fused
from mission.core.circle import Circle
from mission.core.plan import AircraftState, Plan, Planner
from mission.core.requirement import Requirement, Side
from mission.fleet.planner import FleetPlanner, Member, opposite
from mission.geometry.wind import ground_speed_m_s
from mission.predictive.planner import PredictivePlanner
from mission.predictive.value_table import ValueTable

_DECISION_PERIOD_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class FleetResult:
    """What several aircraft came to together. on_side_any, in_band_any: shares of time by at least one of them.

    min_separation_m: the least distance of two aircraft in three dimensions; handovers: of the wanted side.
    aircraft: each by itself, judged as if it were alone.
    """

    time_on_side_any: float
    time_on_side_any_5s: float
    time_in_band_any: float
    min_separation_m: float
    min_range_m: float
    handovers: int
    aircraft: tuple[RunResult, ...]
    decision_s: np.ndarray


@dataclass(slots=True)
class _Member:
    """One aircraft of the run."""

    name: str
    height_m: float
    body: KinematicAircraft
    follower: PlanFollower
    sensing: Sensing


def run_fleet(settings: StudySettings, number: int, table: ValueTable, keep_track: bool = False) -> FleetResult:
    """Fly one run with ``settings.fleet`` aircraft. Target and noise depend on the seed and ``number`` only."""
    flown = scene(settings, number)
    members = _members(settings, flown)
    requirement, aircraft = settings.requirement(), settings.aircraft()

    def planner(_name: str, wanted: Requirement) -> Planner:
        return PredictivePlanner(aircraft, wanted, table)

    fleet = FleetPlanner(tuple(member.name for member in members), requirement, planner)
    stopwatch = StopWatch()
    steps = round(flown.duration_s / STEP_S)
    logs = np.empty((len(members), steps, 6))
    holder, handovers, next_s = None, 0, 0.0
    for k in range(steps):
        time_s = members[0].body.state.time_s
        truth = flown.target.at(time_s)
        for log, member in zip(logs, members, strict=True):
            state = member.body.state
            member.sensing.observe(state, member.body.bank_rad, truth)
            log[k] = (time_s, state.east_m, state.north_m, truth.east_m, truth.north_m, truth.course_rad)
        if time_s >= next_s - 1e-6:
            next_s = time_s + _DECISION_PERIOD_S
            estimate = _estimate(members, time_s)
            if estimate is not None:
                _decide(fleet, members, estimate, settings, stopwatch)
            handovers += holder is not None and fleet.assignment.holder != holder
            holder = fleet.assignment.holder
        for member in members:
            member.body.step(member.follower.curvature_per_m(member.body.state), STEP_S)
    results = tuple(
        judged(settings, log, member.follower.changed_s, [], keep_track)
        for log, member in zip(logs, members, strict=True)
    )
    side, side_5s, band = shares_of_any(settings, logs)
    return FleetResult(
        side,
        side_5s,
        band,
        _separation_m(logs, [member.height_m for member in members]),
        min(result.min_range_m for result in results),
        handovers,
        results,
        np.asarray(stopwatch.taken_s, np.float32),
    )


def _decide(
    fleet: FleetPlanner,
    members: Sequence[_Member],
    estimate: TargetEstimate,
    settings: StudySettings,
    stopwatch: StopWatch,
) -> None:
    told = {
        member.name: Member(
            member.body.state, member.follower.plan, settings.latency_s, busy=member.follower.coming is not None
        )
        for member in members
    }
    decided = stopwatch(lambda: fleet.decide(told, estimate, settings.wind))
    for member in members:
        decision = decided[member.name].decision
        if decision is not None and decision.plan is not None:
            member.follower.take_up(decision.plan)


def _estimate(members: Sequence[_Member], time_s: float) -> TargetEstimate | None:
    estimates = {member.name: member.sensing.estimate(time_s) for member in members}
    return fused({name: estimate for name, estimate in estimates.items() if estimate is not None}).estimate


def _members(settings: StudySettings, flown: Scene) -> list[_Member]:
    """Set the aircraft up in turn on the wanted and the opposite side, each in a height layer of its own."""
    requirement = settings.requirement()
    seeds = flown.sensor_rng.spawn(settings.fleet)
    members = []
    for k in range(settings.fleet):
        wanted = requirement if k % 2 == 0 else opposite(requirement)
        height_m = settings.height_m + k * settings.layer_m
        circle = _start_circle(settings, flown, wanted.side, k // 2)
        course_rad = float(flown.start_rng.uniform(-math.pi, math.pi))
        start = AircraftState(
            0.0,
            *circle.position_at_course(course_rad),
            course_rad,
            ground_speed_m_s(course_rad, settings.airspeed_m_s, settings.wind),
            circle.curvature_per_m,
        )
        body = KinematicAircraft(
            start,
            settings.airspeed_m_s,
            math.atan(BANK_RESERVE * math.tan(settings.circle_bank_rad)),
            settings.aircraft().roll_rate_max_rad_s,
            settings.wind,
            settings.lag_s,
        )
        sensing = sensing_of(replace(settings, height_m=height_m), seeds[k])
        members.append(_Member(f"aircraft {k + 1}", height_m, body, PlanFollower(Plan(circle)), sensing))
    return members


def _start_circle(settings: StudySettings, flown: Scene, side: Side, row: int) -> Circle:
    normal_rad = flown.target.at(0.0).course_rad + side.normal_turn_rad
    range_m = START_RANGE_M + row * settings.radius_m
    return Circle(range_m * math.sin(normal_rad), range_m * math.cos(normal_rad), settings.radius_m, side.clockwise)


def _separation_m(logs: FloatArray, heights_m: Sequence[float]) -> float:
    """Return the least distance of two aircraft, in three dimensions."""
    least_m = math.inf
    for a, b in itertools.combinations(range(len(heights_m)), 2):
        apart_m = float(np.linalg.norm(logs[a, :, 1:3] - logs[b, :, 1:3], axis=1).min())
        least_m = min(least_m, math.hypot(apart_m, heights_m[a] - heights_m[b]))
    return least_m
