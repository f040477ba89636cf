"""What a log contains besides the flight: the autopilot, the time of day, and the altitude of home."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from statistics import median

from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.autopilots.registry import AUTOPILOTS, autopilot_by_mav_autopilot
from sidelong.app.link.telemetry import AUTOPILOT_INVALID, TYPE_FIXED_WING
from sidelong.app.records.log import Log

_NAMES = frozenset({"HEARTBEAT", "HOME_POSITION", "GLOBAL_POSITION_INT"})
_AUTOPILOT_COMPONENT = 1
_DATED_S = 1e9  # a smaller one was not counted from 1970
_RESTARTED_MS = 10_000  # a stamp that is earlier by less was overtaken on the way
_STAMPS = 21  # number of stamps for the time of day: a single one may be wrong


@dataclass(frozen=True, slots=True)
class LogContext:
    """booted is when the vehicle's clock was zero, home_altitude_m is above sea level; None where unknown.

    restarts: how often the vehicle's clock began again: the log then holds several flights. kind: MAV_TYPE of the
    vehicle. system_id: the vehicle's, that of the first heartbeat of an autopilot; others: those of further vehicles.
    """

    autopilot: Autopilot = AUTOPILOTS[0]
    booted: datetime | None = None
    home_altitude_m: float | None = None
    restarts: int = 0
    kind: int = TYPE_FIXED_WING
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

    @staticmethod
    def of(log: Log) -> LogContext:
        """Return the context of the log. Raises InputError when it cannot be read."""
        autopilot, home_m, reckoned_m, kind = AUTOPILOTS[0], None, None, TYPE_FIXED_WING
        boots_s: list[float] = []
        restarts: Counter[int] = Counter()
        latest_ms: dict[int, float] = {}
        system_id: int | None = None
        others: set[int] = set()
        for message in log.messages(_NAMES):
            fields = message.fields
            if message.component_id != _AUTOPILOT_COMPONENT:
                continue
            is_vehicle = message.name == "HEARTBEAT" and fields["autopilot"] != AUTOPILOT_INVALID
            if is_vehicle and system_id is None:
                system_id = message.system_id
            if system_id is not None and message.system_id != system_id:
                if is_vehicle:
                    others.add(message.system_id)
            elif message.name == "HEARTBEAT":
                known = autopilot_by_mav_autopilot(int(fields["autopilot"]))
                if known is not None:
                    autopilot, kind = known, int(fields.get("type") or kind)
            elif message.name == "HOME_POSITION":
                home_m = fields["altitude"] * 1e-3
            elif message.name == "GLOBAL_POSITION_INT":
                system, stamp_ms = message.system_id, fields["time_boot_ms"]
                restarts[system] += stamp_ms < latest_ms.get(system, -math.inf) - _RESTARTED_MS
                latest_ms[system] = stamp_ms
                if reckoned_m is None and fields["lat"]:
                    reckoned_m = (fields["alt"] - fields["relative_alt"]) * 1e-3
                if len(boots_s) < _STAMPS and message.received_s > _DATED_S:
                    boots_s.append(message.received_s - fields["time_boot_ms"] * 1e-3)
        booted = datetime.fromtimestamp(median(boots_s), UTC) if boots_s else None
        return LogContext(
            autopilot,
            booted,
            reckoned_m if home_m is None else home_m,
            max(restarts.values(), default=0),
            kind,
            system_id,
            tuple(sorted(others)),
        )
