"""One MAVLink message as plain values: the same from a live link, a tlog or another log format."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, final


def plain(text: str) -> str:
    """Return the text without control characters and surrounding space."""
    return _printable(text).strip()


def plain_fields(fields: dict[str, Any]) -> dict[str, Any]:
    """Return a message's fields with its texts made plain; their spaces stay, for a text may come in chunks."""
    return {name: _printable(value) if isinstance(value, str) else value for name, value in fields.items()}


def _printable(text: str) -> str:
    if text.isprintable():  # nearly all
        return text
    return "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in text)


DISTANCE_SENSOR_MAX_CM = 0xFFFF  # its fields have 16 bits


@final
class Message(NamedTuple):
    """A tuple, because a log yields a million of them and a frozen dataclass takes three times as long to make.

    fields: by their MAVLink names, in MAVLink units; arrays are lists, text is str, NaN may come as None.

    received_s: when it arrived, seconds since 1970 by the receiver's clock; for records and displays only, the
    estimation goes by the vehicle's own time stamps inside ``fields``.
    """

    name: str
    system_id: int
    component_id: int
    fields: Mapping[str, Any]
    received_s: float
