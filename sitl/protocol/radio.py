"""The vehicle's MAVLink links: one station each, with its own sequence numbers, message rates and signing.

Unsigned messages are dropped, except for a few that command nothing. The checking of signatures is pymavlink's; all
links share one key and one set of stream times, and each has an id of its own.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as mavlink
from pymavlink.generator.mavcrc import x25crc

KEY_BYTES = 32
_EPOCH_UNIX_S = 1_420_070_400  # 2015-01-01
_UNITS_PER_S = 100_000
_SIGNED = 1
_FLAGS_BYTE = 2


class KeyFileError(Exception):
    """The file holds no key; the message gives the reason."""


def read_key(path: Path) -> bytes:
    """Return the key of a file of 64 hexadecimal digits. Raises KeyFileError."""
    try:
        key = bytes.fromhex(path.read_text(encoding="ascii").strip())
    except OSError as error:
        raise KeyFileError(f"{path} cannot be read: {error.strerror}") from None
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise KeyFileError(f"{path} does not hold 64 hexadecimal digits")
    return key


def signing_time(unix_s: float) -> int:
    """Return a time of day in signing's units of 10 us since 2015."""
    return int((unix_s - _EPOCH_UNIX_S) * _UNITS_PER_S)


class SignedParser(mavlink.MAVLink):  # type: ignore[misc]  # pymavlink has no types
    """pymavlink's parser, but a frame with a false signature does not move its stream's time."""

    def check_signature(self, frame: bytearray, system_id: int, component_id: int) -> bool:
        """Check a frame; a forged one does not move the times of the streams."""
        before = self.signing.stream_timestamps.copy()
        genuine = bool(super().check_signature(frame, system_id, component_id))
        if not genuine:
            self.signing.stream_timestamps.clear()
            self.signing.stream_timestamps.update(before)
        return genuine


class Signing:
    """A vehicle's key; without one, all is accepted. unsigned: message ids that are accepted without a signature."""

    def __init__(self, key: bytes | None, unsigned: frozenset[int]) -> None:
        self._key, self._unsigned = key, unsigned
        self._streams: dict[tuple[int, int, int], int] = {}
        self._parsers: dict[int, Any] = {}  # by link id

    @property
    def required(self) -> bool:
        return self._key is not None

    def set_up(self, key: bytes) -> None:
        """Use another key, on all links; one of zeros ends signing."""
        self._key = key if any(key) else None
        self._streams.clear()
        for parser in self._parsers.values():
            self._apply(parser)

    def attach(self, parser: Any) -> None:
        """Make a link's parser refuse unsigned frames."""
        link_id = next(number for number in range(256) if number not in self._parsers or number == 255)
        parser.signing.link_id = link_id
        self._parsers[link_id] = parser
        self._apply(parser)

    def detach(self, parser: Any) -> None:
        """Forget a link: its id may be given again."""
        self._parsers.pop(parser.signing.link_id, None)

    def _apply(self, parser: Any) -> None:
        signing = parser.signing
        signing.secret_key = self._key
        signing.stream_timestamps = self._streams
        allowed = self._unsigned
        signing.allow_unsigned_callback = (lambda _, message_id: message_id in allowed) if self.required else None

    def signed(self, parser: Any, frame: bytes, crc_extra: int, unix_s: float) -> bytes:
        """Return the frame as it goes out on the parser's link."""
        if self._key is None:
            return frame
        body = bytearray(frame[:-2])
        body[_FLAGS_BYTE] |= _SIGNED
        body += x25crc(bytes(body[1:]) + bytes((crc_extra,))).crc.to_bytes(2, "little")
        signing = parser.signing
        signing.timestamp = max(signing.timestamp + 1, signing_time(unix_s))
        body += bytes((signing.link_id,)) + signing.timestamp.to_bytes(6, "little")
        return bytes(body) + hashlib.sha256(self._key + body).digest()[:6]


_HEADER_BYTES = 10


class Extended:
    """A message with further extension fields at its end, numbers of 32 bits; can be sent like any message."""

    def __init__(self, message: Any, *numbers: int) -> None:
        self._message = message
        self._extension = struct.pack(f"<{len(numbers)}I", *numbers)
        self.crc_extra = message.crc_extra

    def pack(self, packer: Any) -> bytes:
        """Return the frame with the extension fields that pymavlink's dialect lacks."""
        frame = bytearray(self._message.pack(packer))
        base_length = self._message.unpacker.size
        payload = bytes(frame[_HEADER_BYTES:-2]).ljust(base_length, b"\0") + self._extension
        payload = payload.rstrip(b"\0") or b"\0"
        frame[_HEADER_BYTES:] = payload
        frame[1] = len(payload)
        crc: int = x25crc(bytes(frame[1:]) + bytes((self.crc_extra,))).crc
        return bytes(frame) + crc.to_bytes(2, "little")


AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
PAYLOAD = mavlink.MAV_COMP_ID_GIMBAL
_SEQUENCE_BYTE = 4

Datagram = tuple[Hashable, bytes]


class Station:
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
        self._packers = {component: mavlink.MAVLink(None, system_id, component) for component in (AUTOPILOT, PAYLOAD)}
        self.signing, self._unix_s = signing, unix_s

    def connect(self, address: Hashable, now_s: float) -> Station:
        """Return the station at an address, a new one if it is not known."""
        station = self.stations.get(address)
        if station is None:
            station = self.stations[address] = Station(address, self._default_interval_s, now_s)
            self.signing.attach(station.parser)
        return station

    def restart(self, default_interval_s: Mapping[int, float]) -> None:
        """Forget every station's rates and sequence numbers, not the stations."""
        for address, before in self.stations.items():
            station = self.stations[address] = Station(address, default_interval_s, 0.0)
            station.expected, station.parser = before.expected, before.parser

    def drop_silent(self, since_s: float) -> None:
        """Remove the stations that were not configured and have sent nothing since ``since_s``."""
        for address, station in list(self.stations.items()):
            if not station.expected and station.received_s is not None and station.received_s < since_s:
                self.signing.detach(station.parser)
                del self.stations[address]

    def send(self, station: Station, message: Any, component: int = AUTOPILOT) -> None:
        """Queue a message of one of the vehicle's components for a station."""
        self._address(station, message.pack(self._packers[component]), message.crc_extra, component)

    def broadcast(self, message: Any, component: int = AUTOPILOT) -> None:
        """Queue a message for all stations, packed once."""
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
