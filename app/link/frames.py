"""MAVLink frames in a stream of bytes: found, checked by their checksum, renumbered."""

from __future__ import annotations

from mmap import mmap

from fastcrc import crc16
from pymavlink.dialects.v20 import all as dialect

from sidelong.app.link.framing import Framer

_MARKER_V1, _MARKER_V2 = 0xFE, 0xFD
_SIGNED = 0x01
_SIGNATURE_BYTES = 13
_CRC_EXTRA = {number: definition.crc_extra for number, definition in dialect.mavlink_map.items()}
_FLAGS_AT, _SEQUENCE_AT = 2, 4
FRAME_MIN_BYTES = 8  # MAVLink 1, without a payload


def message_ids(names: str) -> frozenset[int]:
    return frozenset(getattr(dialect, f"MAVLINK_MSG_ID_{name}") for name in names.split())


class Frame:
    """One whole MAVLink frame whose checksum is right, ``data`` being all its bytes."""

    __slots__ = ("component_id", "data", "is_v2", "message_id", "sequence", "signed", "system_id")

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.is_v2 = data[0] == _MARKER_V2
        self.signed = self.is_v2 and bool(data[_FLAGS_AT] & _SIGNED)
        if self.is_v2:
            self.sequence, self.system_id, self.component_id = data[4], data[5], data[6]
            self.message_id = int.from_bytes(data[7:10], "little")
        else:
            self.sequence, self.system_id, self.component_id, self.message_id = data[2], data[3], data[4], data[5]

    @property
    def source(self) -> tuple[int, int]:
        return self.system_id, self.component_id

    @property
    def payload(self) -> bytes:
        """The payload as it was sent; MAVLink 2 clips zeros off its end."""
        begin = 10 if self.is_v2 else 6
        return self.data[begin : begin + self.data[1]]

    def renumbered(self, sequence: int, *, signed: bool) -> bytes:
        """Return the bytes with another sequence number, without a signature and with the flag for one or not.

        Raises ValueError for MAVLink 1, which cannot be signed.
        """
        if not self.is_v2:
            raise ValueError("a MAVLink 1 frame cannot be sent on this link")
        body = bytearray(self.data[: 10 + self.data[1]])
        body[_FLAGS_AT] = _SIGNED if signed else 0
        body[_SEQUENCE_AT] = sequence
        return bytes(body) + _checksum(bytes(body), self.message_id)


def _checksum(body: bytes, message_id: int) -> bytes:
    checksum: int = crc16.mcrf4xx(body[1:] + bytes((_CRC_EXTRA[message_id],)))
    return checksum.to_bytes(2, "little")


class FrameSplitter(Framer):
    """Finds the MAVLink frames in what comes in, in pieces of any size; only those of known messages are intact."""

    def __init__(self) -> None:
        super().__init__((bytes((_MARKER_V1,)), bytes((_MARKER_V2,))), _size, _whole)

    def split(self, data: bytes) -> list[Frame]:
        """Return the frames that ``data`` completes, in order."""
        return [Frame(frame) for frame in self.feed(data)]


def frame_at(data: bytes | mmap, at: int) -> Frame | None:
    """Return the whole frame that begins at ``at``, None where there is none."""
    size = _size(data, at)
    return Frame(data[at : at + size]) if size and at + size <= len(data) and _whole(data, at) else None


def _size(data: bytes | mmap, at: int = 0) -> int | None:
    """Return how long the frame at ``at`` is, 0 where it can be none, None where too little of it is there."""
    if len(data) < at + 3:
        return None
    if data[at] == _MARKER_V1:
        return 8 + data[at + 1]
    if data[at + 2] & ~_SIGNED:
        return 0
    return 12 + data[at + 1] + _SIGNATURE_BYTES * data[at + 2]


def _whole(data: bytes | mmap, at: int = 0) -> bool:
    is_v2 = data[at] == _MARKER_V2
    message_id = int.from_bytes(data[at + 7 : at + 10], "little") if is_v2 else data[at + 5]
    end = at + (10 if is_v2 else 6) + data[at + 1]
    return message_id in _CRC_EXTRA and _checksum(data[at:end], message_id) == data[end : end + 2]
