"""A payload's measurements as the MAVLink messages of a payload component, for any MAVLink receiver."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.message import DISTANCE_SENSOR_MAX_CM
from sidelong.app.payload.driver import AnglesMeasured, Frame, Measured

COMPONENT = mavlink.MAV_COMP_ID_GIMBAL
"""The component that a driver's messages come from: 154."""

_LOCKED = mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
_FLAGS: dict[Frame, int] = {
    "vehicle": _LOCKED | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME,
    "body": mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME,
    "earth": _LOCKED | mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME,
}
_SENSOR_ID = 1
_COVARIANCE_UNKNOWN = 255
_BOOT_MS_WRAP = 1 << 32


def fields_of(measured: Measured, vehicle_s: float) -> tuple[str, dict[str, Any]]:
    """Return name and fields of the message for a measurement, vehicle_s being its time on the vehicle's clock."""
    boot_ms = round(1000.0 * vehicle_s) % _BOOT_MS_WRAP
    if isinstance(measured, AnglesMeasured):
        return "GIMBAL_DEVICE_ATTITUDE_STATUS", {
            "target_system": 0,
            "target_component": 0,
            "time_boot_ms": boot_ms,
            "flags": _FLAGS[measured.frame],
            "q": list(measured.quaternion_wxyz),
            "angular_velocity_x": math.nan,
            "angular_velocity_y": math.nan,
            "angular_velocity_z": math.nan,
            "failure_flags": 0,
        }
    # A field of 16 bits limits what is sent to others, not what is flown by.
    centimetres = 100.0 * measured.slant_range_m
    return "DISTANCE_SENSOR", {
        "time_boot_ms": boot_ms,
        "min_distance": 0,
        "max_distance": max(DISTANCE_SENSOR_MAX_CM, math.floor(centimetres) + 1),
        "current_distance": centimetres,
        "type": mavlink.MAV_DISTANCE_SENSOR_LASER,
        "id": _SENSOR_ID,
        "orientation": mavlink.MAV_SENSOR_ROTATION_CUSTOM,
        "covariance": _COVARIANCE_UNKNOWN,
        "quaternion": [1.0, 0.0, 0.0, 0.0],
        "signal_quality": 0,
    }


def packed(name: str, fields: dict[str, Any], encoder: Any) -> bytes | None:
    """Return the message as bytes; None for a range beyond the 655 m that DISTANCE_SENSOR can carry."""
    if name == "DISTANCE_SENSOR":
        if fields["current_distance"] > DISTANCE_SENSOR_MAX_CM:
            return None
        fields = fields | {
            "current_distance": round(fields["current_distance"]),
            "max_distance": DISTANCE_SENSOR_MAX_CM,
        }
        message = mavlink.MAVLink_distance_sensor_message(**fields)
    else:
        message = mavlink.MAVLink_gimbal_device_attitude_status_message(**fields)
    data: bytes = message.pack(encoder)
    return data
