"""Whether one vehicle speaks, or two with the same system id: looked at before anything is armed or uploaded.

Each autopilot numbers its frames one after the other, names its kind in its heartbeats, and goes on in time and
place. Where frame numbers go back again and again, kinds change, or clocks or places take turns, there are two.
"""

from __future__ import annotations

from collections import defaultdict, deque

from sidelong.app.link.frames import FRAME_MIN_BYTES, Frame
from sidelong.app.link.message import Message
from sidelong.app.link.modes import AUTOPILOT_INVALID
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT, Telemetry
from sidelong.mission.control.plausibility import Plausibility

_FRAMES = 150
_BACK_MAX_SHARE = 0.06  # the share of reordered packets on a single link is lower
_REMEDY = "give one of them another system id, or end the second route to it"


class SenderCheck:
    """Receives frames (from any thread) and messages; ``system_id`` is the vehicle's, once it is known."""

    def __init__(self) -> None:
        self.system_id: int | None = None
        self._last: dict[int, int] = {}  # by system: which one is meant is known later
        self._back: defaultdict[int, deque[bool]] = defaultdict(lambda: deque(maxlen=_FRAMES))
        self._kinds: list[tuple[int, int]] = []
        self._telemetry: Telemetry | None = None
        self._door = Plausibility()

    def frame(self, data: bytes) -> None:
        """Take a raw frame."""
        if len(data) < FRAME_MIN_BYTES:
            return
        frame = Frame(data)
        if frame.component_id != AUTOPILOT_COMPONENT:
            return
        if frame.system_id in self._last:
            self._back[frame.system_id].append((frame.sequence - self._last[frame.system_id]) % 256 >= 128)
        self._last[frame.system_id] = frame.sequence

    def message(self, message: Message) -> None:
        """Take a message of the vehicle."""
        if self._telemetry is None:
            self._telemetry = Telemetry(message.system_id)
        event = self._telemetry.event(message)
        if event is not None:
            self._door.admit(event)
        if message.name == "HEARTBEAT" and message.component_id == AUTOPILOT_COMPONENT:
            kind = int(message.fields["autopilot"]), int(message.fields["type"])
            if kind[0] != AUTOPILOT_INVALID and kind not in self._kinds:
                self._kinds.append(kind)

    @property
    def two(self) -> str | None:
        """Why there are two vehicles, and the way out, or None."""
        reason = self._door.two_vehicles
        if reason is None and len(self._kinds) > 1:
            reason = "two vehicles speak with the same system id: their heartbeats report different kinds"
        back = list(self._back[self.system_id]) if self.system_id is not None else []
        if reason is None and len(back) == _FRAMES and sum(back) > _BACK_MAX_SHARE * _FRAMES:
            reason = "two vehicles speak with the same system id: their frame numbers take turns"
        return None if reason is None else f"{reason}; {_REMEDY}"
