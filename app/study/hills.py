"""Runs of a study over hills: the predictive planner over known ground, and as if the ground were flat."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sidelong.app.study.flight import CompiledFlight, Flown, OverGround
from sidelong.app.study.flight_kernel import TARGET_M
from sidelong.app.study.judging import RunResult, judged, judged_log
from sidelong.app.study.run import aircraft_on, first_circle, scene, sensed_by
from sidelong.app.study.settings import Hills, StudySettings
from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import AircraftState, Decision, Plan, settled_m
from sidelong.mission.core.requirement import Wind
from sidelong.mission.core.sight import Sight
from sidelong.mission.predictive.planner import PredictivePlanner
from sidelong.mission.predictive.value_table import ValueTable
from sidelong.mission.terrain.heights import FlightHeights, HeightRules
from sidelong.mission.terrain.sight import SightField

_SPREAD_M = 8_000.0  # targets start within this distance of home
_LOOKED_EVERY = 50  # steps: whether any place of the side and the band sees the target
_AZIMUTHS, _RING_M = 72, 20.0


class HillPlanner:
    """The predictive planner over known ground: each plan gets a height, what cannot be cleared is rejected."""

    def __init__(
        self,
        study: StudySettings,
        ground: Ground,
        heights: FlightHeights,
        table: ValueTable,
        height_m: Callable[[], float],
    ) -> None:
        """height_m: the aircraft's present one."""
        self._heights, self._height_m = heights, height_m
        self._field = SightField(ground, study.requirement().range_max_m + 4.0 * study.aircraft().radius_m)
        self._planner = PredictivePlanner(
            study.aircraft(), study.requirement(), table, check=self._levelled, sight=self._sight
        )
        self._present: Plan | None = None
        self._target = (0.0, 0.0)

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        """See :class:`sidelong.mission.core.plan.Planner`."""
        self._present, self._target = present, (target.east_m, target.north_m)
        return self._planner.decide(aircraft, target, present, wind, latency_s)

    def _levelled(self, plan: Plan) -> Plan | str:
        return self._heights.levelled(plan, settled_m(self._height_m(), self._present), self._target)

    def _sight(self, east_m: float, north_m: float, velocity_east_m_s: float, velocity_north_m_s: float) -> Sight:
        height_m = self._heights.expected_m(self._height_m(), (east_m, north_m))
        return self._field.sight(east_m, north_m, velocity_east_m_s, velocity_north_m_s, height_m)


def run_over(settings: StudySettings, number: int, table: ValueTable, keep_track: bool = False) -> RunResult:
    """Fly one run of the predictive planner: its target starts at a place of its own about home.

    Where the terrain is ignored it flies as over flat ground, at one height above where the target starts.
    """
    assert settings.hills is not None
    flown = scene(settings, number)
    place_rng = np.random.default_rng(np.random.SeedSequence((settings.seed, number, 1)))
    ground = _moved(settings.hills.ground, place_rng)
    own = settings.config.aircraft
    rules = HeightRules(own.height_m, "ground", own.clearance_m, own.airspeed_m_s, own.climb_m_s, own.descent_m_s)
    known, circle, heights = settings.terrain == "known", first_circle(settings, flown), FlightHeights(ground, rules)
    height_m = ground.height_m(0.0, 0.0) + own.height_m
    first = heights.levelled(Plan(circle), None, (0.0, 0.0)) if known else ""
    if isinstance(first, Plan) and first.heights is not None:
        height_m = first.heights.to_m
    flight = CompiledFlight(
        flown.target,
        aircraft_on(settings, flown, circle),
        circle,
        height_m,
        sensed_by(settings, flown),
        settings.wind,
        flown.duration_s,
        OverGround(ground, known, own.climb_m_s, own.descent_m_s),
    )
    if known:
        planner = HillPlanner(settings, ground, heights, table, lambda: flight.height_m)
        run = flight.with_planner(planner, settings.latency_s)
    else:
        plain = PredictivePlanner(settings.aircraft(), settings.requirement(), table)
        run = flight.with_predictive(plain, settings.latency_s)
    # The first decision of a process waits for what is compiled to be loaded.
    decision_s = run.decision_s[1:] or run.decision_s
    over_ground = _over_ground(settings, ground, run)
    return judged(settings, run.log, run.changed_s, decision_s, keep_track, over_ground)


def _over_ground(settings: StudySettings, ground: Ground, run: Flown) -> tuple[float, float, float]:
    """Return the time in sight, that where any place of side and band sees the target, and the least clearance."""
    height_m, in_sight = run.over[:, 0], run.over[:, 1] > 0.0
    steps = range(0, len(run.log), _LOOKED_EVERY)
    course_rad = judged_log(settings, run.log).course_rad
    looked = [_some_place_sees(settings, ground, run.log[k, 3:5], course_rad[k], height_m[k]) for k in steps]
    seeable = in_sight | np.repeat(looked, _LOOKED_EVERY)[: len(in_sight)]
    possible = float(in_sight[seeable].mean()) if seeable.any() else math.nan
    clear_m = height_m - ground.heights_at_m(run.log[:, 1], run.log[:, 2])
    known = ~np.isnan(clear_m)
    return float(in_sight.mean()), possible, float(clear_m[known].min()) if known.any() else math.nan


def _some_place_sees(
    settings: StudySettings, ground: Ground, target_m: FloatArray, course_rad: float, height_m: float
) -> bool:
    """Return whether any position in the band sees the target from a height, on the side if the course is known."""
    wanted = settings.requirement()
    east_m, north_m = target_m.tolist()
    ground_m = ground.height_m(east_m, north_m)
    seen_m = TARGET_M + (0.0 if math.isnan(ground_m) else ground_m)
    rings = math.ceil(wanted.range_max_m / _RING_M)
    needed_m = ground.horizon_m(east_m, north_m, seen_m, _AZIMUTHS, rings, _RING_M)
    needed_m = needed_m[:, math.ceil(wanted.range_min_m / _RING_M) :]
    azimuth_rad = np.arange(_AZIMUTHS) * (2.0 * math.pi / _AZIMUTHS)
    off_rad = azimuth_rad - course_rad - wanted.side.normal_turn_rad
    return bool((needed_m[~(np.cos(off_rad) < 0.0)] <= height_m).any())


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
