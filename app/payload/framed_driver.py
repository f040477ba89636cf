"""What the drivers of protocols with frames of their own have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from sidelong.app.payload.driver import DriverSettings, Identity, Measured
from sidelong.app.payload.framing import Framer
from sidelong.app.payload.requests import RoundTrips


class FramedDriver(ABC):
    """State of one connection: its frames, the payload's identity and the round trips.

    Args:
        settings: settings that concern every protocol.
        framer: splits the received bytes into frames.

    """

    def __init__(self, settings: DriverSettings, framer: Framer) -> None:
        self.identity = Identity()
        self._settings = settings
        self._framer = framer
        self._trips = RoundTrips()

    @property
    def damaged(self) -> int:
        """Number of byte sequences that began like a frame and were none."""
        return self._framer.damaged

    @property
    def round_trip_s(self) -> float | None:
        """Shortest recent time between a request and its reply, s; None before the first reply."""
        return self._trips.shortest_s

    def restart(self, now_s: float) -> None:
        """Forget the connection's state: identification, streams and laser are requested again."""
        self._framer.clear()
        self._trips.clear()
        self.identity = Identity()

    def receive(self, data: bytes, now_s: float) -> list[Measured]:
        """Take bytes that arrived at ``now_s`` and return the measurements they complete."""
        return [one for frame in self._framer.feed(data) for one in self._measured(frame, now_s) if one is not None]

    @abstractmethod
    def _measured(self, frame: bytes, now_s: float) -> Sequence[Measured | None]:
        """Return the measurements of a frame."""
