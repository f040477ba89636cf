"""Whether the mission on board is still ours: known by what the vehicle reports in order, not by a time.

Reports may be late, doubled or overtaken. So a report that does not fit makes us stop commanding at once, and only
several of them over more than a round trip mean that another station commands the vehicle.

Source: docs/watch-endings.md#yield-another-operator-has-control.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

_MIN_REPORTS, _MIN_SPAN_S, _SPAN_ROUND_TRIPS = 3, 1.0, 2.0
_REMEMBERED_S, _REMEMBERED = 10.0, 64


@dataclass(slots=True)
class Suspicion:
    """Reports that do not fit to what was commanded from here. Times are of the link's clock."""

    round_trip_s: float = 0.0
    active: bool = False  # the latest report did not fit
    _reports_s: deque[float] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))

    def fits(self) -> None:
        """Take a report that fits."""
        self.active = False

    def is_confirmed_by(self, link_s: float) -> bool:
        """Process a report that does not fit.

        Returns:
            Whether it proves that another operator is in command.
        """
        self.active = True
        while self._reports_s and link_s - self._reports_s[0] > _REMEMBERED_S:
            self._reports_s.popleft()
        self._reports_s.append(link_s)
        span_s = max(_MIN_SPAN_S, _SPAN_ROUND_TRIPS * self.round_trip_s)
        return len(self._reports_s) >= _MIN_REPORTS and link_s - self._reports_s[0] >= span_s

    def forget(self) -> None:
        """Reset after a change by sidelong: late reports belong to the previous mission."""
        self.active = False
        self._reports_s.clear()


@dataclass(slots=True)
class MissionIdentity:
    """The missions of ours, each as (total, mission_id).

    ``expected``: a mission of this many items was written, and its id is learnt from the first report of it.
    ``doubtful``: missions of this many items may have been written since; an id of one proves nothing, as others
    write as many.
    """

    ours: set[tuple[int, int]] = field(default_factory=set)
    expected: int | None = None
    doubtful: set[int] = field(default_factory=set)
    writing: int | None = None  # number of items being written; the mission may be on board already

    def written(self, total: int, mission_id: int, accepted: bool = True) -> None:
        """Register a mission that is on board, or may be.

        Args:
            mission_id: Its id; 0 while unknown.
        """
        self.writing = self.expected = None
        if not accepted:
            self.doubtful.add(total)
            return
        self.doubtful.clear()
        if mission_id:
            self.ours.add((total, mission_id))
        else:
            self.expected = total

    def is_open(self, total: int, mission_id: int) -> bool:
        """Return whether only the items themselves show who wrote the reported mission.

        Args:
            mission_id: Reported id; 0 if the autopilot reports none.
        """
        unknown = mission_id != 0 and (total, mission_id) not in self.ours
        return unknown and self.writing is None and total in self.doubtful

    def is_ours(self, total: int, mission_id: int) -> bool:
        """Return whether a report is about a mission of sidelong; learn its id if one is expected.

        Args:
            mission_id: Reported id; 0 if the autopilot reports none.
        """
        if (total, mission_id) in self.ours or self._is_under_way(total, mission_id):
            return True
        if total != self.expected and total not in self.doubtful:
            return False
        self.ours.add((total, mission_id))
        self.expected = None
        return True

    def _is_under_way(self, total: int, mission_id: int) -> bool:
        """Return whether a report is about the list being written: without id it grows item by item."""
        if self.writing is None:
            return False
        shortest = min((own_total for own_total, _ in self.ours), default=self.writing)
        return total == self.writing or (not mission_id and shortest < total < self.writing)
