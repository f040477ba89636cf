"""One run of a study: one planner against one target."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from app.assembly import tracker_settings
from app.study.airframe import KinematicAircraft
from app.study.flight import CompiledFlight, Flown, Sensed, can_fly
from app.study.judging import STEP_S, RunResult, judged
from app.study.pilots import GuidanceLaw, LawPilot, Pilot, PlanPilot
from app.study.scene import scene
from app.study.sensors import PayloadErrors, PayloadSensing, PerfectSensing, Sensing
from app.study.settings import PlannerName, StudySettings
from app.study.target import Target
from estimators.settings import TrackerSettings
from mission.core.circle import Circle
from mission.core.plan import AircraftState
from mission.geometry.wind import ground_speed_m_s
from mission.laws.lateral_guidance import LateralGuidance
from mission.laws.vector_field import VectorField
from mission.paper.planner import PaperPlanner
from mission.predictive.planner import PredictivePlanner
from mission.predictive.value_table import ValueTable

START_RANGE_M = 300.0
# Of the curvature limit: what correcting the flown line may ask for beyond the circle itself.
BANK_RESERVE = 1.1

# The guidance laws, tuned by grid search over 20 other targets with perfect sensors: of those that always keep the
# band the one most on the side, with room to both edges. Radii 150 to 400 m, gains 0.25 to 2 1/s, look-aheads 40 to
# 180 m; the other way round they are on the side for 42 % of the time.
_FIELD_RADIUS_M, _FIELD_GAIN_PER_S = 350.0, 0.25
_LATERAL_RADIUS_M, _LATERAL_LOOK_AHEAD_M = 350.0, 80.0

FloatArray = npt.NDArray[np.float64]


def run(
    settings: StudySettings, planner: PlannerName, number: int, table: ValueTable | None, keep_track: bool = False
) -> RunResult:
    """Fly one run. Target and sensor noise depend on the seed and ``number`` only, not on the planner."""
    flown = scene(settings, number)
    target = flown.target
    requirement, aircraft = settings.requirement(), settings.aircraft()
    wind = settings.wind
    normal_rad = target.at(0.0).course_rad + requirement.side.normal_turn_rad
    if requirement.sector is not None:
        normal_rad = requirement.sector.middle_rad
    circle = Circle(
        START_RANGE_M * math.sin(normal_rad),
        START_RANGE_M * math.cos(normal_rad),
        aircraft.radius_m,
        requirement.side.clockwise,
    )
    course_rad = float(flown.start_rng.uniform(-math.pi, math.pi))
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
        math.atan(BANK_RESERVE * math.tan(settings.circle_bank_rad)),
        aircraft.roll_rate_max_rad_s,
        wind,
        settings.lag_s,
    )
    errors, told = payload_of(settings)
    if can_fly(told):
        sensed = Sensed(errors, told, settings.height_m, flown.sensor_rng, settings.perfect_sensors)
        flight = CompiledFlight(target, body, circle, sensed, wind, flown.duration_s)
        run = _steered(settings, planner, table, flight)
        return judged(settings, run.log, run.changed_s, run.decision_s, keep_track)
    pilot = _pilot(settings, planner, table, circle)
    sensing = sensing_of(settings, flown.sensor_rng)
    log = fly(target, body, pilot, sensing, flown.duration_s)
    return judged(settings, log, pilot.changed_s, pilot.stopwatch.taken_s, keep_track)


def _steered(
    settings: StudySettings, planner: PlannerName, table: ValueTable | None, flight: CompiledFlight
) -> Flown:
    """Fly a run in the compiled loop."""
    aircraft, requirement = settings.aircraft(), settings.requirement()
    match planner:
        case PlannerName.PREDICTIVE:
            assert table is not None
            return flight.with_predictive(PredictivePlanner(aircraft, requirement, table), settings.latency_s)
        case PlannerName.PAPER:
            return flight.with_planner(PaperPlanner(aircraft, requirement), settings.latency_s)
        case _:
            return flight.with_law(_law(planner, requirement.side.clockwise))


def fly(target: Target, body: KinematicAircraft, pilot: Pilot, sensing: Sensing, duration_s: float) -> FloatArray:
    """Fly step by step from the aircraft's present state, with any sensing and pilot.

    Returns (n, 6): time, aircraft, target (east, north), target's course.
    """
    steps = round(duration_s / STEP_S)
    log = np.empty((steps, 6))
    state = body.state
    for k in range(steps):
        truth = target.at(state.time_s)
        sensing.observe(state, body.bank_rad, truth)
        log[k] = (state.time_s, state.east_m, state.north_m, truth.east_m, truth.north_m, truth.course_rad)
        state = body.step(pilot.curvature_per_m(state, sensing.estimate), STEP_S)
    return log


def sensing_of(settings: StudySettings, rng: np.random.Generator) -> Sensing:
    """Return what one aircraft sees the target with."""
    if settings.perfect_sensors:
        return PerfectSensing()
    return PayloadSensing(rng, *payload_of(settings), settings.height_m)


def payload_of(settings: StudySettings) -> tuple[PayloadErrors, TrackerSettings]:
    """Return the errors of the payload, and what the tracker is told of it."""
    sensors = settings.sensors
    errors = PayloadErrors(sensors.range_sigma_m, math.radians(sensors.angle_sigma_deg))
    return errors, tracker_settings(sensors, settings.lost_after_s)


def _pilot(settings: StudySettings, planner: PlannerName, table: ValueTable | None, circle: Circle) -> Pilot:
    requirement, aircraft = settings.requirement(), settings.aircraft()
    wind = settings.wind
    match planner:
        case PlannerName.PREDICTIVE:
            assert table is not None
            return PlanPilot(PredictivePlanner(aircraft, requirement, table), circle, wind, settings.latency_s)
        case PlannerName.PAPER:
            return PlanPilot(PaperPlanner(aircraft, requirement), circle, wind, settings.latency_s)
        case _:
            return LawPilot(_law(planner, requirement.side.clockwise))


def _law(planner: PlannerName, clockwise: bool) -> GuidanceLaw:
    if planner is PlannerName.LVFG:
        return VectorField(_FIELD_RADIUS_M, clockwise, _FIELD_GAIN_PER_S).curvature_per_m
    return LateralGuidance(_LATERAL_RADIUS_M, clockwise, _LATERAL_LOOK_AHEAD_M).curvature_per_m
