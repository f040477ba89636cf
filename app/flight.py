"""One flight from the first heartbeat to the summary: connect, check, take off, watch, wind up."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import AsyncIterator, Awaitable, Sequence
from dataclasses import dataclass
from pathlib import Path

from app.assembly import fence_check
from app.autopilot import Autopilot, Home
from app.command_guidance import CommandGuidance
from app.config import Config
from app.cot import CotOutput
from app.display import FlightDisplay
from app.ending import ends_within
from app.engaging import Engaging
from app.errors import InputError
from app.guidance import Guidance
from app.loop import ControlLoop, Display
from app.mavsdk_link import FrameListener, MavsdkLink
from app.mission_guidance import MissionGuidance
from app.parameters import Need, borrowed, read_parameters
from app.performer import Performer
from app.point_gimbal import GimbalPointer
from app.preflight import ask_for_streams, autopilot_of, checks, home_of, is_flying, listen
from app.recording import Recording
from app.records.truth import read_truth
from app.summary import Gatherer, Summary, summarise
from app.telemetry import Telemetry
from app.vehicle import Vehicle
from mission.events import Announce, Engaged, Event
from mission.watch import Phase, Snapshot, Watch

_CLOSE_S = 30.0
_LISTEN_S = 1.0
_POLL_S = 0.1
_READY_WITHIN_S = 60.0  # of the vehicle's time
_READY_WALL_S = 20.0  # a fast simulation's minute is over before every question is answered


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
        with ends_within(_CLOSE_S, "closing the link"):
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

    async def fly(self, stopped: asyncio.Event) -> str:
        """Check, take off if need be, watch for the duration or until ``stopped`` is set; return the outcome."""
        self._vehicle.listeners.append(self._telemetry.event)  # the clock and the plane, from the start
        await ask_for_streams(self._vehicle)
        home, needs = await self._check()
        self._vehicle.listeners.remove(self._telemetry.event)
        wanted = needs if self._config.link.set_parameters else ()
        async with borrowed(
            self._vehicle, wanted, self._display.note, lambda: self._watch.phase is not Phase.YIELDED
        ):
            return await self._watched(home, stopped)

    async def _watched(self, home: Home, stopped: asyncio.Event) -> str:
        plane = self._telemetry.plane
        assert plane is not None  # the position check has passed
        self._watch.check = fence_check(self._config, plane)
        self._recording.begin(plane)
        queue: asyncio.Queue[Event | None] = asyncio.Queue()
        missions = MissionGuidance(
            self._vehicle,
            self._autopilot,
            plane,
            home,
            airspeed_m_s=self._config.aircraft.airspeed_m_s,
            height_m=self._config.aircraft.height_m,
            tolerance_m=self._config.planner.tolerance_m,
            now_s=lambda: self._telemetry.now_s,
        )
        commands = CommandGuidance(
            self._vehicle,
            self._autopilot,
            plane,
            home,
            height_m=self._config.aircraft.height_m,
            bank_max_rad=math.radians(self._config.aircraft.bank_max_deg),
            aircraft=lambda: self._watch.snapshot().aircraft,
        )
        guidance: Guidance = missions if self._config.planner.guidance == "mission" else commands
        performer = Performer(
            self._vehicle, self._autopilot, guidance, queue.put_nowait, lambda: self._telemetry.now_s
        )
        engaging = Engaging(
            self._vehicle,
            self._autopilot,
            self._telemetry,
            self._config,
            plane,
            home,
            self._watch.check,
            self._display.note,
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
        flying = asyncio.create_task(self._fly(loop, engaging.engage(missions, commands)))
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
        return loop.outcome or ("interrupted" if stopped.is_set() else "completed")

    async def _fly(self, loop: ControlLoop, engaging: Awaitable[Engaged]) -> None:
        engaged = await engaging
        self._start_s = engaged.time_s
        self._display.engage(self._start_s, self._duration_s)
        loop.put(engaged)
        self._display.note("circling: the target is watched from now on")
        await self._until_over()

    async def _check(self) -> tuple[Home, tuple[Need, ...]]:
        self._display.note("checking the vehicle and its sensors")
        values = await read_parameters(self._vehicle, self._autopilot.meanings)
        limits = self._autopilot.limits(values)
        needs = self._autopilot.needs(values, self._config.aircraft.airspeed_m_s)
        deadline_s, wall_s = self._telemetry.now_s + _READY_WITHIN_S, time.monotonic() + _READY_WALL_S
        while True:
            rates = await listen(self._vehicle, _LISTEN_S)
            home = await home_of(self._vehicle)
            unmet = () if self._config.link.set_parameters else needs
            found = checks(self._config, self._vehicle, limits, home, rates, unmet)
            flying = is_flying(self._vehicle)
            missing = [check for check in found if not (check.ready or (flying and check.before_take_off))]
            if not missing:
                assert home is not None
                return home, needs
            if self._telemetry.now_s > deadline_s and time.monotonic() > wall_s:
                raise InputError("not ready, " + "; ".join(map(str, missing)) + ".")

    async def _until_over(self) -> None:
        while self._duration_s is None or self._telemetry.now_s < self._start_s + self._duration_s:
            await asyncio.sleep(_POLL_S)

    def summary(self, outcome: str, truth: Path | None) -> Summary:
        """Return the summary, judged by a truth file once that is whole."""
        tracker = self._watch.tracker
        return summarise(
            self._gatherer,
            self._watch.snapshot(),
            truth=read_truth(truth) if truth is not None and truth.exists() else None,
            plane=self._telemetry.plane,
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
