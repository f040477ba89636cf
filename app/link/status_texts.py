"""STATUSTEXT messages of the autopilot, put together where they come in chunks."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from sidelong.app.link.message import Message
from sidelong.app.link.plain_text import plain

_CHUNK_CHARACTERS = 50
_WARNING = 4  # MAV_SEVERITY
_KEPT = 50


@dataclass(frozen=True, slots=True)
class StatusText:
    """A text of the autopilot.

    Attributes:
        text: The text, without control characters.
        severity: MAV_SEVERITY: 0 emergency to 7 debug.
        received_s: When its last chunk came.
    """

    text: str
    severity: int
    received_s: float

    @property
    def is_warning(self) -> bool:
        """Whether it is a warning or worse."""
        return self.severity <= _WARNING


@dataclass(slots=True)
class _Arriving:
    severity: int
    received_s: float
    chunks: dict[int, str] = field(default_factory=dict)


class StatusTexts:
    """The latest texts of one autopilot: feed it every STATUSTEXT of it with ``take``."""

    def __init__(self) -> None:
        self._texts: deque[StatusText] = deque(maxlen=_KEPT)
        self._arriving: dict[int, _Arriving] = {}
        self.listeners: list[Callable[[StatusText], object]] = []

    def take(self, message: Message) -> StatusText | None:
        """Take a STATUSTEXT, and return the text that it completes, None while chunks are missing.

        A text whose chunks do not all come is completed, with a gap, by the next one.
        """
        fields = message.fields
        number, chunk = int(fields.get("id") or 0), int(fields.get("chunk_seq") or 0)
        text, severity = str(fields["text"]), int(fields["severity"])
        for other in [one for one in self._arriving if one != number]:
            self._complete(self._arriving.pop(other))
        if not number:
            return self._complete(_Arriving(severity, message.received_s, {0: text}))
        arriving = self._arriving.setdefault(number, _Arriving(severity, message.received_s))
        arriving.chunks[chunk], arriving.received_s = text, message.received_s
        if len(text) >= _CHUNK_CHARACTERS:
            return None
        return self._complete(self._arriving.pop(number))

    def warnings(self, since_s: float) -> tuple[str, ...]:
        """Return the warnings since then, each once, in the order in which they came last."""
        for number in list(self._arriving):
            self._complete(self._arriving.pop(number))
        texts = [one.text for one in self._texts if one.is_warning and one.received_s >= since_s]
        return tuple(reversed(dict.fromkeys(reversed(texts))))

    def _complete(self, arriving: _Arriving) -> StatusText | None:
        parts = (arriving.chunks.get(number, "...") for number in range(max(arriving.chunks) + 1))
        text = plain("".join(parts))  # PX4 ends a text with a tab where it is also sent as an event
        if not text:
            return None
        found = StatusText(text, arriving.severity, arriving.received_s)
        self._texts.append(found)
        for listener in self.listeners:
            listener(found)
        return found
