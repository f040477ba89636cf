"""Status of the vehicle and its links, for display only. No decision depends on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sidelong.app.link.message import Message
from sidelong.app.link.quality import LinkReport
from sidelong.mission.control.alarms import Alarm

_FIXES = ("no GPS", "no fix", "2D", "3D", "DGPS", "RTK float", "RTK fixed", "static", "PPP")  # GPS_FIX_TYPE
_GOOD_FROM, _MIN_SATELLITES = 3, 6
_UNKNOWN_SATELLITES, _UNKNOWN_MV = 255, 65535


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """Status values; None: not reported.

    gps: the fix in words. link_percent: share of the frames sent to this station that arrived over the link in use;
    round_trip_s: its round-trip time. endurance_s: flight time left until the battery's reserve; home_s: to home.
    home_m: home in the local plane, east and north.
    alarms: those that are raised.
    """

    battery_percent: int | None = None
    battery_v: float | None = None
    gps: str | None = None
    gps_good: bool | None = None
    link_percent: int | None = None
    round_trip_s: float | None = None
    endurance_s: float | None = None
    home_s: float | None = None
    home_m: tuple[float, float] | None = None
    alarms: tuple[Alarm, ...] = ()


def vehicle_status(latest: Mapping[str, Message], links: Sequence[LinkReport]) -> VehicleStatus:
    """Return the status by the autopilot's latest messages and the links' present measures."""
    power, fix = latest.get("SYS_STATUS"), latest.get("GPS_RAW_INT")
    percent = mv = gps = good = None
    if power is not None:
        percent, mv = int(power.fields["battery_remaining"]), int(power.fields["voltage_battery"])
    battery = latest.get("BATTERY_STATUS")
    if (percent is None or percent < 0) and battery is not None:
        percent = int(battery.fields["battery_remaining"])
    if fix is not None:
        kind, satellites = int(fix.fields["fix_type"]), int(fix.fields["satellites_visible"])
        known = satellites != _UNKNOWN_SATELLITES
        gps = _FIXES[kind] if kind < len(_FIXES) else f"fix type {kind}"
        gps += f", {satellites} satellites" if known else ""
        good = kind >= _GOOD_FROM and (not known or satellites >= _MIN_SATELLITES)
    used = next((link.measured for link in links if link.in_use), None)
    return VehicleStatus(
        percent if percent is not None and percent >= 0 else None,
        None if mv in (None, 0, _UNKNOWN_MV) else mv * 1e-3,
        gps,
        good,
        None if used is None or used.loss is None else round(100.0 * (1.0 - used.loss)),
        None if used is None else used.round_trip_s,
    )
