"""What a flight needs of a display beyond what the control loop needs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from sidelong.app.flight.loop import Display
from sidelong.app.link.queries import VehicleStatus
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import AlarmReported, MissionChange, OperatorRequest

Wish = OperatorRequest | MissionChange | AlarmReported
"""A request of the operator."""


class FlightDisplay(Display, Protocol):
    """A display that is active from the connection on, before there is a mission to show."""

    def note(self, text: str) -> None:
        """Show a message about the progress of the connection and preparation."""

    def connected(self, status: Callable[[], VehicleStatus]) -> None:
        """Learn how to find out how the vehicle is; ``status`` is cheap."""

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None]) -> None:
        """Receive the position of the local plane, and the receiver of the operator's requests."""

    def engage(self, start_s: float, duration_s: float | None) -> None:
        """Learn that watching has begun, and for how long it is to go on; times are shown since ``start_s``."""
