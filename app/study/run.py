"""One run of a study: one planner against one random target."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from app.study.airframe import KinematicAircraft
from app.study.pilots import LawPilot, Pilot, PlanPilot
from app.study.sensors import PayloadErrors, PayloadSensing, PerfectSensing, Sensing
from app.study.settings import PlannerName, StudySettings
from app.study.target import RandomTarget, Target
from mission.core.circle import Circle
from mission.core.plan import AircraftState
from mission.geometry.wind import ground_speed_m_s
from mission.laws.lateral_guidance import LateralGuidance
from mission.laws.vector_field import VectorField
from mission.paper.planner import PaperPlanner
from mission.predictive.planner import PredictivePlanner
from mission.predictive.value_table import ValueTable

_STEP_S = 0.1
_START_RANGE_M = 300.0
# Of the curvature limit: what correcting the flown line may ask for beyond the circle itself.
_BANK_RESERVE = 1.1

# The guidance laws, tuned by grid search over 20 other targets with perfect sensors: of those that always keep the
# band the one most on the side, with room to both edges. Radii 150 to 400 m, gains 0.25 to 2 1/s, look-aheads 40 to
# 180 m; the other way round they are on the side for 42 % of the time.
_FIELD_RADIUS_M, _FIELD_GAIN_PER_S = 350.0, 0.25
_LATERAL_RADIUS_M, _LATERAL_LOOK_AHEAD_M = 350.0, 80.0

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What was flown, sampled each step: arrays (n,). observation_rad: from the side's normal, wrapped."""

    time_s: FloatArray
    east_m: FloatArray
    north_m: FloatArray
    target_east_m: FloatArray
    target_north_m: FloatArray
    range_m: FloatArray
    observation_rad: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """Fractions are 0..1. observation_histogram counts steps in bins of 5 degrees from -180."""

    time_in_band: float
    time_on_side: float
    min_range_m: float
    max_range_m: float
    moves_per_hour: float
    observation_spread_deg: float
    observation_histogram: npt.NDArray[np.int64]
    decision_s: npt.NDArray[np.float32]
    track: Track | None


def run(
    settings: StudySettings, planner: PlannerName, number: int, table: ValueTable | None, keep_track: bool = False
) -> RunResult:
    """Fly one run. Target and sensor noise depend on the seed and ``number`` only, not on the planner."""
    target_rng, start_rng, sensor_rng = (
        np.random.default_rng(s) for s in np.random.SeedSequence((settings.seed, number)).spawn(3)
    )
    target = RandomTarget(target_rng, settings.duration_s, settings.target_speed_max_m_s, settings.legs_s)
    requirement, aircraft = settings.requirement(), settings.aircraft()
    wind = settings.wind
    normal_rad = target.at(0.0).course_rad + requirement.side.normal_turn_rad
    circle = Circle(
        _START_RANGE_M * math.sin(normal_rad),
        _START_RANGE_M * math.cos(normal_rad),
        aircraft.radius_m,
        requirement.side.clockwise,
    )
    course_rad = float(start_rng.uniform(-math.pi, math.pi))
    start = AircraftState(
        0.0,
        *circle.position_at_course(course_rad),
        course_rad,
        ground_speed_m_s(course_rad, aircraft.airspeed_m_s, wind),
        circle.curvature_per_m,
    )
    body = KinematicAircraft(
        start,
        aircraft.airspeed_m_s,
        math.atan(_BANK_RESERVE * math.tan(settings.circle_bank_rad)),
        aircraft.roll_rate_max_rad_s,
        wind,
    )
    pilot = _pilot(settings, planner, table, circle)
    sensing: Sensing = PerfectSensing() if settings.perfect_sensors else PayloadSensing(sensor_rng, PayloadErrors())

    log = fly(target, body, pilot, sensing, settings.duration_s)
    return _summed_up(settings, pilot, log, keep_track)


def fly(target: Target, body: KinematicAircraft, pilot: Pilot, sensing: Sensing, duration_s: float) -> FloatArray:
    """Fly from the aircraft's present state; return (n, 6): time, aircraft, target (east, north), target's course."""
    steps = round(duration_s / _STEP_S)
    log = np.empty((steps, 6))
    state = body.state
    for k in range(steps):
        truth = target.at(state.time_s)
        sensing.observe(state, body.bank_rad, truth)
        log[k] = (state.time_s, state.east_m, state.north_m, truth.east_m, truth.north_m, truth.course_rad)
        state = body.step(pilot.curvature_per_m(state, sensing.estimate), _STEP_S)
    return log


def _pilot(settings: StudySettings, planner: PlannerName, table: ValueTable | None, circle: Circle) -> Pilot:
    requirement, aircraft = settings.requirement(), settings.aircraft()
    wind = settings.wind
    match planner:
        case PlannerName.PREDICTIVE:
            assert table is not None
            return PlanPilot(PredictivePlanner(aircraft, requirement, table), circle, wind, settings.latency_s)
        case PlannerName.PAPER:
            return PlanPilot(PaperPlanner(aircraft, requirement), circle, wind, settings.latency_s)
        case PlannerName.LVFG:
            field = VectorField(_FIELD_RADIUS_M, requirement.side.clockwise, _FIELD_GAIN_PER_S)
            return LawPilot(field.curvature_per_m)
        case PlannerName.PARK:
            law = LateralGuidance(_LATERAL_RADIUS_M, requirement.side.clockwise, _LATERAL_LOOK_AHEAD_M)
            return LawPilot(law.curvature_per_m)


def _summed_up(settings: StudySettings, pilot: Pilot, log: FloatArray, keep_track: bool) -> RunResult:
    time_s, east_m, north_m, target_east_m, target_north_m, course_rad = log.T
    range_m = np.hypot(east_m - target_east_m, north_m - target_north_m)
    observation_rad = np.arctan2(east_m - target_east_m, north_m - target_north_m) - course_rad
    observation_rad -= settings.requirement().side.normal_turn_rad
    observation_rad = (observation_rad + math.pi) % (2.0 * math.pi) - math.pi
    in_band = (range_m >= settings.range_min_m) & (range_m <= settings.range_max_m)
    return RunResult(
        float(in_band.mean()),
        float((np.abs(observation_rad) <= math.pi / 2).mean()),
        float(range_m.min()),
        float(range_m.max()),
        pilot.moves * 3600.0 / settings.duration_s,
        float(np.degrees(observation_rad).std()),
        np.histogram(np.degrees(observation_rad), bins=72, range=(-180.0, 180.0))[0],
        np.asarray(pilot.controller.taken_s, np.float32),
        Track(time_s, east_m, north_m, target_east_m, target_north_m, range_m, observation_rad)
        if keep_track
        else None,
    )
