"""Mission time of one vehicle's clock, from the messages that report both."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Literal

from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT
from sidelong.mission.fleet.events import ClockReported

_UTC_SINCE_S = 1.5e9  # an earlier time is a clock that has not been set
_UTC_SIGMA_S = 0.02  # GPS time, stamped by the autopilot's main loop
_HOST_SIGMA_S = 0.1  # of this computer's clock against UTC
_ARRIVAL_SIGMA_S = 0.5
_UTC_VALID_S = 10.0
_UTC_AWAITED_S = 3.0  # at the beginning, before the answers to TIMESYNC are used
_ASKED_MAX_S = 10.0
_RATE_OVER_S, _RATE_OFF_MAX = 4.0, 0.2  # of the vehicle's clock; a clock that is set once passes for a while only
_WRAP_S = 2**32 * 1e-3  # time_boot_ms has 32 bits
_AGREES_S = 0.25  # in addition to half a round trip: the delay of a busy computer


class _SameRate:
    """Whether two clocks go equally fast, looked at over some seconds each time; ``unknown`` before the first."""

    def __init__(self, unknown: bool) -> None:
        self.holds = unknown
        self._first_s: tuple[float, float] | None = None

    def look(self, one_s: float, other_s: float) -> None:
        first_s, other_first_s = self._first_s or (one_s, other_s)
        passed_s = one_s - first_s
        if self._first_s is None or passed_s < 0.0:
            self._first_s = one_s, other_s
        elif passed_s > _RATE_OVER_S:
            self.holds = abs(other_s - other_first_s - passed_s) < _RATE_OFF_MAX * passed_s
            self._first_s = one_s, other_s


ToMissionTime = Callable[[Literal["utc", "host"], float], float]
"""Returns mission time for the time of a source: the vehicles' UTC, or this computer's clock."""


class VehicleClockReader:
    """Reads one vehicle's SYSTEM_TIME, which holds UTC and the vehicle's own clock; without UTC, its TIMESYNC.

    An answer to TIMESYNC reports the vehicle's clock as it was half a round trip ago, which is also the uncertainty.
    Without both, a position counts as measured when it was received. A simulator that runs faster than real time and
    still reports this computer's UTC can be compared with neither: its positions then count as measured at the
    mission time of the other vehicles. If no other vehicle has one, its own clock continues from its latest report.

    Args:
        name: The vehicle's name.
        now_s: Returns the time of its own clock, s.
        mission_s: Returns the mission time that the others have reached, s; NaN where they have none.
        to_mission_s: Converts the time of a source into mission time.
    """

    def __init__(
        self,
        name: str,
        now_s: Callable[[], float],
        mission_s: Callable[[], float] = lambda: math.nan,
        to_mission_s: ToMissionTime = lambda _source, time_s: time_s,
    ) -> None:
        self._name, self._now_s, self._mission_s, self._to_mission_s = name, now_s, mission_s, to_mission_s
        self._reported_s = time.monotonic()
        self._utc_received_s = self._reported_s + _UTC_AWAITED_S - _UTC_VALID_S
        self._utc_rate, self._host_rate = _SameRate(unknown=True), _SameRate(unknown=False)
        self._utc_offset_s: float | None = None  # from its own clock
        self._host_offset_s: tuple[float, float] | None = None  # of this computer's clock, and half a round trip
        self._utc_rejected, self._restarted = False, False
        self._reported_offset_s: float | None = None  # of mission time from its own clock
        self._leads = False

    @property
    def reports_time(self) -> bool:
        """Whether mission time may go by this clock: it does not hang on the others'."""
        return self._utc_rate.holds or self._leads

    @property
    def utc_ahead_s(self) -> tuple[float, float] | None:
        """How far its UTC is ahead of this computer's clock, s: least and greatest; None while unknown.

        The span is at least 0.5 s wide. If the spans of two vehicles on one computer do not overlap, one of them does
        not report UTC: its simulator lags, or its receiver does not know the leap seconds yet.
        """
        if self._utc_offset_s is None or self._host_offset_s is None or not self._host_rate.holds:
            return None
        offset_s, unknown_s = self._host_offset_s
        ahead_s = self._utc_offset_s - offset_s
        return ahead_s - unknown_s - _AGREES_S, ahead_s + unknown_s + _AGREES_S

    def doubt_utc(self) -> None:
        """Use the answers to TIMESYNC from now on, even where UTC is reported."""
        self._utc_rejected = self._restarted = True

    def report(self, message: Message) -> ClockReported | None:
        """Return the clock that a message reports, or None."""
        reported = self._report(message)
        if reported is not None:
            self._reported_offset_s = reported.mission_time_s - reported.time_s
        return reported

    def _report(self, message: Message) -> ClockReported | None:
        if message.component_id != AUTOPILOT_COMPONENT:
            return None
        fields, received_s = message.fields, time.monotonic()
        if message.name == "SYSTEM_TIME":
            utc_s = fields["time_unix_usec"] * 1e-6
            if utc_s < _UTC_SINCE_S:
                return None
            vehicle_s = self._unwrapped_s(fields["time_boot_ms"] * 1e-3)
            self._utc_rate.look(vehicle_s, utc_s)
            self._utc_offset_s = utc_s - vehicle_s
            if self._utc_rejected or not self._utc_rate.holds:
                return None
            self._utc_received_s = self._reported_s = received_s
            return ClockReported(self._name, vehicle_s, self._to_mission_s("utc", utc_s), _UTC_SIGMA_S)
        if not self._utc_rate.holds:
            return self._by_other_clocks(fields) if message.name == "GLOBAL_POSITION_INT" else None
        if message.name == "TIMESYNC" and fields["tc1"]:
            round_trip_s = received_s - fields["ts1"] * 1e-9
            if not 0.0 <= round_trip_s < _ASKED_MAX_S:
                return None  # the reply to another system's request
            half_s, vehicle_s = 0.5 * round_trip_s, self._unwrapped_s(math.fmod(fields["tc1"] * 1e-9, _WRAP_S))
            host_s = time.time() - half_s
            self._host_rate.look(vehicle_s, host_s)
            self._host_offset_s = host_s - vehicle_s, half_s
            if received_s - self._utc_received_s <= _UTC_VALID_S and not self._utc_rejected:
                return None
            self._reported_s = received_s
            restarted, self._restarted = self._restarted, False
            mission_s, sigma_s = self._to_mission_s("host", host_s), math.hypot(half_s, _HOST_SIGMA_S)
            return ClockReported(self._name, vehicle_s, mission_s, sigma_s, restarted)
        if message.name == "GLOBAL_POSITION_INT" and received_s - self._reported_s > _UTC_VALID_S:
            vehicle_s = self._unwrapped_s(fields["time_boot_ms"] * 1e-3)
            return ClockReported(self._name, vehicle_s, self._to_mission_s("host", time.time()), _ARRIVAL_SIGMA_S)
        return None

    def _by_other_clocks(self, fields: Mapping[str, Any]) -> ClockReported:
        vehicle_s = self._unwrapped_s(fields["time_boot_ms"] * 1e-3)
        # Two that went by each other would fall back by what each learns too late.
        mission_s = math.nan if self._leads else self._mission_s()
        if math.isnan(mission_s):
            self._leads = True
            if self._reported_offset_s is None:
                self._reported_offset_s = self._to_mission_s("host", time.time()) - vehicle_s
            mission_s = vehicle_s + self._reported_offset_s
        return ClockReported(self._name, vehicle_s, mission_s, _ARRIVAL_SIGMA_S)

    def _unwrapped_s(self, stamp_s: float) -> float:
        """Return a stamp of milliseconds in 32 bits on the vehicle's clock, which does not wrap around."""
        now_s = self._now_s()
        return stamp_s if not math.isfinite(now_s) else stamp_s + _WRAP_S * round((now_s - stamp_s) / _WRAP_S)
