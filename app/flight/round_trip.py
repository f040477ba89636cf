"""Pass changes of the link's measured delay to the core, as plans arrive later by this delay."""

from __future__ import annotations

from collections.abc import Sequence

from sidelong.app.link.quality import LinkReport

_CHANGED_S, _CHANGED_SHARE = 0.05, 0.2


class RoundTripWatch:
    """Detects changes of a link's round trip."""

    def __init__(self) -> None:
        self._announced_s: float | None = None

    def news(self, links: Sequence[LinkReport], rate: float = 1.0) -> float | None:
        """Return the round trip of the link in use, in the vehicle's time, if it differs from the last one returned.

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
