"""What the aircraft of a fleet have in common, for the shell that flies them; and other aircraft near them."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version

from sidelong.app.analysis.score import Asked
from sidelong.app.analysis.summary import MissionTrack
from sidelong.app.fleet.coordination import Coordination, Participant, VehicleClockReader, coordinator_of
from sidelong.app.fleet.fleet_file import FleetFile
from sidelong.app.flight.loop import FlightDisplay, Stepped
from sidelong.app.flight.payload_input import check_route, give_route
from sidelong.app.flight.recording import opening_records
from sidelong.app.flight.shell import FlyingAircraft
from sidelong.app.link.message import Message
from sidelong.app.link.traffic import TrafficReader
from sidelong.app.records.journal import Header, JournalWriter
from sidelong.app.records.run_folder import FleetFolder
from sidelong.mission.control.present import Phase
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.fleet import Neighbour
from sidelong.mission.core.requirement import Side
from sidelong.mission.exchange.mission_controller import InboundEvent, Output
from sidelong.mission.fleet.coordinator import FleetCoordinator
from sidelong.mission.fleet.events import ForeignAircraftReported, TargetRouteGiven
from sidelong.sitl.settings import STARTS_M, TargetSettings


@dataclass(eq=False)
class FleetFlight:
    """The ``Coordinator`` of a shell."""

    _fleet: FleetFile
    folder: FleetFolder
    _displays: Mapping[str, FlightDisplay]  # of each aircraft, by its name
    _note: Callable[[str], None]
    _progress: Callable[[float], None]  # of the value tables

    def __post_init__(self) -> None:
        self.over, self.targets = asyncio.Event(), simulated_targets(self._fleet)
        self._aircraft: list[FlyingAircraft] = []
        self._tracks: defaultdict[str, MissionTrack] = defaultdict(MissionTrack)
        self._coordinator: FleetCoordinator
        self._coordination: Coordination
        self._is_flown = False

    def prepare(self) -> None:
        self._coordinator = coordinator_of(self._fleet, self._progress)

    @property
    def now_s(self) -> float:
        """Mission time; -inf before the first clock is known."""
        return self._coordination.now_s

    def watch_from(self, side: Side, who: str) -> str:
        """Set the required side at an operator's request; return the reason for a refusal, '' if it is set."""
        if not self._is_flown:
            return "nothing is flown yet"
        self._coordination.watch_from(side, who)
        return ""

    def relieve(self, name: str, who: str) -> str:
        """Let another aircraft take the place of this one, by a person's wish; return why not."""
        if not self._is_flown or not any(craft.name == name for craft in self._aircraft):
            return "it is not flown"
        self._coordination.relieve(name, who)
        return ""

    @contextlib.asynccontextmanager
    async def coordinated(self, aircraft: list[FlyingAircraft]) -> AsyncIterator[None]:
        """Coordinate these aircraft inside the context; the coordinator's journal is open for that long."""
        self._aircraft = aircraft
        own_ids = {craft.session.vehicle.system_id for craft in aircraft}
        for route in self._fleet.routes.values():
            check_route(route, own_ids)
        with self._journal() as journal:
            self._coordination = Coordination(self._coordinator, journal, self._say, self._launch)
            self._listen(own_ids)
            self._is_flown = True
            clock = asyncio.create_task(self._coordination.keep_time())
            try:
                yield
            finally:
                self._is_flown = False
                clock.cancel()
                await asyncio.gather(clock, return_exceptions=True)

    def _say(self, name: str, text: str) -> None:
        (self._displays[name].note if name in self._displays else self._note)(text)

    def _launch(self, name: str) -> None:
        for craft in self._aircraft:
            if craft.name == name:
                craft.wanted.set()

    @contextlib.contextmanager
    def _journal(self) -> Iterator[JournalWriter]:
        first = self._aircraft[0]
        config, seeds = self._fleet.model_dump(mode="json"), {"simulation": self._fleet.simulation.seed}
        header = Header(f"sidelong {version('sidelong')}", config, first.flight.plane, seeds)
        with opening_records(self.folder.path):
            journal = JournalWriter(self.folder.journal, header, first.trouble)
        with journal:
            yield journal

    def _listen(self, own_ids: set[int]) -> None:
        """Let the coordinator receive what the aircraft, and others on their links, report."""
        first, coordination = self._aircraft[0].flight, self._coordination
        home_m = first.home.altitude_m
        reader = TrafficReader(first.plane, home_m, own_ids, lambda: coordination.now_s)

        def bystander(message: Message, member: FlyingAircraft | None = None) -> None:
            if member is None or member.controller.phase is Phase.YIELDED:
                found = reader.report(message, "" if member is None else member.name)
                if found is not None:
                    coordination.put(_reported(found, member is not None))

        def join(craft: FlyingAircraft) -> None:
            telemetry, vehicle = craft.session.telemetry, craft.session.vehicle
            clock = VehicleClockReader(
                craft.name,
                lambda: telemetry.now_s,
                lambda: coordination.reported_by_others_s(craft.name),
                coordination.mission_s,
            )
            above_m = craft.flight.home.altitude_m - home_m
            coordination.add(Participant(craft.name, craft.controller, craft.flight.put_event, clock, above_m))
            vehicle.bystanders.append(bystander)
            vehicle.listeners.append(lambda message: bystander(message, craft))
            vehicle.listeners.append(lambda message: coordination.message(craft.name, message))

        for craft in self._aircraft:
            join(craft)
        for target, route in self._fleet.routes.items():

            def put(given: RouteGiven, target: str = target) -> None:
                coordination.put(TargetRouteGiven(target, given))

            give_route(route, self._aircraft[0].session, first.plane, put, self._note)

    def stepped(self, craft: FlyingAircraft) -> Stepped:
        """Return what to call after each step of an aircraft's core."""
        report, track = self._coordination.stepped(craft.name), self._tracks[craft.name]

        def received(event: InboundEvent, outputs: Sequence[Output]) -> None:
            report(event, outputs)
            aircraft, height_m = craft.controller.aircraft, craft.controller.flown_height_m
            offset_s = self._coordinator.offset_s(craft.name)
            if aircraft is not None and height_m is not None and offset_s is not None:
                track.add(aircraft.time_s + offset_s, aircraft.east_m, aircraft.north_m, height_m)

        return received

    def lost(self, craft: FlyingAircraft) -> None:
        self._coordination.lost(craft.name, craft.outcome)

    def flown(self, craft: FlyingAircraft) -> tuple[float, MissionTrack]:
        """Return the mission time less the time of the aircraft, s, and its track."""
        return self._coordinator.offset_s(craft.name) or 0.0, self._tracks[craft.name]

    def asked(self) -> dict[str, Asked]:
        """Return by target the requirements, each with the mission time from which it holds."""
        changes = self._coordination.changes
        return {name: [(-math.inf, first), *changes[name]] for name, first in self._fleet.asked.items()}


def _reported(found: Neighbour, member: bool) -> ForeignAircraftReported:
    """Return the event for the coordinator. member: the aircraft belongs to the fleet."""
    state = found.state
    return ForeignAircraftReported(
        identity=found.name,
        mission_time_s=state.time_s,
        east_m=state.east_m,
        north_m=state.north_m,
        height_m=found.height_m,
        course_rad=state.course_rad,
        speed_m_s=state.ground_speed_m_s,
        member=member,
        curvature_per_m=state.curvature_per_m,
        climb_m_s=found.climb_m_s,
        clear_m=found.clear_m,
    )


def simulated_targets(fleet: FleetFile) -> tuple[list[TargetSettings], list[int]]:
    """Return the targets of the simulation, and which of them each aircraft's payload sees first."""
    names = [target.name for target in fleet.target]
    targets = [
        TargetSettings(target.motion or fleet.simulation.target, start_m=target.start_m or start_m, name=target.name)
        for target, start_m in zip(fleet.target, STARTS_M, strict=False)
    ]
    return targets, [names.index(member.target) for member in fleet.members]
