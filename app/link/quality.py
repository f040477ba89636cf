"""How good a link is: frames lost by sequence numbers, delay by TIMESYNC, signal by RADIO_STATUS, bytes a second.

Pure: times are seconds of one monotonic clock, given as arguments.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

_WINDOW_S = 5.0
_DELAYS_KEPT = 9
_REORDERED = 128  # a sequence number this far ahead belongs to a late frame
_CHANGED_S, _CHANGED_SHARE = 0.05, 0.2  # of a round trip that is news


@dataclass(frozen=True, slots=True)
class Measured:
    """A link over the last 5 s. None: not known."""

    silent_s: float  # since the last frame
    loss: float | None  # of the frames towards us, 0 to 1
    round_trip_s: float | None  # median
    received_bytes_s: float
    sent_bytes_s: float
    rssi: int | None = None  # of a SiK radio, in its own units
    remote_rssi: int | None = None
    unanswered_s: float = 0.0  # since the last answer, or the first question: what is sent may not arrive


@dataclass(frozen=True, slots=True)
class LinkReport:
    """One link: how good it is, whether it is the one spoken on, and what was not let in.

    only_mavlink_1: frames were received, none of them of MAVLink 2.
    """

    url: str
    signed: bool
    in_use: bool
    measured: Measured
    refused: dict[str, int]
    only_mavlink_1: bool = False

    def as_json(self, clock_rate: float = 1.0) -> dict[str, Any]:
        """Return a flat table of plain values; bytes per second refer to a clock that runs faster by this factor."""
        rates = {
            "received_bytes_s": self.measured.received_bytes_s / clock_rate,
            "sent_bytes_s": self.measured.sent_bytes_s / clock_rate,
        }
        values = asdict(self.measured) | rates
        measured = {name: None if value is None else round(value, 4) for name, value in values.items()}
        return {"url": self.url, "signed": self.signed, **measured, "refused": self.refused}


@dataclass(slots=True)
class _Counts:
    begin_s: float
    received: int = 0
    missed: int = 0
    received_bytes: int = 0
    sent_bytes: int = 0


class LinkQuality:
    """Measures one link. whole: counts of all the time."""

    def __init__(self, now_s: float) -> None:
        self.received_s: float | None = None
        self.received_since_s: float | None = None
        self.whole = _Counts(now_s)
        self._seconds: deque[_Counts] = deque([_Counts(now_s)])
        self._next: dict[tuple[int, int], int] = {}
        self._round_trips_s: deque[float] = deque(maxlen=_DELAYS_KEPT)
        self._answered_s: float | None = None  # or first asked
        self._rssi: tuple[int, int] | tuple[None, None] = (None, None)

    def frame(self, source: tuple[int, int], sequence: int, size: int, now_s: float) -> None:
        """Note a received frame of ``size`` bytes; a gap in its source's sequence numbers counts as lost."""
        self.received_s = now_s
        if self.received_since_s is None:
            self.received_since_s = now_s
        ahead = (sequence - self._next.get(source, sequence)) & 0xFF
        is_late = ahead >= _REORDERED
        if not is_late:
            self._next[source] = (sequence + 1) & 0xFF
        for counts in (self.whole, self._second(now_s)):
            counts.received_bytes += size
            counts.received += not is_late
            counts.missed += 0 if is_late else ahead

    def sent(self, size: int, now_s: float) -> None:
        for counts in (self.whole, self._second(now_s)):
            counts.sent_bytes += size

    def asked(self, now_s: float) -> None:
        """Note a request, so that an unanswered one counts from then on."""
        if self._answered_s is None:
            self._answered_s = now_s

    def answered(self, round_trip_s: float, now_s: float) -> None:
        """Note how long a request waited for its reply."""
        self._round_trips_s.append(round_trip_s)
        self._answered_s = now_s

    def radio(self, rssi: int, remote_rssi: int) -> None:
        """Note signal strengths of RADIO_STATUS, here and at the far end, in the radio's units."""
        self._rssi = (rssi, remote_rssi)

    def measured(self, now_s: float) -> Measured:
        """Return the quality over the last seconds."""
        self._second(now_s)
        return self._measured(self._seconds, now_s)

    def total(self, now_s: float) -> Measured:
        """Return the quality since the link was opened."""
        return self._measured([self.whole], now_s)

    def _measured(self, several: Sequence[_Counts], now_s: float) -> Measured:
        span_s = max(1.0, now_s - several[0].begin_s)
        received, missed = sum(counts.received for counts in several), sum(counts.missed for counts in several)
        round_trips_s = sorted(self._round_trips_s)
        return Measured(
            silent_s=now_s - (self.received_s if self.received_s is not None else self.whole.begin_s),
            loss=missed / (received + missed) if received else None,
            round_trip_s=round_trips_s[len(round_trips_s) // 2] if round_trips_s else None,
            received_bytes_s=sum(counts.received_bytes for counts in several) / span_s,
            sent_bytes_s=sum(counts.sent_bytes for counts in several) / span_s,
            rssi=self._rssi[0],
            remote_rssi=self._rssi[1],
            unanswered_s=0.0 if self._answered_s is None else now_s - self._answered_s,
        )

    def _second(self, now_s: float) -> _Counts:
        if now_s >= self._seconds[-1].begin_s + 1.0:
            self._seconds.append(_Counts(now_s))
            while now_s - self._seconds[0].begin_s > _WINDOW_S + 1.0:
                self._seconds.popleft()
        return self._seconds[-1]


@dataclass(slots=True)
class RoundTripWatch:
    _announced_s: float | None = None

    def news(self, links: Sequence[LinkReport], rate: float = 1.0) -> float | None:
        """Return the round trip of the link in use, s of the vehicle's clock, if it differs from the last one.

        rate: how much faster the vehicle's clock runs than the link's.
        """
        measured_s = next((link.measured.round_trip_s for link in links if link.in_use), None)
        before_s = self._announced_s
        if measured_s is None:
            return None
        now_s = measured_s * rate
        if before_s is not None and abs(now_s - before_s) <= max(_CHANGED_S, _CHANGED_SHARE * before_s):
            return None
        self._announced_s = now_s
        return now_s
