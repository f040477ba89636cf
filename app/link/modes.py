"""Numbers of the heartbeat that every autopilot shares, and flight modes by name."""

from __future__ import annotations

from pymavlink.dialects.v20 import all as dialect

from sidelong.app.autopilots.registry import autopilot_by_mav_autopilot

AUTOPILOT_INVALID = int(dialect.MAV_AUTOPILOT_INVALID)
TYPE_FIXED_WING = int(dialect.MAV_TYPE_FIXED_WING)
ARMED_FLAG = int(dialect.MAV_MODE_FLAG_SAFETY_ARMED)

FAILSAFE = "failsafe"
RECOVERY_MODES = ("RTL", "QRTL", "LAND", "QLAND", "AUTOLAND", "PRECLAND", "DESCEND", "TERMINATION", "AVOID_ADSB")
"""Modes out of which a flying aircraft is not taken without permission."""


def mode_name(mav_autopilot: int, base_mode: int, custom_mode: int) -> str:
    """Return the mode as the autopilot's own documentation calls it (AUTO, RTL; MISSION, LOITER)."""
    autopilot = autopilot_by_mav_autopilot(mav_autopilot)
    return f"mode {custom_mode}" if autopilot is None else autopilot.mode_name(base_mode, custom_mode)
