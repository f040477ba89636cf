"""A relay that changes what a real autopilot reports and adds to it, and is another station, too."""

from __future__ import annotations

import contextlib
import copy
import queue
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.frames import Frame
from tests.autopilot.relay import Relay

STATION = 255
VEHICLE = ("HEARTBEAT", "GLOBAL_POSITION_INT", "ATTITUDE")
PAYLOAD = ("DISTANCE_SENSOR", "GIMBAL_DEVICE_ATTITUDE_STATUS")
_ANSWERS = {"MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK", "PARAM_VALUE", "COMMAND_ACK"}
_ANSWERS_WITHIN_S, _ASKS = 1.0, 10

Change = Callable[[Any], Iterator[tuple[float, bytes]]]
"""What becomes of a message of the vehicle: frames, each with its delay in s of the wall clock."""


def unchanged(message: Any) -> Iterator[tuple[float, bytes]]:
    yield 0.0, bytes(message.get_msgbuf())


def packed(message: Any, system_id: int | None = None, seq: int | None = None, **fields: object) -> bytes:
    """Return a frame of the message with other fields, and of another system or number if these are given."""
    changed = copy.copy(message)
    for name, value in fields.items():
        setattr(changed, name, value)
    sender = mavlink.MAVLink(None, system_id or message.get_srcSystem(), message.get_srcComponent())
    sender.seq = message.get_seq() if seq is None else seq
    return bytes(changed.pack(sender))


class ChangingRelay(Relay):
    """A relay that decodes what it receives.

    change may be set at any time. mode, armed, place (latitude, longitude in 1e-7 degrees) and time_boot_ms are the
    vehicle's latest; commanded counts what the application has sent, by message.
    """

    def __init__(self, vehicle_url: str) -> None:
        super().__init__(vehicle_url)
        self.change: Change = unchanged
        self.mode: int | None = None
        self.armed = False
        self.place, self.time_boot_ms = (0, 0), 0
        self.system_id = 1
        self.commanded: Counter[str] = Counter()
        self._decoder = mavlink.MAVLink(None)
        self._answers: queue.Queue[Any] = queue.Queue()
        self._station = mavlink.MAVLink(None, STATION, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._delayed: list[tuple[float, bytes]] = []

    # -- words of the vehicle that it has not reported -----------------------------------------------------------

    def once(self, kind: str, fields: dict[str, Any]) -> None:
        """Give the next message of a kind these fields."""

        def wrong(message: Any) -> Iterator[tuple[float, bytes]]:
            if message.get_type() != kind:
                yield from unchanged(message)
                return
            self.change = unchanged
            yield 0.0, packed(message, **fields)

        self.change = wrong

    def announce(self, message: Any, component_id: int) -> None:
        """Report the application something as another component of the vehicle."""
        sender = mavlink.MAVLink(None, self.system_id, component_id)
        self._send_to_application(bytes(message.pack(sender)))

    # -- another station -----------------------------------------------------------------------------------

    def say(self, message: Any) -> None:
        """Send a message to the vehicle as another station."""
        self._send_to_vehicle(bytes(message.pack(self._station)))

    def ask(self, message: Any, *answers: str) -> Any:
        """Say it until one of these answers comes."""
        for _ in range(_ASKS):
            self.say(message)
            answer = self.answer(*answers)
            if answer is not None:
                return answer
        raise AssertionError(f"no answer to {message}")

    def answer(self, *kinds: str) -> Any:
        """Return the next answer of these kinds, None if there is none for a while."""
        end_s = time.monotonic() + _ANSWERS_WITHIN_S
        with contextlib.suppress(queue.Empty):
            while True:
                message = self._answers.get(timeout=max(0.0, end_s - time.monotonic()))
                if message.get_type() in kinds and getattr(message, "target_system", STATION) in (0, STATION):
                    return message
        return None

    def command(self, number: int, *params: float) -> Any:
        """Send COMMAND_LONG and return its acknowledgement."""
        values = (*params, *(0.0,) * (7 - len(params)))
        message = mavlink.MAVLink_command_long_message(self.system_id, 1, number, 0, *values)
        return self.ask(message, "COMMAND_ACK")

    def has_parameter(self, name: str) -> bool:
        """Return whether the autopilot answers for a parameter of that name."""
        while self._answers.qsize():
            self._answers.get_nowait()
        for _ in range(_ASKS):
            self.say(mavlink.MAVLink_param_request_read_message(self.system_id, 1, name.encode(), -1))
            while (answer := self.answer("PARAM_VALUE")) is not None:
                if answer.param_id == name:
                    return True
        return False

    def set_parameter(self, name: str, value: float, kind: int = mavlink.MAV_PARAM_TYPE_REAL32) -> None:
        """Set a parameter; value as it goes over the link."""
        while self._answers.qsize():
            self._answers.get_nowait()
        message = mavlink.MAVLink_param_set_message(self.system_id, 1, name.encode(), value, kind)
        for _ in range(_ASKS):
            answer = self.ask(message, "PARAM_VALUE")
            if answer.param_id == name:
                return
        raise AssertionError(f"{name} was not set")

    def upload(self, items: list[Any]) -> None:
        """Upload a mission as another station does."""
        count = mavlink.MAVLink_mission_count_message(self.system_id, 1, len(items))
        answer = self.ask(count, "MISSION_REQUEST", "MISSION_REQUEST_INT")
        while answer.get_type() != "MISSION_ACK":
            answer = self.ask(items[answer.seq], "MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK")
        assert answer.type == mavlink.MAV_MISSION_ACCEPTED

    # -- the thread ----------------------------------------------------------------------------------------

    def _from_application(self, frame: Frame, now_s: float) -> None:
        self.commanded[mavlink.mavlink_map[frame.message_id].msgname] += 1
        super()._from_application(frame, now_s)

    def _from_vehicle(self, frame: Frame, now_s: float) -> None:
        message = self._decoder.decode(bytearray(frame.data))
        self._note(message)
        self._delayed += [(now_s + delay_s, data) for delay_s, data in self.change(message)]
        due = [data for due_s, data in self._delayed if due_s <= now_s]
        self._delayed = [one for one in self._delayed if one[0] > now_s]
        for data in due:
            self._to_application.put(data, now_s)

    def _note(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
            self.mode, self.system_id = message.custom_mode, message.get_srcSystem()
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        elif kind == "GLOBAL_POSITION_INT":
            self.place, self.time_boot_ms = (message.lat, message.lon), message.time_boot_ms
        if kind in _ANSWERS:
            self._answers.put(message)
