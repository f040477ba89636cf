"""MAVLink fields that the message definitions of pymavlink do not have yet."""

from __future__ import annotations

import struct
from typing import Any

from pymavlink.generator.mavcrc import x25crc

_HEADER_BYTES = 10


class Extended:
    """A message with further extension fields at its end, numbers of 32 bits; can be sent like any message."""

    def __init__(self, message: Any, *numbers: int) -> None:
        self._message = message
        self._extension = struct.pack(f"<{len(numbers)}I", *numbers)
        self.crc_extra = message.crc_extra

    def pack(self, packer: Any) -> bytes:
        frame = bytearray(self._message.pack(packer))
        base_length = self._message.unpacker.size
        payload = bytes(frame[_HEADER_BYTES:-2]).ljust(base_length, b"\0") + self._extension
        payload = payload.rstrip(b"\0") or b"\0"
        frame[_HEADER_BYTES:] = payload
        frame[1] = len(payload)
        crc: int = x25crc(bytes(frame[1:]) + bytes((self.crc_extra,))).crc
        return bytes(frame) + crc.to_bytes(2, "little")
