"""A whole flight without a socket or a clock on the wall: the real telemetry and control step in a closed loop.

The aircraft is kinematic, flies what its autopilot was told, and tells it in the messages of ArduPlane or of PX4.
Between the two stand faults, which change, delay, drop and add messages. Truth is kept to judge by.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sidelong.app.assembly import controller_of, settle
from sidelong.app.config import Config
from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import Telemetry
from sidelong.app.simulation.airframe import KinematicAircraft
from sidelong.app.simulation.target import RandomTarget
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.snapshot import Phase
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import (
    ActivatePlan,
    Announce,
    ClockTick,
    Command,
    ControlAcquired,
    DecisionRecord,
    End,
    Event,
    HealthChanged,
    PlanStatus,
    UploadPlan,
    Yield,
)
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.progress import nearest_arc_m, point_at
from sidelong.mission.geometry.wind import ground_speed_m_s
from tests.faults.flight_faults import Fault

STEP_S = 0.1
_TICK_STEPS, _SURE_M = 10, 5.0
HOME_DEG = (47.4, 8.5)
_PLANE = LocalPlane(*HOME_DEG)
_HEIGHT_M = 100.0
_ACQUIRED_S, _UPLOAD_S, _ACTIVATION_S = 5.0, 0.5, 0.2
_RANGE_SIGMA_M, _ANGLE_SIGMA_RAD, _OUTLIERS, _DROPOUTS = 0.8, math.radians(0.35), 0.02, 0.1
_CROSS_TRACK_GAIN_PER_M2, _COURSE_GAIN_PER_M = 1.0 / 20.0**2, 2.0 / 20.0
_BANK_RESERVE = 1.1
_FENCE_M = 1500.0
_GPS, _EKF, _ESTIMATOR = "GPS_RAW_INT", "EKF_STATUS_REPORT", "ESTIMATOR_STATUS"


@dataclass(frozen=True, slots=True)
class Flavour:
    """What is particular to an autopilot. radius_factor: flown over commanded radius of a circle."""

    autopilot: int
    mode: int
    mode_name: str
    radius_factor: float


FLAVOURS = {
    "arduplane": Flavour(3, 10, "AUTO", 1.12),
    "px4": Flavour(12, 0x04040000, "MISSION", 1.0),
}


@dataclass(frozen=True, slots=True)
class Scenario:
    """One target and one aircraft, the same with and without faults."""

    seed: int
    flavour: str
    duration_s: float = 240.0


@dataclass(slots=True)
class Decided:
    """A decision, beside the truth of its moment. NaN where nothing was believed."""

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
    told: list[tuple[float, str]] = field(default_factory=list)
    health: list[tuple[float, HealthChanged]] = field(default_factory=list)
    unknown_s: float = 0.0
    wrongly_in_band_s: float = 0.0
    yielded: tuple[float, str] | None = None
    ended: str | None = None
    slowest_step_s: float = 0.0


class ClosedLoop:
    """One flight. Events and commands go nowhere but into ``flown``."""

    def __init__(self, scenario: Scenario, faults: Sequence[Fault] = (), timer=lambda: 0.0) -> None:
        self._scenario, self._faults, self._timer = scenario, faults, timer
        self._flavour = FLAVOURS[scenario.flavour]
        target_rng, air_rng, noise_rng = (
            np.random.default_rng(seed) for seed in np.random.SeedSequence(scenario.seed).spawn(3)
        )
        self._fault_rng = np.random.default_rng((scenario.seed, 77))
        self._noise = noise_rng
        self._config = Config.model_validate({"fences": {"keep_in": [_square_deg()]}})
        self.controller: StandoffController = controller_of(self._config)
        settle(self.controller, self._config, _PLANE, HOME_DEG)
        self._telemetry = Telemetry(1)
        self._telemetry.plane = _PLANE
        self._target = RandomTarget(target_rng, scenario.duration_s + 1.0, 3.0, (15.0, 60.0))
        aircraft = self._config.aircraft.aircraft()
        wind_m_s, wind_rad = air_rng.uniform(0.0, 3.0), air_rng.uniform(-math.pi, math.pi)
        self._wind = Wind(wind_m_s * math.sin(wind_rad), wind_m_s * math.cos(wind_rad))
        self._boot_s = float(air_rng.uniform(100.0, 3000.0))
        truth = self._target.at(0.0)
        side_rad = truth.course_rad - math.pi / 2
        self._circle = Circle(300.0 * math.sin(side_rad), 300.0 * math.cos(side_rad), aircraft.radius_m, True)
        course_rad = float(air_rng.uniform(-math.pi, math.pi))
        place = self._circle.position_at_course(course_rad)
        speed_m_s = ground_speed_m_s(course_rad, aircraft.airspeed_m_s, self._wind)
        start = AircraftState(0.0, *place, course_rad, speed_m_s, self._circle.curvature_per_m)
        self._body = KinematicAircraft(
            start,
            aircraft.airspeed_m_s,
            _BANK_RESERVE * aircraft.bank_max_rad,
            aircraft.roll_rate_max_rad_s,
            self._wind,
        )
        self._line = Plan(self._circle)
        self._plans: dict[int, Plan] = {}
        self._arriving: list[tuple[float, int, Message]] = []
        self._reports: list[tuple[float, int, str]] = []
        self._count = itertools.count()
        self._states: list[AircraftState] = []
        self._dropped_until_s = 0.0
        self.pilot_takes_over_s = math.inf
        self.flown = Flown(scenario)

    def fly(self) -> Flown:
        steps = round(self._scenario.duration_s / STEP_S)
        acquired = False
        for step in range(steps):
            now_s = step * STEP_S
            state = self._body.state
            self._states.append(state)
            self._send(now_s, state)
            while self._arriving and self._arriving[0][0] <= now_s:
                event = self._telemetry.event(heapq.heappop(self._arriving)[2])
                if event is not None:
                    self._step(event, now_s)
            if step % _TICK_STEPS == 0:
                self._step(ClockTick(self._telemetry.now_s, now_s), now_s)
            if not acquired and now_s >= _ACQUIRED_S:
                acquired = True
                self._step(ControlAcquired(self._telemetry.now_s, self._circle, self._flavour.mode_name), now_s)
            while self._reports and self._reports[0][0] <= now_s:
                _, number, stage = heapq.heappop(self._reports)
                if stage == "departed":
                    self._line = self._plans[number]
                self._step(PlanStatus(self._telemetry.now_s, number, stage), now_s)
            if acquired and self.flown.yielded is None:
                self._judge(now_s, state)
            self._body.step(self._curvature_per_m(state), STEP_S)
        return self.flown

    # -- the core ------------------------------------------------------------------------------------------

    def _step(self, event: Event, now_s: float) -> None:
        begun_s = self._timer()
        commands = self.controller.step(event)
        self.flown.slowest_step_s = max(self.flown.slowest_step_s, self._timer() - begun_s)
        for command in commands:
            self._do(command, now_s)

    def _do(self, command: Command, now_s: float) -> None:
        flown = self.flown
        match command:
            case DecisionRecord():
                flown.decided.append(self._beside_truth(now_s, command.moves))
            case UploadPlan():
                factor = self._flavour.radius_factor
                circle = replace(command.commanded, radius_m=command.commanded.radius_m * factor)
                self._plans[command.number] = replace(command.plan, circle=circle)
                heapq.heappush(self._reports, (now_s + _UPLOAD_S, command.number, "ready"))
            case ActivatePlan():
                heapq.heappush(self._reports, (now_s + _ACTIVATION_S, command.number, "departed"))
            case Announce():
                flown.told.append((now_s, command.text))
            case HealthChanged():
                flown.told.append((now_s, command.text))
                flown.health.append((now_s, command))
            case Yield():
                flown.yielded = flown.yielded or (now_s, command.reason)
            case End():
                flown.ended = command.reason

    def _beside_truth(self, now_s: float, moved: bool) -> Decided:
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

    def _judge(self, now_s: float, state: AircraftState) -> None:
        truth = self._target.at(now_s)
        east_m, north_m = state.east_m - truth.east_m, state.north_m - truth.north_m
        self.flown.range_m.append(math.hypot(east_m, north_m))
        off_rad = math.atan2(east_m, north_m) - (truth.course_rad - math.pi / 2)
        self.flown.on_side.append(abs(math.remainder(off_rad, math.tau)) <= math.pi / 2)
        self._judge_reported(now_s, state, truth)
        outside_m = max(abs(state.east_m), abs(state.north_m)) - _FENCE_M
        self.flown.outside_fence_m = max(self.flown.outside_fence_m, outside_m)

    def _judge_reported(self, now_s: float, state: AircraftState, truth) -> None:
        """Compare what the flight claims of itself with the truth, once a second."""
        if round(now_s / STEP_S) % _TICK_STEPS:
            return
        snapshot, requirement = self.controller.snapshot(), self._config.requirement.requirement()
        estimate = snapshot.estimate
        if snapshot.unknown or estimate is None:
            self.flown.unknown_s += 1.0
            return
        own = snapshot.aircraft
        claimed_m = math.hypot(own.east_m - estimate.east_m, own.north_m - estimate.north_m)
        true_m = math.hypot(state.east_m - truth.east_m, state.north_m - truth.north_m)
        claims = requirement.range_min_m <= claimed_m <= requirement.range_max_m
        is_true = requirement.range_min_m - _SURE_M <= true_m <= requirement.range_max_m + _SURE_M
        self.flown.wrongly_in_band_s += claims and not is_true

    # -- the aircraft --------------------------------------------------------------------------------------

    def _curvature_per_m(self, aircraft: AircraftState) -> float:
        line = point_at(self._line, nearest_arc_m(self._line, aircraft), aircraft)
        off_rad = math.remainder(line.course_rad - aircraft.course_rad, math.tau)
        sin_c, cos_c = math.sin(line.course_rad), math.cos(line.course_rad)
        cross_track_m = (aircraft.east_m - line.east_m) * cos_c - (aircraft.north_m - line.north_m) * sin_c
        return line.curvature_per_m + _COURSE_GAIN_PER_M * off_rad - _CROSS_TRACK_GAIN_PER_M2 * cross_track_m

    def _send(self, now_s: float, state: AircraftState) -> None:
        for message in self._messages(now_s, state):
            arriving = [(0.0, message)]
            for fault in self._faults:
                if fault.begin_s <= now_s < fault.end_s:
                    arriving = [
                        (delay_s + more_s, changed)
                        for delay_s, one in arriving
                        for more_s, changed in fault.change(one, now_s - fault.begin_s, self._fault_rng)
                    ]
            for delay_s, changed in arriving:
                heapq.heappush(self._arriving, (now_s + delay_s, next(self._count), changed))

    def _messages(self, now_s: float, state: AircraftState) -> list[Message]:
        boot_ms = round((self._boot_s + now_s) * 1000.0)
        latitude_deg, longitude_deg = _PLANE.latitude_longitude_deg(state.east_m, state.north_m)
        north_m_s = state.ground_speed_m_s * math.cos(state.course_rad)
        east_m_s = state.ground_speed_m_s * math.sin(state.course_rad)
        messages = [
            _message("ATTITUDE", time_boot_ms=boot_ms, roll=self._body.bank_rad, pitch=0.0, yaw=state.course_rad),
            _message(
                "GLOBAL_POSITION_INT",
                time_boot_ms=boot_ms,
                lat=round(latitude_deg * 1e7),
                lon=round(longitude_deg * 1e7),
                relative_alt=round(_HEIGHT_M * 1000.0),
                vx=round(north_m_s * 100.0),
                vy=round(east_m_s * 100.0),
                vz=0,
            ),
        ]
        if round(now_s / STEP_S) % 10 == 0:
            messages += self._slow_messages(now_s)
        return messages + self._payload_messages(now_s, boot_ms, state)

    def _slow_messages(self, now_s: float) -> list[Message]:
        flavour, wind = self._flavour, self._wind
        mode = flavour.mode if now_s < self.pilot_takes_over_s else 11 if flavour.autopilot == 3 else 0x00020000
        heartbeat = _message("HEARTBEAT", autopilot=flavour.autopilot, type=1, base_mode=217, custom_mode=mode)
        gps = _message("GPS_RAW_INT", fix_type=3)
        if flavour.autopilot == 3:
            from_deg = math.degrees(math.atan2(-wind.east_m_s, -wind.north_m_s))
            blowing = _message("WIND", direction=from_deg, speed=wind.speed_m_s, speed_z=0.0)
            return [heartbeat, gps, _message("EKF_STATUS_REPORT", flags=831), blowing]
        blowing = _message("WIND_COV", wind_x=wind.north_m_s, wind_y=wind.east_m_s)
        return [heartbeat, gps, _message("ESTIMATOR_STATUS", flags=831), blowing]

    def _payload_messages(self, now_s: float, boot_ms: int, state: AircraftState) -> list[Message]:
        truth = self._target.at(now_s)
        east_m, north_m = truth.east_m - state.east_m, truth.north_m - state.north_m
        level_m = math.hypot(east_m, north_m)
        range_noise, yaw_noise, pitch_noise = self._noise.standard_normal(3)
        chance, outlier_m = self._noise.random(), self._noise.uniform(-90.0, 90.0)
        yaw_rad = math.atan2(east_m, north_m) + _ANGLE_SIGMA_RAD * yaw_noise
        pitch_rad = -math.atan2(_HEIGHT_M, level_m) + _ANGLE_SIGMA_RAD * pitch_noise
        cy, sy, cp, sp = (
            math.cos(yaw_rad / 2),
            math.sin(yaw_rad / 2),
            math.cos(pitch_rad / 2),
            math.sin(pitch_rad / 2),
        )
        gimbal = _message(
            "GIMBAL_DEVICE_ATTITUDE_STATUS",
            154,
            time_boot_ms=boot_ms,
            q=[cy * cp, -sy * sp, cy * sp, sy * cp],
            flags=92,
            gimbal_device_id=0,
        )
        if chance < _DROPOUTS * STEP_S / 3.0:
            self._dropped_until_s = now_s + 3.0
        if round(now_s / STEP_S) % 2 or now_s < self._dropped_until_s:
            return [gimbal]
        range_m = math.hypot(level_m, _HEIGHT_M) + _RANGE_SIGMA_M * range_noise
        if self._noise.random() < _OUTLIERS:
            range_m = max(2.0, range_m + outlier_m)
        laser = _message(
            "DISTANCE_SENSOR",
            154,
            time_boot_ms=boot_ms,
            min_distance=100,
            max_distance=65_500,
            current_distance=min(round(range_m * 100.0), 65_500),
            id=1,
            orientation=100,
            covariance=255,
            signal_quality=90,
            quaternion=[1.0, 0.0, 0.0, 0.0],
        )
        return [gimbal, laser]


def _message(name: str, component: int = 1, **fields) -> Message:
    return Message(name, 1, component, fields, 0.0)


def _square_deg() -> list[tuple[float, float]]:
    corners = ((-1, -1), (-1, 1), (1, 1), (1, -1))
    return [_PLANE.latitude_longitude_deg(_FENCE_M * east, _FENCE_M * north) for east, north in corners]


def watched(flown: Flown, controller: StandoffController) -> bool:
    """Tell whether the mission goes on."""
    return flown.yielded is None and flown.ended is None and controller.phase is Phase.WATCHING
