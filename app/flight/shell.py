"""The shell of a flight of one or several aircraft: connect, check, take off, watch, shut down, summarise.

If one aircraft is not ready, all are given up; where others fly already, it is left out. If one fails later, the
others go on. Aircraft on the ground take off one after the other, the highest layer first: none climbs through
another's. A reserve waits until the coordinator wants it.

What ends a flight early, and what is reported:

| | nothing commanded yet | flying to the first circle, or tracking | shutting down |
| --- | --- | --- | --- |
| INT, TERM, HUP | aborted at once | shut down, exit code 130 | asked to wait, with a time limit; then ignored |
| the simulated vehicle ends | failed, exit code 1 | shut down, exit code 1 | ignored |
| first circle unreachable, or internal error | failed, exit code 1 | shut down, exit code 1 | exit code 1 |
| output cannot be written | refused for a record, exit code 2 | reported; the flight continues | reported |

Shut down means: no further plan is sent, changed parameters are restored, records are closed and the summary is
printed. The aircraft stays on its circle, which needs no companion computer. Records are deleted only if the vehicle
was never armed.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import signal
import socket
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Literal, Protocol

from sidelong.app.analysis.score import Asked
from sidelong.app.analysis.summary import FleetSummary, FlownAircraft, MissionTrack, Summary, summarise_fleet
from sidelong.app.analysis.truth import truth_if_whole
from sidelong.app.assembly import Prepared
from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.config import Config
from sidelong.app.errors import FlightError, InputError, Interrupted
from sidelong.app.flight.flight import CameraPlaces, Flight
from sidelong.app.flight.loop import FlightDisplay, Stepped
from sidelong.app.flight.payload_input import payload_input
from sidelong.app.flight.recording import ClockRate, Recording, link_log
from sidelong.app.flight.session import Session, connected
from sidelong.app.link.frames import Frame
from sidelong.app.link.mavsdk_link import OWN_SYSTEM_ID, SETTLING_S
from sidelong.app.link.message import Message
from sidelong.app.link.raw_links import opened_url
from sidelong.app.link.signing import key_in_use, signing_time
from sidelong.app.link.telemetry import ARMED_FLAG, AUTOPILOT_COMPONENT
from sidelong.app.link.transport import sharing_opener
from sidelong.app.link.vehicle import Vehicle, is_flying, mode_of
from sidelong.app.payload.registry import MAVLINK, kind_by_name
from sidelong.app.process import ends_within, helper_command, helper_environment
from sidelong.app.records.run_folder import FleetFolder, RunFolder
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.present import Phase, Present
from sidelong.sitl import settings as sitl
from sidelong.sitl.world.airframe import WindVector
from sidelong.sitl.world.turbulence import Level

_READY_S = 30.0
_STOP_S = 5.0
_PACE_S = 0.01


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class SimulatedVehicles:
    """Starts ``python -m sitl`` for one configuration or several, and stops it. Use as ``async with``.

    truths: one file per vehicle. ``urls`` are the vehicles'; their system ids count from 1. Shared settings, such as
    the wind, are the first one's. on_end: receives a sentence if they end early. targets: instead of the configured
    one; looks_at: which of them each payload sees first, from 0.
    """

    def __init__(
        self,
        configs: Sequence[Config],
        truths: Sequence[Path | None],
        on_end: Callable[[str], object],
        targets: Sequence[sitl.TargetSettings] = (),
        looks_at: Sequence[int] = (),
    ) -> None:
        first, simulation = configs[0], configs[0].simulation
        ports = [free_udp_port() for _ in configs]
        self.urls = tuple(f"udpin://127.0.0.1:{port}" for port in ports)
        self.payload_url: str | None = None
        self.video_url: str | None = None
        device, camera = "", None
        if first.camera.source is not None:
            self.video_url = f"udp://127.0.0.1:{free_udp_port()}"
            camera = sitl.CameraSettings(self.video_url, view_deg=first.camera.view_deg, rate_hz=first.camera.rate_hz)
        if first.payload.kind != MAVLINK:
            payload_port = free_udp_port()
            scheme = kind_by_name(first.payload.kind).url.partition(":")[0]
            self.payload_url = f"{scheme}://127.0.0.1:{payload_port}"
            device = f"{first.payload.kind}@127.0.0.1:{payload_port}"
        speed_max_m_s = first.requirement.target_speed_max_m_s
        payload = sitl.PayloadSettings(
            dropout_fraction=sitl.PayloadSettings().dropout_fraction if simulation.laser else 1.0,
            pan_limit_deg=math.degrees(first.aircraft.aircraft().pan_limit_rad),
        )
        common = sitl.Settings(
            flavour=sitl.Flavour(simulation.autopilot),
            seed=simulation.seed,
            wind=WindVector.blowing_from(simulation.wind_speed_m_s, math.radians(simulation.wind_from_deg)),
            turbulence=Level(simulation.turbulence),
            home=None if simulation.home is None else sitl.HomePosition(*simulation.home),
            home_on_ground=True,
            targets=tuple(replace(target, speed_max_m_s=speed_max_m_s) for target in targets)
            or (sitl.TargetSettings(simulation.target, speed_max_m_s),),
            payload=payload,
            device=device,
            camera=camera,
            terrain=None if first.terrain.folder is None else Path(first.terrain.folder),
        )
        count = len(configs)
        own = ports, truths or [None] * count, looks_at or [0] * count
        vehicles = tuple(
            replace(
                vehicle,
                flavour=sitl.Flavour(config.simulation.autopilot),
                airspeed_m_s=config.aircraft.airspeed_m_s,
                stations=(f"127.0.0.1:{port}",),
                truth=truth,
                looks_at=seen,
            )
            for vehicle, config, port, truth, seen in zip(sitl.in_a_row(common, count), configs, *own, strict=True)
        )
        self.settings = sitl.RunSettings(vehicles, simulation.speed, signing_key_file=first.link.signing_key_file)
        self._what = "the simulated vehicle" if len(configs) == 1 else "the simulation of the vehicles"
        self._on_end = on_end
        self._process: asyncio.subprocess.Process
        self._vigil: asyncio.Task[None]

    async def __aenter__(self) -> SimulatedVehicles:
        # A session of its own keeps the terminal's Ctrl-C from ending it before the mission has been wound up.
        self._process = await asyncio.create_subprocess_exec(
            *helper_command("sidelong.sitl", "--settings", "-"),
            env=helper_environment(),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        # It ends with this input, so that it does not outlive this program, however that ends.
        self._process.stdin.write(self.settings.to_json() + b"\n")
        try:
            line = await asyncio.wait_for(self._process.stdout.readline(), _READY_S)
        except TimeoutError as error:
            await self._stop()
            raise FlightError(f"{self._what} was not ready within {_READY_S:g} s.") from error
        except asyncio.CancelledError:
            await self._stop()
            raise
        if not line.startswith(b"ready"):
            raise InputError(await self.ended())  # asyncio has words for a process that ends after its loop
        self._vigil = asyncio.create_task(self._keep_vigil())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._vigil.cancel()
        await asyncio.gather(self._vigil, return_exceptions=True)
        await self._stop()

    async def keep_pace(self, time_s: Callable[[], float]) -> None:
        """Let the simulation wait for the controlling program if that falls behind.

        time_s: simulation time the program has processed, inf if not known. A program that no longer flies sends
        nothing, and the simulation does not wait for it.
        """
        assert self._process.stdin is not None
        announced_s = -math.inf
        with contextlib.suppress(ConnectionError):
            while True:
                await asyncio.sleep(_PACE_S)
                now_s = time_s()
                if announced_s < now_s < math.inf:
                    announced_s = now_s
                    self._process.stdin.write(f"{now_s:.3f}\n".encode())
                    await self._process.stdin.drain()

    async def _keep_vigil(self) -> None:
        why = await self.ended()
        self._on_end(f"{self._what} has ended: {why.rstrip('.')}; nothing flies any more.")

    async def ended(self) -> str:
        """Wait until the simulator ends; return its last words."""
        await self._process.wait()
        assert self._process.stderr is not None
        text = (await self._process.stderr.read()).decode(errors="replace").strip()
        return text.splitlines()[-1] if text else f"it stopped with code {self._process.returncode}."

    async def _stop(self) -> None:
        process = self._process
        if process.returncode is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        try:
            await asyncio.wait_for(process.wait(), _STOP_S)
        except TimeoutError:
            process.kill()
            await process.wait()


_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_WIND_UP_S = 60.0  # the bounds of what is done after an interrupt are together below this


class Life:
    """Life cycle of one flight. ``begun``: returns whether a command may have been sent to the vehicle.

    stopped is set when the flight must shut down. signal_name or failure gives the reason; at most one is set.
    """

    def __init__(self, begun: Callable[[], bool], note: Callable[[str], object]) -> None:
        self.stopped = asyncio.Event()
        self.signal_name: str | None = None
        self.failure: str | None = None
        self.was_armed = False
        self._begun, self._note = begun, note
        self._task = asyncio.current_task()
        self._at_once = self._broken_off = False
        self._winding_up = contextlib.ExitStack()

    @contextlib.contextmanager
    def handling_signals(self) -> Iterator[None]:
        """Handle signals according to the table above.

        asyncio's own handler loses a signal when the loop is so late that its wake-up socket is full.
        """
        loop = asyncio.get_running_loop()

        def handle(number: int, _frame: object) -> None:
            if self._at_once:
                self._broken_off = True
                raise KeyboardInterrupt
            loop.call_soon_threadsafe(self._signalled, number)

        heeded = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
        with self._winding_up:
            for number in heeded:
                signal.signal(number, handle)
            try:
                yield
            finally:
                for number in heeded:
                    signal.signal(number, self._signalled_late)

    def _signalled_late(self, _number: int, _frame: object) -> None:
        """Let the records of a flight be completed, and its summary be written: that takes a moment."""
        if not self._begun():
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def computing(self) -> Iterator[None]:
        """Let a signal abort the work in this context at once: the event loop is blocked, nothing is commanded."""
        self._at_once = True
        try:
            yield
        except Exception as error:
            if self._broken_off:  # an interrupted library may raise its own error
                raise KeyboardInterrupt from error
            raise
        finally:
            self._at_once = False

    def watch(self, vehicle: Vehicle) -> None:
        """Note from the vehicle's heartbeats whether this flight has armed it."""

        def on_message(message: Message) -> None:
            if message.name == "HEARTBEAT" and message.component_id == AUTOPILOT_COMPONENT:
                self.was_armed |= self._begun() and bool(int(message.fields["base_mode"]) & ARMED_FLAG)

        vehicle.listeners.append(on_message)

    def fail(self, reason: str) -> None:
        """End the flight for a reason that leaves no way on."""
        if not self._ending:
            self.failure = reason
            self._end()

    @property
    def _ending(self) -> bool:
        return self.signal_name is not None or self.failure is not None

    def _signalled(self, number: int) -> None:
        if self._ending:
            self._note(f"{signal.Signals(number).name}: shutting down already; that takes {_WIND_UP_S:.0f} s at most")
            return
        self.signal_name = signal.Signals(number).name
        self._note(f"{self.signal_name}: shutting down")
        self._end()

    def _end(self) -> None:
        self.stopped.set()
        self._winding_up.enter_context(ends_within(_WIND_UP_S, "shutting down"))
        if not self._begun() and self._task is not None:
            self._task.cancel()  # there is nothing to wind up


def describe_aircraft(
    vehicle: Vehicle, autopilot: Autopilot, snapshot: Present, *, loaded: bool, simulated: bool
) -> str:
    """Return what the aircraft does now that this program leaves off, as the end of a sentence."""
    mode, waits = mode_of(vehicle), snapshot.phase is Phase.WAITING
    if not int(vehicle.latest["HEARTBEAT"].fields["base_mode"]) & ARMED_FLAG:
        does = "the aircraft is not armed"
    elif snapshot.phase is Phase.YIELDED:
        does = "a pilot or another station flies the aircraft"
    elif mode not in (autopilot.mission_mode, autopilot.circle_mode) or (waits and not loaded):
        flies = is_flying(vehicle)
        does = f"the aircraft flies on in {mode}" if flies else f"the aircraft is armed on the ground in {mode}"
    elif waits:
        does = "the aircraft flies to its first circle and stays on it"
    else:
        does = "the aircraft goes on circling where it is"
    if simulated:
        return f"{does}, but it was simulated and ends with this program"
    return does if snapshot.connected else f"by its last message, {does}"


_POLL_S = 0.1
_SAME_CLOCK_S, _SAME_PLACE_M = 5.0, 10.0  # of one vehicle by two links, one of which may be slow
_FLEET_WITHIN_M = 100_000.0


@dataclass(eq=False)
class FlyingAircraft:
    config: Config  # its configuration; without link URLs a vehicle is simulated
    folder: RunFolder  # its run folder
    recording: Recording  # its records
    display: FlightDisplay  # shows the flight, and passes the operator's requests
    trouble: Callable[[str], None]  # displays a problem, from any thread
    prepare: Callable[[], Prepared]  # returns what the control step is made of; it may compute for seconds
    name: str = ""  # its name; '' where it is the only one
    reserve: bool = False  # whether it waits on the ground until the fleet needs it
    session: Session = None  # type: ignore[assignment]  # a given one stays open, and has its frames recorded
    wanted: asyncio.Event = field(default_factory=asyncio.Event)  # set once it has to be in the air
    outcome: str = ""  # how its flight ended; '' until then
    error: Exception | None = None  # what its flight failed with
    flight: Flight = None  # type: ignore[assignment]  # until it is connected
    links: tuple[dict[str, Any], ...] = ()

    def __post_init__(self) -> None:
        if not self.reserve:
            self.wanted.set()
        self.clock_rate = ClockRate(lambda: self.session.telemetry.now_s)

    def own_frame(self, data: bytes) -> None:
        """Record a frame of a shared link, from any thread, unless it is of another aircraft of the flight."""
        if Frame(data).system_id in (self.config.link.system_id, OWN_SYSTEM_ID):
            self.recording.frame(data)

    @property
    def controller(self) -> StandoffController:
        return self.flight.controller

    @property
    def is_received(self) -> bool:
        """Whether messages of the vehicle arrive."""
        return self.controller.snapshot().connected

    @property
    def settled(self) -> bool:
        """Whether it is settled: sidelong controls it, its flight is over, or the fleet does not need it yet."""
        return self.controller.phase.in_control or bool(self.outcome) or not self.wanted.is_set()

    def failed(self, error: Exception) -> None:
        """Note the error that ended its flight, and the outcome in words."""
        known = isinstance(error, FlightError | InputError)
        self.error, self.outcome = error, f"failed: {error if known else f'a fault of the program, {error!r}'}"


@dataclass(frozen=True, slots=True)
class FlightEnded:
    folder: RunFolder | FleetFolder  # where its records are
    summary: Summary | FleetSummary  # what was flown
    reason: Exception | None  # the error to report and to exit with, None after a regular end
    aircraft: str = ""  # what each aircraft does now, as the end of a sentence

    @property
    def is_internal(self) -> bool:
        """Whether a fault of the program ended it."""
        return self.reason is not None and not isinstance(self.reason, FlightError | InputError | Interrupted)


class Coordinator(Protocol):
    """What several aircraft have in common: see :class:`sidelong.app.fleet.flight.FleetFlight`."""

    folder: FleetFolder  # the folder of the whole run
    targets: tuple[list[sitl.TargetSettings], list[int]]
    over: asyncio.Event  # set when the flight of all is over

    @property
    def now_s(self) -> float: ...  # mission time; -inf before the first clock is known
    def prepare(self) -> None: ...  # may compute for some seconds
    def coordinated(self, aircraft: list[FlyingAircraft]) -> contextlib.AbstractAsyncContextManager[None]: ...
    def stepped(self, craft: FlyingAircraft) -> Stepped:
        """Return what to call after each step of an aircraft's core."""

    def lost(self, craft: FlyingAircraft) -> None: ...  # its flight is over
    def flown(self, craft: FlyingAircraft) -> tuple[float, MissionTrack]:
        """Return the mission time less the time of the aircraft, s, and its track."""

    def asked(self) -> dict[str, Asked]:
        """Return by target the requirements, each with the mission time from which it holds."""


@dataclass(eq=False)
class Shell:
    """Flies one aircraft, or several with a coordinator."""

    _aircraft: list[FlyingAircraft]
    _duration_s: float | None  # how long to watch, of the vehicle's clock; None: until it is stopped
    _life: Life  # ends the flight early
    _note: Callable[[str], None]  # displays a text about all aircraft
    _coordinator: Coordinator | None = None
    _simulated: SimulatedVehicles | None = None

    async def fly(self) -> FlightEnded:
        """Fly to the end and return how it ended. Raises what happens before an aircraft was armed."""
        coordinator = self._coordinator
        async with contextlib.AsyncExitStack() as stack:
            with self._life.computing():
                prepared = [craft.prepare() for craft in self._aircraft]
                if coordinator is not None:
                    coordinator.prepare()
            await self._connect(stack, prepared)
            await self._prepare()
            try:
                if coordinator is None:
                    await self._fly_one(self._aircraft[0])
                else:
                    async with coordinator.coordinated(self._aircraft):
                        await self._fly_in_turn(coordinator)
            finally:
                described = self._described()
        # Only now, with the simulated vehicles ended, are their truth files whole.
        reason = self._reason(described)
        folder = self._aircraft[0].folder if coordinator is None else coordinator.folder
        return FlightEnded(folder, self._summary(), reason, described)

    # -- before the flight ---------------------------------------------------------------------------------

    async def _links(self, stack: contextlib.AsyncExitStack) -> list[tuple[str, ...]]:
        """Return each aircraft's links; those of simulated vehicles are started."""
        configs = [craft.config for craft in self._aircraft]
        if configs[0].link.connections:
            return [config.link.connections for config in configs]
        targets, looks_at = ([], []) if self._coordinator is None else self._coordinator.targets
        about = ", ".join(target.name for target in targets) or "its target"
        kinds = ", ".join(config.simulation.autopilot for config in configs)
        self._note(f"starting the simulation: {kinds}, about {about}")
        truths = [craft.folder.truth for craft in self._aircraft]
        vehicles = self._simulated = SimulatedVehicles(configs, truths, self._life.fail, targets, looks_at)
        await stack.enter_async_context(vehicles)
        pace = asyncio.create_task(vehicles.keep_pace(self._processed_to_s))
        stack.callback(pace.cancel)
        return [(url,) for url in vehicles.urls]

    def _processed_to_s(self) -> float:
        """Return the time of the simulation that all aircraft have reached that are received and still fly."""
        alone = len(self._aircraft) == 1
        flying = [craft for craft in self._aircraft if craft.flight is not None and not craft.outcome]
        return min((craft.flight.processed_to_s for craft in flying if alone or craft.is_received), default=math.inf)

    async def _connect(self, stack: contextlib.AsyncExitStack, prepared: Sequence[Prepared]) -> None:
        urls = await self._links(stack)
        shared = [any(sum(url in others for others in urls) > 1 for url in own) for own in urls]
        opener, key, file = sharing_opener(urls, opened_url), None, self._aircraft[0].config.link.signing_key_file
        if file is not None and len(urls) > 1:
            key = stack.enter_context(key_in_use(file, signing_time(time.time()), self._aircraft[0].trouble))

        async def join(craft: FlyingAircraft, own: tuple[str, ...], is_shared: bool, control: Prepared) -> None:
            link, simulated = craft.config.link, self._simulated is not None
            if craft.session is None:
                craft.display.note(f"connecting to {' and '.join(own)}")
                role = link.role or ("ground" if self._coordinator or simulated else None)
                system_id = None if simulated else link.system_id
                craft.session = await stack.enter_async_context(
                    connected(
                        link.model_copy(update={"urls": [*own], "system_id": system_id, "role": role}),
                        craft.trouble,
                        craft.own_frame if is_shared else craft.recording.frame,
                        key.apart() if key is not None and is_shared else key,
                        0.0 if simulated else SETTLING_S,
                        opener if is_shared else opened_url,
                    )
                )
            await self._joined(stack, craft, control)

        joins = (join(*each) for each in zip(self._aircraft, urls, shared, prepared, strict=True))
        self._go_on_with(await asyncio.gather(*joins, return_exceptions=True))

    async def _joined(self, stack: contextlib.AsyncExitStack, craft: FlyingAircraft, prepared: Prepared) -> None:
        session, vehicle = craft.session, craft.session.vehicle
        await stack.enter_async_context(session.for_a_flight())
        craft.display.note(f"connected to {session.autopilot.name}, system {vehicle.system_id}")
        craft.recording.follow(vehicle.system_id)
        url = None if self._simulated is None else self._simulated.payload_url
        payload = await stack.enter_async_context(
            payload_input(craft.config, vehicle, craft.display.note, craft.recording.frame, url)
        )
        self._life.watch(vehicle)
        turns_payload = self._coordinator is not None and len(self._coordinator.targets[0]) > 1
        film = CameraPlaces(None if self._simulated is None else self._simulated.video_url, craft.folder.video)
        craft.flight = Flight(
            session,
            craft.config,
            prepared,
            craft.recording,
            craft.display,
            self._duration_s,
            turns_payload,
            payload,
            film,
        )
        await stack.enter_async_context(link_log(vehicle.link, craft.folder.links, craft.clock_rate, craft.trouble))

    async def _prepare(self) -> None:
        prepare = (craft.flight.prepare() for craft in self._aircraft)
        self._go_on_with(await asyncio.gather(*prepare, return_exceptions=True))
        check_apart(self._aircraft)
        for craft in self._aircraft[1:]:
            craft.flight.share_plane(self._aircraft[0].flight.plane)

    def _go_on_with(self, done: Sequence[BaseException | None]) -> None:
        """Continue with the aircraft that are ready, if that may be, else raise an error. done: each one's error."""
        pairs = list(zip(self._aircraft, done, strict=True))
        ready = [craft for craft, error in pairs if error is None]
        for craft, error in pairs:
            if isinstance(error, InputError) and len(pairs) > 1:
                if not any(is_flying(other.session.vehicle) for other in ready):
                    raise InputError(f"aircraft {craft.name!r}: {error}") from error
                craft.display.note(f"left out: {error}")
            elif isinstance(error, FlightError) and len(pairs) == 1 and craft.flight is not None:
                craft.failed(error)
                ready = [craft]
            elif error is not None:
                raise error
        self._aircraft = ready

    # -- in flight -----------------------------------------------------------------------------------------

    async def _fly_in_turn(self, coordinator: Coordinator) -> None:
        over, stopped = coordinator.over, self._life.stopped
        flights: list[asyncio.Task[None]] = []
        clock = asyncio.create_task(self._until_over(coordinator))
        for craft in self._aircraft:
            if is_flying(craft.session.vehicle):
                craft.wanted.set()
        # Those in the air, then the rest from the highest layer down.
        order = [(not is_flying(craft.session.vehicle), -craft.config.aircraft.height_m) for craft in self._aircraft]
        try:
            for _, craft in sorted(zip(order, self._aircraft, strict=True), key=lambda pair: pair[0]):
                flights.append(asyncio.create_task(self._fly_one(craft)))
                while not (craft.settled or stopped.is_set()):
                    await asyncio.sleep(_POLL_S)
            await asyncio.gather(*flights)
        finally:
            over.set()
            clock.cancel()
            await asyncio.gather(*flights, clock, return_exceptions=True)

    async def _fly_one(self, craft: FlyingAircraft) -> None:
        """Fly one aircraft; a reserve starts when the fleet needs it."""
        if craft.outcome:
            return
        coordinator, stopped = self._coordinator, self._life.stopped
        if coordinator is not None:
            waits = [asyncio.create_task(event.wait()) for event in (craft.wanted, stopped, coordinator.over)]
            await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
            for wait in waits:
                wait.cancel()
            if stopped.is_set() or coordinator.over.is_set():
                craft.outcome = "not flown"
                return
        try:
            if coordinator is None:
                craft.outcome = await craft.flight.watch(stopped)
                return
            craft.outcome = await craft.flight.watch(stopped, coordinator.stepped(craft), coordinator.over)
            if not craft.is_received:
                craft.outcome = "lost: its link is silent"
        except Exception as error:  # whatever befalls one, the others go on
            craft.failed(error)
            if coordinator is not None:
                craft.display.note(f"its flight has {craft.outcome}")
        if coordinator is not None:
            coordinator.lost(craft)

    async def _until_over(self, coordinator: Coordinator) -> None:
        """End the flight when the duration is over, which runs from when all that fly are on their circles."""
        start_s, duration_s = math.inf, math.inf if self._duration_s is None else self._duration_s
        while coordinator.now_s < start_s + duration_s:
            await asyncio.sleep(_POLL_S)
            clock_known = math.isfinite(coordinator.now_s)
            if start_s == math.inf and clock_known and all(craft.settled for craft in self._aircraft):
                start_s = coordinator.now_s
        coordinator.over.set()

    # -- after the flight ----------------------------------------------------------------------------------

    def _described(self) -> str:
        """Return what each aircraft does now, and take the measures of its links."""
        described = []
        for craft in self._aircraft:
            vehicle, simulated = craft.session.vehicle, self._simulated is not None
            craft.links = tuple(report.as_json(craft.clock_rate.mean) for report in vehicle.link.reports())
            autopilot, present, loaded = craft.session.autopilot, craft.controller.snapshot(), craft.flight.loaded
            does = describe_aircraft(vehicle, autopilot, present, loaded=loaded, simulated=simulated)
            described.append(f"{craft.name}: {does}" if craft.name else does)
        return "; ".join(described)

    def _summary(self) -> Summary | FleetSummary:
        ended = "" if self._life.failure is None else f"failed: {self._life.failure}"
        truths, summaries = [], []
        for craft in self._aircraft:
            path = None if self._simulated is None else craft.folder.truth
            truths.append(truth_if_whole(path, craft.controller.time_s, craft.display.note))
            summary = craft.flight.summary(ended or craft.outcome, truths[-1])
            summaries.append(replace(summary, links=craft.links, records_lost=craft.recording.lost))
        if self._coordinator is None:
            return summaries[0]
        for craft, summary in zip(self._aircraft, summaries, strict=True):
            with contextlib.suppress(OSError):  # the fleet's holds the same
                craft.folder.write_summary(summary.as_json())
        flown = [
            FlownAircraft(craft.name, summary, craft.flight.moments(truth), *self._coordinator.flown(craft))
            for craft, summary, truth in zip(self._aircraft, summaries, truths, strict=True)
        ]
        outcomes = {craft.outcome for craft in self._aircraft}
        outcome = ended or next((end for end in ("completed", "interrupted") if end in outcomes), "; ".join(outcomes))
        source: Literal["truth", "estimate"] = "estimate" if None in truths else "truth"
        return summarise_fleet(flown, self._coordinator.asked(), outcome, source)

    def _reason(self, described: str) -> Exception | None:
        """Return the error to report. Raises what happened before an aircraft was armed."""
        life, errors = self._life, {craft.name: craft.error for craft in self._aircraft if craft.error is not None}
        if len(errors) == len(self._aircraft) == 1:
            (error,) = errors.values()
            if not (life.was_armed or isinstance(error, FlightError)):
                raise error
        if life.failure is not None:
            return FlightError(life.failure)
        if life.signal_name is not None:
            return Interrupted(f"interrupted by {life.signal_name}: {described}.")
        if len(errors) < len(self._aircraft):
            return None
        reasons = " ".join(f"{name}: {error}" if name else str(error) for name, error in errors.items())
        known = [error for error in errors.values() if isinstance(error, FlightError | InputError)]
        if not life.was_armed and all(isinstance(error, InputError) for error in errors.values()):
            return InputError(reasons)
        return FlightError(f"{reasons} Now {described}.") if known or len(errors) > 1 else next(iter(errors.values()))


def check_apart(aircraft: Iterable[FlyingAircraft]) -> None:
    """Raise InputError where two links lead to one vehicle, or two aircraft are too far apart for one flight."""
    for craft, other in combinations(aircraft, 2):
        vehicles = craft.session.vehicle, other.session.vehicle
        a, b = (vehicle.latest["GLOBAL_POSITION_INT"].fields for vehicle in vehicles)
        place = LocalPlane(a["lat"] * 1e-7, a["lon"] * 1e-7)
        apart_m = math.hypot(*place.east_north_m(b["lat"] * 1e-7, b["lon"] * 1e-7))
        passed_s = abs(a["time_boot_ms"] - b["time_boot_ms"]) * 1e-3
        flown_m = math.hypot(a["vx"], a["vy"]) * 1e-2 * passed_s
        same_id = vehicles[0].system_id == vehicles[1].system_id
        if same_id and passed_s < _SAME_CLOCK_S and apart_m < flown_m + _SAME_PLACE_M:
            raise InputError(
                f"aircraft {craft.name!r} and {other.name!r} are one vehicle by its id, clock and position: "
                "give each aircraft the link of its own vehicle, and each vehicle its own system id."
            )
        if apart_m > _FLEET_WITHIN_M:
            raise InputError(
                f"aircraft {craft.name!r} and {other.name!r} are {apart_m / 1e3:.0f} km apart: a fleet flies within "
                f"{_FLEET_WITHIN_M / 1e3:.0f} km; check the link and the home of both."
            )
