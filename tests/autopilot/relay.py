"""A relay between a vehicle and the application: it delays, loses, changes and adds. It is another station, too."""

from __future__ import annotations

import copy
import queue
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from sitl.link import FaultyLink, LinkFaults

STATION = 255
VEHICLE = ("HEARTBEAT", "GLOBAL_POSITION_INT", "ATTITUDE")
PAYLOAD = ("DISTANCE_SENSOR", "GIMBAL_DEVICE_ATTITUDE_STATUS")
_ANSWERS = {"MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK", "PARAM_VALUE", "COMMAND_ACK"}
_WAIT_S = 0.005
_CONNECTS_WITHIN_S, _ANSWERS_WITHIN_S, _ASKS = 20.0, 1.0, 10

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


class Relay:
    """Joins the vehicle at ``url`` and tells the application at UDP port ``port`` of it. Use as ``with``.

    change may be set at any time. mode, armed, place (latitude, longitude in 1e-7 degrees) and time_boot_ms are the
    vehicle's latest; commanded counts what the application has sent, by message.
    """

    def __init__(self, url: str, port: int) -> None:
        scheme, _, address = url.partition("://")
        host, _, there = address.rpartition(":")
        self._stream = scheme == "tcpout"
        self._vehicle = _connected(host, int(there)) if self._stream else _bound(int(there))
        self._vehicle.setblocking(False)
        self._vehicle_address: tuple[str, int] | None = None
        self._ours = _bound(0)
        self._ours.setblocking(False)
        self._application = ("127.0.0.1", port)
        self._from_vehicle, self._from_application = (mavlink.MAVLink(None) for _ in range(2))
        for parser in (self._from_vehicle, self._from_application):
            parser.robust_parsing = True
        self.change: Change = unchanged
        self.mode: int | None = None
        self.armed = False
        self.place, self.time_boot_ms = (0, 0), 0
        self.system_id = 1
        self.commanded: Counter[str] = Counter()
        self._answers: queue.Queue[Any] = queue.Queue()
        self._to_send: queue.Queue[bytes] = queue.Queue()
        self._to_tell: queue.Queue[bytes] = queue.Queue()
        self._station = mavlink.MAVLink(None, STATION, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._ended = threading.Event()
        self._delayed: list[tuple[float, bytes]] = []
        self.spoil(LinkFaults())
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Relay:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(10.0)
        self._vehicle.close()
        self._ours.close()

    def spoil(self, faults: LinkFaults, seed: int = 1) -> None:
        """Make both ways as bad as that from now on."""
        out_rng, in_rng = (np.random.default_rng((seed, way)) for way in range(2))
        self._outward: FaultyLink[bytes] = FaultyLink(faults, out_rng)
        self._inward: FaultyLink[bytes] = FaultyLink(faults, in_rng)

    # -- words of the vehicle that it has not said -----------------------------------------------------------

    def once(self, kind: str, fields: dict[str, Any]) -> None:
        """Give the next message of a kind these fields."""

        def wrong(message: Any) -> Iterator[tuple[float, bytes]]:
            if message.get_type() != kind:
                yield from unchanged(message)
                return
            self.change = unchanged
            yield 0.0, packed(message, **fields)

        self.change = wrong

    def tell(self, message: Any, component_id: int) -> None:
        """Tell the application something as another component of the vehicle."""
        sender = mavlink.MAVLink(None, self.system_id, component_id)
        self._to_tell.put(bytes(message.pack(sender)))

    # -- another station -----------------------------------------------------------------------------------

    def say(self, message: Any) -> None:
        """Send a message to the vehicle as another station."""
        self._to_send.put(bytes(message.pack(self._station)))

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
        deadline_s = time.monotonic() + _ANSWERS_WITHIN_S
        while (left_s := deadline_s - time.monotonic()) > 0.0:
            try:
                message = self._answers.get(timeout=left_s)
            except queue.Empty:
                return None
            if message.get_type() in kinds and getattr(message, "target_system", STATION) in (0, STATION):
                return message
        return None

    def command(self, number: int, *params: float) -> Any:
        """Send COMMAND_LONG and return its acknowledgement."""
        values = (*params, *(0.0,) * (7 - len(params)))
        message = mavlink.MAVLink_command_long_message(self.system_id, 1, number, 0, *values)
        return self.ask(message, "COMMAND_ACK")

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

    def _run(self) -> None:
        while not self._ended.wait(_WAIT_S):
            now_s = time.monotonic()
            for data in _read(self._vehicle, self._note_address):
                for message in self._from_vehicle.parse_buffer(data) or ():
                    self._hear(message, now_s)
            for data in _read(self._ours, lambda _address: None):
                for message in self._from_application.parse_buffer(data) or ():
                    self.commanded[message.get_type()] += 1
                    self._inward.put(bytes(message.get_msgbuf()), now_s)
            due = [frame for due_s, frame in self._delayed if due_s <= now_s]
            self._delayed = [one for one in self._delayed if one[0] > now_s]
            for frame in due:
                self._outward.put(frame, now_s)
            for frame in self._outward.take(now_s):
                self._ours.sendto(frame, self._application)
            for frame in self._inward.take(now_s):
                self._tell_vehicle(frame)
            while not self._to_tell.empty():
                self._ours.sendto(self._to_tell.get(), self._application)
            while not self._to_send.empty():
                self._tell_vehicle(self._to_send.get())

    def _hear(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        if kind == "BAD_DATA":
            return
        if kind == "HEARTBEAT" and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
            self.mode, self.system_id = message.custom_mode, message.get_srcSystem()
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        elif kind == "GLOBAL_POSITION_INT":
            self.place, self.time_boot_ms = (message.lat, message.lon), message.time_boot_ms
        if kind in _ANSWERS:
            self._answers.put(message)
        self._delayed += [(now_s + delay_s, frame) for delay_s, frame in self.change(message)]

    def _note_address(self, address: Any) -> None:
        self._vehicle_address = address or self._vehicle_address

    def _tell_vehicle(self, frame: bytes) -> None:
        if self._stream:
            self._vehicle.sendall(frame)
        elif self._vehicle_address is not None:
            self._vehicle.sendto(frame, self._vehicle_address)


def _read(source: socket.socket, note: Callable[[Any], None]) -> Iterator[bytes]:
    while True:
        try:
            data, address = source.recvfrom(65_536)
        except (BlockingIOError, ConnectionError):
            return
        if not data:
            return
        note(address)
        yield data


def _bound(port: int) -> socket.socket:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind(("127.0.0.1", port))
    return udp


def _connected(host: str, port: int) -> socket.socket:
    deadline_s = time.monotonic() + _CONNECTS_WITHIN_S
    while True:
        try:
            return socket.create_connection((host, port), 5.0)
        except ConnectionError:
            assert time.monotonic() < deadline_s
            time.sleep(0.2)
