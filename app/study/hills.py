"""A study over hills: the predictive planner over known ground, and as if the ground were flat."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from app.study.airframe import KinematicAircraft
from app.study.judging import STEP_S, RunResult, judged
from app.study.pilots import DECISION_PERIOD_S, EstimateAt, PlanFollower, StopWatch
from app.study.processes import uninterrupted
from app.study.report import spread
from app.study.run import BANK_RESERVE, START_RANGE_M, fly, payload_of
from app.study.scene import scene
from app.study.sensors import PayloadSensing
from app.study.settings import StudySettings
from app.study.target import TargetTruth
from estimators.terrain.ground import Ground
from mission.core.circle import Circle
from mission.core.plan import AircraftState, Plan, settled_m
from mission.core.requirement import Requirement
from mission.predictive._sight_kernel import NOTHING_HIDDEN, Sight
from mission.predictive.planner import PredictivePlanner
from mission.predictive.value_table import ValueTable
from mission.terrain.heights import FlightHeights, HeightRules
from mission.terrain.sight import SightField

_SPREAD_M = 8_000.0  # targets start so far about home
_LOOKED_EVERY = 50  # steps: whether any place of the side and the band sees the target
_AZIMUTHS, _RING_M = 72, 20.0
_TARGET_M = 1.0


@dataclass(frozen=True, slots=True)
class HillSettings:
    """Over one ground. clearance_m, climb_m_s and descent_m_s are as a mission's."""

    study: StudySettings
    ground: Ground
    clearance_m: float = 50.0
    climb_m_s: float = 3.0
    descent_m_s: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class HillResult:
    """One run. Shares 0..1: of all time, and of the time in which some place of side and band sees the target."""

    result: RunResult
    time_in_sight: float
    time_in_sight_where_possible: float
    min_clearance_m: float


class HillFlight:
    """Sensing and pilot of one run: what hills hide is not measured, and each plan is flown at its own height.

    heights None: as over flat ground, at one height above where the target starts.
    """

    def __init__(
        self,
        settings: HillSettings,
        ground: Ground,
        table: ValueTable,
        circle: Circle,
        sensor_rng: np.random.Generator,
        known: bool,
    ) -> None:
        study = settings.study
        self._settings, self._ground = settings, ground
        self._requirement: Requirement = study.requirement()
        rules = HeightRules(
            study.height_m,
            "ground",
            settings.clearance_m,
            study.airspeed_m_s,
            settings.climb_m_s,
            settings.descent_m_s,
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
                wind, latency_s = self._settings.study.wind, self._settings.study.latency_s
                decided = self.stopwatch(
                    lambda: self._planner.decide(aircraft, estimate, follower.plan, wind, latency_s)
                ).plan
                levelled = None if decided is None else self._levelled(decided)
                follower.coming = None if isinstance(levelled, str) else levelled
        curvature_per_m = follower.curvature_per_m(aircraft)
        heights = follower.plan.heights
        if heights is not None:
            up_m, down_m = self._settings.climb_m_s * STEP_S, self._settings.descent_m_s * STEP_S
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
        study = self._settings.study
        rings = math.ceil(study.range_max_m / _RING_M)
        needed_m = self._ground.horizon_m(
            target.east_m, target.north_m, target_m + _TARGET_M, _AZIMUTHS, rings, _RING_M
        )[:, math.ceil(study.range_min_m / _RING_M) :]
        azimuth_rad = np.arange(_AZIMUTHS) * (2.0 * math.pi / _AZIMUTHS)
        off_rad = azimuth_rad - target.course_rad - self._requirement.side.normal_turn_rad
        return bool((needed_m[np.cos(off_rad) >= 0.0] <= self.height_m).any())


def fly_over(settings: HillSettings, number: int, table: ValueTable, known: bool) -> HillResult:
    """Fly one run: its target starts at a place of its own about home."""
    study = settings.study
    flown = scene(study, number)
    place_rng = np.random.default_rng(np.random.SeedSequence((study.seed, number, 1)))
    ground = _moved(settings.ground, place_rng)
    side = study.requirement().side
    normal_rad = flown.target.at(0.0).course_rad + side.normal_turn_rad
    circle = Circle(
        START_RANGE_M * math.sin(normal_rad), START_RANGE_M * math.cos(normal_rad), study.radius_m, side.clockwise
    )
    course_rad = float(flown.start_rng.uniform(-math.pi, math.pi))
    start = AircraftState(
        0.0, *circle.position_at_course(course_rad), course_rad, study.airspeed_m_s, circle.curvature_per_m
    )
    body = KinematicAircraft(
        start,
        study.airspeed_m_s,
        math.atan(BANK_RESERVE * math.tan(study.circle_bank_rad)),
        study.aircraft().roll_rate_max_rad_s,
        study.wind,
        study.lag_s,
    )
    flight = HillFlight(settings, ground, table, circle, flown.sensor_rng, known)
    log = fly(flown.target, body, flight, flight, flown.duration_s)
    result = judged(study, log, flight.changed_s, flight.stopwatch.taken_s, keep_track=False)
    seen, seeable = np.array(flight.seen), np.array(flight.seeable)
    where_possible = float(seen[seeable].mean()) if seeable.any() else math.nan
    return HillResult(result, float(seen.mean()), where_possible, min(flight.clearances_m, default=math.nan))


def _moved(ground: Ground, rng: np.random.Generator) -> Ground:
    """Return the ground as seen from a place about home that is known."""
    while True:
        east_m, north_m = rng.uniform(-_SPREAD_M, _SPREAD_M, 2).tolist()
        if not math.isnan(ground.height_m(east_m, north_m)):
            return replace(ground, west_m=ground.west_m - east_m, south_m=ground.south_m - north_m)


# -- many of them ------------------------------------------------------------------------------------------

WAYS = {"over known ground": True, "as if it were flat": False}


def fly_study(
    settings: HillSettings, table: ValueTable, jobs: int | None, progress: Callable[[int], None]
) -> dict[str, list[HillResult]]:
    """Fly all runs both ways, on so many processes; progress hears of each that is done."""
    tasks = [(way, number) for way in WAYS for number in settings.study.numbers]
    found: dict[tuple[str, int], HillResult] = {}
    with uninterrupted():
        pool = multiprocessing.get_context("spawn").Pool(jobs or os.cpu_count() or 1, _begin, (settings, table))
    with pool:
        for task, result in pool.imap_unordered(_fly, tasks):
            found[task] = result
            progress(1)
    return {way: [found[way, number] for number in settings.study.numbers] for way in WAYS}


_worker: tuple[HillSettings, ValueTable]


def _begin(settings: HillSettings, table: ValueTable) -> None:
    global _worker  # noqa: PLW0603  # what a worker needs is too large to come with every task
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _worker = settings, table
    brief = replace(settings, study=replace(settings.study, duration_s=5.0))
    fly_over(brief, 0, table, known=True)  # loading what is compiled is no decision's time


def _fly(task: tuple[str, int]) -> tuple[tuple[str, int], HillResult]:
    return task, fly_over(_worker[0], task[1], _worker[1], WAYS[task[0]])


def hill_table(flown: dict[str, list[HillResult]]) -> Table:
    """Return the figures for people: mean and worst of each way."""
    table = Table("", "", *flown, box=box.SIMPLE_HEAD)
    rows: tuple[tuple[str, Callable[[HillResult], float], float, int], ...] = (
        ("time in sight, %", lambda one: one.time_in_sight, 100.0, 1),
        ("where some place sees it, %", lambda one: one.time_in_sight_where_possible, 100.0, 1),
        ("time on side, %", lambda one: one.result.time_on_side, 100.0, 1),
        ("time in band, %", lambda one: one.result.time_in_band, 100.0, 1),
        ("least height over ground, m", lambda one: one.min_clearance_m, 1.0, 0),
    )
    for label, value, scale, digits in rows:
        values = [scale * np.array([value(one) for one in runs]) for runs in flown.values()]
        table.add_row(label, "mean", *(f"{np.nanmean(of):.{digits}f}" for of in values))
        table.add_row("", "worst", *(f"{np.nanmin(of):.{digits}f}" for of in values))
    for tail in (50, 99):
        times_ms = (1e3 * np.concatenate([one.result.decision_s for one in runs]) for runs in flown.values())
        row = (f"{np.percentile(of, tail):.2f}" for of in times_ms)
        table.add_row("decision, ms" if tail == 50 else "", f"{tail} %", *row)
    return table


def hill_json(flown: dict[str, list[HillResult]]) -> dict[str, Any]:
    """Return the summary that ``--json`` writes."""

    def over(values: list[float]) -> dict[str, float | None]:
        return spread(np.array(values), 5)

    return {
        way.replace(" ", "_"): {
            "time_in_sight": over([one.time_in_sight for one in runs]),
            "time_in_sight_where_possible": over([one.time_in_sight_where_possible for one in runs]),
            "min_clearance_m": over([one.min_clearance_m for one in runs]),
            "time_on_side": over([one.result.time_on_side for one in runs]),
            "time_in_band": over([one.result.time_in_band for one in runs]),
            "decision_ms": {
                f"p{tail}": float(1e3 * np.percentile(np.concatenate([one.result.decision_s for one in runs]), tail))
                for tail in (50, 99)
            },
        }
        for way, runs in flown.items()
    }
