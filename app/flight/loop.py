"""The control loop: one queue of timed events, one call of the pure step, one place that performs its commands."""

from __future__ import annotations

import asyncio
import time
from typing import Protocol

from app.delivery.performer import CommandExecutor
from app.link.message import Message
from app.link.telemetry import Telemetry
from app.link.vehicle import Vehicle
from mission.control.controller import Snapshot, StandoffController
from mission.core.events import Announce, Command, DecisionRecord, End, Event, LinkReported, Yield

_LINK_SILENCE_S = 3.0
_LINK_CHECK_S = 0.5


class Log(Protocol):
    """Where events and commands are kept."""

    def event(self, event: Event) -> None: ...

    def command(self, command: Command) -> None: ...


class Display(Protocol):
    """Where a person sees what goes on. ``show`` is called at every event and has to be cheap."""

    def say(self, announcement: Announce) -> None: ...

    def show(self, snapshot: Snapshot) -> None: ...


class ControlLoop:
    """Runs the step on what the vehicle says and the performer reports, until ``stop`` or the end of the mission."""

    def __init__(
        self,
        queue: asyncio.Queue[Event | None],
        vehicle: Vehicle,
        telemetry: Telemetry,
        controller: StandoffController,
        performer: CommandExecutor,
        log: Log,
        display: Display,
    ) -> None:
        self.controller = controller
        self.outcome: str | None = None
        self._vehicle, self._telemetry, self._performer = vehicle, telemetry, performer
        self._log, self._display = log, display
        self._queue = queue
        self._heard_s = time.monotonic()
        self._connected = True

    def put(self, event: Event) -> None:
        """Add an event to the queue; what is performed reports here too."""
        self._queue.put_nowait(event)

    def stop(self) -> None:
        """End the loop after the events that are already queued."""
        self._queue.put_nowait(None)

    def received(self, message: Message) -> None:
        """Take a message of the vehicle."""
        self._heard_s = time.monotonic()
        event = self._telemetry.event(message)
        if event is not None:
            self._queue.put_nowait(event)

    async def run(self) -> None:
        """Run until stopped; the outcome then says why."""
        self._vehicle.listeners.append(self.received)
        watchdog = asyncio.create_task(self._watch_link())
        try:
            while (event := await self._queue.get()) is not None:
                self._log.event(event)
                for command in self.controller.step(event):
                    self._log.command(command)
                    self._do(command)
                self._display.show(self.controller.snapshot())
        finally:
            watchdog.cancel()
            self._vehicle.listeners.remove(self.received)

    def _do(self, command: Command) -> None:
        if isinstance(command, DecisionRecord):
            return
        if isinstance(command, Announce):
            self._display.say(command)
            return
        self._performer.perform(command)
        if isinstance(command, Yield):
            self.outcome = f"yielded: {command.reason}"
            self._display.say(
                Announce(command.time_s, "yield", f"yielding: {command.reason}; commanding nothing more")
            )
        elif isinstance(command, End):
            self.outcome = f"ended: {command.reason}"
            self._display.say(Announce(command.time_s, "end", f"ending ({command.action}): {command.reason}"))
            self.stop()

    async def _watch_link(self) -> None:
        # Silence has no time stamp of the vehicle, so it is measured on the wall clock.
        while True:
            await asyncio.sleep(_LINK_CHECK_S)
            connected = time.monotonic() - self._heard_s < _LINK_SILENCE_S
            if connected != self._connected:
                self._connected = connected
                self.put(LinkReported(self._telemetry.now_s, connected))
