"""A whole flight with faults between vehicle and us: the loop of :mod:`sidelong.app.simulation`, judged by truth.

Faults change, delay, drop and add what the vehicle and its payload report; the exchange with the autopilot has tests
of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from sidelong.app.analysis.score import Samples, judge
from sidelong.app.assembly import mission_controller_of, prepared
from sidelong.app.autopilots.registry import AUTOPILOTS
from sidelong.app.config import Config
from sidelong.app.link.message import Message
from sidelong.app.planners.planner_kind import PlannerKind
from sidelong.app.simulation.kinematic import Body, Rates, Start
from sidelong.app.simulation.target import Payload, RandomTarget
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.present import Phase
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import Announce, ControlAcquired, DecisionRecord, End, HealthChanged, Yield
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Wind
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.geometry.progress import ground_speed_m_s
from tests.faults.flight_faults import Fault
from tests.faulty_loop import NO_FAULTS, FaultyLoop, Link, MessagingVehicle
from tests.faulty_payload import FaultyPayload, PayloadFaults

STEP_S = 0.1
_TICK_STEPS, _SURE_M = 10, 5.0
HOME_DEG = (47.4, 8.5)
_HOME = Home(*HOME_DEG, 400.0)
_PLANE = LocalPlane(*HOME_DEG)
ERRORS = PayloadFaults(yaw_bias_rad=0.0, outliers=0.02, dropouts_per_s=0.1 / 3.0)
_RATES = Rates(
    tick_hz=10, position_hz=10, attitude_hz=10, gimbal_hz=10, laser_hz=10, status_hz=1, mission_current_hz=1
)
_EXCHANGE = ("MISSION_", "COMMAND_", "POSITION_TARGET_")
_FENCE_M = 1500.0
FLAVOURS = {one.name.lower(): one for one in AUTOPILOTS}


@dataclass(frozen=True, slots=True)
class Scenario:
    """One target and one aircraft, the same with and without faults."""

    seed: int
    flavour: str
    duration_s: float = 240.0


@dataclass(slots=True)
class Decided:
    """A decision, compared with the truth of its moment. NaN where no value was accepted."""

    time_s: float
    moved: bool
    own_error_m: float
    target_error_m: float
    unseen_s: float
    clock_error_s: float


@dataclass(slots=True)
class Flown:
    """What came of a flight. Ranges are true, from when the circle was acquired, until it was yielded."""

    scenario: Scenario
    range_m: list[float] = field(default_factory=list)
    on_side: list[bool] = field(default_factory=list)
    outside_fence_m: float = 0.0
    decided: list[Decided] = field(default_factory=list)
    announced: list[tuple[float, str]] = field(default_factory=list)
    health: list[tuple[float, HealthChanged]] = field(default_factory=list)
    unknown_s: float = 0.0
    wrongly_in_band_s: float = 0.0
    wrongly_on_side_s: float = 0.0
    yielded: tuple[float, str] | None = None
    ended: str | None = None
    slowest_step_s: float = 0.0


class FaultedFlight(FaultyLoop[Message]):
    """One flight with faults. What came of it is in ``flown``."""

    def __init__(
        self,
        scenario: Scenario,
        faults: Sequence[Fault] = (),
        timer=lambda: 0.0,
        terrain: str = "",
        configured: Mapping[str, dict] = MappingProxyType({}),
        number: int = 0,
        kind: PlannerKind | None = None,
    ) -> None:
        """number: of an aircraft of two, which begins on its own side; kind: of planner, None: the configured one."""
        self._scenario, self._faults, self._timer = scenario, faults, timer
        autopilot = FLAVOURS[scenario.flavour]
        target_rng, air_rng, noise_rng = (
            np.random.default_rng(seed) for seed in np.random.SeedSequence(scenario.seed).spawn(3)
        )
        self._fault_rng = np.random.default_rng((scenario.seed, 77))
        self._noise = noise_rng
        ground = {"terrain": {"folder": terrain}} if terrain else {}
        config = Config.model_validate({"fences": {"keep_in": [_square_deg()]}, **ground, **configured})
        self.controller: StandoffController = prepared(config, kind=kind).controller(_PLANE, HOME_DEG)
        self._required = config.requirement.requirement()  # a fleet lets an aircraft hold the other side
        self._target = RandomTarget(target_rng, scenario.duration_s + 1.0, 3.0, (15.0, 60.0))
        limits = config.aircraft.aircraft()
        wind_m_s, wind_rad = air_rng.uniform(0.0, 3.0), air_rng.uniform(-math.pi, math.pi)
        wind = Wind(wind_m_s * math.sin(wind_rad), wind_m_s * math.cos(wind_rad))
        if number:  # the same target and wind, other noise
            air_rng, noise_rng = (np.random.default_rng((scenario.seed, number, k)) for k in range(2))
        self._boot_s = round(float(air_rng.uniform(100.0, 3000.0)), 1)
        side_rad = self._target.at(0.0).course_rad + (number - 0.5) * math.pi
        circle = Circle(300.0 * math.sin(side_rad), 300.0 * math.cos(side_rad), limits.radius_m, True)
        course_rad = float(air_rng.uniform(-math.pi, math.pi))
        speed_m_s = ground_speed_m_s(course_rad, limits.airspeed_m_s, wind)
        state = AircraftState(
            0.0, *circle.position_at_course(course_rad), course_rad, speed_m_s, circle.curvature_per_m
        )
        body = Body(limits.airspeed_m_s, limits.bank_max_rad)
        start = Start(_PLANE, _HOME, circle, config.aircraft.height_m, state, self._boot_s)
        vehicle = MessagingVehicle(autopilot, body, wind, start, self.payload(noise_rng), self._target, _RATES)
        super().__init__(vehicle, Link(NO_FAULTS, self._fault_rng, change=self._change))
        self.telemetry.plane = _PLANE
        self._states = [state]
        vehicle.flown = lambda: self._states.append(vehicle.state)
        self.pilot_takes_over_s = math.inf
        self._acquired_s = math.inf
        self.flown = Flown(scenario)
        self._shown_on_side: list[tuple[float, bool | None]] = []  # what a display claims
        self.start(
            lambda plane: mission_controller_of(config, self.controller, autopilot, plane, _HOME), vehicle.mode
        )

    def payload(self, rng: np.random.Generator) -> Payload | None:
        return FaultyPayload(ERRORS, rng)

    def fly(self) -> Flown:
        while self.simulated.time_s < self._scenario.duration_s - 1e-6:
            if self.simulated.time_s >= self.pilot_takes_over_s:
                self.simulated.pilot_takes_over()
            self.step()
            if self.flown.yielded is None and self.simulated.time_s >= self._acquired_s:
                self._judge_reported(self.simulated.time_s, self._states[-1])
        self._judge()
        return self.flown

    def put(self, event):
        begun_s = self._timer()
        outputs = super().put(event)
        flown, now_s = self.flown, self.simulated.time_s
        flown.slowest_step_s = max(flown.slowest_step_s, self._timer() - begun_s)
        for output in outputs:
            match output:
                case ControlAcquired():
                    self._acquired_s = now_s
                case DecisionRecord():
                    flown.decided.append(self._relative_to_truth(now_s, output.moves))
                case Announce():
                    flown.announced.append((now_s, output.text))
                case HealthChanged():
                    flown.announced.append((now_s, output.text))
                    flown.health.append((now_s, output))
                case Yield():
                    flown.yielded = flown.yielded or (now_s, output.reason)
                case End():
                    flown.ended = output.reason
        return outputs

    def _change(self, message: Message, now_s: float):
        """Return what the faults make of a report."""
        arriving = [(0.0, message)]
        for fault in self._faults:
            if fault.begin_s <= now_s < fault.end_s and not message.name.startswith(_EXCHANGE):
                arriving = [
                    (delay_s + more_s, changed)
                    for delay_s, one in arriving
                    for more_s, changed in fault.change(one, now_s - fault.begin_s, self._fault_rng)
                ]
        return arriving

    def _relative_to_truth(self, now_s: float, moved: bool) -> Decided:
        controller = self.controller
        time_s = controller.time_s - self._boot_s
        clock_error_s = time_s - now_s
        own, estimate = controller.snapshot().aircraft, controller.estimate
        state = self._states[min(max(round(time_s / STEP_S), 0), len(self._states) - 1)]
        truth = self._target.at(min(max(time_s, 0.0), self._scenario.duration_s))
        own_m = math.nan if own is None else math.hypot(own.east_m - state.east_m, own.north_m - state.north_m)
        target_m, unseen_s = math.nan, 0.0
        if estimate is not None:
            target_m = math.hypot(estimate.east_m - truth.east_m, estimate.north_m - truth.north_m)
            unseen_s = estimate.time_s - estimate.last_sighting_s
        return Decided(now_s, moved, own_m, target_m, unseen_s, clock_error_s)

    def _judge_reported(self, now_s: float, state: AircraftState) -> None:
        """Compare what the flight claims of itself with the truth, once a second."""
        if round(now_s / STEP_S) % _TICK_STEPS:
            return
        snapshot, requirement = self.controller.snapshot(), self.controller.settings.requirement
        estimate, truth = snapshot.estimate, self._target.at(now_s)
        self._shown_on_side.append((now_s, snapshot.on_side))
        if snapshot.unknown or estimate is None:
            self.flown.unknown_s += 1.0
            return
        own = snapshot.aircraft
        claimed_m = math.hypot(own.east_m - estimate.east_m, own.north_m - estimate.north_m)
        true_m = math.hypot(state.east_m - truth.east_m, state.north_m - truth.north_m)
        claims = requirement.range_min_m <= claimed_m <= requirement.range_max_m
        is_true = requirement.range_min_m - _SURE_M <= true_m <= requirement.range_max_m + _SURE_M
        self.flown.wrongly_in_band_s += claims and not is_true

    def _judge(self) -> None:
        """Judge the time from when the circle was acquired until it was yielded."""
        end_s = math.inf if self.flown.yielded is None else self.flown.yielded[0]
        flown = [state for state in self._states if self._acquired_s <= state.time_s < end_s]
        aircraft_m = np.array([(state.east_m, state.north_m) for state in flown])
        time_s = np.array([state.time_s for state in flown])
        truth = self._target.sampled(time_s)
        judged = judge(Samples(time_s, aircraft_m, truth[:, :2], truth[:, 2:4]), ((-math.inf, self._required),))
        self.flown.range_m, self.flown.on_side = judged.range_m.tolist(), judged.on_side.tolist()
        on_side = dict(zip(np.round(time_s, 1).tolist(), self.flown.on_side, strict=True))
        self.flown.wrongly_on_side_s = float(
            sum(claimed is True and on_side.get(round(at_s, 1)) is False for at_s, claimed in self._shown_on_side)
        )
        self.flown.outside_fence_m = max(float(np.abs(aircraft_m).max()) - _FENCE_M, 0.0)


def _square_deg() -> list[tuple[float, float]]:
    corners = ((-1, -1), (-1, 1), (1, 1), (1, -1))
    return [_PLANE.latitude_longitude_deg(_FENCE_M * east, _FENCE_M * north) for east, north in corners]


def watched(flown: Flown, controller: StandoffController) -> bool:
    """Return whether the mission goes on."""
    return flown.yielded is None and flown.ended is None and controller.phase is Phase.WATCHING
