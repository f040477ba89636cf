"""MAVLink signing as on a vehicle: unsigned messages are dropped, except for a few that command nothing.

The checking is pymavlink's. One key and one set of stream times for all links; each link has an id of its own.
"""

from __future__ import annotations

import hashlib
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
    """Return the time in signatures' units."""
    return int((unix_s - _EPOCH_UNIX_S) * _UNITS_PER_S)


class SignedParser(mavlink.MAVLink):  # type: ignore[misc]  # pymavlink has no types
    """pymavlink's parser, but a frame with a false signature does not move its stream's time."""

    def check_signature(self, frame: bytearray, system_id: int, component_id: int) -> bool:
        streams, stream = self.signing.stream_timestamps, (frame[-13], system_id, component_id)
        before = streams.get(stream)
        genuine = bool(super().check_signature(frame, system_id, component_id))
        if not genuine:
            streams.pop(stream, None)
            if before is not None:
                streams[stream] = before
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
        """Take another key, on all links; one of zeros ends signing."""
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
        signing.allow_unsigned_callback = self._is_accepted_unsigned if self._key is not None else None

    def _is_accepted_unsigned(self, _parser: Any, message_id: int) -> bool:
        return message_id in self._unsigned

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
