"""The connection to one vehicle, what is known of it, and whether it is one.

Each autopilot numbers its frames one after the other, names its kind in its heartbeats, and goes on in time and
place. Where frame numbers go back again and again, kinds change, or clocks or places take turns, there are two.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import defaultdict, deque
from collections.abc import AsyncIterator, Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from sidelong.app.assembly import tracker_of, with_vehicle_fences
from sidelong.app.autopilots.autopilot import Autopilot, ParameterTable, Release
from sidelong.app.config import Config, LinkSection
from sidelong.app.errors import InputError
from sidelong.app.flight.preflight import Check, autopilot_of, check_release
from sidelong.app.link.frames import FRAME_MIN_BYTES, Frame
from sidelong.app.link.mavsdk_link import SETTLING_S, STATION_ID, MavsdkLink
from sidelong.app.link.message import Message
from sidelong.app.link.raw_links import FrameListener, opened_links, opened_url
from sidelong.app.link.signing import KeyInUse
from sidelong.app.link.stored import VehicleFences, read_fences
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT, AUTOPILOT_INVALID, Telemetry
from sidelong.app.link.transport import Transport
from sidelong.app.link.vehicle import LinkError, Vehicle, VehicleMessages, release_of
from sidelong.app.process import ends_within, fails_with
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading
from sidelong.estimators.tracking.payload_fit import yaw_fault
from sidelong.mission.control.plausibility import Plausibility
from sidelong.mission.core.events import ClockTick, Event
from sidelong.mission.core.inputs import Input, InputState
from sidelong.mission.health.health import Health

_CLOSE_S = 30.0
_FRAMES = 150
_BACK_MAX_SHARE = 0.06  # the share of reordered packets on a single link is lower
_UNION_OF_INCLUSIONS = 2  # of FENCE_OPTIONS: to be inside one of them is enough
_REMEDY = "give one of them another system id, or end the second route to it"


@dataclass(slots=True)
class Session:
    vehicle: Vehicle
    autopilot: Autopilot
    release: Release | None  # of its firmware; None: not reported
    inputs: VehicleInputs  # until the control step runs
    senders: SenderCheck
    background: set[asyncio.Task[None]]  # tasks that end with the connection
    note: Callable[[str], object]  # displays what has gone wrong in them

    @property
    def telemetry(self) -> Telemetry:
        """The decoder of the vehicle's messages, from the connection to the end of the flight."""
        return self.inputs.telemetry

    @contextlib.asynccontextmanager
    async def for_a_flight(self) -> AsyncIterator[None]:
        """Remove, at the end of one of several flights over this connection, its tasks, listeners and inputs."""
        vehicle, outer = self.vehicle, self.inputs
        outer.close()
        lists: tuple[list[Any], ...] = (vehicle.listeners, vehicle.bystanders, vehicle.texts.listeners)
        before, tasks = [[*listeners] for listeners in lists], {*self.background}
        self.inputs = VehicleInputs(vehicle)
        self.senders.judge(self.inputs)
        vehicle.latest.pop("HOME_POSITION", None)  # requested again
        try:
            yield
        finally:
            ended = self.background - tasks
            for task in ended:
                task.cancel()
            await asyncio.gather(*ended, return_exceptions=True)
            for listeners, kept in zip(lists, before, strict=True):
                listeners[:] = [listener for listener in listeners if listener in kept]
            self.inputs = outer
            self.senders.judge(outer)
            outer.listen()

    def begin(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """Run some work in the background, until the connection ends at the latest."""
        task = asyncio.create_task(work)
        self.background.add(task)
        task.add_done_callback(self._ended)
        return task

    def _ended(self, task: asyncio.Task[None]) -> None:
        self.background.discard(task)
        error = None if task.cancelled() else task.exception()
        if error is not None and not isinstance(error, LinkError):  # the link reports its own faults
            self.note(f"a fault of the program, {error!r}; the flight continues")


@contextlib.asynccontextmanager
async def connected(
    section: LinkSection,
    note: Callable[[str], object],
    on_frame: FrameListener = lambda _data: None,
    key: KeyInUse | None = None,
    settling_s: float = SETTLING_S,
    open_transport: Callable[[str], Transport] = opened_url,
) -> AsyncIterator[Session]:
    """Connect to one vehicle over one or several links; ``note`` and ``on_frame`` are called from several threads.

    Args:
        key: The signing key where other links use it, too; None: that of the section.
        settling_s: How long to listen for other vehicles, s.
        open_transport: Opens URLs that other links use as well.

    Raises:
        InputError: There is no vehicle, none that sidelong supports, or several and none is selected.
    """
    urls, timeout_s, senders = section.connections, section.heartbeat_timeout_s, SenderCheck()

    def frame(data: bytes) -> None:
        if len(urls) == 1:  # each link has numbers of its own
            senders.frame(data)
        on_frame(data)

    links = opened_links(urls, STATION_ID, key or section.signing_key_file, frame, note, open_transport)
    link = await MavsdkLink.open(links, timeout_s, section.system_id, section.role, settling_s)
    vehicle = Vehicle(link)
    what, own_id = "companion of the vehicle" if vehicle.is_companion else "ground station", link.own_id
    note(f"on this link sidelong is a {what} (system {own_id[0]}, component {own_id[1]}); link.role selects it")
    inputs = VehicleInputs(vehicle)
    senders.judge(inputs)
    receiving = asyncio.create_task(vehicle.run())
    background = {receiving}
    try:
        if await vehicle.received("HEARTBEAT", timeout_s) is None:
            raise InputError(f"{' and '.join(urls)}: the autopilot stopped talking; check the link.")
        autopilot, release = autopilot_of(vehicle), await release_of(vehicle)
        remark = check_release(autopilot, release)
        if remark is not None:
            note(f"{remark}.")
        with fails_with(receiving):
            yield Session(vehicle, autopilot, release, inputs, senders, background, note)
    finally:
        with ends_within(_CLOSE_S, "closing the link"):
            await link.close()
        for task in background:
            task.cancel()
        await asyncio.gather(*background, return_exceptions=True)


async def with_fences(vehicle: Vehicle, config: Config, parameters: ParameterTable) -> tuple[Config, VehicleFences]:
    """Return the configuration with the vehicle's fences, and those. Raises InputError if it cannot be flown so."""
    try:
        found = await read_fences(vehicle)
    except LookupError as error:
        raise InputError(f"the vehicle's fences cannot be read: {error}.") from error
    every = not int(parameters.values.get("FENCE_OPTIONS", 0.0)) & _UNION_OF_INCLUSIONS
    return with_vehicle_fences(config, found, every), found


class VehicleInputs:
    """What a vehicle reports before the control step runs: each message is decoded once, and checked once.

    A journal begins with the control step, whose own check therefore begins with its first event.
    """

    def __init__(self, vehicle: VehicleMessages) -> None:
        self.telemetry, self.plausibility = Telemetry(vehicle.system_id), Plausibility()
        # Each is called with a message, its event and what of that passes the check.
        self.listeners: list[Callable[[Message, Event | None, Event | None], object]] = []
        self._vehicle = vehicle
        self.listen()

    def listen(self) -> None:
        """Process the vehicle's messages from now on, and the clock and the plane of the last one."""
        self._vehicle.listen(self._message, "GLOBAL_POSITION_INT")

    def close(self) -> None:
        self._vehicle.listeners.remove(self._message)

    def _message(self, message: Message) -> None:
        event = self.telemetry.event(message)
        admitted = None if event is None else self.plausibility.admit(event)[0]
        for listener in self.listeners:
            listener(message, event, admitted)


class SenderCheck:
    """Receives frames (from any thread), and judges a vehicle's inputs once they are known."""

    def __init__(self) -> None:
        self._inputs: VehicleInputs | None = None
        self._last: dict[int, int] = {}  # by system: which one is meant is known later
        self._back: defaultdict[int, deque[bool]] = defaultdict(lambda: deque(maxlen=_FRAMES))
        self._kinds: list[tuple[int, int]] = []

    def frame(self, data: bytes) -> None:
        """Note a frame's sequence number, if an autopilot sent it."""
        if len(data) < FRAME_MIN_BYTES:
            return
        frame = Frame(data)
        if frame.component_id != AUTOPILOT_COMPONENT:
            return
        if frame.system_id in self._last:
            self._back[frame.system_id].append((frame.sequence - self._last[frame.system_id]) % 256 >= 128)
        self._last[frame.system_id] = frame.sequence

    def judge(self, inputs: VehicleInputs) -> None:
        """Judge these inputs from here on."""
        self._inputs = inputs
        if self._message not in inputs.listeners:
            inputs.listeners.append(self._message)

    def _message(self, message: Message, _event: Event | None, _admitted: Event | None) -> None:
        if message.name == "HEARTBEAT" and message.component_id == AUTOPILOT_COMPONENT:
            kind = int(message.fields["autopilot"]), int(message.fields["type"])
            if kind[0] != AUTOPILOT_INVALID and kind not in self._kinds:
                self._kinds.append(kind)

    @property
    def two_vehicles(self) -> str | None:
        """Why two vehicles seem to send with one system id, and the way out; None while they do not."""
        inputs = self._inputs
        reason = None if inputs is None else inputs.plausibility.two_vehicles
        if reason is None and len(self._kinds) > 1:
            reason = "two vehicles speak with the same system id: their heartbeats report different kinds"
        back = [] if inputs is None else list(self._back.get(inputs.telemetry.system_id or 0, ()))
        if reason is None and len(back) == _FRAMES and sum(back) > _BACK_MAX_SHARE * _FRAMES:
            reason = "two vehicles speak with the same system id: their frame numbers take turns"
        return None if reason is None else f"{reason}; {_REMEDY}"


_BAD = (InputState.STALE, InputState.INCONSISTENT)
_OF_PAYLOAD = (Input.LASER, Input.GIMBAL)
_TICK_S = 1.0


class InputHealth:
    """Judges a vehicle's inputs until ``close`` as the control step does in flight.

    A fault that shows only while the aircraft turns (a frozen gimbal, a repeated range, a wrong frame or unit) is not
    found on the ground.
    """

    def __init__(self, config: Config, inputs: VehicleInputs) -> None:
        self._inputs, self._tracker = inputs, tracker_of(config)
        self._health = Health(self._tracker.payload)
        self._tick_s = -math.inf
        inputs.listeners.append(self._on_message)

    def close(self) -> None:
        self._inputs.listeners.remove(self._on_message)

    def _on_message(self, message: Message, event: Event | None, admitted: Event | None) -> None:
        if event is not None:
            self._take(event, admitted)
        if message.received_s >= self._tick_s + _TICK_S or message.received_s < self._tick_s:
            self._tick_s = message.received_s
            tick = ClockTick(self._inputs.telemetry.now_s, message.received_s)
            self._take(tick, tick)

    def _take(self, event: Event, admitted: Event | None) -> None:
        door, tracker = self._inputs.plausibility, self._tracker
        now_s = door.clock.now_s
        due = self._health.received(event, now_s, tracker.ranges)
        if isinstance(admitted, PositionReading | AttitudeReading | GimbalReading | RangeReading):
            tracker.add(admitted)
        if due and now_s > -math.inf:
            self._health.changes(now_s, tracker.ranges, tracker.gimbals, door.input_faults)

    def checks(self) -> tuple[Check, ...]:
        """Return the checks that failed; one that passed if there are none."""
        wrong = [(report.input, report.text) for report in self._health.reports if report.state in _BAD]
        if self._tracker.turns:
            yaw_error_rad = self._tracker.calibration.yaw_bias_rad
            wrong.append((Input.GIMBAL, f"the gimbal: {yaw_fault(yaw_error_rad)}; a flight corrects it"))
        if not wrong:
            judged = ", ".join(report.input for report in self._health.reports) or "none received"
            return (Check("inputs", True, f"{judged}: fresh, and without contradiction"),)
        return tuple(Check(f"input {one}", False, text, before_take_off=one in _OF_PAYLOAD) for one, text in wrong)
