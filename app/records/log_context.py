"""What a log contains besides the flight: the autopilot, the time of day, and the altitude of home."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from statistics import median

from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.autopilots.registry import AUTOPILOTS, autopilot_by_mav_autopilot
from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_INVALID, TYPE_FIXED_WING

_AUTOPILOT_COMPONENT = 1
_DATED_S = 1e9  # a smaller one was not counted from 1970
_RESTARTED_MS = 10_000  # a stamp that is earlier by less was overtaken on the way
_ARDUPILOT, _PX4, _VTOL, _TYPE_MAX = 3, 12, 22, 50
# How ArduPilot's firmware announces itself, with the MAV_TYPE of most of its vehicles.
_TYPES = {"Plane": 1, "Copter": 2, "Tracker": 5, "Blimp": 7, "Rover": 10, "Sub": 12}
_FIRMWARE = re.compile(rf"(?:(?:Ardu|APM:|Antenna)?({'|'.join(_TYPES)}) V?\d|PX4 v\d)[\w. ()-]*")
_STAMPS = 21  # number of stamps for the time of day: a single one may be wrong

_TIME_MAX_S = 2.0**32  # the year 2106: a later time of boot is that of a damaged clock


@dataclass(frozen=True, slots=True)
class LogContext:
    """booted is when the vehicle's clock was zero, home_altitude_m is above sea level; None where unknown.

    restarts: how often the vehicle's clock began again: the log then holds several flights. kind: MAV_TYPE of the
    vehicle. firmware: its name and release; '' if no message has them. system_id: the vehicle's, that of the first
    heartbeat of an autopilot; others: those of further vehicles.
    """

    autopilot: Autopilot = AUTOPILOTS[0]
    booted: datetime | None = None
    home_altitude_m: float | None = None
    restarts: int = 0
    kind: int = TYPE_FIXED_WING
    firmware: str = ""
    system_id: int | None = None
    others: tuple[int, ...] = ()

    @property
    def warning(self) -> str:
        """What keeps the results from being those of one fixed wing's flight, in a sentence; '' if nothing does."""
        if self.restarts:
            flights = f"the vehicle's clock starts again in it ({self.restarts + 1} flights)"
            return f"warning: {flights}, and the results mix them; give a log of one flight"
        if self.kind != TYPE_FIXED_WING:
            return f"warning: the vehicle is of MAV_TYPE {self.kind}, no fixed wing, which the results assume"
        if self.others:
            others = ", ".join(map(str, self.others))
            return f"warning: the results are of the vehicle of system {self.system_id} only; it also has {others}"
        return ""


class ContextBuilder:
    """Makes a log's context of its messages of ``NAMES``, in their order.

    Args:
        autopilot: the autopilot of the log's kind, until a message names it.
    """

    NAMES = frozenset({"HEARTBEAT", "HOME_POSITION", "GLOBAL_POSITION_INT", "STATUSTEXT", "PARAM_VALUE"})

    def __init__(self, autopilot: Autopilot = AUTOPILOTS[0]) -> None:
        self._autopilot, self._kind, self._firmware = autopilot, TYPE_FIXED_WING, ""
        self._home_m: float | None = None
        self._reckoned_m: float | None = None  # home's altitude by a position
        self._boots_s: list[float] = []
        self._restarts: Counter[int] = Counter()  # of each system, as is the next one
        self._latest_ms: dict[int, float] = {}
        self._system_id: int | None = None
        self._others: set[int] = set()

    def take(self, message: Message) -> None:
        fields, system_id = message.fields, message.system_id
        if message.component_id != _AUTOPILOT_COMPONENT:
            return
        is_vehicle = message.name == "HEARTBEAT" and fields["autopilot"] != AUTOPILOT_INVALID
        if is_vehicle and self._system_id is None:
            self._system_id = system_id
        if self._system_id not in (None, system_id):
            if is_vehicle:
                self._others.add(system_id)
        elif message.name == "HEARTBEAT":
            known = autopilot_by_mav_autopilot(int(fields["autopilot"]))
            if known is not None:
                self._autopilot = known
                self._is_of_kind(int(fields.get("type") or TYPE_FIXED_WING))
        elif message.name == "STATUSTEXT":
            self._text(str(fields["text"]))
        elif message.name == "PARAM_VALUE":
            self._parameter(str(fields["param_id"]), fields["param_value"])
        elif message.name == "HOME_POSITION":
            self._home_m = fields["altitude"] * 1e-3
        else:
            self._position(message)

    def _position(self, message: Message) -> None:
        fields, system_id = message.fields, message.system_id
        stamp_ms = fields["time_boot_ms"]
        self._restarts[system_id] += stamp_ms < self._latest_ms.get(system_id, -math.inf) - _RESTARTED_MS
        self._latest_ms[system_id] = stamp_ms
        if self._reckoned_m is None and fields["lat"]:
            self._reckoned_m = (fields["alt"] - fields["relative_alt"]) * 1e-3
        if len(self._boots_s) < _STAMPS and message.received_s > _DATED_S:
            self._boots_s.append(message.received_s - stamp_ms * 1e-3)

    def _text(self, text: str) -> None:
        firmware = _FIRMWARE.match(text)
        if firmware:
            self._firmware = self._firmware or firmware[0].strip()
            self._autopilot = autopilot_by_mav_autopilot(_ARDUPILOT if firmware[1] else _PX4) or self._autopilot
            self._is_of_kind(_TYPES.get(firmware[1], TYPE_FIXED_WING))

    def _parameter(self, name: str, value: float) -> None:
        if name == "Q_ENABLE" and value:  # such a vehicle may call itself a fixed wing
            self._is_of_kind(_VTOL)
        elif name == "MAV_TYPE" and value in range(1, _TYPE_MAX + 1):
            self._is_of_kind(int(value))

    def _is_of_kind(self, kind: int) -> None:
        """Note the vehicle's MAV_TYPE by one source; if several differ, it is not a fixed wing."""
        if self._kind == TYPE_FIXED_WING:
            self._kind = kind

    def context(self) -> LogContext:
        boot_s = median(self._boots_s) if self._boots_s else -1.0
        booted = datetime.fromtimestamp(boot_s, UTC) if 0.0 <= boot_s < _TIME_MAX_S else None
        home_m = self._reckoned_m if self._home_m is None else self._home_m
        restarts, others = max(self._restarts.values(), default=0), tuple(sorted(self._others))
        own = self._kind, self._firmware, self._system_id
        return LogContext(self._autopilot, booted, home_m, restarts, *own, others)
