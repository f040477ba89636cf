"""Runs of a study in the closed loop: the whole core against the kinematic vehicle, not planner and filter alone.

Target, noise and start are drawn as in :mod:`sidelong.app.study.run`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sidelong.app.assembly import mission_controller_of
from sidelong.app.autopilots.registry import AUTOPILOTS as FLOWN_AUTOPILOTS
from sidelong.app.simulation.kinematic import KinematicVehicle, Rates, Start
from sidelong.app.simulation.loop import ClosedLoop
from sidelong.app.simulation.payload import Payload
from sidelong.app.simulation.target import RandomTarget, TargetTruth
from sidelong.app.study.flight import StopWatch
from sidelong.app.study.judging import RunResult, judged
from sidelong.app.study.recorded import RecordedTarget
from sidelong.app.study.run import aircraft_on, first_circle, payload_of, scene
from sidelong.app.study.settings import AUTOPILOTS, PlannerName, StudySettings
from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.control.controller import StandoffController, StandoffSettings
from sidelong.mission.core.plan import AircraftState, Decision, Plan, Planner
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.paper.planner import PaperPlanner
from sidelong.mission.predictive.planner import PredictivePlanner
from sidelong.mission.predictive.value_table import ValueTable
from sidelong.mission.route.route import event_of

_HOME = Home(47.4, 8.5, 400.0)
_RATES = Rates(attitude_hz=1)


class _OnTicks:
    """A target with precomputed motion for each tick of the vehicle."""

    def __init__(self, target: RandomTarget | RecordedTarget, ticks: int) -> None:
        self._rows = target.sampled(np.arange(ticks) / _RATES.tick_hz).tolist()

    def at(self, time_s: float) -> TargetTruth:
        return TargetTruth(*self._rows[round(time_s * _RATES.tick_hz)])


@dataclass(frozen=True, slots=True)
class _Timed:
    """A planner whose decisions are timed."""

    planner: Planner
    watch: StopWatch

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        return self.watch(lambda: self.planner.decide(aircraft, target, present, wind, latency_s))


def run_closed_loop(
    settings: StudySettings, planner: PlannerName, number: int, table: ValueTable | None, keep_track: bool = False
) -> RunResult:
    """Fly one run; see :func:`sidelong.app.study.run.run`."""
    flown, watch = scene(settings, number), StopWatch()
    autopilot = next(one for one in FLOWN_AUTOPILOTS if one.name.lower() == settings.autopilot)
    errors, assumed = payload_of(settings)
    circle = first_circle(settings, flown)
    # The bank and the lag are those of the autopilot.
    lag_s = settings.lag_s or AUTOPILOTS[settings.autopilot].lag_s
    aircraft = aircraft_on(settings, flown, circle, settings.aircraft().bank_max_rad, lag_s)
    plane = LocalPlane(_HOME.latitude_deg, _HOME.longitude_deg)
    start = Start(plane, _HOME, circle, settings.config.aircraft.height_m)
    payload = Payload(errors, flown.sensor_rng)
    target = _OnTicks(flown.target, math.ceil(flown.duration_s * _RATES.tick_hz) + 2)
    vehicle = KinematicVehicle(autopilot, aircraft, settings.wind, start, payload, target, _RATES)

    def make_planner(aircraft: Aircraft, requirement: Requirement) -> Planner:
        if planner is PlannerName.PAPER:
            return _Timed(PaperPlanner(aircraft, requirement), watch)
        assert table is not None
        return _Timed(PredictivePlanner(aircraft, requirement, table), watch)

    controller = StandoffController(
        StandoffSettings(
            settings.requirement(),
            settings.aircraft(),
            lost_after_s=settings.config.planner.lost_after_s,
            give_up_after_s=math.inf,
        ),
        Tracker(assumed),
        make_planner,
    )
    loop = ClosedLoop(vehicle)
    loop.telemetry.plane = plane  # as of home: the first position lies elsewhere
    departed_s: list[float] = []

    def departures(_event: object, _outputs: object) -> None:
        if controller.changes.moves > len(departed_s):
            departed_s.append(vehicle.time_s)

    loop.listeners.append(departures)
    states = [aircraft.body]
    vehicle.flown = states.append
    loop.start(
        lambda plane: mission_controller_of(settings.config, controller, autopilot, plane, _HOME), vehicle.mode
    )
    if flown.route is not None:
        loop.put(event_of(flown.route, vehicle.time_s))
    loop.run(flown.duration_s - vehicle.time_s)
    rows = np.array([(state.time_s, state.east_m, state.north_m) for state in states])
    log = np.hstack([rows, flown.target.sampled(rows[:, 0])])
    return judged(settings, log, departed_s, watch.taken_s, keep_track)
