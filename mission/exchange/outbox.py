"""What leaves the exchange in one step. Source: <https://mavlink.io/en/services/mission.html>."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from sidelong.mission.core.events import Announce, ControlAcquired, PlanStatus, Timed, YieldRequested
from sidelong.mission.upload.mission_item import MissionItem

MISSION = 0  # MAV_MISSION_TYPE_MISSION
ACCEPTED, ERROR, DENIED, CANCELLED = 0, 1, 14, 15  # of MAV_MISSION_RESULT
_RATE_KNOWN_S = 2.0
INVALID_SEQUENCE, NO_SPACE = 13, 4


@dataclass(frozen=True, slots=True)
class SendMessage(Timed):
    """Send a MAVLink message to the autopilot of our vehicle; NaN: unused."""

    name: str
    fields: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class TakeoverFailed(Timed):
    """The aircraft could not be brought onto a circle. wrong_input: the configuration is why, nothing was sent."""

    reason: str
    wrong_input: bool = False


@dataclass(frozen=True, slots=True)
class ExternalControl(YieldRequested):
    """The exchange has detected that another operator commands the vehicle."""


Derived = ControlAcquired | PlanStatus | ExternalControl


@dataclass(slots=True)
class Outbox:
    """Collects one step's output in order. time_s and link_s are the step's."""

    time_s: float = -math.inf
    link_s: float = 0.0
    sent: list[SendMessage] = field(default_factory=list)
    derived: list[Derived | Announce | TakeoverFailed] = field(default_factory=list)
    _began: tuple[float, float] | None = None

    def begin(self, time_s: float, link_s: float) -> None:
        """Begin a step at a time of the vehicle's clock (-inf: not known yet) and of the link's clock."""
        self.time_s, self.link_s = time_s, link_s
        if math.isfinite(time_s) and (self._began is None or time_s < self._began[0]):
            self._began = (time_s, link_s)

    def vehicle_s(self, link_s: float) -> float:
        """Convert a duration of the link's clock to one of the vehicle's clock, which runs faster in a simulation."""
        if self._began is None or self.link_s - self._began[1] < _RATE_KNOWN_S:
            return link_s
        return link_s * (self.time_s - self._began[0]) / (self.link_s - self._began[1])

    def send(self, name: str, **fields: float) -> None:
        """Queue a message with these fields for the autopilot."""
        self.sent.append(SendMessage(self.time_s, name, fields))

    def send_mission(self, name: str, **fields: float) -> None:
        """Queue a message of the mission protocol, for the flight plan rather than fence or rally points."""
        self.send(name, **fields, mission_type=MISSION)

    def end_reading(self) -> None:
        """Acknowledge that the list was read: twice, for a PX4 that misses it takes no other mission for seconds."""
        for _ in range(2):
            self.send_mission("MISSION_ACK", type=ACCEPTED)

    def send_item(self, seq: int, item: MissionItem, current: bool) -> None:
        """Queue MISSION_ITEM_INT; ``current`` is the field of that name."""
        fields = {"seq": seq, "current": int(current), **asdict(item), "mission_type": MISSION}
        self.sent.append(SendMessage(self.time_s, "MISSION_ITEM_INT", fields))

    def report(self, event: Derived | Announce | TakeoverFailed) -> None:
        """Report to the control step, or to the operator."""
        self.derived.append(event)
