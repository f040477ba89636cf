"""Telemetry that both autopilots send alike, made from the vehicle's state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sitl.autopilot import Autopilot

NAN = math.nan


def common_builders(vehicle: Autopilot) -> dict[int, Callable[[], Any]]:
    """Return what makes each message, by message id."""
    telemetry = _Telemetry(vehicle)
    return {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT: telemetry.heartbeat,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: telemetry.system_time,
        mavlink.MAVLINK_MSG_ID_ATTITUDE: telemetry.attitude,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: telemetry.attitude_quaternion,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: telemetry.global_position,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: telemetry.local_position,
        mavlink.MAVLINK_MSG_ID_VFR_HUD: telemetry.vfr_hud,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: telemetry.extended_sys_state,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: telemetry.battery,
    }


def quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> tuple[float, float, float, float]:
    """Return (w, x, y, z) of yaw, then pitch, then roll."""
    cr, sr = math.cos(roll_rad / 2), math.sin(roll_rad / 2)
    cp, sp = math.cos(pitch_rad / 2), math.sin(pitch_rad / 2)
    cy, sy = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


class _Telemetry:
    def __init__(self, vehicle: Autopilot) -> None:
        self._vehicle = vehicle
        self._craft = vehicle.craft

    def heartbeat(self) -> Any:
        vehicle = self._vehicle
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_FIXED_WING,
            vehicle.autopilot_id,
            vehicle.base_mode,
            vehicle.mode,
            mavlink.MAV_STATE_ACTIVE if vehicle.craft.flying else mavlink.MAV_STATE_STANDBY,
            3,
        )

    def system_time(self) -> Any:
        vehicle = self._vehicle
        unix_us = int((vehicle.settings.boot_unix_s + vehicle.now_s) * 1e6)
        return mavlink.MAVLink_system_time_message(unix_us, vehicle.boot_ms)

    def attitude(self) -> Any:
        craft = self._craft
        return mavlink.MAVLink_attitude_message(
            self._vehicle.boot_ms,
            craft.roll_rad,
            craft.pitch_rad,
            math.remainder(craft.heading_rad, math.tau),
            *self._body_rates_rad_s(),
        )

    def attitude_quaternion(self) -> Any:
        craft = self._craft
        return mavlink.MAVLink_attitude_quaternion_message(
            self._vehicle.boot_ms,
            *quaternion(craft.roll_rad, craft.pitch_rad, craft.heading_rad),
            *self._body_rates_rad_s(),
            [0.0, 0.0, 0.0, 0.0],
        )

    def _body_rates_rad_s(self) -> tuple[float, float, float]:
        craft = self._craft
        return (
            craft.roll_rate_rad_s,
            craft.yaw_rate_rad_s * math.sin(craft.roll_rad),
            craft.yaw_rate_rad_s * math.cos(craft.roll_rad),
        )

    def global_position(self) -> Any:
        vehicle, craft = self._vehicle, self._craft
        latitude_deg, longitude_deg = vehicle.plane.latitude_longitude_deg(craft.east_m, craft.north_m)
        return mavlink.MAVLink_global_position_int_message(
            vehicle.boot_ms,
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            round((vehicle.home.altitude_m + craft.height_m) * 1000.0),
            round(craft.height_m * 1000.0),
            round(craft.velocity_north_m_s * 100.0),
            round(craft.velocity_east_m_s * 100.0),
            round(-craft.climb_m_s * 100.0),
            round(math.degrees(craft.heading_rad) * 100.0) % 36000,
        )

    def local_position(self) -> Any:
        craft = self._craft
        return mavlink.MAVLink_local_position_ned_message(
            self._vehicle.boot_ms,
            craft.north_m,
            craft.east_m,
            -craft.height_m,
            craft.velocity_north_m_s,
            craft.velocity_east_m_s,
            -craft.climb_m_s,
        )

    def vfr_hud(self) -> Any:
        vehicle, craft = self._vehicle, self._craft
        return mavlink.MAVLink_vfr_hud_message(
            craft.airspeed_m_s / vehicle.true_airspeed_ratio,
            craft.ground_speed_m_s,
            round(math.degrees(craft.heading_rad)) % 360,
            (45 if craft.flying else 100 if vehicle.lifting_off else 0),
            vehicle.home.altitude_m + craft.height_m,
            craft.climb_m_s,
        )

    def extended_sys_state(self) -> Any:
        return mavlink.MAVLink_extended_sys_state_message(
            mavlink.MAV_VTOL_STATE_UNDEFINED, self._vehicle.landed_state
        )

    def battery(self) -> Any:
        return mavlink.MAVLink_battery_status_message(
            0,
            mavlink.MAV_BATTERY_FUNCTION_ALL,
            mavlink.MAV_BATTERY_TYPE_LIPO,
            32767,
            [16200] + [65535] * 9,
            1000,
            0,
            -1,
            self.battery_percent(self._vehicle),
        )

    @staticmethod
    def battery_percent(vehicle: Autopilot) -> int:
        """Run down in three hours."""
        return max(5, 100 - int(vehicle.now_s / 108.0))
