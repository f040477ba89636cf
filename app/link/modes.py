"""Flight modes by name, from the heartbeat's custom_mode."""

from __future__ import annotations

from functools import cache
from typing import Any

from pymavlink.dialects.v20 import common as dialect

AUTOPILOT_ARDUPILOT = int(dialect.MAV_AUTOPILOT_ARDUPILOTMEGA)
AUTOPILOT_PX4 = int(dialect.MAV_AUTOPILOT_PX4)
AUTOPILOT_INVALID = int(dialect.MAV_AUTOPILOT_INVALID)
TYPE_FIXED_WING = int(dialect.MAV_TYPE_FIXED_WING)
ARMED_FLAG = int(dialect.MAV_MODE_FLAG_SAFETY_ARMED)


@cache
def _mavutil() -> Any:
    """Return what knows the modes, when the first is named: it loads another dialect, and much else."""
    from pymavlink import mavutil  # noqa: PLC0415

    return mavutil


@cache
def _arduplane_modes() -> dict[int, str]:
    return dict(_mavutil().mode_mapping_bynumber(TYPE_FIXED_WING))


def mode_name(autopilot: int, base_mode: int, custom_mode: int) -> str:
    """Return the mode as the autopilot's own documentation calls it (AUTO, RTL; MISSION, LOITER)."""
    if autopilot == AUTOPILOT_ARDUPILOT:
        return _arduplane_modes().get(custom_mode, f"mode {custom_mode}")
    if autopilot == AUTOPILOT_PX4:
        return str(_mavutil().interpret_px4_mode(base_mode, custom_mode))
    return f"mode {custom_mode}"
