"""One aircraft of a fleet in flight: its own flight, and what becomes of it."""

from __future__ import annotations

import asyncio
from dataclasses import replace

from sidelong.app.analysis.summary import Summary
from sidelong.app.analysis.truth import Truth
from sidelong.app.assembly import Prepared
from sidelong.app.fleet.fleet_file import Member
from sidelong.app.fleet.summary import FlownTrack
from sidelong.app.flight.flight import Flight
from sidelong.app.flight.life import describe_aircraft
from sidelong.app.flight.loop import FlightDisplay
from sidelong.app.flight.recording import ClockRate, Recording
from sidelong.app.flight.session import Session
from sidelong.app.link.frames import Frame
from sidelong.app.link.mavsdk_link import OWN_SYSTEM_ID
from sidelong.app.records.run_folder import RunFolder
from sidelong.mission.control.controller import StandoffController


class FleetAircraft:
    """One aircraft of the fleet, from its connection to its summary."""

    def __init__(self, member: Member, folder: RunFolder, display: FlightDisplay) -> None:
        self.name, self.config, self.folder, self.display = member.name, member.config, folder, display
        self.wanted = asyncio.Event()  # in the air
        if not member.reserve:
            self.wanted.set()
        self._event_loop = asyncio.get_running_loop()
        self.recording = Recording(folder, member.config, self.trouble)
        self.track = FlownTrack()
        self.clock_rate = ClockRate(lambda: self.session.telemetry.now_s)
        self.outcome = ""
        self.error: Exception | None = None
        self.prepared: Prepared
        self.joined = False  # once it is, it has a session and a flight
        self.session: Session
        self.flight: Flight

    def own_frame(self, data: bytes) -> None:
        """Take a frame of a link that is shared, from any thread: the others' are theirs to record."""
        frame = Frame(data)
        if frame.source[0] in (self.config.link.system_id, OWN_SYSTEM_ID):
            self.recording.frame(data)

    def trouble(self, text: str) -> None:
        """Display a problem, from any thread."""
        self._event_loop.call_soon_threadsafe(self.display.note, text)

    @property
    def controller(self) -> StandoffController:
        """Its control step."""
        return self.flight.controller

    @property
    def is_received(self) -> bool:
        """Whether its link is not silent."""
        return self.controller.snapshot().connected

    @property
    def settled(self) -> bool:
        """Whether it is settled: sidelong controls it, its flight is over, or the fleet does not need it yet."""
        return self.controller.phase.in_control or bool(self.outcome) or not self.wanted.is_set()

    def described(self, simulated: bool) -> str:
        session = self.session
        does = describe_aircraft(session.vehicle, session.autopilot, self.controller.snapshot(), simulated=simulated)
        return f"{self.name}: {does}"

    def summary(self, truth: Truth | None, outcome: str | None) -> Summary:
        links = tuple(report.as_json(self.clock_rate.mean) for report in self.session.vehicle.link.reports())
        summary = self.flight.summary(outcome or self.outcome, truth)
        return replace(summary, links=links, records_lost=self.recording.lost)
