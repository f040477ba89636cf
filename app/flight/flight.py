"""One flight from the first heartbeat to the summary: connect, check, take off, watch, wind up."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.analysis.score import Moment
from sidelong.app.analysis.summary import Summary, SummaryCollector, summarise
from sidelong.app.analysis.truth import Truth
from sidelong.app.assembly import Prepared, mission_controller_of, winds_m_s
from sidelong.app.autopilots.autopilot import ParameterTable, RequiredParameter
from sidelong.app.config import Config
from sidelong.app.errors import FlightError, InputError
from sidelong.app.flight.changes import MissionChanges, PanLimitInput, WindTables
from sidelong.app.flight.loop import ControlLoop, Display, FlightDisplay, Observer, Stepped, TrackRequest, Wish
from sidelong.app.flight.outputs import GimbalPointer, PayloadPointer, open_beacon, outputs
from sidelong.app.flight.payload_input import PayloadRunner, check_route, give_route
from sidelong.app.flight.preflight import SourceRates, check_takeover, checks
from sidelong.app.flight.recording import Recording
from sidelong.app.flight.session import InputHealth, Session, with_fences
from sidelong.app.flight.streams import OneTask, StreamKeeper, TerrainServer, announcing, ask_for_streams, wants_few
from sidelong.app.link.message import Message
from sidelong.app.link.quality import RoundTripWatch
from sidelong.app.link.stored import ParameterWatch, VehicleFences, read_fences, read_table, temporary_parameters
from sidelong.app.link.traffic import TrafficReader
from sidelong.app.link.vehicle import (
    LinkError,
    StatusText,
    Vehicle,
    home_of,
    is_flying,
    mode_of,
    reported_pan_limits_rad,
    request_pan_limits,
    vehicle_status,
)
from sidelong.app.planners.registry import planner_by_name
from sidelong.app.sharing.outputs import AltitudeAt
from sidelong.app.terrain.elevation_data import elevation_data
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.alarms import Alarms, Endurance, battery_is_low, describe_battery, time_to_s
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.present import Phase, Present, VehicleStatus
from sidelong.mission.core import events
from sidelong.mission.core.plan import AircraftState, PanLimitPlanner
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.exchange.outbox import TakeoverFailed
from sidelong.mission.exchange.reports import TakeoverRequested

if TYPE_CHECKING:
    from sidelong.app.camera.runner import CameraRunner

_LISTEN_S = 1.0
_POLL_S = 0.1
_RESUMED_WITHIN_S = 4.0
_SAME_HOME_M, _SAME_HOME_HEIGHT_M = 30.0, 10.0  # arming sets it again, by another GPS fix
_DELAY_EVERY_S = 1.0
_FENCES_EVERY_S = 20.0
_READY_WITHIN_S = 60.0  # of the vehicle's time
_READY_WALL_S = 20.0  # a fast simulation's minute is over before every question is answered


@dataclass(frozen=True, slots=True)
class _Ready:
    """A vehicle that was checked: its plane, its home, and what is borrowed of its parameters for the flight."""

    plane: LocalPlane
    home: Home
    parameters: tuple[RequiredParameter, ...]
    table: ParameterTable


@dataclass(frozen=True, slots=True)
class CameraPlaces:
    simulated: str | None = None  # of a simulated vehicle, whose operator clicks the target; None: as configured
    record: Path | None = None  # the file in the run folder; None: nowhere


@dataclass(slots=True)
class StoppedClock:
    """Counts by this computer's clock while the vehicle's clock stands still."""

    _now_s: float
    _wall_s: float
    seconds: float = 0.0  # for how long it has stood still; 0 once it has gone on by more than that

    def update(self, now_s: float, wall_s: float) -> None:
        """Compare the vehicle's clock with this computer's; ``seconds`` is how long the former has stood still."""
        if now_s == self._now_s:
            self.seconds += wall_s - self._wall_s
        elif abs(now_s - self._now_s) > self.seconds:
            self.seconds = 0.0
        self._now_s, self._wall_s = now_s, wall_s


class Flight:
    def __init__(
        self,
        session: Session,
        config: Config,
        prepared: Prepared,
        recording: Recording,
        display: FlightDisplay,
        duration_s: float | None,
        turn_payload: bool = False,
        payload: PayloadRunner | None = None,
        camera: CameraPlaces | None = None,
    ) -> None:
        self._payload, self._camera = payload, camera or CameraPlaces()
        self._vehicle, self._autopilot, self._telemetry = session.vehicle, session.autopilot, session.telemetry
        self._session, self._release = session, session.release
        self._config, self._recording, self._display = config, recording, display
        self._duration_s, self._turn_payload = duration_s, turn_payload
        self._prepared, self._senders = prepared, session.senders
        self._core: StandoffController | None = None  # known once the vehicle is checked
        self._begin = session.begin
        self._collector = SummaryCollector(config.requirement.requirement())
        self._start_s, self._takeover_s = math.inf, math.inf
        self._battery_percent: int | None = None  # when watching began
        self._warnings: set[str] = set()  # of the autopilot, that were shown
        self._ready: _Ready | None = None
        self._terrain: TerrainServer | None = None
        self._loop: ControlLoop | None = None
        self._runner: CameraRunner | None = None
        self._resumption = OneTask()  # after a yield
        self._fences = VehicleFences()

    async def prepare(self) -> None:
        """Check the vehicle: nothing is armed or changed. Raises InputError when it is not ready."""
        check_route(self._config.route, (self._vehicle.system_id,))
        if self._config.terrain.folder is not None:  # the autopilot may want heights before it takes off
            self._terrain = TerrainServer(self._vehicle, elevation_data(Path(self._config.terrain.folder)))
        few = wants_few(self._config.link)
        # In parallel: over a slow link each waits for its answers. Rates may be confirmed later.
        self._request_streams = partial(ask_for_streams, self._vehicle, few, self._terrain is not None)
        self._begin(self._request_streams())
        sources, inputs = SourceRates(self._vehicle), InputHealth(self._config, self._session.inputs)
        parameters, _ = await asyncio.gather(
            read_table(self._vehicle, self._autopilot, self._release), home_of(self._vehicle)
        )
        for sentence in parameters.missing:
            self._display.note(sentence)
        self._config, self._fences = await with_fences(self._vehicle, self._config, parameters)
        self._prepared = replace(self._prepared, config=self._config)
        self._display.note(f"the vehicle has {self._fences}")
        home, required_parameters = await self._check(parameters, sources, inputs)
        check_takeover(self._vehicle, self._config.link.take_over_from)
        inputs.close()
        sources.close()
        self._session.inputs.close()  # from here on the control step looks
        plane = self._telemetry.plane
        assert plane is not None  # the position check has passed
        borrowed = required_parameters if self._config.link.set_parameters else ()
        self._ready = _Ready(plane, home, borrowed, parameters)
        self.share_plane(plane)

    async def _watch_fences(self, put: Callable[[events.AlarmReported], object]) -> None:
        """Announce once that the vehicle's fences differ from those that are flown by."""
        vehicle, partial_writes = self._vehicle, self._autopilot.quirks.stores_items_one_by_one
        known_id = _fence_ids(vehicle)
        while True:
            await asyncio.sleep(_FENCES_EVERY_S)
            # Where the whole list has an id it is compared; only ArduPilot serves a list while another is written.
            if not (partial_writes if known_id is None else _fence_ids(vehicle) != known_id):
                continue
            with contextlib.suppress(LookupError, LinkError):
                if await read_fences(vehicle) != self._fences:
                    text = "the vehicle's fences have changed: end this watch and start another one to keep them"
                    put(events.AlarmReported(self._telemetry.now_s, "fences", "raised", text))
                    return

    async def watch(
        self,
        stopped: asyncio.Event,
        stepped: Stepped = lambda _event, _outputs: None,
        over: asyncio.Event | None = None,
    ) -> str:
        """Take off if needed and track, until ``stopped``, ``over`` or the end of the duration; return the outcome.

        stepped: called after each step of the core, with its event and outputs. ``prepare`` must have passed.
        """
        assert self._ready is not None
        in_control: Callable[[], bool] = lambda: self.controller.phase is not Phase.YIELDED  # noqa: E731
        async with temporary_parameters(self._vehicle, self._ready.parameters, self._display.note, in_control):
            return await self._watched(self._ready, stopped, stepped, over)

    @property
    def controller(self) -> StandoffController:
        """The control step; before ``prepare`` has passed one that knows no surroundings and flies nothing."""
        self._core = self._core or self._prepared.controller()
        return self._core

    @property
    def plane(self) -> LocalPlane:
        """The local plane, known once ``prepare`` has passed, as ``home`` is."""
        assert self._ready is not None
        return self._ready.plane

    @property
    def home(self) -> Home:
        """Home as the autopilot reports it, known once ``prepare`` has passed."""
        assert self._ready is not None
        return self._ready.home

    @property
    def processed_to_s(self) -> float:
        """Vehicle time up to which all input is processed, s; -inf while output is still to be sent, inf: not known.

        Before the control step runs, this is the latest time reported by the vehicle.
        """
        if self._loop is not None and math.isfinite(self.controller.time_s):
            return -math.inf if self._loop.is_sending else self.controller.time_s
        last = self._vehicle.latest.get("GLOBAL_POSITION_INT")
        return math.inf if last is None else float(last.fields["time_boot_ms"]) * 1e-3

    @property
    def loaded(self) -> bool:
        """Whether a mission of sidelong is on board."""
        return self._loop is not None and self._loop.controller.loaded

    def put_event(self, event: events.Event) -> None:
        """Pass the core an event that does not come from the vehicle; ignored if the core does not run."""
        if self._loop is not None:
            self._loop.put(event)

    def share_plane(self, plane: LocalPlane) -> None:
        """Fly in another vehicle's local plane, between ``prepare`` and ``watch``."""
        assert self._ready is not None
        self._telemetry.plane, home = plane, self._ready.home
        self._ready = replace(self._ready, plane=plane)
        self._core = self._prepared.controller(plane, (home.latitude_deg, home.longitude_deg))

    async def _watched(
        self, ready: _Ready, stopped: asyncio.Event, stepped: Stepped, ended: asyncio.Event | None
    ) -> str:
        plane, home = ready.plane, ready.home
        home_deg = (home.latitude_deg, home.longitude_deg)
        self._collector.ground = self.controller.surroundings.ground
        self._recording.begin(plane, home_deg, self._autopilot.name, home.altitude_m, self._config)
        core = mission_controller_of(self._config, self.controller, self._autopilot, plane, home)
        shared = contextlib.ExitStack()
        observers = self._observers(plane, home, shared)
        own_values = {required.name: required.value for required in ready.parameters}
        bytewise = self._autopilot.packs_integers_bytewise
        watch = ParameterWatch(ready.table, bytewise, own_values, self._display.note, self._limits_changed)
        self._vehicle.listeners.append(watch.take)
        shared.callback(self._vehicle.listeners.remove, watch.take)
        streams = StreamKeeper(self._request_streams, self._display.note)
        alarms = AlarmWatch(self._config, self._home_m, self._status, self.put_event, self._send_alarm)
        observed = _Observed(self._display, alarms, observers, self._collector)
        camera = self._runner = self._camera_runner(plane, home)
        steps = (stepped,) if camera is None else (camera.stepped, stepped)
        loop = self._loop = ControlLoop(
            self._vehicle,
            self._telemetry,
            core,
            self._recording,
            observed,
            self._acquired,
            steps,
            streams.health_changed,
        )
        beacon = await open_beacon(
            self._config.sharing, plane, self._now_s, loop.put, self._display.note, self._vehicle.listeners
        )
        changes = MissionChanges(self._config, self.controller, self._now_s, loop.put, self._display.say)
        kind, winds = planner_by_name(self._config.planner.name), winds_m_s(self._config)
        tables = WindTables(kind, self.controller, winds, loop.put, self._display.note)
        observers += [streams, *self._pan_limits(changes), tables]
        for running in (streams, beacon, changes, tables, self._resumption):
            if running is not None:
                shared.callback(running.stop)
        self._display.begin(plane, partial(self._request, changes, alarms, loop), self._config)
        gc.collect()
        gc.freeze()  # without the objects that are loaded now, a search for garbage takes 0.1 s less
        shared.callback(gc.unfreeze)
        looping = asyncio.create_task(loop.run())
        over = asyncio.create_task(self._until_over(ended))
        interrupt = asyncio.create_task(stopped.wait())
        works = [self._announce_delay(loop), alarms.run(), self._watch_fences(loop.put)]
        if camera is not None:
            works.append(announcing(camera.run(), "the camera", self._display.note))
        background = [self._begin(work) for work in works]
        give_route(self._config.route, self._session, plane, loop.put, self._display.note)
        if not stopped.is_set():
            loop.put(self._takeover(loop.link_s))
        try:
            await asyncio.wait((looping, over, interrupt), return_when=asyncio.FIRST_COMPLETED)
        finally:
            loop.stop()
            for task in (over, interrupt, *background):
                task.cancel()
            await asyncio.gather(looping, over, interrupt, *background, return_exceptions=True)
            shared.close()
        looping.result()
        if loop.failed is not None:
            raise self._failure(loop.failed)
        return loop.outcome or ("interrupted" if stopped.is_set() else "completed")

    def _now_s(self) -> float:
        return self._telemetry.now_s

    def _limits_changed(self, values: Mapping[str, float]) -> None:
        bank_deg = self._autopilot.limits(values).bank_max_deg
        if bank_deg is not None:
            self.put_event(events.BankLimitReported(self._telemetry.now_s, math.radians(bank_deg)))

    def _takeover(self, link_s: float) -> TakeoverRequested:
        """Return the request to take over, and show the autopilot's warnings from now on."""
        vehicle = self._vehicle
        self._takeover_s = vehicle.latest["HEARTBEAT"].received_s
        if self._warned not in vehicle.texts.listeners:
            vehicle.texts.listeners.append(self._warned)
        arm_period_s, round_trip_s = 1.0 / self._vehicle_rate, vehicle.round_trip_s or 0.0
        flying, mode = is_flying(vehicle), mode_of(vehicle)
        return TakeoverRequested(self._telemetry.now_s, link_s, flying, mode, arm_period_s, round_trip_s)

    async def _try_to_resume(self) -> None:
        try:
            await self._resume()
        except InputError as refusal:
            self._display.say(events.Announce(self._telemetry.now_s, "refused", f"resume refused: {refusal}"))

    async def _resume(self) -> None:
        """Check the vehicle again after a yield, then ask the core to take it over.

        A failing check may pass within seconds, as while an EKF starts. Raises InputError that lists what then fails.
        """
        ready, loop = self._ready, self._loop
        assert ready is not None
        assert loop is not None
        check_takeover(self._vehicle, self._config.link.take_over_from)
        mode = mode_of(self._vehicle)
        if not is_flying(self._vehicle):
            raise InputError("the aircraft is on the ground; end this watch and start another one to take off.")
        sources, until_s = SourceRates(self._vehicle), time.monotonic() + _RESUMED_WITHIN_S
        with contextlib.closing(sources):
            while True:
                rates = await sources.received(_LISTEN_S, self._config.sharing)
                home = await home_of(self._vehicle)
                found = checks(self._config, self._vehicle, self._autopilot, ready.table, home, rates)
                missing = [str(check) for check in found if not check.ready and not check.before_take_off]
                if objection := self.controller.resume_objection():
                    missing.insert(0, objection)
                if not missing:
                    break
                if time.monotonic() > until_s or self.controller.phase is not Phase.YIELDED:
                    raise InputError("not ready, " + "; ".join(missing) + ".")
        for check in found:
            if not check.ready:  # the target may be out of the laser's range while a pilot flies
                self._display.note(f"resuming without {check}")
        moved_m = 0.0 if home is None else math.dist(_place_m(home, ready.plane), self._home_m)
        raised_m = 0.0 if home is None else abs(home.altitude_m - ready.home.altitude_m)
        if moved_m > _SAME_HOME_M or raised_m > _SAME_HOME_HEIGHT_M:
            raise InputError("the autopilot has another home than at take-off; end this watch and start another one.")
        check_takeover(self._vehicle, self._config.link.take_over_from)
        if mode_of(self._vehicle) != mode:
            raise InputError(
                f"the flight mode was changed to {mode_of(self._vehicle)} in the meantime; resume again."
            )
        loop.put(self._takeover(loop.link_s))

    def _request(self, changes: MissionChanges, alarms: AlarmWatch, loop: ControlLoop, wish: Wish) -> None:
        match wish:
            case events.MissionChange():
                changes.take(wish)
            case events.AlarmReported():
                alarms.acknowledge(wish)
            case TrackRequest():
                if self._runner is None:
                    self._display.note("no camera is configured: nothing is tracked")
                elif wish.where:
                    self._runner.camera.follow(*wish.where)
                else:
                    self._runner.camera.stop()
            case _:
                loop.put(wish)
                if wish.action == "resume" and self.controller.phase is Phase.YIELDED:
                    self._resumption.begin(self._try_to_resume)

    def _watch_traffic(self, plane: LocalPlane, home: Home, shared: contextlib.ExitStack) -> None:
        """Let the core receive what is reported of other aircraft; of a fleet, the coordinator does."""
        if self._config.requirement.fleet_size > 1:
            return
        vehicle, controller = self._vehicle, self.controller

        def own() -> tuple[AircraftState, float] | None:
            state, height_m = controller.aircraft, controller.flown_height_m
            return None if state is None or height_m is None else (state, height_m)

        beacon = (self._config.sharing.beacon or "").upper().removeprefix("ADSB:")
        ignored = (f"ADS-B {beacon:>06}",)
        reader = TrafficReader(plane, home.altitude_m, (vehicle.system_id,), self._now_s, own, ignored)

        def listen(message: Message) -> None:
            if reader.report(message) is not None:
                self.put_event(events.TrafficReported(self._telemetry.now_s, reader.aircraft))

        vehicle.bystanders.append(listen)
        shared.callback(vehicle.bystanders.remove, listen)

    def _observers(self, plane: LocalPlane, home: Home, shared: contextlib.ExitStack) -> list[Observer]:

        def altitude_m(east_m: float, north_m: float) -> float:
            return home.altitude_m + self._target_height_m(east_m, north_m)

        self._watch_traffic(plane, home, shared)
        observers: list[Observer] = []
        config, latest = self._config, self._vehicle.latest
        for output in outputs(config.sharing, config.camera, plane, altitude_m, latest, self._display.note):
            shared.callback(output.stop)
            observers.append(output)
        observers += self._pointers(plane, altitude_m, shared)
        if self._terrain is not None:
            shared.callback(self._terrain.stop)
        return observers

    def _pan_limits(self, changes: MissionChanges) -> list[Observer]:
        planner, configured_deg = self.controller.planning.planner, self._config.aircraft.pan_limit_deg
        if not (isinstance(planner, PanLimitPlanner) and planner.plans_pan_limits):
            return []
        vehicle, payload = self._vehicle, self._payload
        if payload is None:
            self._begin(request_pan_limits(vehicle))

        def reported_rad() -> tuple[float, float] | None:
            return reported_pan_limits_rad(vehicle) if payload is None else payload.pan_limits_rad

        return [PanLimitInput(configured_deg, reported_rad, changes, self._display.note)]

    def _send_alarm(self, text: str) -> None:
        self._begin(self._vehicle.send_text(text, mavlink.MAV_SEVERITY_CRITICAL))

    @property
    def _home_m(self) -> tuple[float, float]:
        return _place_m(self.home, self.plane)

    async def _announce_delay(self, loop: ControlLoop) -> None:
        watch, rate = RoundTripWatch(), self._vehicle_rate
        while True:
            began_s, at_s = self._telemetry.now_s, loop.link_s
            await asyncio.sleep(_DELAY_EVERY_S)
            if not self._config.link.connections and math.isfinite(began_s):  # a simulation waits for us at times
                rate = (self._telemetry.now_s - began_s) / (loop.link_s - at_s)
            round_trip_s = watch.news(self._vehicle.link.recent(), rate)
            if round_trip_s is not None:
                loop.put(events.RoundTripReported(self._telemetry.now_s, round_trip_s))

    def _target_height_m(self, east_m: float, north_m: float) -> float:
        """Return the ground's height above home at a place, 0 where it is not known."""
        ground = self._collector.ground
        height_m = math.nan if ground is None else ground.height_m(east_m, north_m)
        return height_m if math.isfinite(height_m) else 0.0

    def _pointers(self, plane: LocalPlane, altitude_m: AltitudeAt, shared: contextlib.ExitStack) -> list[Observer]:
        always = self._config.payload.point_gimbal
        if self._payload is not None and always:
            tracker = self.controller.tracker
            return [PayloadPointer(self._payload.point, tracker, self._target_height_m)]
        if not (always or self._turn_payload):
            return []
        pointer = GimbalPointer(self._vehicle, plane, altitude_m, self._display.note, always)
        shared.callback(pointer.stop)
        return [pointer]

    def _camera_runner(self, plane: LocalPlane, home: Home) -> CameraRunner | None:
        config = self._config
        if config.camera.source is None:
            return None
        from sidelong.app.camera.runner import CameraRunner, Here  # noqa: PLC0415  # an extra

        places, point = self._camera, None if self._payload is None else self._payload.point
        here = Here("sidelong" if places.record is None else places.record.parent.name, plane, home.altitude_m)
        return CameraRunner(
            config.camera,
            self._vehicle,
            self.controller.tracker,
            self._collector.ground,
            self._display.note,
            here,
            source=places.simulated,
            point=point,
            clicks=places.simulated is not None,
            record=places.record,
            show=self._display.show_picture,
        )

    def _status(self) -> VehicleStatus:
        return vehicle_status(self._vehicle.latest, self._vehicle.link.recent())

    def _warned(self, text: StatusText) -> None:
        if text.is_warning and text.text not in self._warnings:
            self._warnings.add(text.text)
            self._display.note(f'the autopilot reports "{text.text}"')

    def _acquired(self, acquired: events.ControlAcquired) -> None:
        self._vehicle.texts.listeners.remove(self._warned)
        if self._start_s < math.inf:
            self._display.note("circling again: the target is watched from now on")
            return
        self.put_event(events.HomeReported(acquired.time_s, *self._home_m))  # it may have been reported long before
        self._start_s, self._battery_percent = acquired.time_s, self._status().battery_percent
        self._display.watching_began(self._start_s, self._duration_s)
        self._display.note("circling: the target is watched from now on")

    def _failure(self, failed: TakeoverFailed) -> Exception:
        if failed.wrong_input:
            return InputError(f"{failed.reason}.")
        texts = [f'"{text}"' for text in self._vehicle.texts.warnings(self._takeover_s)]
        return FlightError(": ".join((failed.reason, *([", ".join(texts)] if texts else ()))) + ".")

    @property
    def _vehicle_rate(self) -> float:
        """How much faster than ours the vehicle's clock runs."""
        return 1.0 if self._config.link.connections else self._config.simulation.speed

    async def _check(
        self, parameters: ParameterTable, sources: SourceRates, inputs: InputHealth
    ) -> tuple[Home, tuple[RequiredParameter, ...]]:
        self._display.note("checking the vehicle and its sensors")
        required_parameters = parameters.as_on_board(
            self._autopilot.required_parameters(parameters.values, self._config.aircraft.airspeed_m_s)
        )
        deadline_s, wall_s = self._telemetry.now_s + _READY_WITHIN_S, time.monotonic() + _READY_WALL_S
        while True:
            rates = await sources.received(_LISTEN_S, self._config.sharing)
            if self._senders.two_vehicles is not None:
                raise InputError(f"{self._senders.two_vehicles}.")
            home = await home_of(self._vehicle)
            unmet = () if self._config.link.set_parameters else required_parameters
            found = checks(self._config, self._vehicle, self._autopilot, parameters, home, rates, unmet)
            found += inputs.checks()
            flying = is_flying(self._vehicle)
            missing = [check for check in found if not (check.ready or (flying and check.before_take_off))]
            if not missing:
                assert home is not None
                return home, required_parameters
            over = self._telemetry.now_s > deadline_s and time.monotonic() > wall_s
            reported = missing if over else [check for check in missing if check.lasts]
            if reported:
                raise InputError("not ready, " + "; ".join(map(str, reported)) + ".")

    async def _until_over(self, ended: asyncio.Event | None) -> None:
        if ended is not None:
            await ended.wait()
            return
        while self._start_s == math.inf:
            await asyncio.sleep(_POLL_S)
        stopped = StoppedClock(self._telemetry.now_s, time.monotonic())
        while self._duration_s is None or self._telemetry.now_s + stopped.seconds < self._start_s + self._duration_s:
            await asyncio.sleep(_POLL_S)
            stopped.update(self._telemetry.now_s, time.monotonic())

    def moments(self, truth: Truth | None) -> Sequence[Moment]:
        """Return the moments since control was acquired, with the target by the truth; None: as estimated."""
        return self._collector.moments(truth, self._telemetry.plane, self._start_s)[0]

    def summary(self, outcome: str, truth: Truth | None) -> Summary:
        """Return the summary up to now; the outcome is in words."""
        begin, end = self._battery_percent, self._status().battery_percent
        judged = summarise(
            self._collector,
            self.controller.snapshot(),
            truth=truth,
            plane=self._telemetry.plane,
            start_s=self._start_s,
            tracker=self.controller.tracker,
            outcome=outcome,
        )
        return judged if begin is None or end is None else replace(judged, battery_percent=(begin, end))


def _fence_ids(vehicle: Vehicle) -> tuple[int, int] | None:
    """Return the ids of the stored fences and rally points; None where the autopilot reports none."""
    message = vehicle.latest.get("MISSION_CURRENT")
    fields = {} if message is None else message.fields
    ids = fields.get("fence_id") or 0, fields.get("rally_points_id") or 0
    return ids if any(ids) else None


def _place_m(home: Home, plane: LocalPlane) -> tuple[float, float]:
    return plane.east_north_m(home.latitude_deg, home.longitude_deg)


class _Observed:
    """The display and the observers as one; also collects the data of the summary."""

    def __init__(
        self, display: Display, alarms: AlarmWatch, observers: Sequence[Observer], gatherer: SummaryCollector
    ) -> None:
        self.say, self._show, self._completed = display.say, display.show, alarms.completed
        self._observers, self._collector = observers, gatherer

    def show(self, snapshot: Present) -> None:
        snapshot = self._completed(snapshot)
        self._collector.observe(snapshot)
        self._show(snapshot)
        for observer in self._observers:
            observer.show(snapshot)


_LOOK_EVERY_S = 0.5
_STATUS_EVERY_S = 0.2  # of the wall clock: a fast simulation looks more often
_BATTERY_EVERY_S, _LOW_BATTERY_EVERY_S = 10.0, 1.0  # the controller flies home by a report that lasts
_TEXT_EVERY_S = 5.0


@dataclass(eq=False)
class AlarmWatch:
    """Judges the flight and completes what is shown of it by the vehicle's status and the alarms.

    Each change is an event of the control loop, so it is in the journal and on all displays. A ground station gets
    the text of a raised alarm as STATUSTEXT.
    """

    _config: Config
    _home_m: tuple[float, float]  # east and north in the local plane
    _status: Callable[[], VehicleStatus]  # as received last
    _put: Callable[[events.AlarmReported | events.BatteryReported], object]
    _send: Callable[[str], object]  # a text to the ground station
    _clock_s: Callable[[], float] = time.monotonic
    left_s: float | None = None
    home_s: float | None = None

    def __post_init__(self) -> None:
        self._alarms = Alarms()
        self._endurance = Endurance(self._config.planner.battery_reserve_percent)
        self._snapshot: Present | None = None
        self._known, self._low = VehicleStatus(), False
        self._received_at_s = self._looked_at_s = self._clock_s()
        self._known_at_s = self._looked_s = self._reported_s = self._sent_s = -math.inf

    def acknowledge(self, wish: events.AlarmReported) -> None:
        """Acknowledge an active alarm, and journal this; another key changes nothing."""
        if self._alarms.acknowledge(wish.key):
            self._put(wish)

    async def run(self) -> None:
        """Judge the alarms also while the vehicle's clock does not advance, until cancelled."""
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            if self._snapshot is not None and self._clock_s() >= self._looked_at_s + _LOOK_EVERY_S:
                self._look(self._snapshot)

    def completed(self, present: Present) -> Present:
        """Return the state with the vehicle's status; twice a second the alarms are judged, which takes longer."""
        before, self._snapshot = self._snapshot, present
        if before is None or present.time_s != before.time_s:
            self._received_at_s = self._clock_s()
        link_changed = before is None or present.connected != before.connected
        if link_changed or present.time_s >= self._looked_s + _LOOK_EVERY_S:
            self._look(present)
        return replace(present, vehicle=self.status)

    @property
    def status(self) -> VehicleStatus:
        """The vehicle's state for displays: reports, endurance, way home and active alarms, as of now."""
        return replace(
            self._known,
            endurance_s=self.left_s,
            home_s=self.home_s,
            home_m=self._home_now_m,
            silent_s=self._clock_s() - self._received_at_s,
            alarms=self._alarms.active,
            reserve_percent=self._config.planner.battery_reserve_percent,
            battery_doubt=self._endurance.charge.doubt,
        )

    @property
    def _home_now_m(self) -> tuple[float, float]:
        """Home as the autopilot reported it last: another station may set it elsewhere in flight."""
        present = self._snapshot
        return self._home_m if present is None or present.home_m is None else present.home_m

    def _look(self, present: Present) -> None:
        self._looked_s, self._looked_at_s = present.time_s, self._clock_s()
        if not math.isfinite(present.time_s):
            return
        if self._clock_s() >= self._known_at_s + _STATUS_EVERY_S:
            self._known, self._known_at_s = self._status(), self._clock_s()
        self._watch_battery(present)
        raised, cleared = self._alarms.update(replace(present, vehicle=self.status))
        for alarm in cleared:
            self._put(events.AlarmReported(present.time_s, alarm.key, "cleared", alarm.text))
        for alarm in raised:
            self._put(events.AlarmReported(present.time_s, alarm.key, "raised", f"{alarm.text}: {alarm.advice}"))
        if raised and present.phase.in_control and present.time_s >= self._sent_s + _TEXT_EVERY_S:
            self._sent_s = present.time_s
            self._send(f"sidelong: {raised[0].text}")

    def _watch_battery(self, present: Present) -> None:
        if self._known.battery_percent is None or present.aircraft is None:
            return
        self._endurance.take(present.time_s, self._known.battery_percent, self._known.battery_v)
        self.left_s = self._endurance.left_s(present.time_s)
        airspeed_m_s = self._config.aircraft.airspeed_m_s
        self.home_s = time_to_s(present.aircraft, self._home_now_m, airspeed_m_s, present.wind)
        if self.left_s is None:
            return
        was_low, self._low = self._low, battery_is_low(self.left_s, self.home_s)
        every_s = 0.0 if self._low != was_low else _LOW_BATTERY_EVERY_S if self._low else _BATTERY_EVERY_S
        if present.time_s >= self._reported_s + every_s:
            self._reported_s, status = present.time_s, self.status
            text, rejected = describe_battery(status) if self._low else "", bool(status.battery_doubt)
            percent = self._known.battery_percent
            self._put(events.BatteryReported(present.time_s, percent, self.left_s, self.home_s, text, rejected))
