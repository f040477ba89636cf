"""The vehicle's MAVLink links: one station each, with its own sequence numbers and message rates."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import Any

from pymavlink.dialects.v20 import all as mavlink
from pymavlink.generator.mavcrc import x25crc

from sidelong.sitl.protocol.signing import SignedParser, Signing

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
PAYLOAD = mavlink.MAV_COMP_ID_GIMBAL
_SEQUENCE_BYTE = 4

Datagram = tuple[Hashable, bytes]


class Station:
    """A MAVLink station: a ground station, a companion computer or a separate payload."""

    def __init__(self, address: Hashable, interval_s: Mapping[int, float], now_s: float) -> None:
        self.address = address
        self.expected = False  # configured: it is sent to indefinitely, even if it never sends
        self.sequence: dict[int, int] = {}
        self.received_s: float | None = None
        self.parser = SignedParser(None)
        self.parser.robust_parsing = True
        self.interval_s: dict[int, float] = {}
        self._next_due_s: dict[int, float] = {}
        self.wakes_s = now_s
        for message_id, interval in interval_s.items():
            self.stream(message_id, interval, now_s)

    def stream(self, message_id: int, interval_s: float, now_s: float) -> None:
        """Send a message every interval_s from now on; 0 stops it. All stations share one time grid."""
        self.interval_s[message_id] = interval_s
        if interval_s <= 0.0:
            self._next_due_s.pop(message_id, None)
            return
        self._next_due_s[message_id] = _on_grid(now_s, interval_s)
        self.wakes_s = min(self.wakes_s, self._next_due_s[message_id])

    def due(self, now_s: float) -> list[int]:
        """Return the messages whose time has come, and look to the next."""
        if now_s < self.wakes_s:
            return []
        due = [message_id for message_id, due_s in self._next_due_s.items() if due_s <= now_s]
        for message_id in due:
            self._next_due_s[message_id] = _on_grid(now_s, self.interval_s[message_id])
        self.wakes_s = min(self._next_due_s.values(), default=float("inf"))
        return due


def _on_grid(now_s: float, interval_s: float) -> float:
    """Return the next multiple of the interval, half a millisecond early so that rounding cannot skip a step."""
    return (int((now_s + 1e-3) / interval_s) + 1) * interval_s - 5e-4


class Radio:
    """Packs messages once and hands a copy to each station that is to have it."""

    def __init__(
        self,
        system_id: int,
        default_interval_s: Mapping[int, float],
        signing: Signing,
        unix_s: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self.stations: dict[Hashable, Station] = {}
        self.outbox: list[Datagram] = []
        self._default_interval_s = default_interval_s
        self._packers = {
            component: mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component)
            for component in (AUTOPILOT, PAYLOAD)
        }
        self.system_id = system_id
        self.signing, self._unix_s = signing, unix_s

    def connect(self, address: Hashable, now_s: float) -> Station:
        station = self.stations.get(address)
        if station is None:
            station = self.stations[address] = Station(address, self._default_interval_s, now_s)
            self.signing.attach(station.parser)
        return station

    def restart(self, default_interval_s: Mapping[int, float]) -> None:
        """Forget every station's rates and sequence numbers, not the stations."""
        for address in list(self.stations):
            before = self.stations[address]
            station = self.stations[address] = Station(address, default_interval_s, 0.0)
            station.expected, station.parser = before.expected, before.parser

    def drop_silent(self, since_s: float) -> None:
        """Remove the stations that were not configured and have sent nothing since ``since_s``."""
        for address, station in list(self.stations.items()):
            if not station.expected and station.received_s is not None and station.received_s < since_s:
                self.signing.detach(station.parser)
                del self.stations[address]

    def send(self, station: Station, message: Any, component: int = AUTOPILOT) -> None:
        self._address(station, message.pack(self._packers[component]), message.crc_extra, component)

    def broadcast(self, message: Any, component: int = AUTOPILOT) -> None:
        if not self.stations:
            return
        frame = message.pack(self._packers[component])
        for station in self.stations.values():
            self._address(station, frame, message.crc_extra, component)

    def forward(self, message: Any, origin: Station) -> None:
        """Forward a frame of another system or component, unchanged, to every station that has sent something."""
        frame = bytes(message.get_msgbuf())
        for station in self.stations.values():
            if station is not origin and station.received_s is not None:
                self.outbox.append((station.address, frame))

    def stream(self, now_s: float, build: Callable[[int], list[Any]]) -> None:
        """Send what is due; ``build`` makes the messages of an id."""
        packer = self._packers[AUTOPILOT]
        frames: dict[int, list[tuple[bytes, int]]] = {}
        for station in self.stations.values():
            for message_id in station.due(now_s):
                if message_id not in frames:
                    frames[message_id] = [(message.pack(packer), message.crc_extra) for message in build(message_id)]
                for frame, crc_extra in frames[message_id]:
                    self._address(station, frame, crc_extra, AUTOPILOT)

    def _address(self, station: Station, frame: bytes, crc_extra: int, component: int) -> None:
        """Give the frame this station's sequence number and the checksum that goes with it."""
        sequence = station.sequence.get(component, 0)
        station.sequence[component] = (sequence + 1) & 0xFF
        if sequence != frame[_SEQUENCE_BYTE]:
            renumbered = bytearray(frame[:-2])
            renumbered[_SEQUENCE_BYTE] = sequence
            crc = x25crc(bytes(renumbered[1:]) + bytes((crc_extra,))).crc
            frame = bytes(renumbered) + crc.to_bytes(2, "little")
        if self.signing.required:
            frame = self.signing.signed(station.parser, frame, crc_extra, self._unix_s())
        self.outbox.append((station.address, frame))
