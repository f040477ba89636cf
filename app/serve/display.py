"""A ``FlightDisplay`` without a terminal: lines for the system's journal, and the latest snapshot."""

from __future__ import annotations

from collections.abc import Callable

from sidelong.app.flight.display import Wish
from sidelong.app.link.queries import VehicleStatus
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.snapshot import Snapshot
from sidelong.mission.core.events import Announce

_PRINTED = frozenset({"yield", "operator", "end", "takeover", "alarm", "clear", "health", "link", "position"})


class ServiceDisplay:
    """Of one watch.

    Args:
        log: Receives a line for people.
        changed: Called when the flight is in another phase.
        refused: Receives why a resumption is refused.

    Attributes:
        request: Passes on an operator's wish, None before the flight takes any.
        snapshot: The latest one.
    """

    def __init__(
        self,
        log: Callable[[str], object],
        changed: Callable[[], object],
        refused: Callable[[str], object],
    ) -> None:
        self._log, self._changed, self._refused = log, changed, refused
        self.request: Callable[[Wish], None] | None = None
        self.snapshot: Snapshot | None = None
        self._vehicle: Callable[[], VehicleStatus] | None = None

    @property
    def trouble(self) -> str:
        """What is wrong with the watch now, in words; '' if nothing is."""
        alarms = () if self._vehicle is None else self._vehicle().alarms
        unknown = "" if self.snapshot is None else self.snapshot.unknown
        return "; ".join(one.text for one in alarms) or unknown

    def note(self, text: str) -> None:
        self._log(text)

    def connected(self, status: Callable[[], VehicleStatus]) -> None:
        self._vehicle = status

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None]) -> None:
        self.request = request

    def engage(self, start_s: float, duration_s: float | None) -> None:
        self._changed()

    def say(self, announcement: Announce) -> None:
        if announcement.kind == "refused":
            self._refused(announcement.text)
        elif announcement.kind in _PRINTED:
            self._log(announcement.text)

    def show(self, snapshot: Snapshot) -> None:
        before, self.snapshot = self.snapshot, snapshot
        if before is None or before.phase is not snapshot.phase:
            self._changed()
