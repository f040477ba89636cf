"""One run of a study: its target, start and noise, and one planner."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sidelong.app.assembly import tracker_settings
from sidelong.app.simulation.airframe import KinematicAircraft
from sidelong.app.simulation.payload import PayloadErrors
from sidelong.app.simulation.target import RandomTarget
from sidelong.app.study.controller import ExternalController
from sidelong.app.study.flight import CompiledFlight, Flown, Sensed
from sidelong.app.study.judging import RunResult, judged
from sidelong.app.study.recorded import RecordedTarget
from sidelong.app.study.settings import PlannerName, StudySettings
from sidelong.estimators.settings import TrackerSettings
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import GRAVITY_M_S2, Side
from sidelong.mission.geometry.wind import ground_speed_m_s
from sidelong.mission.laws.course_field import StandoffOrbit, VectorField
from sidelong.mission.laws.lateral_guidance import LateralGuidance
from sidelong.mission.paper.planner import PaperPlanner
from sidelong.mission.predictive.planner import PredictivePlanner
from sidelong.mission.predictive.value_table import ValueTable
from sidelong.mission.route.route import Route

START_RANGE_M = 300.0
# Of the curvature limit: what correcting the flown line may ask for beyond the circle itself.
_BANK_RESERVE = 1.1

# The guidance laws, tuned by grid search over 20 other targets with perfect sensors: of those that always keep the
# band the one most on the side, with room to both edges. Radii 150 to 400 m, gains 0.25 to 2 1/s, look-aheads 40 to
# 180 m; the other way round they are on the side for 42 % of the time. The orbit: ten targets, radii 300 to 400 m,
# approaches 0.005 to 0.03 1/m, gains 0.25 to 1 1/s.
_FIELD_RADIUS_M, _FIELD_GAIN_PER_S = 350.0, 0.25
_LATERAL_RADIUS_M, _LATERAL_LOOK_AHEAD_M = 350.0, 80.0
_ORBIT_RADIUS_M, _ORBIT_GAIN_PER_S, _ORBIT_APPROACH_PER_M = 300.0, 0.25, 0.005


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The same for every planner."""

    name: str
    target: RandomTarget | RecordedTarget
    duration_s: float
    start_rng: np.random.Generator
    sensor_rng: np.random.Generator
    route: Route | None = None


def scene(settings: StudySettings, number: int) -> Scene:
    """Return the scene of a run, one of ``settings.numbers``."""
    draw, k = divmod(number, settings.runs)
    if not settings.tracks:
        seeds = np.random.SeedSequence((settings.seed, k)).spawn(3)
        speed_max_m_s = settings.config.requirement.target_speed_max_m_s
        target = RandomTarget(np.random.default_rng(seeds[0]), settings.duration_s, speed_max_m_s, settings.legs_s)
        start, sensor = np.random.SeedSequence((settings.seed, k, draw)).spawn(2) if draw else seeds[1:]
        return Scene(
            f"random {k}", target, settings.duration_s, np.random.default_rng(start), np.random.default_rng(sensor)
        )
    track = settings.tracks[k]
    start, sensor = np.random.SeedSequence((settings.seed, track.key, draw)).spawn(2)
    duration_s = min(track.duration_s, settings.duration_s)
    return Scene(
        track.name, track, duration_s, np.random.default_rng(start), np.random.default_rng(sensor), track.route
    )


def run(
    settings: StudySettings, planner: PlannerName, number: int, table: ValueTable | None, keep_track: bool = False
) -> RunResult:
    """Fly one run. Target and sensor noise depend on the seed and ``number`` only, not on the planner."""
    flown = scene(settings, number)
    circle = first_circle(settings, flown)
    inputs = (
        aircraft_on(settings, flown, circle),
        circle,
        settings.config.aircraft.height_m,
        sensed_by(settings, flown),
    )
    flight = CompiledFlight(flown.target, *inputs, settings.wind, flown.duration_s)
    run = _steered(settings, planner, table, flight, flown.route)
    return judged(settings, run.log, run.changed_s, run.decision_s, keep_track)


def first_circle(
    settings: StudySettings, flown: Scene, side: Side | None = None, range_m: float = START_RANGE_M
) -> Circle:
    """Return the initial circle of a run, to one side of the target; None: the required one."""
    requirement = settings.requirement()
    side = side or requirement.side
    normal_rad = flown.target.at(0.0).course_rad + side.normal_turn_rad
    if requirement.sector is not None:
        normal_rad = requirement.sector.middle_rad
    return Circle(
        range_m * math.sin(normal_rad), range_m * math.cos(normal_rad), settings.aircraft().radius_m, side.clockwise
    )


def aircraft_on(
    settings: StudySettings,
    flown: Scene,
    circle: Circle,
    bank_max_rad: float | None = None,
    lag_s: float | None = None,
) -> KinematicAircraft:
    """Return an aircraft somewhere on a circle; None: with little more bank than it takes, and the study's lag."""
    aircraft, wind = settings.aircraft(), settings.wind
    course_rad = float(flown.start_rng.uniform(-math.pi, math.pi))
    start = AircraftState(
        0.0,
        *circle.position_at_course(course_rad),
        course_rad,
        ground_speed_m_s(course_rad, aircraft.airspeed_m_s, wind),
        circle.curvature_per_m,
    )
    if bank_max_rad is None:
        circle_bank_rad = math.atan(aircraft.airspeed_m_s**2 / (GRAVITY_M_S2 * settings.still_air_radius_m))
        bank_max_rad = math.atan(_BANK_RESERVE * math.tan(circle_bank_rad))
    lag_s = settings.lag_s if lag_s is None else lag_s
    return KinematicAircraft(start, aircraft.airspeed_m_s, bank_max_rad, aircraft.roll_rate_max_rad_s, wind, lag_s)


def sensed_by(settings: StudySettings, flown: Scene) -> Sensed:
    """Return what one aircraft sees the target with."""
    errors, assumed = payload_of(settings)
    # The compiled loop estimates no delays: its payload has none.
    return Sensed(errors, replace(assumed, latency_sigma_s=0.0), flown.sensor_rng, settings.perfect_sensors)


def _steered(
    settings: StudySettings,
    planner: PlannerName,
    table: ValueTable | None,
    flight: CompiledFlight,
    route: Route | None,
) -> Flown:
    """Fly a run in the compiled loop."""
    aircraft, requirement = settings.aircraft(), settings.requirement()
    clockwise = requirement.side.clockwise
    match planner:
        case PlannerName.PREDICTIVE:
            assert table is not None
            planner_with = PredictivePlanner(aircraft, requirement, table, route=route)
            return flight.with_predictive(planner_with, settings.latency_s)
        case PlannerName.PAPER:
            return flight.with_planner(PaperPlanner(aircraft, requirement), settings.latency_s)
        case PlannerName.CONTROLLER:
            limit_per_m = _BANK_RESERVE / settings.still_air_radius_m
            band_m = requirement.range_min_m, requirement.range_max_m
            with ExternalController(
                settings.controller, limit_per_m, band_m, settings.config.requirement.side
            ) as controller:
                return flight.with_law(controller)
        case PlannerName.LVFG:
            law = VectorField(_FIELD_RADIUS_M, clockwise, _FIELD_GAIN_PER_S).curvature_per_m
        case PlannerName.ORBIT:
            orbit = StandoffOrbit(_ORBIT_RADIUS_M, clockwise, _ORBIT_GAIN_PER_S, _ORBIT_APPROACH_PER_M)
            law = orbit.curvature_per_m
        case _:
            law = LateralGuidance(_LATERAL_RADIUS_M, clockwise, _LATERAL_LOOK_AHEAD_M).curvature_per_m
    return flight.with_law(law)


def payload_of(settings: StudySettings) -> tuple[PayloadErrors, TrackerSettings]:
    """Return the errors of the payload, and the tracker's settings for it."""
    sensors = settings.config.sensors
    errors = PayloadErrors(
        sensors.range_sigma_m, math.radians(sensors.angle_sigma_deg), pan_limit_rad=settings.aircraft().pan_limit_rad
    )
    return errors, tracker_settings(sensors, settings.config.planner.lost_after_s)
