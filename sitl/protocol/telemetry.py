"""Telemetry that both autopilots send alike, made from the vehicle's state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

from pymavlink.dialects.v20 import all as mavlink

if TYPE_CHECKING:
    from sidelong.sitl.autopilot import Autopilot

NAN = math.nan

Builder = Callable[[], Any]  # a message, a list of messages, or None if there is no data


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


class Telemetry:
    """Builds messages; ``builders`` maps message ids to functions."""

    gps_fix: ClassVar[int]
    gps_dilution: ClassVar[tuple[int, int]]  # horizontal, vertical, times 100
    gps_accuracy_mm: ClassVar[tuple[int, int, int]]  # horizontal, vertical, speed
    home_quaternion: ClassVar[tuple[float, float, float, float]]
    parameter_capability: ClassVar[int]

    def __init__(self, vehicle: Autopilot) -> None:
        self._vehicle = vehicle
        self._craft = vehicle.craft

    def builders(self) -> dict[int, Builder]:
        return {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._attitude_quaternion,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_sys_state,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._version,
            mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION: self._gimbal_manager,
        }

    def _gimbal_manager(self) -> Any:
        """Return the limits of a gimbal that the autopilot manages; None if it pans all around."""
        settings = self._vehicle.settings
        if settings.payload is None or settings.device or settings.payload.pan_limit_deg >= 180.0:
            return None
        pan_rad, pitch_rad = math.radians(settings.payload.pan_limit_deg), 0.5 * math.pi
        flags = mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_AXIS
        return mavlink.MAVLink_gimbal_manager_information_message(
            self._vehicle.boot_ms, flags, 1, 0.0, 0.0, -pitch_rad, 0.0, -pan_rad, pan_rad
        )

    @property
    def battery_percent(self) -> int:
        return max(5, 100 - int(100.0 * self._vehicle.now_s / self._vehicle.settings.endurance_s))

    def _heartbeat(self) -> Any:
        vehicle = self._vehicle
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_FIXED_WING,
            vehicle.autopilot_id,
            vehicle.base_mode,
            vehicle.mode,
            mavlink.MAV_STATE_ACTIVE if self._craft.flying else mavlink.MAV_STATE_STANDBY,
            3,
        )

    def _system_time(self) -> Any:
        vehicle = self._vehicle
        unix_us = int((vehicle.settings.boot_unix_s + vehicle.now_s) * 1e6)
        return mavlink.MAVLink_system_time_message(unix_us, vehicle.boot_ms)

    def _attitude(self) -> Any:
        craft = self._craft
        return mavlink.MAVLink_attitude_message(
            self._vehicle.boot_ms,
            craft.roll_rad,
            craft.pitch_rad,
            math.remainder(craft.heading_rad, math.tau),
            *self._body_rates_rad_s(),
        )

    def _attitude_quaternion(self) -> Any:
        craft = self._craft
        return mavlink.MAVLink_attitude_quaternion_message(
            self._vehicle.boot_ms,
            *quaternion(craft.roll_rad, craft.pitch_rad, craft.heading_rad),
            *self._body_rates_rad_s(),
        )

    def _body_rates_rad_s(self) -> tuple[float, float, float]:
        craft = self._craft
        return (
            craft.roll_rate_rad_s,
            craft.yaw_rate_rad_s * math.sin(craft.roll_rad),
            craft.yaw_rate_rad_s * math.cos(craft.roll_rad),
        )

    def place_e7(self, east_m: float, north_m: float) -> tuple[int, int]:
        latitude_deg, longitude_deg = self._vehicle.plane.latitude_longitude_deg(east_m, north_m)
        return round(latitude_deg * 1e7), round(longitude_deg * 1e7)

    def altitude_m(self, height_m: float) -> float:
        return self._vehicle.home.altitude_m + height_m

    def _global_position(self) -> Any:
        craft = self._craft
        return mavlink.MAVLink_global_position_int_message(
            self._vehicle.boot_ms,
            *self.place_e7(craft.east_m, craft.north_m),
            round(self.altitude_m(craft.height_m) * 1000.0),
            round(craft.height_m * 1000.0),
            round(craft.velocity_north_m_s * 100.0),
            round(craft.velocity_east_m_s * 100.0),
            round(-craft.climb_m_s * 100.0),
            round(math.degrees(craft.heading_rad) * 100.0) % 36000,
        )

    def _local_position(self) -> Any:
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

    def _vfr_hud(self) -> Any:
        vehicle, craft = self._vehicle, self._craft
        return mavlink.MAVLink_vfr_hud_message(
            craft.airspeed_m_s / vehicle.true_airspeed_ratio,
            craft.ground_speed_m_s,
            round(math.degrees(craft.heading_rad)) % 360,
            45 if craft.flying else 100 if vehicle.lifting_off else 0,
            self.altitude_m(craft.height_m),
            craft.climb_m_s,
        )

    def _gps_raw(self) -> Any:
        craft = self._craft
        altitude_mm = round(self.altitude_m(craft.height_m) * 1000.0)
        return mavlink.MAVLink_gps_raw_int_message(
            self._vehicle.boot_us,
            self.gps_fix,
            *self.place_e7(craft.east_m, craft.north_m),
            altitude_mm,
            *self.gps_dilution,
            round(craft.ground_speed_m_s * 100.0),
            round(math.degrees(craft.course_rad) * 100.0) % 36000,
            10,
            altitude_mm,
            *self.gps_accuracy_mm,
        )

    def _home_position(self) -> Any:
        vehicle = self._vehicle
        if not vehicle.home_known:
            return None
        return mavlink.MAVLink_home_position_message(
            *self.place_e7(0.0, 0.0),
            round(vehicle.home.altitude_m * 1000.0),
            *(0.0,) * 3,
            list(self.home_quaternion),
            *(0.0,) * 3,
            vehicle.boot_us,
        )

    def _extended_sys_state(self) -> Any:
        return mavlink.MAVLink_extended_sys_state_message(
            mavlink.MAV_VTOL_STATE_UNDEFINED, self._vehicle.landed_state
        )

    def _battery(self) -> Any:
        return mavlink.MAVLink_battery_status_message(
            0,
            mavlink.MAV_BATTERY_FUNCTION_ALL,
            mavlink.MAV_BATTERY_TYPE_LIPO,
            32767,
            [16200] + [65535] * 9,
            1000,
            0,
            -1,
            self.battery_percent,
        )

    def _version(self) -> Any:
        capabilities = (
            self.parameter_capability
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
            | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        )
        major, minor = self._vehicle.release
        version = major << 24 | minor << 16 | mavlink.FIRMWARE_VERSION_TYPE_OFFICIAL
        unnamed = [0] * 8
        return mavlink.MAVLink_autopilot_version_message(
            capabilities, version, 0, 0, 0, unnamed, unnamed, unnamed, 0, 0, self._vehicle.system_id
        )
