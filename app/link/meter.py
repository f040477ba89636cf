"""The measure of a link on MAVSDK's own transport, by what MAVSDK shows of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

from sidelong.app.link.frames import Frame
from sidelong.app.link.message import Message
from sidelong.app.link.quality import LinkQuality, LinkReport, Measured

_AUTOPILOT = 1
_TIMESYNC = "TIMESYNC"
_ASKED_MAX = 32


class LinkMeter:
    """Takes the frames of MAVSDK's raw copy, and the messages: those addressed to us are not in the copy.

    Without the copy there is nothing but the delay.
    """

    def __init__(self, url: str, own: tuple[int, int]) -> None:
        self._url, self._own = url, own
        self._quality = LinkQuality(time.monotonic())
        self._asked_s: dict[int, float] = {}
        self._lock = threading.Lock()
        self.vehicle_signs = False

    def frame(self, data: bytes) -> None:
        """Take a frame that was received or sent, from any thread."""
        frame, now_s = Frame(data), time.monotonic()
        with self._lock:
            if frame.source == self._own:
                self._quality.sent(len(data), now_s)
            else:
                self.vehicle_signs |= frame.signed and frame.component_id == _AUTOPILOT
                self._quality.frame(frame.source, frame.sequence, len(data), now_s)

    def message(self, message: Message) -> None:
        """Take a message of the vehicle."""
        with self._lock:
            if message.fields.get("target_system") == self._own[0]:
                self._quality.found(time.monotonic())
            if message.name == _TIMESYNC and message.fields["tc1"]:
                asked_s = self._asked_s.pop(int(message.fields["ts1"]), None)
                if asked_s is not None:
                    self._quality.answered(time.monotonic() - asked_s)
            elif message.name == "RADIO_STATUS":
                self._quality.radio(int(message.fields["rssi"]), int(message.fields["remrssi"]))

    def question(self) -> tuple[str, Mapping[str, Any]]:
        """Return the message whose answer gives the delay."""
        stamp = time.monotonic_ns()
        with self._lock:
            self._asked_s[stamp] = time.monotonic()
            while len(self._asked_s) > _ASKED_MAX:
                del self._asked_s[next(iter(self._asked_s))]
        return _TIMESYNC, {"tc1": 0, "ts1": stamp, "target_system": 0, "target_component": 0}

    @property
    def received_since_s(self) -> float | None:
        """When the first frame came, on the monotonic clock."""
        return self._quality.received_since_s

    def reports(self) -> tuple[LinkReport, ...]:
        """Return how the link has been since the beginning."""
        with self._lock:
            return (self._report(self._quality.total(time.monotonic())),)

    def recent(self) -> tuple[LinkReport, ...]:
        """Return how the link is now."""
        with self._lock:
            return (self._report(self._quality.measured(time.monotonic())),)

    def _report(self, measured: Measured) -> LinkReport:
        return LinkReport(self._url, signed=False, in_use=True, measured=measured, refused={})
