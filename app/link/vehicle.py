"""The vehicle at the other end of a link: its messages, commands with their answers, what it reports of itself."""

from __future__ import annotations

import asyncio
import contextlib
import math
import re
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from sidelong.app.autopilots.autopilot import Release, release_in
from sidelong.app.autopilots.registry import autopilot_by_mav_autopilot
from sidelong.app.errors import FlightError
from sidelong.app.link.message import Message, plain
from sidelong.app.link.quality import LinkReport
from sidelong.app.link.telemetry import ARMED_FLAG, AUTOPILOT_COMPONENT, FAILSAFE_STATES, mode_name
from sidelong.mission.control.present import VehicleStatus
from sidelong.mission.exchange.dialect import Home

REMOTE_ID_STATUS = "OPEN_DRONE_ID_ARM_STATUS"
"""Sent by a Remote ID module next to the autopilot."""
_CHUNK_CHARACTERS = 50
_WARNING = 4  # MAV_SEVERITY
_KEPT = 50


@dataclass(frozen=True, slots=True)
class StatusText:
    text: str  # the text, without control characters
    severity: int  # MAV_SEVERITY: 0 emergency to 7 debug
    received_s: float  # when its last chunk came

    @property
    def is_warning(self) -> bool:
        return self.severity <= _WARNING


@dataclass(slots=True)
class _Arriving:
    severity: int
    received_s: float
    chunks: dict[int, str] = field(default_factory=dict)


class StatusTexts:
    """The latest texts of one autopilot: feed it every STATUSTEXT of it with ``take``."""

    def __init__(self) -> None:
        self._texts: deque[StatusText] = deque(maxlen=_KEPT)
        self._arriving: dict[int, _Arriving] = {}
        self.listeners: list[Callable[[StatusText], object]] = []

    def take(self, message: Message) -> StatusText | None:
        """Process a STATUSTEXT; return the text that it completes, None while chunks are missing.

        A text whose chunks do not all come is completed, with a gap, by the next one.
        """
        fields = message.fields
        number, chunk = int(fields.get("id") or 0), int(fields.get("chunk_seq") or 0)
        text, severity = str(fields["text"]), int(fields["severity"])
        for other in self._arriving.keys() - {number}:
            self._complete(self._arriving.pop(other))
        if not number:
            return self._complete(_Arriving(severity, message.received_s, {0: text}))
        arriving = self._arriving.setdefault(number, _Arriving(severity, message.received_s))
        arriving.chunks[chunk], arriving.received_s = text, message.received_s
        if len(text) >= _CHUNK_CHARACTERS:
            return None
        return self._complete(self._arriving.pop(number))

    def matching(self, pattern: re.Pattern[str], since_s: float) -> tuple[str, ...]:
        """Return the texts in which the pattern is found, since a time of this computer's clock, each once."""
        texts = (said.text for said in self._texts if said.received_s >= since_s and pattern.search(said.text))
        return tuple(dict.fromkeys(texts))

    def warnings(self, since_s: float) -> tuple[str, ...]:
        """Return the warnings since then, each once, in the order in which they came last."""
        for number in list(self._arriving):
            self._complete(self._arriving.pop(number))
        texts = [said.text for said in self._texts if said.is_warning and said.received_s >= since_s]
        return tuple(reversed(dict.fromkeys(reversed(texts))))

    def _complete(self, arriving: _Arriving) -> StatusText | None:
        parts = (arriving.chunks.get(number, "...") for number in range(max(arriving.chunks) + 1))
        text = plain("".join(parts))  # PX4 ends a text with a tab where it is also sent as an event
        return self.add(StatusText(text, arriving.severity, arriving.received_s)) if text else None

    def add(self, completed: StatusText) -> StatusText:
        """Store a complete text."""
        self._texts.append(completed)
        for listener in self.listeners:
            listener(completed)
        return completed


class Link(Protocol):
    """A connection to one vehicle. Every call ends within its own bound, whatever the other side does."""

    system_id: int
    own_id: tuple[int, int]  # system and component id of this end

    def messages(self) -> AsyncIterator[Message]: ...  # of the vehicle and its components, until the link is closed
    async def send(self, name: str, fields: Mapping[str, Any]) -> None: ...  # raises LinkError when it cannot
    async def parameter(self, name: str) -> float | None: ...  # None where the vehicle has none of that name
    async def set_parameter(self, name: str, value: float) -> bool: ...  # whether the vehicle accepted it
    def reports(self) -> tuple[LinkReport, ...]:
        """Return the quality of each link since it was opened."""

    def recent(self) -> tuple[LinkReport, ...]:
        """Return the quality of each link over the last seconds."""

    async def close(self) -> None: ...  # safe to call more than once

    def serving(
        self, system_id: int, component_id: int
    ) -> contextlib.AbstractContextManager[Callable[[bytes], None]]:
        """Be another component, too: receive the commands to it, and yield what sends its frames."""


class LinkError(FlightError):
    """A link operation failed; the message names the operation and the reason."""


_ANSWER_S = 1.0
_TEXT_MAX = 50  # characters of a STATUSTEXT
_TRIES = 4
_IN_PROGRESS = 5
_SET_MESSAGE_INTERVAL = 511
_RATE_ROUNDS, _RATE_ANSWER_S = 5, 0.6
_ROUND_TRIPS, _MORE_S = 1.5, 0.15  # timeout of an answer: this many round trips, plus this many seconds

Listener = Callable[[Message], object]


class VehicleMessages:
    """What one vehicle sends, and who listens to it. own_id: system and component id of this end of the link."""

    def __init__(self, system_id: int, own_id: tuple[int, int]) -> None:
        self.system_id, self.own_id = system_id, own_id
        self.latest: dict[str, Message] = {}
        self.texts = StatusTexts()  # of the autopilot
        self.listeners: list[Listener] = []
        self.bystanders: list[Listener] = []  # receive the messages of other systems, too

    def take(self, message: Message) -> None:
        """Pass a message to bystanders, and one of this vehicle to all listeners, too."""
        for bystander in self.bystanders:
            bystander(message)
        if message.system_id != self.system_id:
            return
        if message.component_id == AUTOPILOT_COMPONENT or message.name == REMOTE_ID_STATUS:
            self.latest[message.name] = message
            if message.name == "STATUSTEXT":
                self.texts.take(message)
            elif message.name == "EVENT":
                self._take_event(message)
        for listener in self.listeners:
            listener(message)

    def _take_event(self, message: Message) -> None:
        """Take what an event says of a failsafe as a text: PX4 sends no texts where it receives no ground station."""
        heartbeat, fields = self.latest.get("HEARTBEAT"), message.fields
        autopilot = heartbeat and autopilot_by_mav_autopilot(int(heartbeat.fields["autopilot"]))
        cause = autopilot.failsafe_cause(int(fields["id"]), fields["arguments"]) if autopilot else ""
        if cause:
            self.texts.add(StatusText(cause, int(fields["log_levels"]) & 0xF, message.received_s))

    def listen(self, listener: Listener, *known: str) -> None:
        """Pass a listener the latest messages of the ``known`` names, if any, and each message from now on."""
        for name in known:
            if name in self.latest:
                listener(self.latest[name])
        self.listeners.append(listener)

    @property
    def is_companion(self) -> bool:
        """Whether sidelong is a component of the vehicle's own system."""
        return self.own_id[0] == self.system_id

    def is_for_us(self, message: Message) -> bool:
        """Return whether a message of the autopilot is addressed to this station; answers to others may arrive too.

        Older autopilots do not set the target of a COMMAND_ACK.
        """
        if message.component_id != AUTOPILOT_COMPONENT:
            return False
        system_id, component_id = self.own_id
        fields = message.fields
        for_system, for_component = fields.get("target_system") or 0, fields.get("target_component") or 0
        return for_system in (0, system_id) and for_component in (0, component_id)


class Vehicle(VehicleMessages):
    """One vehicle on a link. ``run`` must be running for anything else to proceed."""

    def __init__(self, link: Link) -> None:
        super().__init__(link.system_id, link.own_id)
        self.link = link

    async def run(self) -> None:
        """Pass on every message of the link, until it is closed."""
        async for message in self.link.messages():
            self.take(message)

    def answer_s(self, unknown_s: float) -> float:
        """Return how long to wait for an answer: by the measured round trip, unknown_s as long as there is none."""
        round_trip_s = self.round_trip_s
        return unknown_s if round_trip_s is None else _MORE_S + _ROUND_TRIPS * round_trip_s

    @property
    def only_mavlink_1(self) -> bool:
        """Whether the link in use has no MAVLink 2: messages above number 255 cannot arrive."""
        return any(report.in_use and report.only_mavlink_1 for report in self.link.reports())

    @property
    def round_trip_s(self) -> float | None:
        """What a question and its answer take over the link in use, as measured; None: not known."""
        return next((link.measured.round_trip_s for link in self.link.recent() if link.in_use), None)

    @contextlib.contextmanager
    def collecting(self, *names: str, system_id: int | None = None) -> Iterator[asyncio.Queue[Message]]:
        """Collect the messages of these names of the autopilot, or of another system's, inside the context."""
        queue: asyncio.Queue[Message] = asyncio.Queue()
        sender = self.system_id if system_id is None else system_id, AUTOPILOT_COMPONENT

        def on_message(message: Message) -> None:
            if message.name in names and (message.system_id, message.component_id) == sender:
                queue.put_nowait(message)

        listeners = self.listeners if system_id is None else self.bystanders
        listeners.append(on_message)
        try:
            yield queue
        finally:
            with contextlib.suppress(ValueError):  # a flight that ends takes its listeners with it
                listeners.remove(on_message)

    async def received(self, name: str, timeout_s: float) -> Message | None:
        """Return the latest message of that name from the autopilot, waiting for the first one if need be."""
        if name in self.latest:
            return self.latest[name]
        with self.collecting(name) as messages, contextlib.suppress(TimeoutError):
            return await asyncio.wait_for(messages.get(), timeout_s)
        return None

    async def transmit(self, name: str, fields: Mapping[str, Any]) -> None:
        """Send a message to the autopilot. Raises LinkError when it cannot be sent."""
        address = {"target_system": self.system_id, "target_component": AUTOPILOT_COMPONENT}
        await self.link.send(name, {**address, **fields})

    async def send_text(self, text: str, severity: int) -> None:
        """Send the beginning of a text to the ground stations (STATUSTEXT), as far as there is a link."""
        with contextlib.suppress(LinkError):
            fields = {"severity": severity, "text": text[:_TEXT_MAX], "id": 0, "chunk_seq": 0}
            await self.link.send("STATUSTEXT", fields)

    async def acknowledge(self, command: Message, result: int) -> None:
        """Answer a command that was addressed to us, as far as there is a link."""
        fields = {"command": command.fields["command"], "result": result, "progress": 0, "result_param2": 0}
        address = {"target_system": command.system_id, "target_component": command.component_id}
        with contextlib.suppress(LinkError):
            await self.link.send("COMMAND_ACK", fields | address)

    async def command_int(
        self, command: int, frame: int, params: tuple[float, ...], x: int, y: int, z: float
    ) -> int | None:
        """Send COMMAND_INT until it is answered; return its MAV_RESULT, None without one. Missing params: NaN."""
        fields: dict[str, Any] = {f"param{i}": math.nan for i in range(1, 5)}
        fields |= {f"param{i}": value for i, value in enumerate(params, 1)}
        fields |= {"command": command, "frame": frame, "current": 0, "autocontinue": 0, "x": x, "y": y, "z": z}
        for _ in range(_TRIES):
            with self.collecting("COMMAND_ACK") as answers:
                await self.transmit("COMMAND_INT", fields)
                answer_s = _ANSWER_S
                with contextlib.suppress(TimeoutError):
                    while True:
                        answer = await asyncio.wait_for(answers.get(), answer_s)
                        if not self.is_for_us(answer) or answer.fields["command"] != command:
                            continue
                        if answer.fields["result"] != _IN_PROGRESS:
                            return int(answer.fields["result"])
                        answer_s = 10.0 * _ANSWER_S
        return None

    async def set_rates(self, rates_hz: Mapping[int, float], rounds: int = _RATE_ROUNDS) -> None:
        """Request messages at these rates in Hz, 0 for none, all at once; unsupported messages are ignored.

        An answer does not name its message. If one is missing, all are requested again; after the last round no
        answer is awaited.
        """
        for round_ in range(rounds):
            with self.collecting("COMMAND_ACK") as answers:
                for message_id, rate_hz in rates_hz.items():
                    values = {"param1": float(message_id), "param2": 1e6 / rate_hz if rate_hz else -1.0}
                    rest = {f"param{i}": 0.0 for i in range(3, 8)}
                    body = {"command": _SET_MESSAGE_INTERVAL, "confirmation": 0} | values | rest
                    await self.transmit("COMMAND_LONG", body)
                missing = len(rates_hz) if round_ < rounds - 1 else 0
                with contextlib.suppress(TimeoutError):
                    while missing:
                        answer = await asyncio.wait_for(answers.get(), self.answer_s(_RATE_ANSWER_S))
                        missing -= self.is_for_us(answer) and answer.fields["command"] == _SET_MESSAGE_INTERVAL
            if not missing:
                return


_STAMPED = frozenset(("ATTITUDE", "GLOBAL_POSITION_INT"))
_REAL_WINDOW_S = 10.0
_SIMULATED_WINDOW_S, _SIMULATED_AHEAD_MAX_S = 0.5, 0.06  # a little more than the time between two stamps
_JUMP_S = 5.0


class VehicleTimeline:
    """Converts this computer's time to the vehicle's.

    The least delayed message gives the offset of the clocks. A simulated vehicle's clock runs up to ``rate`` times as
    fast. Its latest stamps show its present rate. It may pause, so it is extrapolated only for a short time.
    simulated: whether it is one that runs at most as fast as a real one.
    """

    def __init__(self, rate: float = 1.0, *, simulated: bool = False) -> None:
        self._rate = rate
        simulated = simulated or rate != 1.0
        self._window_s = _SIMULATED_WINDOW_S if simulated else _REAL_WINDOW_S
        self._ahead_max_s = _SIMULATED_AHEAD_MAX_S if simulated else math.inf
        self._samples: deque[tuple[float, float]] = deque()  # (arrival, stamp)

    def on_report(self, message: Message) -> bool:
        """Process a message that has just arrived; return whether it is an autopilot's position or attitude."""
        if message.component_id != AUTOPILOT_COMPONENT or message.name not in _STAMPED:
            return False
        self.on_message(message.fields["time_boot_ms"] * 1e-3, time.monotonic())
        return True

    def on_message(self, stamp_s: float, arrived_s: float) -> None:
        """Process the time stamp of a message of the vehicle, and when it arrived by this computer's clock."""
        expected_s = self.vehicle_s(arrived_s)
        if expected_s is not None and abs(stamp_s - expected_s) > _JUMP_S:
            self._samples.clear()  # the autopilot has rebooted, or its clock was set
        self._samples.append((arrived_s, stamp_s))
        while self._samples[0][0] < arrived_s - self._window_s:
            self._samples.popleft()

    def vehicle_s(self, time_s: float, delay_s: float = 0.0) -> float | None:
        """Return the vehicle's time at a time of this computer, None before the first message.

        delay_s: the shortest delay of a message of the vehicle, by this computer's clock.
        """
        if not self._samples:
            return None
        rate = self._present_rate()
        now_s = max(
            stamp_s + min(rate * (time_s - arrived_s), self._ahead_max_s) for arrived_s, stamp_s in self._samples
        )
        return now_s + rate * delay_s

    def _present_rate(self) -> float:
        """Return how fast the vehicle's clock runs now."""
        (first_s, from_s), (last_s, to_s) = self._samples[0], self._samples[-1]
        if self._rate == 1.0 or last_s <= first_s:
            return self._rate
        return min(max((to_s - from_s) / (last_s - first_s), 0.0), self._rate)


_FLYING_HEIGHT_M = 25.0
_REQUEST_S, _REQUESTS, _WARNED_S = 0.8, 3, 10.0
_REQUEST_MESSAGE, _HOME_POSITION_ID, _AUTOPILOT_VERSION_ID, _GIMBAL_MANAGER_INFORMATION_ID = 512, 242, 148, 280
_GIMBAL_MANAGER_INFORMATION = "GIMBAL_MANAGER_INFORMATION"
_FAILSAFE_TEXT = re.compile("failsafe|lost|loss|low|level|breach|fence", re.IGNORECASE)
_INFINITE_YAW = 2048  # GIMBAL_MANAGER_CAP_FLAGS


def failsafe_of(vehicle: VehicleMessages) -> str:
    """Return why the autopilot is in a failsafe, by its own texts; '' if it is in none."""
    heartbeat = vehicle.latest.get("HEARTBEAT")
    if heartbeat is None or int(heartbeat.fields["system_status"]) not in FAILSAFE_STATES:
        return ""
    return ", ".join(vehicle.texts.matching(_FAILSAFE_TEXT, heartbeat.received_s - _WARNED_S)) or "no reason is given"


def mode_of(vehicle: Vehicle) -> str:
    """Return the name of the mode in the newer of HEARTBEAT and CURRENT_MODE."""
    heartbeat, current = vehicle.latest["HEARTBEAT"], vehicle.latest.get("CURRENT_MODE")
    newer = current if current is not None and current.received_s > heartbeat.received_s else heartbeat
    fields = heartbeat.fields
    return mode_name(int(fields["autopilot"]), int(fields["base_mode"]), int(newer.fields["custom_mode"]))


def is_flying(vehicle: Vehicle) -> bool:
    """Return whether the vehicle is armed and well above its home."""
    armed = int(vehicle.latest["HEARTBEAT"].fields["base_mode"]) & ARMED_FLAG
    position = vehicle.latest.get("GLOBAL_POSITION_INT")
    return bool(armed) and position is not None and position.fields["relative_alt"] * 1e-3 > _FLYING_HEIGHT_M


async def home_of(vehicle: Vehicle) -> Home | None:
    """Return the vehicle's home, requesting it if it was not reported yet."""
    message = await _requested(vehicle, "HOME_POSITION", _HOME_POSITION_ID)
    if message is None:
        return None
    fields = message.fields
    return Home(fields["latitude"] * 1e-7, fields["longitude"] * 1e-7, fields["altitude"] * 1e-3)


async def release_of(vehicle: Vehicle) -> Release | None:
    """Ask the autopilot for the release of its firmware; None: no reply, or one without it."""
    message = await _requested(vehicle, "AUTOPILOT_VERSION", _AUTOPILOT_VERSION_ID)
    return None if message is None else release_in(message.fields)


async def request_pan_limits(vehicle: Vehicle) -> None:
    """Request how far the gimbal turns off the nose, unless its gimbal manager has reported that."""
    # Any component may be the manager: https://mavlink.io/en/services/gimbal_v2.html#discovery-of-gimbal-manager
    await _requested(vehicle, _GIMBAL_MANAGER_INFORMATION, _GIMBAL_MANAGER_INFORMATION_ID, target_component=0)


def reported_pan_limits_rad(vehicle: Vehicle) -> tuple[float, float] | None:
    """Return the gimbal's least and greatest yaw off the nose; None if there is no limit or none was reported."""
    message = vehicle.latest.get(_GIMBAL_MANAGER_INFORMATION)
    if message is None or int(message.fields["cap_flags"]) & _INFINITE_YAW:
        return None
    least_rad, most_rad = float(message.fields["yaw_min"]), float(message.fields["yaw_max"])
    return (least_rad, most_rad) if least_rad < most_rad else None


async def _requested(vehicle: Vehicle, name: str, message_id: int, **address: int) -> Message | None:
    request: dict[str, Any] = address | {"command": _REQUEST_MESSAGE, "confirmation": 0, "param1": float(message_id)}
    request |= {f"param{i}": 0.0 for i in range(2, 8)}
    for _ in range(_REQUESTS):
        if name in vehicle.latest:
            break
        waiting = asyncio.ensure_future(vehicle.received(name, vehicle.answer_s(_REQUEST_S)))
        await vehicle.transmit("COMMAND_LONG", request)
        await waiting
    return vehicle.latest.get(name)


_FIXES = ("no GPS", "no fix", "2D", "3D", "DGPS", "RTK float", "RTK fixed", "static", "PPP")  # GPS_FIX_TYPE
_GOOD_FROM, _MIN_SATELLITES = 3, 6
_UNKNOWN_SATELLITES, _UNKNOWN_MV = 255, 65535


def vehicle_status(latest: Mapping[str, Message], links: Sequence[LinkReport]) -> VehicleStatus:
    """Return the status by the autopilot's latest messages and the links' present measures."""
    power, fix = latest.get("SYS_STATUS"), latest.get("GPS_RAW_INT")
    percent = mv = amps = gps = good = None
    if power is not None:
        percent, mv = int(power.fields["battery_remaining"]), int(power.fields["voltage_battery"])
        amps = int(power.fields["current_battery"]) * 1e-2
    battery = latest.get("BATTERY_STATUS")
    if (percent is None or percent < 0) and battery is not None:
        percent = int(battery.fields["battery_remaining"])
    if fix is not None:
        kind, satellites = int(fix.fields["fix_type"]), int(fix.fields["satellites_visible"])
        known = satellites != _UNKNOWN_SATELLITES
        gps = _FIXES[kind] if kind < len(_FIXES) else f"fix type {kind}"
        gps += f", {satellites} satellites" if known else ""
        good = kind >= _GOOD_FROM and (not known or satellites >= _MIN_SATELLITES)
    used = next((link.measured for link in links if link.in_use), None)
    return VehicleStatus(
        percent if percent is not None and percent >= 0 else None,
        None if mv in (None, 0, _UNKNOWN_MV) else mv * 1e-3,
        gps,
        good,
        None if used is None or used.loss is None else round(100.0 * (1.0 - used.loss)),
        None if used is None else used.round_trip_s,
        battery_a=amps if amps is not None and amps > 0.0 else None,
    )
