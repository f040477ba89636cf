"""Runs of a study in the compiled loop, and what the loop leaves to others.

The loop leaves to others: other planners, a track that begins, other filters, and payloads that measure late or from
the ground.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import thread_time
from typing import TypeVar

import numpy as np

from sidelong.app.simulation.airframe import KinematicAircraft
from sidelong.app.simulation.airframe_kernel import Body
from sidelong.app.simulation.payload import PayloadErrors
from sidelong.app.simulation.target import RandomTarget
from sidelong.app.study import flight_kernel as kernel
from sidelong.app.study.flight_kernel import (
    COMING_HEIGHT_M,
    COMMAND_PER_M,
    DECIDE,
    DEPARTURE_S,
    ENDED,
    FILTER_S,
    FLAT,
    HEIGHT_M,
    MEASURE,
    PLAN_HEIGHT_M,
    PRESENT,
    REJECTIONS,
    SEEN_S,
    STEP,
    Filtering,
    Flight,
    Hills,
    Payload,
    Steering,
    Target,
)
from sidelong.app.study.recorded import RecordedTarget
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.imm import DENSITIES, TargetImm
from sidelong.estimators.filters.imm_kernel import ERRORS, MODELS, TARGET
from sidelong.estimators.rotations import from_roll_pitch_yaw
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.tracking.track import Track
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray, Path
from sidelong.mission.core.plan import AircraftState, HeightProfile, Plan, Planner
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.line_kernel import Craft
from sidelong.mission.geometry.progress import circling_of, line_of
from sidelong.mission.predictive.cost import WatchCost
from sidelong.mission.predictive.cost_kernel import Table
from sidelong.mission.predictive.decision_kernel import Depth, Looker, Prices
from sidelong.mission.predictive.foresight import no_route
from sidelong.mission.predictive.future_kernel import Motions, Turns
from sidelong.mission.predictive.moves_kernel import nothing_kept
from sidelong.mission.predictive.planner import PredictivePlanner, PredictiveSettings
from sidelong.mission.predictive.second_moves_kernel import no_seconds
from sidelong.mission.viewpoint.viewpoint_kernel import Wish, fresh_memory

_LAW_PERIOD_S, _DECISION_PERIOD_S = 0.2, 1.0
_TIMED_EVERY = 32
_LASER, _GIMBAL = Source("DISTANCE_SENSOR", 154, 1, 100), Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)

# In Python, as of the airframe: a single call of compiled code takes longer than what it does.
sighted: Callable[[Body, float, FloatArray, FloatArray, Payload], tuple[float, float, float]]
sighted = kernel.sighted.py_func  # type: ignore[attr-defined]

T = TypeVar("T")
GuidanceLaw = Callable[[AircraftState, TargetEstimate], float]


class StopWatch:
    """Times one call in ``every``: asking for the processor's time may itself cost as much as a decision."""

    def __init__(self, every: int = _TIMED_EVERY) -> None:
        self.taken_s: list[float] = []
        self._every, self._calls = every, 0

    def __call__(self, decide: Callable[[], T]) -> T:
        self._calls += 1
        if (self._calls - 1) % self._every != 0:
            return decide()
        begun_s = thread_time()
        decision = decide()
        self.taken_s.append(thread_time() - begun_s)
        return decision


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """log (n, 6): time, aircraft, target (east, north), target's course. changed_s: when plans were departed to.

    over (n, 2): height, and 1 where the target was in sight.
    """

    log: FloatArray
    over: FloatArray
    changed_s: list[float]
    decision_s: list[float]


def payload_in(
    errors: PayloadErrors, assumed: TrackerSettings, perfect: bool = False, apart: bool = False
) -> Payload:
    """Return a payload for the loops: its actual errors, and the errors that the filter assumes."""
    return Payload(
        perfect,
        apart,
        errors.range_sigma_m,
        errors.angle_sigma_rad,
        errors.yaw_bias_rad,
        assumed.range_sigma_m,
        assumed.yaw_sigma_rad,
        assumed.pitch_sigma_rad,
        assumed.position_sigma_m,
        math.cos(errors.pan_limit_rad),
    )


def filtering_in(assumed: TrackerSettings) -> Filtering:
    """Return the settings of the filter for the loops."""
    return Filtering(
        assumed.gate_nis,
        assumed.soft_nis,
        DENSITIES[assumed.target_kind],
        assumed.reacquire_after,
        assumed.lost_after_s,
        assumed.lost_sigma_m,
    )


def can_fly(settings: TrackerSettings) -> bool:
    """Return whether the loop supports the payload: no latency, no lever arm, the loop's filter."""
    placed = any(settings.lever_arm_body_m) or any(settings.mount_roll_pitch_yaw_rad)
    return settings.filter == "imm" and not any(settings.latencies_s) and not placed and settings.quality_min <= 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Sensed:
    """The payload of a run: its errors, those the tracker assumes, and the noise. perfect: the truth is known."""

    errors: PayloadErrors
    assumed: TrackerSettings
    rng: np.random.Generator
    perfect: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class OverGround:
    """What is flown over. known: whether the filter stands on it. climb_m_s, descent_m_s: from plan to plan."""

    ground: Ground
    known: bool
    climb_m_s: float
    descent_m_s: float

    @property
    def hills(self) -> Hills:
        """The same as the loop takes it."""
        step_s, ground = kernel.STEP_S, self.ground
        return Hills(ground.grid, ground.sigma_m, self.known, self.climb_m_s * step_s, self.descent_m_s * step_s)


class CompiledFlight:
    """One run. Steer it by :meth:`with_planner` or :meth:`with_law`."""

    def __init__(
        self,
        target: RandomTarget | RecordedTarget,
        start: KinematicAircraft,
        circle: Circle,
        height_m: float,
        sensed: Sensed,
        wind: Wind,
        duration_s: float,
        over: OverGround | None = None,
    ) -> None:
        steps = round(duration_s / kernel.STEP_S)
        # As the aircraft's clock counts.
        time_s = np.add.accumulate(np.append(start.state.time_s, np.full(steps - 1, kernel.STEP_S)))
        assumed, n = sensed.assumed, TARGET + ERRORS
        apart = not sensed.perfect and not can_fly(assumed)
        noise = np.zeros((steps, 3)) if sensed.perfect or apart else sensed.rng.normal(size=(steps, 3))
        self._target = Target(np.ascontiguousarray(target.sampled(time_s)), noise)
        self._payload = payload_in(sensed.errors, assumed, sensed.perfect, apart)
        self._hills, self._ground = FLAT, None
        if over is not None:
            self._hills, self._ground = over.hills, over.ground if over.known else None
        self._rng, self._tracker = sensed.rng, Tracker(assumed) if apart else None
        if self._tracker is not None and self._ground is not None:
            # A laser that is only hidden is not silent.
            self._tracker.stand_on(self._ground, angles_alone=False)
        self._filtering = filtering_in(assumed)
        self._assumed, self._wind = assumed, wind
        self._frame = start.frame(kernel.STEP_S)
        self._flight: Flight = kernel.new_flight(
            start.body, circling_of(circle), height_m, (len(MODELS), 1 + n + n * n), steps, assumed.reacquire_after
        )
        self._watch = StopWatch()

    def with_predictive(self, planner: PredictivePlanner, latency_s: float) -> Flown:
        """Fly the predictive planner, with no fences, in the loop alone where that can be."""
        if self._tracker is not None:
            return self.with_planner(planner, latency_s)
        looker, *_ = planner.lookers
        steering = Steering(
            True, _TIMED_EVERY, True, _DECISION_PERIOD_S, latency_s, PredictiveSettings().lost_after_s
        )
        inputs = self._target, self._payload, self._filtering, self._hills, steering, self._frame, looker
        self._watch = StopWatch(1)  # the loop pauses for those alone that are timed
        return self._flown(steering, looker, lambda: self._watch(lambda: kernel.choose(self._flight, *inputs)))

    def with_planner(self, planner: Planner, latency_s: float) -> Flown:
        """Fly any planner."""

        def decide() -> None:
            estimate = self._estimate()
            if estimate is None:
                return
            inputs = self._aircraft, estimate, self._present, self._wind, latency_s
            plan = self._watch(lambda: planner.decide(*inputs)).plan
            if plan is not None:
                kernel.take_plan(self._flight, plan.departure_s, *line_of(plan))
                if plan.heights is not None:
                    self._flight.numbers[COMING_HEIGHT_M] = plan.heights.to_m

        return self._flown(Steering(False, 1, True, _DECISION_PERIOD_S, latency_s, math.inf), _blind(), decide)

    def with_law(self, law: GuidanceLaw) -> Flown:
        """Fly a guidance law."""

        def steer() -> None:
            estimate = self._estimate()
            if estimate is not None:
                self._flight.numbers[COMMAND_PER_M] = self._watch(lambda: law(self._aircraft, estimate))

        return self._flown(Steering(False, 1, False, _LAW_PERIOD_S, 0.0, math.inf), _blind(), steer)

    @property
    def height_m(self) -> float:
        """The present height of the aircraft."""
        return float(self._flight.numbers[HEIGHT_M])

    def _flown(self, steering: Steering, looker: Looker, decide: Callable[[], None]) -> Flown:
        inputs = self._target, self._payload, self._filtering, self._hills, steering, self._frame, looker
        while (pause := kernel.advance(self._flight, *inputs)) != ENDED:
            if pause == DECIDE:
                decide()
            elif pause == MEASURE:
                self._measure()
            else:
                self._reconsider()
        changes = self._flight.changed_s[: self._flight.counts[kernel.CHANGES]]
        return Flown(self._flight.log, self._flight.over, changes.tolist(), self._watch.taken_s)

    @property
    def _aircraft(self) -> AircraftState:
        return AircraftState(*self._flight.body[:6].tolist())

    @property
    def _present(self) -> Plan:
        height_m = float(self._flight.numbers[PLAN_HEIGHT_M])
        level = None if self._hills is FLAT else HeightProfile(height_m, height_m, 0.0)
        departure_s = float(self._flight.numbers[DEPARTURE_S])
        return flown_plan(self._flight, self._flight.counts[PRESENT], departure_s, level)

    def _measure(self) -> None:
        """Measure with a payload that the loop cannot measure with, through the real tracker."""
        body, height_m, tracker = kernel.body_of(self._flight), self.height_m, self._tracker
        assert tracker is not None
        truth, time_s = self._target.sampled[self._flight.counts[STEP]], body.time_s
        east_m, north_m = truth[:2].tolist()
        here_m = body.east_m, body.north_m, height_m
        target_height_m, in_sight = kernel.ground_and_sight(self._hills, *here_m, east_m, north_m)
        in_sight = in_sight and kernel.within_pan(body, self._frame, east_m, north_m, self._payload.cos_pan_limit)
        velocity_m_s = body.speed_m_s * math.sin(body.course_rad), body.speed_m_s * math.cos(body.course_rad)
        tracker.add(PositionReading(time_s, *here_m, *velocity_m_s, 0.0))
        tracker.add(AttitudeReading(time_s, body.bank_rad, 0.0, body.course_rad))
        noise = self._rng.normal(size=3)
        if in_sight:
            slant_m, yaw_rad, pitch_rad = sighted(body, height_m - target_height_m, truth, noise, self._payload)
            tracker.add(GimbalReading(time_s, from_roll_pitch_yaw(0.0, pitch_rad, yaw_rad), "earth", _GIMBAL))
            tracker.add(RangeReading(time_s, slant_m, _LASER, quality=0.9))

    def _estimate(self) -> TargetEstimate | None:
        time_s = float(self._flight.body[0])
        if self._tracker is not None:
            return self._tracker.estimate(time_s)
        if self._payload.perfect:
            return true_estimate(time_s, self._target.sampled[self._flight.counts[STEP]])
        return self._track().estimate(time_s)

    def _track(self) -> Track:
        """Return the track as it stands."""
        numbers, track = self._flight.numbers, Track(self._assumed)
        if self._ground is not None:
            track.stand_on(self._ground)
        if math.isinf(numbers[SEEN_S]):
            return track
        models = self._flight.models.copy()
        last = TargetImm.resumed(self._assumed, float(numbers[FILTER_S]), models, self._ground)
        rejected = self._flight.rejected
        before = min(int(self._flight.counts[REJECTIONS]), len(rejected)) - 1  # the newest
        rows = rejected[len(rejected) - 1 - max(before, 0) : len(rejected) - 1].tolist()
        track.resume(last, float(numbers[SEEN_S]), [_sighting(*row) for row in rows])
        return track

    def _reconsider(self) -> None:
        """Let the track decide what a sighting beyond the gate means, and whether to start or restart."""
        flight, track = self._flight, self._track()
        if not track.add(_sighting(*flight.rejected[-1])).accepted:
            return
        last, seen_s = track.last
        assert last is not None
        flight.models[:] = last.state
        flight.numbers[FILTER_S], flight.numbers[SEEN_S] = last.time_s, seen_s
        flight.counts[REJECTIONS] = 0


def flown_plan(flight: Flight, which: int, departure_s: float, heights: HeightProfile | None = None) -> Plan:
    """Return one of the two plans of a flight."""
    line, circle = kernel.plan_of(flight, which)
    ring = Circle(circle.east_m, circle.north_m, abs(circle.radius_m), circle.radius_m > 0.0)
    return Plan(ring, Path(*line.copy()) if line.size else None, departure_s, heights)


def true_estimate(time_s: float, truth: FloatArray) -> TargetEstimate:
    """Return the estimate of perfect sensors. truth: a row of :meth:`RandomTarget.sampled`."""
    east_m, north_m, velocity_e, velocity_n = truth[:4].tolist()
    unerring = np.zeros((4, 4))
    return TargetEstimate(time_s, east_m, north_m, velocity_e, velocity_n, unerring, TrackQuality.GOOD, time_s)


def _blind() -> Looker:
    """Return a looker that is never asked: with it the loop is compiled once for all planners."""
    nothing = np.zeros((1, 1, 2, 2), np.float32)
    return Looker(
        Craft(1.0, 1.0, 1.0, 1.0, 1.0),
        1.0,
        Wish(False, 0.0, math.nan),
        WatchCost(0.0, 1.0).terms,
        Table(nothing, nothing, 1.0, 1.0, 1.0),
        Motions(True, 0.0, 1.0, 1, 1),
        Prices(0.0, 0.0, 0.0, 0.0),
        fresh_memory(1.0),
        nothing_kept(),
        Turns(np.zeros(1), 1.0, False),
        Depth(0, 0.0, np.zeros(1), 0.0, False),
        no_seconds(),
        no_route(),
    )


def _sighting(
    time_s: float,
    slant_m: float,
    bearing_rad: float,
    depression_rad: float,
    range_variance: float,
    bearing_variance: float,
    depression_variance: float,
    east_m: float,
    north_m: float,
    height_m: float,
) -> Sighting:
    sigmas = (math.sqrt(range_variance), math.sqrt(bearing_variance), math.sqrt(depression_variance))
    return Sighting(time_s, slant_m, bearing_rad, depression_rad, *sigmas, east_m, north_m, height_m)
