"""Runs of a study: the whole core in a closed loop with a vehicle of the simulator, over flat ground or hills."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from sidelong.app.analysis.replay import Replayed
from sidelong.app.analysis.score import Moment
from sidelong.app.analysis.truth import Truth
from sidelong.app.assembly import mission_controller_of, surroundings_of
from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.autopilots.registry import AUTOPILOTS as FLOWN_AUTOPILOTS
from sidelong.app.config import Config
from sidelong.app.link.message import Message
from sidelong.app.planners.planner_kind import PlannerNeeds
from sidelong.app.planners.registry import planner_by_name
from sidelong.app.simulation.kinematic import Body, KinematicVehicle, Rates, Start
from sidelong.app.simulation.loop import ClosedLoop
from sidelong.app.simulation.target import GIMBAL, LASER, Payload, PayloadErrors, RandomTarget, TargetTruth
from sidelong.app.study.judging import RunResult, judged, judged_log
from sidelong.app.study.recorded import STEP_S, RecordedTarget
from sidelong.app.study.scene import StopWatch, StudyScene, first_circle, payload_of, scene, start_on
from sidelong.app.study.settings import LAG_S, StudySettings, StudyTerrain
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import GimbalReading, RangeReading, Reading, TargetFixReading
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.control.controller import StandoffController, StandoffSettings
from sidelong.mission.control.present import Present
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import StepOutput, WindReported
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import CheckedPlannerFactory, Plan, PlanCheck, Planner
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.exchange.mission_controller import DERIVED, InboundEvent, Output
from sidelong.mission.fleet.team_planner import IN_TEAM
from sidelong.mission.predictive.planner import USUAL, PredictivePlanner
from sidelong.mission.predictive.value_table import ValueTable
from sidelong.mission.route.route import event_of
from sidelong.mission.terrain.heights import FlightHeights, HeightRules
from sidelong.sitl.world.turbulence import turbulence

RATES = Rates(attitude_hz=1)
# At sea level, where true and equivalent airspeed are equal.
HOME = Home(47.4, 8.5, 0.0)
PLANE = LocalPlane(HOME.latitude_deg, HOME.longitude_deg)
BOOT_S = 100.0  # the vehicle's clock when a run begins
TARGET_M = 1.0  # what of a target stands above the ground
_SPREAD_M = 8_000.0  # targets start within this distance of home
_LOOKED_EVERY = 50  # steps: whether any position of the side and the band sees the target
_AZIMUTHS, _RING_M = 72, 20.0


class OnTicks:
    def __init__(self, target: RandomTarget | RecordedTarget, duration_s: float) -> None:
        ticks = np.arange(math.ceil(duration_s * RATES.tick_hz) + 2)
        self._truths = [TargetTruth(*row) for row in target.sampled(ticks / RATES.tick_hz).tolist()]

    def at(self, time_s: float) -> TargetTruth:
        """Return the truth at the tick next to a time."""
        return self._truths[round(time_s * RATES.tick_hz)]


class StudiedAircraft(ClosedLoop[Message | Reading]):
    """One aircraft of a run, taken over on its first circle.

    Args:
        config: the mission, where it is not that of the design.
        ground: what it flies over; the core knows it if the configuration counts the height from the ground.

    Attributes:
        rows: time, east, north, height above home, 1 within the envelope and else 0, after each step.
        departed_s: when each plan departed.
    """

    def __init__(
        self,
        settings: StudySettings,
        flown: StudyScene,
        target: OnTicks,
        circle: Circle,
        noise_rng: np.random.Generator,
        make_planner: CheckedPlannerFactory,
        *,
        config: Config | None = None,
        ground: Ground | None = None,
    ) -> None:
        config = config or settings.config
        errors, assumed = payload_of(settings)
        known = config.aircraft.height_above == "ground"
        autopilot = next(one for one in FLOWN_AUTOPILOTS if one.key == settings.autopilot)
        state, height_m = start_on(settings, flown, circle), _first_height_m(config, circle, ground)
        start = Start(PLANE, HOME, circle, height_m, state, BOOT_S)
        body = Body.configured(config.aircraft, settings.lag_s or LAG_S[settings.autopilot])
        payload = Payload(errors, noise_rng)
        vehicle = KinematicVehicle(autopilot, body, settings.wind, start, payload, target, RATES)
        vehicle.craft.turbulence = turbulence(config.simulation.turbulence, noise_rng)
        super().__init__(vehicle)
        self.vehicle_in_flight, self.watch = vehicle, StopWatch()
        if ground is not None:
            put_over(vehicle, ground)
        self.telemetry.plane = PLANE  # as of home: the first position lies elsewhere
        surroundings, tracker = surroundings_of(config, PLANE, None, ground if known else None), Tracker(assumed)
        if surroundings.ground is not None:
            tracker.stand_on(surroundings.ground, config.sensors.angles_alone)

        def make(aircraft: Aircraft, requirement: Requirement) -> Planner:
            planner = make_planner(aircraft, requirement, surroundings)
            decide = planner.decide
            planner.decide = lambda *of: self.watch(lambda: decide(*of))  # type: ignore[method-assign]
            return planner

        self.controller = controller = StandoffController(
            StandoffSettings(
                config.requirement.requirement(),
                config.aircraft.aircraft(),
                lost_after_s=config.planner.lost_after_s,
                give_up_after_s=math.inf,
            ),
            tracker,
            make,
            surroundings,
        )
        self.rows: list[tuple[float, float, float, float, float]] = []
        self.departed_s: list[float] = []
        self._departed = 0
        self._judged, self._within = controller.health.reports, 1.0
        vehicle.flown = self._flown
        self._flown()
        self.start(lambda plane: mission_controller_of(config, controller, autopilot, plane, HOME), vehicle.mode)

    def _flown(self) -> None:
        vehicle, craft, reports = self.vehicle_in_flight, self.vehicle_in_flight.craft, self.controller.health.reports
        if reports is not self._judged:  # they change seldom, and a study makes ten steps for each second
            self._judged, self._within = reports, float(not self.controller.breach)
        self.rows.append((vehicle.flown_s, craft.east_m, craft.north_m, craft.height_m, self._within))
        if self.controller.changes.moves > self._departed:
            self._departed += 1
            self.departed_s.append(vehicle.time_s)

    def log(self, flown: StudyScene) -> FloatArray:
        """Return time, aircraft and target (east, north), the target's course, height, within envelope, (n, 8)."""
        rows = np.array(self.rows[:-1])  # where each step begins
        truth = flown.target.sampled(rows[:, 0])[:, [0, 1, 4]]
        return np.hstack([rows[:, :3], truth, rows[:, 3:]])


def run(
    settings: StudySettings, planner: str, number: int, table: ValueTable | None, keep_track: bool = False
) -> RunResult:
    """Fly one run. Target and sensor noise depend on the seed and ``number`` only, not on the planner."""
    if table is None:
        own, wanted = settings.aircraft(), settings.requirement()
        needs = PlannerNeeds(own, wanted, (), settings.config.planner.lost_after_s, lambda _share: None)
        return fly(settings, number, planner_by_name(planner).factory(needs), keep_track)

    def make_planner(aircraft: Aircraft, requirement: Requirement, plans: PlanCheck) -> Planner:
        own = IN_TEAM if settings.config.requirement.fleet_size > 1 else USUAL
        return PredictivePlanner(aircraft, requirement, table, own, check=plans.cleared, sight=plans.sight)

    return fly(settings, number, make_planner, keep_track)


def fly(
    settings: StudySettings, number: int, make_planner: CheckedPlannerFactory, keep_track: bool = False
) -> RunResult:
    """Fly one run with a planner of this kind in the closed loop."""
    flown, config, ground = scene(settings, number), settings.config, None
    if settings.hills is not None:
        place_rng = np.random.default_rng(np.random.SeedSequence((settings.seed, number, 1)))
        ground = _moved(settings.hills.ground, place_rng)
        config = _over(settings, ground)
    target = OnTicks(flown.target, flown.duration_s)
    circle = first_circle(settings, flown)
    craft = StudiedAircraft(
        settings, flown, target, circle, flown.sensor_rng, make_planner, config=config, ground=ground
    )
    if flown.route is not None:
        craft.put(event_of(flown.route, craft.telemetry.now_s))
    craft.run(flown.duration_s - craft.simulated.time_s)
    log = craft.log(flown)
    over_ground = () if ground is None else (_over_ground(settings, ground, log),)
    return judged(settings, log, craft.departed_s, craft.watch.taken_s, keep_track, *over_ground)


# -- over hills ----------------------------------------------------------------------------------------------------


def _over(settings: StudySettings, ground: Ground) -> Config:
    """Return the mission over hills: heights above known ground, else one height above the target's start."""
    config = settings.config
    changed: dict[str, str | float] = {"height_above": "ground"}
    if settings.terrain == "ignored":
        changed = {"height_m": config.aircraft.height_m + ground.height_m(0.0, 0.0)}
    return config.model_copy(update={"aircraft": config.aircraft.model_copy(update=changed)})


def _first_height_m(config: Config, circle: Circle, ground: Ground | None) -> float:
    own = config.aircraft
    if ground is None or own.height_above != "ground":
        return own.height_m
    rules = HeightRules(own.height_m, "ground", own.clearance_m, own.rates())
    first = FlightHeights(ground, rules).levelled(Plan(circle), None, (0.0, 0.0))
    over_target_m = own.height_m + ground.height_m(0.0, 0.0)
    return over_target_m if isinstance(first, str) else first.circle_height_m(over_target_m)


def put_over(vehicle: KinematicVehicle, ground: Ground) -> None:
    """Let the target stand on a ground whose hills hide it; where the ground is void, at the height of home."""

    def seen_at_m(here_m: tuple[float, float, float], east_m: float, north_m: float) -> float | None:
        known_m = ground.height_m(east_m, north_m)
        target_m = 0.0 if math.isnan(known_m) else known_m
        return target_m if ground.sees(here_m, (east_m, north_m, target_m + TARGET_M)) else None

    vehicle.seen_at_m = seen_at_m


def _over_ground(settings: StudySettings, ground: Ground, log: FloatArray) -> tuple[float, float, float]:
    """Return the time in sight, that where any place of side and band sees the target, and the least clearance."""
    heights_m = ground.heights_at_m(log[:, 3], log[:, 4])
    eyes_m = np.where(np.isnan(heights_m), 0.0, heights_m) + TARGET_M
    in_sight = np.array(
        [ground.sees((e, n, h), (te, tn, eye)) for (_, e, n, te, tn, _, h, _), eye in zip(log, eyes_m, strict=True)]
    )
    steps = range(0, len(log), _LOOKED_EVERY)
    course_rad = judged_log(settings, log).course_rad
    looked = [_some_place_sees(settings, ground, log[k, 3:5], course_rad[k], log[k, 6]) for k in steps]
    seeable = in_sight | np.repeat(looked, _LOOKED_EVERY)[: len(in_sight)]
    possible = float(in_sight[seeable].mean()) if seeable.any() else math.nan
    clear_m = log[:, 6] - ground.heights_at_m(log[:, 1], log[:, 2])
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


def hills_of(ground: Ground) -> StudyTerrain:
    """Return a ground with a digest of it, by which runs are stored."""
    posts = (ground.west_m, ground.south_m, ground.step_east_m, ground.step_north_m, ground.sigma_m)
    return StudyTerrain(ground, hashlib.sha256(repr(posts).encode() + ground.heights_m.tobytes()).hexdigest()[:16])


def _moved(ground: Ground, rng: np.random.Generator) -> Ground:
    """Return the ground as seen from a place about home that is known."""
    while True:
        east_m, north_m = rng.uniform(-_SPREAD_M, _SPREAD_M, 2).tolist()
        if not math.isnan(ground.height_m(east_m, north_m)):
            return replace(ground, west_m=ground.west_m - east_m, south_m=ground.south_m - north_m)


def follow_readings(controller: StandoffController, flown: Tracker, events: Iterable[object], until_s: float) -> None:
    """Let a control step see what a flight's payload measured until a moment, as if measured by the simulated one."""
    sources = {flown.ranges.chosen: LASER, flown.gimbals.chosen: GIMBAL}
    for event in events:
        if not isinstance(event, Reading | WindReported):
            continue
        if event.time_s > until_s:
            return
        if isinstance(event, RangeReading | GimbalReading):
            if event.source in sources:
                controller.step(replace(event, source=sources[event.source]))
        elif not isinstance(event, TargetFixReading):
            controller.step(event)


_ON_CIRCLE_M = 50.0  # nearer to it, the aircraft flies the circle of its plan


def recorded_motion(moments: Sequence[Moment], from_s: float) -> RecordedTarget:
    """Return the target's motion in a recording from a time on."""
    rows = np.array([(one.time_s - from_s, one.target_east_m, one.target_north_m) for one in moments]).T
    steps_s = np.arange(0.0, rows[0, -1], STEP_S)
    return RecordedTarget("recorded", *(np.interp(steps_s, rows[0], row) for row in rows[1:]))


class FlownOn(ClosedLoop[Message | Reading]):
    """A flight that leaves a recorded one at the moment ``begin``, with a control step that has seen what was before.

    target: the recorded motion from that moment on. yaw_bias_rad: of the payload.
    """

    def __init__(
        self,
        config: Config,
        controller: StandoffController,
        autopilot: Autopilot,
        plane: LocalPlane,
        home_altitude_m: float,
        begin: Present,
        wind: Wind,
        target: RecordedTarget,
        yaw_bias_rad: float,
    ) -> None:
        state, own, limits, sensors = begin.aircraft, config.aircraft, config.aircraft.aircraft(), config.sensors
        assert state is not None
        circle = None if begin.plan is None else begin.plan.circle
        place = state.east_m, state.north_m, state.course_rad
        from_m = math.inf if circle is None else math.dist(place[:2], (circle.east_m, circle.north_m))
        if circle is None or abs(from_m - circle.radius_m) > _ON_CIRCLE_M:
            circle = Circle.tangent_to(*place, limits.radius_m, config.requirement.requirement().side.clockwise)
        height_m = own.height_m if begin.plan is None else begin.plan.circle_height_m(own.height_m)
        home = Home(plane.origin_latitude_deg, plane.origin_longitude_deg, home_altitude_m)
        body = Body.configured(own, LAG_S[autopilot.key])
        errors = PayloadErrors(
            sensors.range_sigma_m, math.radians(sensors.angle_sigma_deg), yaw_bias_rad, limits.pan_limit_rad
        )
        start = Start(plane, home, circle, height_m, state, begin.time_s)
        self._target, payload = OnTicks(target, target.duration_s), Payload(errors, np.random.default_rng(1))
        vehicle = KinematicVehicle(autopilot, body, wind, start, payload, self._target, RATES)
        if math.isfinite(begin.height_m):  # it may still climb to its circle
            vehicle.craft.height_m = begin.height_m
        super().__init__(vehicle)
        if controller.surroundings.ground is not None:
            put_over(vehicle, controller.surroundings.ground)
        self.telemetry.plane, self._plane, self._duration_s = plane, plane, target.duration_s
        self.controller, self._vehicle, self._begin_s = controller, vehicle, begin.time_s
        self._rows: list[tuple[float, float, float]] = []
        self._steps: list[Replayed] = []
        vehicle.flown = self._flown
        self.listeners.append(self._stepped)
        self.start(lambda _plane: mission_controller_of(config, controller, autopilot, plane, home), vehicle.mode)

    def _flown(self) -> None:
        craft = self._vehicle.craft
        self._rows.append((self._vehicle.flown_s, craft.east_m, craft.north_m))

    def _stepped(self, event: InboundEvent, outputs: tuple[Output, ...]) -> None:
        controller = self.controller
        derived = [output for output in outputs if isinstance(output, DERIVED)]
        commands = tuple(output for output in outputs if isinstance(output, StepOutput))
        self._steps += [Replayed(one, (), controller.estimate, controller.snapshot) for one in derived]
        self._steps.append(Replayed(event, commands, controller.estimate, controller.snapshot))

    def steps(self) -> Iterator[Replayed]:
        """Fly to the end of the recorded motion and yield each step as a replay does."""
        while True:
            yield from self._steps
            self._steps.clear()
            if self.simulated.time_s >= self._duration_s:
                return
            self.step()

    @property
    def truth(self) -> Truth:
        """The true tracks of aircraft and target so far."""
        rows = np.array(self._rows)
        targets = [self._target.at(time_s) for time_s in rows[:, 0].tolist()]
        places_m = [(one.east_m, one.north_m) for one in targets], rows[:, 1:].tolist()
        degrees = [[self._plane.latitude_longitude_deg(*one) for one in of] for of in places_m]
        positions_deg, count = np.hstack(degrees).T, len(rows)
        return Truth(rows[:, 0] + self._begin_s, positions_deg, np.full((2, count), np.nan), np.full(count, ""))
