"""What a vehicle's messages tell of its clock: when it was what time for everybody."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from app.link.message import Message
from app.link.telemetry import AUTOPILOT_COMPONENT
from mission.fleet.events import ClockReported

_UTC_SINCE_S = 1.5e9  # an earlier time is a clock that has not been set
_UTC_SIGMA_S = 0.02  # GPS time, stamped by the autopilot's main loop
_HOST_SIGMA_S = 0.1  # of this computer's clock against UTC
_ARRIVAL_SIGMA_S = 0.5
_UTC_VALID_S = 10.0
_ASKED_MAX_S = 10.0


class VehicleClockReader:
    """Hears one vehicle's SYSTEM_TIME, which tells UTC and its own clock at once; without UTC, its TIMESYNC.

    The answer to TIMESYNC tells its clock half a round trip ago: half of that is what is not known of it. Where there
    is neither, its positions count as made when they came.
    """

    def __init__(self, name: str, now_s: Callable[[], float]) -> None:
        self._name, self._now_s = name, now_s
        self._utc_heard_s = -math.inf
        self._told_s = time.monotonic()

    def report(self, message: Message) -> ClockReported | None:
        """Return what a message tells of the clock, None where it tells nothing."""
        if message.component_id != AUTOPILOT_COMPONENT:
            return None
        fields, heard_s = message.fields, time.monotonic()
        if message.name == "SYSTEM_TIME":
            utc_s = fields["time_unix_usec"] * 1e-6
            if utc_s < _UTC_SINCE_S:
                return None
            self._utc_heard_s = self._told_s = heard_s
            return ClockReported(self._name, self._unwrapped_s(fields["time_boot_ms"] * 1e-3), utc_s, _UTC_SIGMA_S)
        if message.name == "TIMESYNC" and fields["tc1"] and heard_s - self._utc_heard_s > _UTC_VALID_S:
            round_trip_s = heard_s - fields["ts1"] * 1e-9
            if not 0.0 <= round_trip_s < _ASKED_MAX_S:
                return None  # somebody else's question
            half_s = 0.5 * round_trip_s
            self._told_s = heard_s
            vehicle_s = self._unwrapped_s(math.fmod(fields["tc1"] * 1e-9, _WRAP_S))
            return ClockReported(self._name, vehicle_s, time.time() - half_s, math.hypot(half_s, _HOST_SIGMA_S))
        if message.name == "GLOBAL_POSITION_INT" and heard_s - self._told_s > _UTC_VALID_S:
            vehicle_s = self._unwrapped_s(fields["time_boot_ms"] * 1e-3)
            return ClockReported(self._name, vehicle_s, time.time(), _ARRIVAL_SIGMA_S)
        return None

    def _unwrapped_s(self, stamp_s: float) -> float:
        """Return a stamp of milliseconds in 32 bits on the vehicle's clock, which goes on where they begin anew."""
        now_s = self._now_s()
        return stamp_s if not math.isfinite(now_s) else stamp_s + _WRAP_S * round((now_s - stamp_s) / _WRAP_S)


_WRAP_S = 2**32 * 1e-3
