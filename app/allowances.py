"""What each sender may use of an input, before anything of it is decoded."""

from __future__ import annotations

from collections.abc import Hashable


class Allowances:
    """A bucket for each sender, filled by ``rate_s`` a second up to ``burst``; the oldest is dropped."""

    def __init__(self, burst: float, rate_s: float, senders_max: int = 500) -> None:
        self._burst, self._rate_s, self._senders_max = burst, rate_s, senders_max
        self._left: dict[Hashable, tuple[float, float]] = {}  # what is left, and since when

    def left(self, sender: Hashable, now_s: float) -> float:
        """Return what a sender may still use."""
        left, at_s = self._left.get(sender, (self._burst, now_s))
        return min(self._burst, left + (now_s - at_s) * self._rate_s)

    def used(self, sender: Hashable, now_s: float, amount: float = 1.0) -> bool:
        """Take an amount of a sender's if one unit is left; what it then lacks is paid later."""
        left = self.left(sender, now_s)
        self._left.pop(sender, None)
        self._left[sender] = (left - amount if left >= 1.0 else left, now_s)
        if len(self._left) > self._senders_max:
            del self._left[next(iter(self._left))]
        return left >= 1.0
