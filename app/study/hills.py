"""Runs of a study over hills: the predictive planner over known ground, and as if the ground were flat."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from typing import Any

import numpy as np

from app.study.airframe import KinematicAircraft
from app.study.judging import STEP_S, RunResult, judged
from app.study.pilots import DECISION_PERIOD_S, EstimateAt, PlanFollower, StopWatch
from app.study.run import BANK_RESERVE, START_RANGE_M, fly, payload_of
from app.study.scene import scene
from app.study.sensors import PayloadSensing
from app.study.settings import Hills, StudySettings
from app.study.target import TargetTruth
from estimators.terrain.ground import Ground
from mission.core.circle import Circle
from mission.core.plan import AircraftState, Plan, settled_m
from mission.core.requirement import Requirement
from mission.geometry.wind import ground_speed_m_s
from mission.predictive._sight_kernel import NOTHING_HIDDEN, Sight
from mission.predictive.planner import PredictivePlanner
from mission.predictive.value_table import ValueTable
from mission.terrain.heights import FlightHeights, HeightRules
from mission.terrain.sight import SightField

_SPREAD_M = 8_000.0  # targets start so far about home
_LOOKED_EVERY = 50  # steps: whether any place of the side and the band sees the target
_AZIMUTHS, _RING_M = 72, 20.0
_TARGET_M = 1.0


class HillFlight:
    """Sensing and pilot of one run: what hills hide is not measured, and each plan is flown at its own height.

    Where the terrain is ignored it flies as over flat ground, at one height above where the target starts.
    """

    def __init__(
        self,
        study: StudySettings,
        ground: Ground,
        table: ValueTable,
        circle: Circle,
        sensor_rng: np.random.Generator,
    ) -> None:
        known = study.terrain == "known"
        self._study, self._ground = study, ground
        self._requirement: Requirement = study.requirement()
        rules = HeightRules(
            study.height_m,
            "ground",
            study.clearance_m,
            study.airspeed_m_s,
            study.climb_m_s,
            study.descent_m_s,
        )
        self._heights = FlightHeights(ground, rules) if known else None
        self._field = SightField(ground, study.range_max_m + 4.0 * study.radius_m)
        first: Plan | str = Plan(circle)
        if self._heights is not None:
            first = self._heights.levelled(Plan(circle), None, (0.0, 0.0))
        plan = Plan(circle) if isinstance(first, str) else first
        self._follower = PlanFollower(plan)
        self.height_m = ground.height_m(0.0, 0.0) + study.height_m if plan.heights is None else plan.heights.to_m
        self.changed_s, self.stopwatch = self._follower.changed_s, StopWatch()
        self._sensing = PayloadSensing(sensor_rng, *payload_of(study), study.height_m)
        if known:
            self._sensing.tracker.stand_on(ground)
        self._planner = PredictivePlanner(
            study.aircraft(), self._requirement, table, check=self._check, sight=self._sight
        )
        self._next_s = 0.0
        self._target = (0.0, 0.0)
        self._steps = 0
        self.seen: list[bool] = []
        self.seeable: list[bool] = []
        self.clearances_m: list[float] = []

    def observe(self, aircraft: AircraftState, bank_rad: float, target: TargetTruth) -> None:
        """See :class:`app.study.sensors.Sensing`."""
        ground_m = self._ground.height_m(target.east_m, target.north_m)
        target_m = 0.0 if math.isnan(ground_m) else ground_m
        place = (aircraft.east_m, aircraft.north_m, self.height_m)
        seen = self._ground.sees(place, (target.east_m, target.north_m, target_m + _TARGET_M))
        below_m = self._ground.height_m(aircraft.east_m, aircraft.north_m)
        if not math.isnan(below_m):
            self.clearances_m.append(self.height_m - below_m)
        self.seen.append(seen)
        if self._steps % _LOOKED_EVERY == 0:
            self._seeable = self._some_place_sees(target, target_m)
        self.seeable.append(seen or self._seeable)
        self._steps += 1
        self._sensing.height_m, self._sensing.target_height_m, self._sensing.sees = self.height_m, target_m, seen
        self._sensing.observe(aircraft, bank_rad, target)

    def estimate(self, time_s: float) -> Any:
        """See :class:`app.study.sensors.Sensing`."""
        return self._sensing.estimate(time_s)

    def curvature_per_m(self, aircraft: AircraftState, estimate_at: EstimateAt) -> float:
        """See :class:`app.study.pilots.Pilot`."""
        follower = self._follower
        if follower.coming is None and aircraft.time_s >= self._next_s - 1e-6:
            self._next_s = aircraft.time_s + DECISION_PERIOD_S
            estimate = estimate_at(aircraft.time_s)
            if estimate is not None:
                self._target = (estimate.east_m, estimate.north_m)
                wind, latency_s = self._study.wind, self._study.latency_s
                decided = self.stopwatch(
                    lambda: self._planner.decide(aircraft, estimate, follower.plan, wind, latency_s)
                ).plan
                levelled = None if decided is None else self._levelled(decided)
                follower.coming = None if isinstance(levelled, str) else levelled
        curvature_per_m = follower.curvature_per_m(aircraft)
        heights = follower.plan.heights
        if heights is not None:
            up_m, down_m = self._study.climb_m_s * STEP_S, self._study.descent_m_s * STEP_S
            self.height_m += min(max(heights.to_m - self.height_m, -down_m), up_m)
        return curvature_per_m

    def _levelled(self, plan: Plan) -> Plan | str:
        if self._heights is None:
            return plan
        return self._heights.levelled(plan, settled_m(self.height_m, self._follower.plan), self._target)

    def _check(self, plan: Plan) -> str | None:
        levelled = self._levelled(plan)
        return levelled if isinstance(levelled, str) else None

    def _sight(self, east_m: float, north_m: float, velocity_east_m_s: float, velocity_north_m_s: float) -> Sight:
        if self._heights is None:
            return NOTHING_HIDDEN
        height_m = self._heights.expected_m(self.height_m, (east_m, north_m))
        return self._field.sight(east_m, north_m, velocity_east_m_s, velocity_north_m_s, height_m)

    def _some_place_sees(self, target: TargetTruth, target_m: float) -> bool:
        study = self._study
        rings = math.ceil(study.range_max_m / _RING_M)
        needed_m = self._ground.horizon_m(
            target.east_m, target.north_m, target_m + _TARGET_M, _AZIMUTHS, rings, _RING_M
        )[:, math.ceil(study.range_min_m / _RING_M) :]
        azimuth_rad = np.arange(_AZIMUTHS) * (2.0 * math.pi / _AZIMUTHS)
        off_rad = azimuth_rad - target.course_rad - self._requirement.side.normal_turn_rad
        return bool((needed_m[np.cos(off_rad) >= 0.0] <= self.height_m).any())


def run_over(settings: StudySettings, number: int, table: ValueTable, keep_track: bool = False) -> RunResult:
    """Fly one run of the predictive planner: its target starts at a place of its own about home."""
    assert settings.hills is not None
    flown = scene(settings, number)
    place_rng = np.random.default_rng(np.random.SeedSequence((settings.seed, number, 1)))
    ground = _moved(settings.hills.ground, place_rng)
    side, aircraft = settings.requirement().side, settings.aircraft()
    normal_rad = flown.target.at(0.0).course_rad + side.normal_turn_rad
    circle = Circle(
        START_RANGE_M * math.sin(normal_rad), START_RANGE_M * math.cos(normal_rad), settings.radius_m, side.clockwise
    )
    course_rad = float(flown.start_rng.uniform(-math.pi, math.pi))
    start = AircraftState(
        0.0,
        *circle.position_at_course(course_rad),
        course_rad,
        ground_speed_m_s(course_rad, aircraft.airspeed_m_s, settings.wind),
        circle.curvature_per_m,
    )
    body = KinematicAircraft(
        start,
        aircraft.airspeed_m_s,
        math.atan(BANK_RESERVE * math.tan(settings.circle_bank_rad)),
        aircraft.roll_rate_max_rad_s,
        settings.wind,
        settings.lag_s,
    )
    flight = HillFlight(settings, ground, table, circle, flown.sensor_rng)
    log = fly(flown.target, body, flight, flight, flown.duration_s)
    seen, seeable = np.array(flight.seen), np.array(flight.seeable)
    over_ground = (
        float(seen.mean()),
        float(seen[seeable].mean()) if seeable.any() else math.nan,
        min(flight.clearances_m, default=math.nan),
    )
    # The first decision of a process waits for what is compiled to be loaded.
    decision_s = flight.stopwatch.taken_s[1:] or flight.stopwatch.taken_s
    return judged(settings, log, flight.changed_s, decision_s, keep_track, over_ground)


def hills_of(ground: Ground) -> Hills:
    """Return the ground with its digest."""
    posts = (ground.west_m, ground.south_m, ground.step_east_m, ground.step_north_m, ground.sigma_m)
    return Hills(ground, hashlib.sha256(repr(posts).encode() + ground.heights_m.tobytes()).hexdigest()[:16])


def _moved(ground: Ground, rng: np.random.Generator) -> Ground:
    """Return the ground as seen from a place about home that is known."""
    while True:
        east_m, north_m = rng.uniform(-_SPREAD_M, _SPREAD_M, 2).tolist()
        if not math.isnan(ground.height_m(east_m, north_m)):
            return replace(ground, west_m=ground.west_m - east_m, south_m=ground.south_m - north_m)
