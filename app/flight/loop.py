"""The control loop: one queue of timed events, one call of the pure step, one executor of its outputs.

Messages, timers, requests and link timeouts all pass through the queue and the journal, so a replay of the journal
repeats the flight.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import fields as fields_of
from functools import partial
from typing import Any, Protocol

from sidelong.app.config import Config
from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import ARMED_FLAG, AUTOPILOT_COMPONENT, Telemetry, mode_name
from sidelong.app.link.vehicle import LinkError, Vehicle, VehicleMessages, failsafe_of
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Present
from sidelong.mission.core import events
from sidelong.mission.exchange import reports
from sidelong.mission.exchange.mission_controller import UNSEEN, InboundEvent, MissionController, Output
from sidelong.mission.exchange.outbox import MISSION, SendMessage, TakeoverFailed
from sidelong.mission.upload.mission_item import MissionItem

_LINK_SILENCE_S = 3.0
_LINK_CHECK_S = 0.5
_TICK_CHECKS = 2  # a tick of the clock is a second
_FINISH_S = 3.0  # time limit after the end for pending work


class Log(Protocol):
    def write(self, record: InboundEvent | Output) -> None: ...


class Observer(Protocol):
    """What looks at the flight. ``show`` is called at every position, some ten times a second."""

    def show(self, snapshot: Present) -> None: ...


class Display(Observer, Protocol):
    def say(self, announcement: events.Announce) -> None: ...


Stepped = Callable[[InboundEvent, Sequence[Output]], object]


@dataclass(eq=False)
class ControlLoop:
    """Runs the core on what the vehicle reports, until ``stop`` or the end of the mission."""

    _vehicle: Vehicle
    _telemetry: Telemetry
    controller: MissionController
    _log: Log
    _display: Display
    _acquired: Callable[[events.ControlAcquired], object]  # called once control of the aircraft is confirmed
    _stepped: Sequence[Stepped] = ()  # called after each step
    _health_changed: Callable[[events.HealthChanged], object] = lambda _change: None
    outcome: str | None = None
    failed: TakeoverFailed | None = None  # why control was never acquired

    def __post_init__(self) -> None:
        self._reports = VehicleReports(self._vehicle)
        self._commands: asyncio.Queue[SendMessage] = asyncio.Queue()
        self._sending = False
        self._queue: asyncio.Queue[InboundEvent] = asyncio.Queue()
        self._start_s = self._received_s = time.monotonic()
        self._timer: asyncio.TimerHandle | None = None
        self._timer_s = float("inf")
        self._connected = True
        self._ending_s = float("inf")

    @property
    def link_s(self) -> float:
        """The link's clock: seconds since this loop was made."""
        return time.monotonic() - self._start_s

    @property
    def is_sending(self) -> bool:
        """Whether messages wait to be sent or are being sent."""
        return self._sending or not self._commands.empty()

    def put(self, event: InboundEvent) -> None:
        self._queue.put_nowait(event)

    def stop(self) -> None:
        """Start nothing new, and end the loop when what is under way has ended."""
        self.put(reports.ShutdownRequested(self._telemetry.now_s, self.link_s))

    def received(self, message: Message) -> None:
        """Queue the event that a message amounts to, if any."""
        self._received_s = time.monotonic()
        event = self._telemetry.event(message)
        report = self._reports.report(message, self._telemetry.now_s, self.link_s) if event is None else event
        if isinstance(report, events.ModeReported) and (failsafe := failsafe_of(self._vehicle)):
            report = replace(report, failsafe=failsafe)
        if report is not None:
            self._queue.put_nowait(report)

    async def run(self) -> None:
        """Make the steps, with their outputs sent, journaled and shown, until the flight ends."""
        self._vehicle.listeners.append(self.received)
        helpers = [asyncio.create_task(self._watch_link()), asyncio.create_task(self._send_commands())]
        try:
            while not self._has_ended():
                event = await self._queue.get()
                self._log.write(event)
                outputs = self.controller.step(event)
                for output in outputs:
                    self._handle(output)
                for stepped in self._stepped:
                    stepped(event, outputs)
                if isinstance(event, reports.ShutdownRequested):
                    self._end()
                self._set_timer()
                if outputs or type(event) not in UNSEEN:
                    self._display.show(self.controller.snapshot())
        finally:
            if self._timer is not None:
                self._timer.cancel()
            for helper in helpers:
                helper.cancel()
            self._vehicle.listeners.remove(self.received)

    # -- outputs of the core -------------------------------------------------------------------------------

    def _handle(self, output: Output) -> None:
        self._log.write(output)
        match output:
            case SendMessage():
                self._commands.put_nowait(output)
            case events.Announce():
                self._display.say(output)
            case events.ControlAcquired():
                self.outcome = None
                self._acquired(output)
            case TakeoverFailed():
                self.failed = output
                self._end()
            case events.Yield():
                self._drop_commands()
                self.outcome = output.announcement.text
                text = f"yielding: {output.reason}; commanding nothing more until you resume"
                self._display.say(events.Announce(output.time_s, "yield", text))
            case events.HealthChanged():
                self._health_changed(output)
                self._display.say(output.announcement)
            case events.End():
                self._drop_commands()
                self.outcome = output.announcement.text
                self._display.say(events.Announce(output.time_s, "end", f"ending ({output.action}): {output.reason}"))
                self._end()
            case events.DecisionRecord() | events.PlanStatus():
                pass

    def _drop_commands(self) -> None:
        while not self._commands.empty():
            self._commands.get_nowait()

    async def _send_commands(self) -> None:
        while True:
            self._sending = False
            command = await self._commands.get()
            self._sending = True
            with contextlib.suppress(LinkError):  # the core repeats unanswered messages
                await self._vehicle.transmit(command.name, command.fields)

    # -- timers --------------------------------------------------------------------------------------------

    def _set_timer(self) -> None:
        wanted_s = self.controller.next_timer_s
        if wanted_s == self._timer_s and self._timer is not None:
            return
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._timer_s = wanted_s
        if wanted_s < float("inf"):
            wait_s = max(wanted_s - self.link_s, 0.0)
            self._timer = asyncio.get_running_loop().call_later(wait_s, self._expire)

    def _expire(self) -> None:
        self._timer = None
        self.put(reports.TimerExpired(self._telemetry.now_s, self.link_s))

    async def _watch_link(self) -> None:
        # Silence has no time stamp of the vehicle, so it is measured on the wall clock.
        for check in itertools.count(1):
            await asyncio.sleep(_LINK_CHECK_S)
            if check % _TICK_CHECKS == 0:
                self.put(events.ClockTick(self._telemetry.now_s, self.link_s))
            connected = time.monotonic() - self._received_s < _LINK_SILENCE_S
            if connected != self._connected:
                self._connected = connected
                self.put(events.LinkReported(self._telemetry.now_s, connected))

    # -- the end -------------------------------------------------------------------------------------------

    def _end(self) -> None:
        if self._ending_s == float("inf"):
            self._ending_s = self.link_s
            asyncio.get_running_loop().call_later(_FINISH_S, self._expire)  # so that the loop sees it

    def _has_ended(self) -> bool:
        if self._ending_s == float("inf"):
            return False
        return self.controller.idle or self.link_s - self._ending_s > _FINISH_S


@dataclass(frozen=True, slots=True)
class TrackRequest:
    """A request to follow what the camera's picture shows at a place, or to stop."""

    time_s: float  # on the vehicle's clock
    where: tuple[float, ...] = ()  # middle (x, y), width and height of a rectangle, in shares of it; empty: stop
    who: str = ""


Wish = events.OperatorRequest | events.MissionChange | events.AlarmReported | TrackRequest
"""A request of the operator."""


class FlightDisplay(Display, Protocol):
    """A display that is active from the connection on, before there is a mission to show."""

    def note(self, text: str) -> None: ...

    def watching_began(self, start_s: float, duration_s: float | None) -> None:
        """Learn when control was acquired, and how long the watch is to last, None: without end."""

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None], config: Config | None = None) -> None:
        """Receive the local plane, the receiver of the operator's requests, and the configuration as it is flown."""

    def show_picture(self, picture: Callable[[], bytes]) -> None:
        """Receive what returns a picture's marks as a line of JSON, and then the picture as JPEG."""


Fields = Mapping[str, Any]
_Report = reports.VehicleReport | events.ModeReported
_Decoder = Callable[[Fields, float, float], _Report | None]
# Reports of whole numbers alone: their fields, 0 for an extension that the sender does not have.
_NUMBERS: dict[str, tuple[Any, ...]] = {
    "MISSION_CURRENT": (reports.MissionCurrentReported, "seq", "total", "mission_id"),
    "MISSION_COUNT": (reports.MissionCountReported, "count", "opaque_id"),
    "MISSION_REQUEST": (reports.MissionItemRequested, "seq"),
    "MISSION_REQUEST_INT": (reports.MissionItemRequested, "seq"),
    "MISSION_ACK": (reports.MissionAcknowledged, "type", "opaque_id"),
    "COMMAND_ACK": (reports.CommandAcknowledged, "command", "result"),
    "POSITION_TARGET_GLOBAL_INT": (reports.PositionTargetReported, "lat_int", "lon_int"),
}
_UNASKED = {"MISSION_CURRENT", "POSITION_TARGET_GLOBAL_INT", "ORBIT_EXECUTION_STATUS", "CURRENT_MODE"}


class VehicleReports:
    """Reports of the exchange: from the autopilot only, answers only those that are for us."""

    def __init__(self, vehicle: VehicleMessages) -> None:
        self._vehicle = vehicle
        self._mode = ""
        self._decoders: dict[str, _Decoder] = {
            name: partial(_numbers, kind, names) for name, (kind, *names) in _NUMBERS.items()
        } | {"MISSION_ITEM_INT": _mission_item, "ORBIT_EXECUTION_STATUS": _orbit, "CURRENT_MODE": self._current_mode}

    def report(
        self, message: Message, time_s: float, link_s: float
    ) -> reports.VehicleReport | events.ModeReported | None:
        """Return what a message reports, None if nothing. time_s: the vehicle's clock, link_s: when it came."""
        decoder = self._decoders.get(message.name)
        if decoder is None or message.component_id != AUTOPILOT_COMPONENT or time_s == -math.inf:
            return None
        if message.name not in _UNASKED and not self._vehicle.is_for_us(message):
            return None
        if message.fields.get("mission_type", MISSION) != MISSION:
            return None
        return decoder(message.fields, time_s, link_s)

    def _current_mode(self, fields: Fields, time_s: float, link_s: float) -> events.ModeReported | None:
        heartbeat = self._vehicle.latest.get("HEARTBEAT")
        if heartbeat is None:
            return None
        base_mode = int(heartbeat.fields["base_mode"])
        mode = mode_name(int(heartbeat.fields["autopilot"]), base_mode, int(fields["custom_mode"]))
        if mode == self._mode:
            return None  # it is sent often, so that a change is seen at once
        self._mode = mode
        return events.ModeReported(time_s, mode, bool(base_mode & ARMED_FLAG))


def _numbers(
    kind: Callable[..., reports.VehicleReport], names: list[str], fields: Fields, time_s: float, link_s: float
) -> reports.VehicleReport:
    return kind(time_s, link_s, *(int(fields.get(name) or 0) for name in names))


def _mission_item(fields: Fields, time_s: float, link_s: float) -> reports.MissionItemReported:
    values: dict[str, Any] = {field.name: fields[field.name] for field in fields_of(MissionItem)}
    values.update({name: math.nan for name, value in values.items() if value is None})
    return reports.MissionItemReported(time_s, link_s, int(fields["seq"]), MissionItem(**values))


def _orbit(fields: Fields, time_s: float, link_s: float) -> reports.OrbitReported:
    return reports.OrbitReported(time_s, link_s, int(fields["x"]), int(fields["y"]), float(fields["radius"]))
