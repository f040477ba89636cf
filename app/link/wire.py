"""Messages to frames and back: of a component that this program is, and of the two ends of a simulated link."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.message import Message

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
