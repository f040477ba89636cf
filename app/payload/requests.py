"""When requests are due, and how long their replies take."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable

_REPLIES_KEPT = 20
_GIVEN_UP_S, _GIVEN_UP_FIRST_S = 0.3, 1.0


class Period:
    """Timer of a periodic request."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next_s = float("-inf")

    def is_due(self, now_s: float) -> bool:
        """Return whether it is due, and begin the next period if it is. No missed period is made up for."""
        if now_s < self._next_s:
            return False
        late_s = now_s - self._next_s
        self._next_s = (now_s if late_s > self._period_s else self._next_s) + self._period_s
        return True

    def restart(self) -> None:
        """Make it due now."""
        self._next_s = float("-inf")


class RoundTrips:
    """Requests that wait for a reply, one of each kind, and the shortest time of the latest replies.

    Replies do not name their request. So nothing is requested again before its reply has come or is given up, and a
    measurement that comes without a request counts as delayed by half of the shortest time.
    """

    def __init__(self) -> None:
        self._sent_s: dict[Hashable, float] = {}
        self._latest_s: deque[float] = deque(maxlen=_REPLIES_KEPT)

    @property
    def shortest_s(self) -> float | None:
        """The shortest of the latest round trips, s; None before the first."""
        return min(self._latest_s, default=None)

    def sent(self, kind: Hashable, now_s: float) -> None:
        """Note that a request was sent."""
        self._sent_s[kind] = now_s

    def awaits(self, kind: Hashable, now_s: float) -> bool:
        """Return whether a reply is still expected."""
        shortest_s = self.shortest_s
        given_up_s = _GIVEN_UP_FIRST_S if shortest_s is None else max(_GIVEN_UP_S, 3.0 * shortest_s)
        return now_s - self._sent_s.get(kind, float("-inf")) < given_up_s

    def measured_s(self, kind: Hashable, now_s: float) -> float:
        """Return when a message that came now was written: halfway to its request, if it answers one."""
        awaited = self.awaits(kind, now_s)
        sent_s = self._sent_s.pop(kind, now_s)
        if not awaited:
            return now_s - 0.5 * (self.shortest_s or 0.0)
        self._latest_s.append(now_s - sent_s)
        return 0.5 * (sent_s + now_s)

    def clear(self) -> None:
        """Discard pending requests."""
        self._sent_s.clear()
