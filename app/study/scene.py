"""What a run of a study begins with, the same for every planner: target, first circle, start, payload and noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import thread_time
from typing import TypeVar

import numpy as np

from sidelong.app.assembly import tracker_settings
from sidelong.app.simulation.target import PayloadErrors, RandomTarget
from sidelong.app.study.recorded import RecordedTarget
from sidelong.app.study.settings import StudySettings
from sidelong.estimators.settings import TrackerSettings
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Side
from sidelong.mission.geometry.progress import ground_speed_m_s
from sidelong.mission.route.route import Route

START_RANGE_M = 300.0
_TIMED_EVERY = 32

T = TypeVar("T")


class StopWatch:
    """Times one call in 32: asking for the processor's time may itself cost as much as a decision."""

    def __init__(self) -> None:
        self.taken_s: list[float] = []
        self._calls = 0

    def __call__(self, decide: Callable[[], T]) -> T:
        self._calls += 1
        if (self._calls - 1) % _TIMED_EVERY != 0:
            return decide()
        begun_s = thread_time()
        decision = decide()
        self.taken_s.append(thread_time() - begun_s)
        return decision


@dataclass(frozen=True, slots=True, eq=False)
class StudyScene:
    name: str
    target: RandomTarget | RecordedTarget
    duration_s: float
    start_rng: np.random.Generator
    sensor_rng: np.random.Generator
    route: Route | None = None


def scene(settings: StudySettings, number: int) -> StudyScene:
    """Return target and random numbers of a run; they depend on seed, target and draw of noise alone."""
    draw, k = divmod(number, settings.runs)
    if settings.tracks:
        target: RandomTarget | RecordedTarget = (track := settings.tracks[k])
        name, duration_s, route = track.name, min(track.duration_s, settings.duration_s), track.route
        start, sensor = np.random.SeedSequence((settings.seed, track.key, draw)).spawn(2)
    else:
        seeds = np.random.SeedSequence((settings.seed, k)).spawn(3)
        speed_max_m_s = settings.config.requirement.target_speed_max_m_s
        target = RandomTarget(np.random.default_rng(seeds[0]), settings.duration_s, speed_max_m_s, settings.legs_s)
        start, sensor = np.random.SeedSequence((settings.seed, k, draw)).spawn(2) if draw else seeds[1:]
        name, duration_s, route = f"random {k}", settings.duration_s, None
    start_rng, sensor_rng = map(np.random.default_rng, (start, sensor))
    return StudyScene(name, target, duration_s, start_rng, sensor_rng, route)


def first_circle(
    settings: StudySettings, flown: StudyScene, side: Side | None = None, range_m: float = START_RANGE_M
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


def start_on(settings: StudySettings, flown: StudyScene, circle: Circle) -> AircraftState:
    """Return a state on the circle at a random course."""
    course_rad = float(flown.start_rng.uniform(-math.pi, math.pi))
    return AircraftState(
        0.0,
        *circle.position_at_course(course_rad),
        course_rad,
        ground_speed_m_s(course_rad, settings.aircraft().airspeed_m_s, settings.wind),
        circle.curvature_per_m,
    )


def payload_of(settings: StudySettings) -> tuple[PayloadErrors, TrackerSettings]:
    """Return the errors of the payload and the tracker's settings; perfect sensors have none."""
    sensors, limit_rad = settings.config.sensors, settings.aircraft().pan_limit_rad
    errors = PayloadErrors(sensors.range_sigma_m, math.radians(sensors.angle_sigma_deg), pan_limit_rad=limit_rad)
    if settings.perfect_sensors:
        errors = PayloadErrors(0.0, 0.0, 0.0, limit_rad)
    return errors, tracker_settings(sensors, settings.config.planner.lost_after_s)
