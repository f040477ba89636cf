"""The flight of a fleet: one flight for each aircraft, the coordinator, and what happens if one of them fails.

| | before anything was commanded | later |
| --- | --- | --- |
| one aircraft is not received or not ready | all are given up; where others fly already, it is left out | |
| one link, autopilot or payload is lost, a pilot takes over, a flight fails | | the others go on |
| an interrupt, the end of the simulation | given up at once | all are wound up |

Aircraft on the ground take off one after the other, the highest layer first: none climbs through another's. A reserve
waits until the coordinator wants it.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import combinations

from sidelong.app.analysis.truth import truth_if_whole
from sidelong.app.assembly import prepared
from sidelong.app.errors import FlightError, InputError, Interrupted
from sidelong.app.fleet.aircraft import FleetAircraft
from sidelong.app.fleet.assembly import coordinator_of
from sidelong.app.fleet.coordination import Coordination, Participant
from sidelong.app.fleet.fleet_file import FleetFile
from sidelong.app.fleet.foreign import ForeignAircraft
from sidelong.app.fleet.planner import planner_in_fleet
from sidelong.app.fleet.summary import FleetSummary, FlownAircraft, summarise_fleet
from sidelong.app.flight.flight import Flight
from sidelong.app.flight.life import Life
from sidelong.app.flight.loop import FlightDisplay
from sidelong.app.flight.recording import beginning, link_log
from sidelong.app.flight.route_input import check_route, give_route
from sidelong.app.flight.session import connected
from sidelong.app.flight.simulated import SimulatedVehicles
from sidelong.app.link.key_file import KeyInUse, key_in_use
from sidelong.app.link.mavsdk_link import SETTLING_S
from sidelong.app.link.message import Message
from sidelong.app.link.queries import is_flying
from sidelong.app.link.raw_links import opened_url
from sidelong.app.link.signing import signing_time
from sidelong.app.link.transport import Transport, sharing_opener
from sidelong.app.records.journal import Header, JournalWriter
from sidelong.app.records.run_folder import FleetFolder
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Phase
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.requirement import Side
from sidelong.mission.exchange.mission_controller import InboundEvent, Output
from sidelong.mission.fleet.events import TargetRouteGiven
from sidelong.sitl.settings import STARTS_M, TargetSettings

_POLL_S = 0.1
_SAME_CLOCK_S, _SAME_PLACE_M = 5.0, 10.0  # of one vehicle by two links, one of which may be slow
_FLEET_WITHIN_M = 100_000.0


@dataclass(frozen=True, slots=True)
class FleetEnded:
    """How a fleet's flight ended. reason: the error that the program reports and exits with, None at a normal end."""

    folder: FleetFolder
    summary: FleetSummary
    reason: Exception | None


class FleetFlight:
    """Flies a fleet. display: returns the display of an aircraft by name; note: displays a text about all of them."""

    def __init__(
        self,
        fleet: FleetFile,
        folder: FleetFolder,
        display: Callable[[str], FlightDisplay],
        note: Callable[[str], None],
        duration_s: float,
    ) -> None:
        self._fleet, self._folder, self._note = fleet, folder, note
        self._duration_s = duration_s
        self._displays = {member.name: display(member.name) for member in fleet.members}
        self._aircraft = [
            FleetAircraft(member, folder.make(member.name), self._displays[member.name]) for member in fleet.members
        ]
        self._recordings = [one.recording for one in self._aircraft]
        self._over = asyncio.Event()
        self._coordination: Coordination | None = None

    @property
    def begun(self) -> bool:
        """Whether a vehicle may have been commanded something."""
        return any(recording.begun for recording in self._recordings)

    def watch_from(self, side: Side, who: str) -> str:
        """Set the required side at an operator's request; return the reason for a refusal, '' if it is set."""
        if self._coordination is None:
            return "nothing is flown yet"
        self._coordination.watch_from(side, who)
        return ""

    def relieve(self, name: str, who: str) -> str:
        """Let another aircraft take the place of this one, by a person's wish; return why not."""
        if self._coordination is None or not any(one.name == name for one in self._aircraft):
            return "it is not flown"
        self._coordination.relieve(name, who)
        return ""

    async def fly(self, life: Life, progress: Callable[[float], None]) -> FleetEnded:
        """Connect, check, take off, watch and shut down."""
        try:
            return await self._fly(life, progress)
        finally:
            for recording in self._recordings:
                recording.close()

    async def _fly(self, life: Life, progress: Callable[[float], None]) -> FleetEnded:
        async with contextlib.AsyncExitStack() as stack:
            with life.computing():
                for one in self._aircraft:
                    kind = planner_in_fleet(one.config)
                    one.prepared = prepared(one.config, progress, self._note, kind)
                coordinator = coordinator_of(self._fleet, progress)
            urls, simulated = await self._urls(stack, life)
            await self._connect(stack, urls, simulated, life)
            await self._prepare()
            with self._journal() as journal:
                coordination = self._coordination = Coordination(coordinator, journal, self._say, self._launch)
                try:
                    await self._watch(stack, coordination, life)
                finally:
                    self._coordination = None
                    described = "; ".join(one.described(simulated) for one in self._aircraft)
        # Only now, with the simulated vehicles ended, are their truth files whole.
        summary = self._summary(coordination, simulated, life)
        return FleetEnded(self._folder, summary, self._reason(life, described))

    def _say(self, name: str, text: str) -> None:
        if name in self._displays:
            self._displays[name].note(text)
        else:
            self._note(text)

    def _launch(self, name: str) -> None:
        """Let a reserve take off."""
        for one in self._aircraft:
            if one.name == name:
                one.wanted.set()

    # -- before the flight ---------------------------------------------------------------------------------

    async def _urls(self, stack: contextlib.AsyncExitStack, life: Life) -> tuple[list[tuple[str, ...]], bool]:
        """Return each aircraft's links, and whether it is simulated; they are started then."""
        if self._aircraft[0].config.link.connections:
            return [one.config.link.connections for one in self._aircraft], False
        kinds = ", ".join(one.config.simulation.autopilot for one in self._aircraft)
        names = ", ".join(target.name for target in self._fleet.target)
        self._note(f"starting the simulation: {kinds}, about {names}")
        truths = [one.folder.truth for one in self._aircraft]
        configs = [one.config for one in self._aircraft]
        vehicles = SimulatedVehicles(configs, truths, life.fail, *simulated_targets(self._fleet))
        await stack.enter_async_context(vehicles)
        pace = asyncio.create_task(vehicles.keep_pace(self._come_to_s))
        stack.callback(pace.cancel)
        return [(url,) for url in vehicles.urls], True

    def _come_to_s(self) -> float:
        """Return the time of the simulation that all aircraft have reached that are received and still fly."""
        received = [one for one in self._aircraft if one.joined and not one.outcome and one.is_received]
        return min((one.flight.come_to_s for one in received), default=math.inf)

    async def _connect(
        self, stack: contextlib.AsyncExitStack, urls: Sequence[tuple[str, ...]], simulated: bool, life: Life
    ) -> None:
        opener = sharing_opener(urls, opened_url)
        key, file = None, self._fleet.link.signing_key_file
        if file is not None:
            key = stack.enter_context(key_in_use(file, signing_time(time.time()), self._aircraft[0].trouble))
        done = await asyncio.gather(
            *(
                self._join(stack, one, own, opener if _is_shared(own, urls) else None, key, simulated)
                for one, own in zip(self._aircraft, urls, strict=True)
            ),
            return_exceptions=True,
        )
        self._go_on_with(done)
        for one in self._aircraft:
            life.watch(one.session.vehicle)

    async def _join(
        self,
        stack: contextlib.AsyncExitStack,
        one: FleetAircraft,
        urls: tuple[str, ...],
        opener: Callable[[str], Transport] | None,
        key: KeyInUse | None,
        simulated: bool,
    ) -> None:
        """Connect to one aircraft. opener: of a link that it shares."""
        link = one.config.link
        if key is not None and opener is not None:
            key = key.apart()
        one.display.note(f"connecting to {' and '.join(urls)}")
        one.session = await stack.enter_async_context(
            connected(
                urls,
                link.heartbeat_timeout_s,
                one.recording.frame if opener is None else one.own_frame,
                key,
                one.trouble,
                system_id=None if simulated else link.system_id,
                settling_s=0.0 if simulated else SETTLING_S,
                open_transport=opener,
            )
        )
        one.display.note(f"connected to {one.session.autopilot.name}, system {one.session.vehicle.system_id}")
        one.flight = Flight(
            one.session,
            one.config,
            one.prepared,
            one.recording,
            one.display,
            self._duration_s,
            len(self._fleet.target) > 1,
        )
        one.joined = True

    async def _prepare(self) -> None:
        """Check all, and let all fly in one plane."""
        own_ids = {one.session.vehicle.system_id for one in self._aircraft}
        for route in self._fleet.routes.values():
            check_route(route, own_ids)
        done = await asyncio.gather(*(one.flight.prepare() for one in self._aircraft), return_exceptions=True)
        self._go_on_with(done)
        check_apart(self._aircraft)
        for one in self._aircraft[1:]:
            one.flight.share_plane(self._aircraft[0].flight.plane)

    def _go_on_with(self, done: Sequence[BaseException | None]) -> None:
        """Continue with the aircraft that are ready. done: the error of each aircraft.

        If others already fly, aircraft that are not ready are left out, so that the flight continues. Otherwise this
        raises the error.
        """
        pairs = list(zip(self._aircraft, done, strict=True))
        ready = [one for one, error in pairs if error is None]
        for one, error in pairs:
            if isinstance(error, InputError):
                if not any(is_flying(other.session.vehicle) for other in ready):
                    raise InputError(f"aircraft {one.name!r}: {error}") from error
                one.display.note(f"left out: {error}")
            elif error is not None:
                raise error
        self._aircraft = ready

    @contextlib.contextmanager
    def _journal(self) -> Iterator[JournalWriter]:
        header = Header(
            program=f"sidelong {version('sidelong')}",
            config=self._fleet.model_dump(mode="json"),
            plane=self._aircraft[0].flight.plane,
            seeds={"simulation": self._fleet.simulation.seed},
        )
        with beginning(self._folder.path):
            journal = JournalWriter(self._folder.journal, header, self._aircraft[0].trouble)
        with journal:
            yield journal

    # -- in flight -----------------------------------------------------------------------------------------

    async def _watch(self, stack: contextlib.AsyncExitStack, coordination: Coordination, life: Life) -> None:
        first = self._aircraft[0].flight
        home_m = first.home.altitude_m
        own_ids = {one.session.vehicle.system_id for one in self._aircraft}
        foreign = ForeignAircraft(first.plane, home_m, own_ids, lambda: coordination.now_s)

        def bystander(message: Message, member: FleetAircraft | None = None) -> None:
            if member is None or member.controller.phase is Phase.YIELDED:
                report = foreign.report(message, "" if member is None else member.name)
                if report is not None:
                    coordination.put(report)

        for one in self._aircraft:
            telemetry, vehicle = one.session.telemetry, one.session.vehicle
            await stack.enter_async_context(link_log(vehicle.link, one.folder.links, one.clock_rate, one.trouble))
            above_m = one.flight.home.altitude_m - home_m
            coordination.add(
                Participant(
                    one.name,
                    one.controller,
                    one.flight.put_event,
                    lambda own=telemetry: own.now_s,  # type: ignore[misc]
                    above_m,
                    lambda name=one.name: coordination.reported_by_others_s(name),  # type: ignore[misc]
                    coordination.mission_s,
                )
            )
            vehicle.bystanders.append(bystander)
            vehicle.listeners.append(lambda message, one=one: bystander(message, one))  # type: ignore[misc]
            vehicle.listeners.append(lambda message, name=one.name: coordination.message(name, message))  # type: ignore[misc]
        for target, route in self._fleet.routes.items():

            def put(given: RouteGiven, target: str = target) -> None:
                coordination.put(TargetRouteGiven(target, given))

            give_route(route, self._aircraft[0].session, first.plane, put, self._note)
        flights: list[asyncio.Task[None]] = []
        clocks = [asyncio.create_task(coordination.keep_time()), asyncio.create_task(self._until_over(coordination))]
        try:
            for one in self._in_turn():
                flights.append(asyncio.create_task(self._fly_one(one, coordination, life.stopped)))
                while not (one.settled or life.stopped.is_set()):
                    await asyncio.sleep(_POLL_S)
            await asyncio.gather(*flights)
        finally:
            self._over.set()
            await asyncio.gather(*flights, return_exceptions=True)
            for clock in clocks:
                clock.cancel()
            await asyncio.gather(*clocks, return_exceptions=True)

    def _in_turn(self) -> list[FleetAircraft]:
        """Return the aircraft in take-off order: those in the air, then the rest from the highest layer down."""
        for one in self._aircraft:
            if is_flying(one.session.vehicle):
                one.wanted.set()
        return sorted(
            self._aircraft,
            key=lambda one: (not is_flying(one.session.vehicle), -one.config.aircraft.height_m),
        )

    async def _fly_one(self, one: FleetAircraft, coordination: Coordination, stopped: asyncio.Event) -> None:
        """Fly one aircraft; a reserve starts when the fleet needs it."""
        events = [asyncio.create_task(event.wait()) for event in (one.wanted, stopped, self._over)]
        await asyncio.wait(events, return_when=asyncio.FIRST_COMPLETED)
        for event in events:
            event.cancel()
        if stopped.is_set() or self._over.is_set():
            one.outcome = "not flown"
            return
        stepped = coordination.stepped(one.name)

        def received(event: InboundEvent, outputs: Sequence[Output]) -> None:
            stepped(event, outputs)
            aircraft, height_m = one.controller.aircraft, one.controller.flown_height_m
            offset_s = coordination.coordinator.offset_s(one.name)
            if aircraft is not None and height_m is not None and offset_s is not None:
                one.track.add(aircraft.time_s + offset_s, aircraft.east_m, aircraft.north_m, height_m)

        try:
            one.outcome = await one.flight.watch(stopped, received, self._over)
            if not one.is_received:
                one.outcome = "lost: its link is silent"
        except Exception as error:  # whatever befalls one, the others go on
            known = isinstance(error, FlightError | InputError)
            one.error, one.outcome = error, f"failed: {error if known else f'a fault of the program, {error!r}'}"
            one.display.note(f"its flight has {one.outcome}")
        coordination.lost(one.name, one.outcome)

    async def _until_over(self, coordination: Coordination) -> None:
        """End the flight when the duration is over, which runs from when all that fly are on their circles."""
        start_s = math.inf
        while coordination.now_s < start_s + self._duration_s:
            await asyncio.sleep(_POLL_S)
            clock_known = math.isfinite(coordination.now_s)
            if start_s == math.inf and clock_known and all(one.settled for one in self._aircraft):
                start_s = coordination.now_s
        self._over.set()

    # -- after the flight ----------------------------------------------------------------------------------

    def _summary(self, coordination: Coordination, simulated: bool, life: Life) -> FleetSummary:
        ended = f"failed: {life.failure}" if life.failure is not None else None
        truths = {
            one.name: truth_if_whole(one.folder.truth if simulated else None, one.controller.time_s, one.display.note)
            for one in self._aircraft
        }
        flown = [
            FlownAircraft(
                one.name,
                one.summary(truths[one.name], ended),
                one.flight.moments(truths[one.name]),
                coordination.coordinator.offset_s(one.name) or 0.0,
                one.track,
            )
            for one in self._aircraft
        ]
        for one, part in zip(self._aircraft, flown, strict=True):
            with contextlib.suppress(OSError):  # the fleet's holds the same
                one.folder.write_summary(part.summary.as_json())
        outcomes = {one.outcome for one in self._aircraft}
        outcome = ended or next((one for one in ("completed", "interrupted") if one in outcomes), "; ".join(outcomes))
        asked = {name: [(-math.inf, first), *coordination.changes[name]] for name, first in self._fleet.asked.items()}
        return summarise_fleet(flown, asked, outcome, "estimate" if None in truths.values() else "truth")

    def _reason(self, life: Life, described: str) -> Exception | None:
        if life.failure is not None:
            return FlightError(life.failure)
        if life.signal_name is not None:
            return Interrupted(f"interrupted by {life.signal_name}: {described}.")
        errors = {one.name: one.error for one in self._aircraft if one.error is not None}
        if len(errors) < len(self._aircraft):
            lost = "; ".join(f"{one.name}: {one.recording.lost}" for one in self._aircraft if one.recording.lost)
            return FlightError(f"the flight has ended, but its records are incomplete: {lost}.") if lost else None
        reasons = " ".join(f"{name}: {error}" for name, error in errors.items())
        if not life.was_armed and all(isinstance(error, InputError) for error in errors.values()):
            return InputError(reasons)
        return FlightError(f"{reasons} Now {described}.")


def check_apart(aircraft: Iterable[FleetAircraft]) -> None:
    """Raise InputError where two links lead to one vehicle, or two aircraft are too far apart for one flight."""
    for one, other in combinations(aircraft, 2):
        vehicles = one.session.vehicle, other.session.vehicle
        a, b = (vehicle.latest["GLOBAL_POSITION_INT"].fields for vehicle in vehicles)
        place = LocalPlane(a["lat"] * 1e-7, a["lon"] * 1e-7)
        apart_m = math.hypot(*place.east_north_m(b["lat"] * 1e-7, b["lon"] * 1e-7))
        passed_s = abs(a["time_boot_ms"] - b["time_boot_ms"]) * 1e-3
        flown_m = math.hypot(a["vx"], a["vy"]) * 1e-2 * passed_s
        same_id = vehicles[0].system_id == vehicles[1].system_id
        if same_id and passed_s < _SAME_CLOCK_S and apart_m < flown_m + _SAME_PLACE_M:
            raise InputError(
                f"aircraft {one.name!r} and {other.name!r} are one vehicle by its id, clock and position: "
                "give each aircraft the link of its own vehicle, and each vehicle its own system id."
            )
        if apart_m > _FLEET_WITHIN_M:
            raise InputError(
                f"aircraft {one.name!r} and {other.name!r} are {apart_m / 1e3:.0f} km apart: a fleet flies within "
                f"{_FLEET_WITHIN_M / 1e3:.0f} km; check the link and the home of both."
            )


def simulated_targets(fleet: FleetFile) -> tuple[list[TargetSettings], list[int]]:
    """Return the targets of the simulation, and which of them each aircraft's payload sees first."""
    names = [target.name for target in fleet.target]
    targets = [
        TargetSettings(target.motion or fleet.simulation.target, start_m=target.start_m or start_m, name=target.name)
        for target, start_m in zip(fleet.target, STARTS_M, strict=False)
    ]
    return targets, [names.index(member.target) for member in fleet.members]


def _is_shared(own: Sequence[str], links: Sequence[Sequence[str]]) -> bool:
    return any(sum(url in urls for urls in links) > 1 for url in own)
