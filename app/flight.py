"""One flight from the first heartbeat to the summary: connect, check, take off, watch, wind up."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pymavlink import mavutil

from app.assembly import fence_check
from app.autopilot import Autopilot, Home
from app.config import Config
from app.cot import CotOutput
from app.display import FlightDisplay
from app.errors import FlightError, InputError
from app.link import RawItem, UploadResult
from app.loop import ControlLoop, Display
from app.mavsdk_link import FrameListener, MavsdkLink
from app.performer import Performer
from app.point_gimbal import GimbalPointer
from app.preflight import ask_for_streams, autopilot_of, checks, home_of, listen, mode_of
from app.recording import Recording
from app.records.truth import read_truth
from app.summary import Gatherer, Summary, summarise
from app.telemetry import Telemetry
from app.vehicle import Vehicle
from estimators.frames import LocalPlane
from mission.circle import Circle
from mission.events import Announce, Engaged, Event
from mission.plan import Plan
from mission.watch import Snapshot, Watch

_mav = mavutil.mavlink
_LISTEN_S = 1.0
_FLYING_HEIGHT_M = 25.0
_ARM_EVERY_S = 1.0
_POLL_S = 0.1
_READY_WITHIN_S, _ARM_WITHIN_S, _TAKE_OFF_WITHIN_S = 60.0, 120.0, 240.0  # of the vehicle's time
_READY_WALL_S = 20.0  # a fast simulation's minute is over before every question is answered
_MODE_WITHIN_S = 5.0
_HIGH_ENOUGH = 0.7  # of the height wanted, to begin watching


@dataclass(frozen=True, slots=True)
class Sharing:
    """Who else is told of the estimate. cot: udp://HOST:PORT; point_gimbal: the vehicle, for its gimbal."""

    cot: str | None = None
    point_gimbal: bool = False


@dataclass(slots=True)
class Session:
    """A connected vehicle and what is known of it."""

    vehicle: Vehicle
    autopilot: Autopilot
    telemetry: Telemetry


@contextlib.asynccontextmanager
async def connected(url: str, timeout_s: float, on_frame: FrameListener | None = None) -> AsyncIterator[Session]:
    """Connect to the vehicle at ``url``. Raises InputError when there is none, or none that this can fly."""
    link = await MavsdkLink.open(url, timeout_s, on_frame)
    vehicle = Vehicle(link)
    pump = asyncio.create_task(vehicle.run())
    try:
        if await vehicle.heard("HEARTBEAT", timeout_s) is None:
            raise InputError(f"{url!r}: the autopilot stopped talking; check the link.")
        yield Session(vehicle, autopilot_of(vehicle), Telemetry(vehicle.system_id))
    finally:
        await link.close()
        pump.cancel()
        await asyncio.gather(pump, return_exceptions=True)


class Flight:
    """Flies a configuration on a connected vehicle."""

    def __init__(
        self,
        session: Session,
        config: Config,
        watch: Watch,
        recording: Recording,
        display: FlightDisplay,
        duration_s: float | None,
        sharing: Sharing = Sharing(),
    ) -> None:
        self._vehicle, self._autopilot, self._telemetry = session.vehicle, session.autopilot, session.telemetry
        self._config, self._recording, self._display = config, recording, display
        self._duration_s, self._sharing = duration_s, sharing
        self._watch = watch
        self._gatherer = Gatherer(config.requirement.requirement())
        self._start_s = math.inf

    async def fly(self, truth: Path | None, stopped: asyncio.Event) -> Summary:
        """Check, take off if need be, watch for the duration or until ``stopped`` is set, and sum up."""
        self._vehicle.listeners.append(self._telemetry.event)  # the clock and the plane, from the start
        await ask_for_streams(self._vehicle)
        home = await self._check()
        self._vehicle.listeners.remove(self._telemetry.event)
        plane = self._telemetry.plane
        assert plane is not None  # the position check has passed
        self._watch.check = fence_check(self._config, plane)
        self._recording.begin(plane)
        queue: asyncio.Queue[Event | None] = asyncio.Queue()
        performer = Performer(
            self._vehicle,
            self._autopilot,
            plane,
            home,
            airspeed_m_s=self._config.aircraft.airspeed_m_s,
            height_m=self._config.aircraft.height_m,
            tolerance_m=self._config.planner.tolerance_m,
            report=queue.put_nowait,
            now_s=lambda: self._telemetry.now_s,
        )
        observers: list[Display] = [self._display]
        shared = contextlib.ExitStack()
        if self._sharing.cot is not None:
            observers.append(shared.enter_context(CotOutput(self._sharing.cot, plane)))
        if self._sharing.point_gimbal:
            pointer = GimbalPointer(self._vehicle, plane, home.altitude_m, self._display.note)
            shared.callback(pointer.stop)
            observers.append(pointer)
        loop = ControlLoop(
            queue,
            self._vehicle,
            self._telemetry,
            self._watch,
            performer,
            self._recording,
            _Observed(observers, self._gatherer),
        )
        self._display.begin(plane, loop.put)
        running = asyncio.create_task(loop.run())
        flying = asyncio.create_task(self._fly(loop, performer, plane, home))
        interrupt = asyncio.create_task(stopped.wait())
        try:
            await asyncio.wait((running, flying, interrupt), return_when=asyncio.FIRST_COMPLETED)
            if flying.done():
                flying.result()
        finally:
            for task in (flying, interrupt):
                task.cancel()
            loop.stop()
            await asyncio.gather(running, flying, interrupt, return_exceptions=True)
            await performer.drain()
            shared.close()
        running.result()
        outcome = loop.outcome or ("interrupted" if stopped.is_set() else "completed")
        return self._summary(outcome, plane, truth)

    async def _fly(self, loop: ControlLoop, performer: Performer, plane: LocalPlane, home: Home) -> None:
        await self._engage(loop, performer, plane, home)
        await self._until_over()

    async def _check(self) -> Home:
        self._display.note("checking the vehicle and its sensors")
        limits = await self._autopilot.limits(self._vehicle)
        deadline_s, wall_s = self._telemetry.now_s + _READY_WITHIN_S, time.monotonic() + _READY_WALL_S
        while True:
            rates = await listen(self._vehicle, _LISTEN_S)
            home = await home_of(self._vehicle)
            missing = [check for check in checks(self._config, self._vehicle, limits, home, rates) if not check.ready]
            if not missing:
                assert home is not None
                return home
            if self._telemetry.now_s > deadline_s and time.monotonic() > wall_s:
                raise InputError("not ready, " + "; ".join(map(str, missing)) + ".")

    async def _engage(self, loop: ControlLoop, performer: Performer, plane: LocalPlane, home: Home) -> None:
        """Bring the aircraft onto a circle of ours, and engage."""
        position = self._vehicle.latest["GLOBAL_POSITION_INT"].fields
        armed = bool(self._vehicle.latest["HEARTBEAT"].fields["base_mode"] & _mav.MAV_MODE_FLAG_SAFETY_ARMED)
        flying = armed and position["relative_alt"] * 1e-3 > _FLYING_HEIGHT_M
        circle = self._first_circle(plane, home, flying)
        broken = self._watch.check(Plan(circle))
        if broken is not None:
            raise InputError(f"the first circle cannot be flown: {broken}; change the fences or where it begins.")
        line = performer.line(Plan(circle))
        result = await performer.load(line, () if flying else (self._take_off_item(home),))
        if result is not UploadResult.ACCEPTED:
            raise FlightError(f"the first mission was not taken ({result}); nothing was armed.")
        if flying:
            self._display.note("already flying: taking over from where it is")
            await self._in_mission_mode()
            await self._autopilot.select(self._vehicle, performer.line_first)
        else:
            await self._arm()
            try:
                await self._in_mission_mode()
            except FlightError:
                await self._autopilot.disarm(self._vehicle)  # still on the ground; refused if it is not
                raise
            self._display.note("taking off")
        await self._until_circling(performer.line_first)
        self._start_s = self._telemetry.now_s
        self._display.engage(self._start_s, self._duration_s)
        loop.put(Engaged(self._start_s, circle, self._autopilot.mission_mode))
        self._display.note("circling: the target is watched from now on")

    def _first_circle(self, plane: LocalPlane, home: Home, flying: bool) -> Circle:
        radius_m = self._config.aircraft.radius_m
        clockwise = self._config.requirement.requirement().side.clockwise
        if not flying:
            return Circle(*plane.east_north_m(home.latitude_deg, home.longitude_deg), radius_m, clockwise)
        fields = self._vehicle.latest["GLOBAL_POSITION_INT"].fields
        east_m, north_m = plane.east_north_m(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
        return Circle.tangent_to(east_m, north_m, math.atan2(fields["vy"], fields["vx"]), radius_m, clockwise)

    def _take_off_item(self, home: Home) -> RawItem:
        return RawItem(
            _mav.MAV_CMD_NAV_TAKEOFF,
            _mav.MAV_FRAME_GLOBAL_RELATIVE_ALT,
            15.0,
            0.0,
            0.0,
            math.nan,
            round(home.latitude_deg * 1e7),
            round(home.longitude_deg * 1e7),
            min(_FLYING_HEIGHT_M * 2.0, self._config.aircraft.height_m),
        )

    async def _arm(self) -> None:
        self._display.note("arming")
        deadline_s = self._telemetry.now_s + _ARM_WITHIN_S
        while not (answer := await self._autopilot.arm(self._vehicle)).accepted:
            if self._telemetry.now_s > deadline_s:
                raise FlightError(f"the autopilot does not arm ({answer}){self._last_words()}.")
            await asyncio.sleep(_ARM_EVERY_S / (self._config.simulation.speed if self._simulated else 1.0))

    async def _in_mission_mode(self) -> None:
        answer = await self._autopilot.start_mission(self._vehicle)
        # An accepted command proves nothing: PX4 accepts, and stays in HOLD with a mission it does not like.
        if not answer.accepted or not await self._mode_is(self._autopilot.mission_mode):
            raise FlightError(f"the mission was not started ({answer}){self._last_words()}.")

    async def _mode_is(self, mode: str) -> bool:
        deadline_s = time.monotonic() + _MODE_WITHIN_S
        while mode_of(self._vehicle) != mode:
            if time.monotonic() > deadline_s:
                return False
            await asyncio.sleep(_POLL_S)
        return True

    async def _until_circling(self, first: int) -> None:
        deadline_s, wall_s = self._telemetry.now_s + _TAKE_OFF_WITHIN_S, time.monotonic() + _TAKE_OFF_WITHIN_S
        while not self._circling(first):
            if self._telemetry.now_s > deadline_s or time.monotonic() > wall_s:
                raise FlightError(f"the first circle was not reached{self._last_words()}.")
            await asyncio.sleep(_POLL_S)

    def _circling(self, first: int) -> bool:
        latest = self._vehicle.latest
        height_m = latest["GLOBAL_POSITION_INT"].fields["relative_alt"] * 1e-3
        at_item = "MISSION_CURRENT" in latest and latest["MISSION_CURRENT"].fields["seq"] >= first
        return at_item and height_m > _HIGH_ENOUGH * self._config.aircraft.height_m

    async def _until_over(self) -> None:
        while self._duration_s is None or self._telemetry.now_s < self._start_s + self._duration_s:
            await asyncio.sleep(_POLL_S)

    def _last_words(self) -> str:
        said = self._vehicle.latest.get("STATUSTEXT")
        return f": {said.fields['text']}" if said is not None else ""

    @property
    def _simulated(self) -> bool:
        return self._config.link.url is None

    def _summary(self, outcome: str, plane: LocalPlane, truth: Path | None) -> Summary:
        tracker = self._watch.tracker
        return summarise(
            self._gatherer,
            self._watch.snapshot(),
            truth=read_truth(truth) if truth is not None and truth.exists() else None,
            plane=plane,
            start_s=self._start_s,
            sightings=tracker.sightings,
            rejected=tracker.rejected,
            outcome=outcome,
        )


class _Observed:
    """All who watch, as one display; also gathers what the summary needs."""

    def __init__(self, displays: Sequence[Display], gatherer: Gatherer) -> None:
        self._displays, self._gatherer = displays, gatherer

    def say(self, announcement: Announce) -> None:
        for display in self._displays:
            display.say(announcement)

    def show(self, snapshot: Snapshot) -> None:
        self._gatherer.observe(snapshot)
        for display in self._displays:
            display.show(snapshot)
