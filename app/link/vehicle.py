"""The vehicle at the other end of a link: its latest messages, commands with their answers, waiting for messages."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from sidelong.app.link.link import Link, LinkError
from sidelong.app.link.message import Message
from sidelong.app.link.status_texts import StatusTexts
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT

_ANSWER_S = 1.0
_TEXT_MAX = 50  # characters of a STATUSTEXT
_TRIES = 4
_IN_PROGRESS = 5
_SET_MESSAGE_INTERVAL = 511
_RATE_ROUNDS, _RATE_ANSWER_S = 5, 0.6
_ROUND_TRIPS, _MORE_S = 1.5, 0.15  # timeout of an answer: this many round trips, plus this many seconds

Listener = Callable[[Message], object]


class Vehicle:
    """One vehicle. ``run`` must be running for anything else to proceed."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self.system_id = link.system_id
        self.latest: dict[str, Message] = {}
        self.texts = StatusTexts()  # of the autopilot
        self.listeners: list[Listener] = []
        self.bystanders: list[Listener] = []  # receive the messages of other systems, too

    async def run(self) -> None:
        """Hand every message of this vehicle to whoever waits or listens, until the link is closed."""
        async for message in self.link.messages():
            self.take(message)

    def take(self, message: Message) -> None:
        """Hand a message to whoever waits or listens, if it is of this vehicle; to bystanders in any case."""
        for bystander in self.bystanders:
            bystander(message)
        if message.system_id != self.system_id:
            return
        if message.component_id == AUTOPILOT_COMPONENT:
            self.latest[message.name] = message
            if message.name == "STATUSTEXT":
                self.texts.take(message)
        for listener in self.listeners:
            listener(message)

    def listen(self, listener: Listener, *known: str) -> None:
        """Hand a listener the latest messages of these names, if they have come, and each message from now on."""
        for name in known:
            if name in self.latest:
                listener(self.latest[name])
        self.listeners.append(listener)

    def answer_s(self, unknown_s: float) -> float:
        """Return how long to wait for an answer: by the measured round trip, unknown_s as long as there is none."""
        round_trip_s = self.round_trip_s
        return unknown_s if round_trip_s is None else _MORE_S + _ROUND_TRIPS * round_trip_s

    @property
    def round_trip_s(self) -> float | None:
        """What a question and its answer take over the link in use, as measured; None: not known."""
        return next((link.measured.round_trip_s for link in self.link.recent() if link.in_use), None)

    @contextlib.contextmanager
    def hearing(self, *names: str) -> Iterator[asyncio.Queue[Message]]:
        """Collect the autopilot's messages of these names inside the context."""
        queue: asyncio.Queue[Message] = asyncio.Queue()

        def on_message(message: Message) -> None:
            if message.name in names and message.component_id == AUTOPILOT_COMPONENT:
                queue.put_nowait(message)

        self.listeners.append(on_message)
        try:
            yield queue
        finally:
            self.listeners.remove(on_message)

    def is_for_us(self, message: Message) -> bool:
        """Return whether a message of the autopilot is addressed to this station; answers to others may arrive too.

        Older autopilots do not set the target of a COMMAND_ACK.
        """
        if message.component_id != AUTOPILOT_COMPONENT:
            return False
        system_id, component_id = self.link.own_id
        fields = message.fields
        for_system, for_component = fields.get("target_system") or 0, fields.get("target_component") or 0
        return for_system in (0, system_id) and for_component in (0, component_id)

    async def received(self, name: str, timeout_s: float) -> Message | None:
        """Return the latest message of that name from the autopilot, waiting for the first one if need be."""
        if name in self.latest:
            return self.latest[name]
        with self.hearing(name) as messages, contextlib.suppress(TimeoutError):
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

    async def command_int(
        self, command: int, frame: int, params: tuple[float, ...], x: int, y: int, z: float
    ) -> int | None:
        """Send COMMAND_INT until it is answered; return its MAV_RESULT, None without one. Missing params: NaN."""
        fields: dict[str, Any] = {f"param{i}": math.nan for i in range(1, 5)}
        fields |= {f"param{i}": value for i, value in enumerate(params, 1)}
        fields |= {"command": command, "frame": frame, "current": 0, "autocontinue": 0, "x": x, "y": y, "z": z}
        for _ in range(_TRIES):
            with self.hearing("COMMAND_ACK") as answers:
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
            with self.hearing("COMMAND_ACK") as answers:
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
