"""Flight modes by name, from the heartbeat's custom_mode."""

from __future__ import annotations

from pymavlink import mavutil

AUTOPILOT_ARDUPILOT = int(mavutil.mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
AUTOPILOT_PX4 = int(mavutil.mavlink.MAV_AUTOPILOT_PX4)
AUTOPILOT_INVALID = int(mavutil.mavlink.MAV_AUTOPILOT_INVALID)
TYPE_FIXED_WING = int(mavutil.mavlink.MAV_TYPE_FIXED_WING)
ARMED_FLAG = int(mavutil.mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

_ARDUPLANE_MODES: dict[int, str] = dict(mavutil.mode_mapping_bynumber(TYPE_FIXED_WING))


def mode_name(autopilot: int, base_mode: int, custom_mode: int) -> str:
    """Return the mode as the autopilot's own documentation calls it (AUTO, RTL; MISSION, LOITER)."""
    if autopilot == AUTOPILOT_ARDUPILOT:
        return _ARDUPLANE_MODES.get(custom_mode, f"mode {custom_mode}")
    if autopilot == AUTOPILOT_PX4:
        return str(mavutil.interpret_px4_mode(base_mode, custom_mode))
    return f"mode {custom_mode}"
