"""MAVLink frames in a stream of bytes: found, checked, renumbered, made of messages and decoded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from mmap import mmap
from typing import Any

from fastcrc import crc16
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.framing import Framer
from sidelong.app.link.message import Message

_MARKER_V1, _MARKER_V2 = 0xFE, 0xFD
_SIGNED = 0x01
_SIGNATURE_BYTES = 13
_EVENT = 410  # pymavlink does not know it, MAVSDK decodes it: https://mavlink.io/en/messages/common.html#EVENT
_CRC_EXTRA = {number: definition.crc_extra for number, definition in mavlink.mavlink_map.items()} | {_EVENT: 160}
_FLAGS_AT, _SEQUENCE_AT = 2, 4
FRAME_MIN_BYTES = 8  # MAVLink 1, without a payload


def message_ids(names: str) -> frozenset[int]:
    """Return the numbers of messages, named without prefix and separated by spaces."""
    return frozenset(getattr(mavlink, f"MAVLINK_MSG_ID_{name}") for name in names.split())


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


OWN_ID = (245, 190)
"""System and component id of sidelong in a simulation."""

# Fields that pymavlink does not know yet, four bytes each: name and place in the payload.
_FURTHER_FIELDS = {
    "MISSION_CURRENT": ("mission_id", 6),
    "MISSION_ACK": ("opaque_id", 4),
    "MISSION_COUNT": ("opaque_id", 5),
}
_HEADER_BYTES, _CHECKSUM_BYTES = 10, 2


class Packer:
    """Packs the messages of one sender, given by its system and component id."""

    def __init__(self, source: tuple[int, int] = OWN_ID) -> None:
        self._packer = mavlink.MAVLink(None, srcSystem=source[0], srcComponent=source[1])

    def frame(self, name: str, fields: Mapping[str, Any], system_id: int) -> bytes:
        """Return a message to the autopilot of a vehicle as a frame; fields that are not given are 0."""
        kind = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        addressed = {"target_system": system_id, "target_component": mavlink.MAV_COMP_ID_AUTOPILOT1}
        known = dict.fromkeys(kind.fieldnames, 0) | {k: v for k, v in addressed.items() if k in kind.fieldnames}
        packed: bytes = kind(**{**known, **fields}).pack(self._packer)
        return packed


class Decoder:
    def __init__(self) -> None:
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True

    def messages(self, frame: bytes, received_s: float) -> Iterator[Message]:
        """Yield the messages of a whole frame, as it was sent; received_s: when it arrived, by the link's clock."""
        for got in self._parser.parse_buffer(frame) or ():
            name = got.get_type()
            fields = {field: getattr(got, field) for field in got.get_fieldnames()}
            if name == "STATUSTEXT":
                fields["text"] = str(fields["text"])
            if name in _FURTHER_FIELDS:
                field, place = _FURTHER_FIELDS[name]
                payload = frame[_HEADER_BYTES:-_CHECKSUM_BYTES].ljust(place + 4, b"\0")
                fields[field] = int.from_bytes(payload[place : place + 4], "little")
            yield Message(name, got.get_srcSystem(), got.get_srcComponent(), fields, received_s)
