"""The telemetry of PX4."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.protocol.telemetry import NAN, Builder, Telemetry
from sidelong.sitl.protocol.wire import Extended
from sidelong.sitl.px4.modes import BY_PILOT, Mode

if TYPE_CHECKING:
    from sidelong.sitl.px4.vehicle import Px4

# MAV_SYS_STATUS bits as the stock simulator sends them.
_PRESENT = 0x300403F
_ENABLED = 0x301403F
_HEALTHY = 0x1320C83F
_HEALTHY_BEFORE_READY = 0x0320C83F

_STANDARD_MODES: dict[int, int] = {
    Mode.MISSION: mavlink.MAV_STANDARD_MODE_MISSION,
    Mode.RTL: mavlink.MAV_STANDARD_MODE_SAFE_RECOVERY,
    Mode.LAND: mavlink.MAV_STANDARD_MODE_LAND,
    Mode.TAKEOFF: mavlink.MAV_STANDARD_MODE_TAKEOFF,
}
_DOWNWARD_MAX_M = 100.0
_DOWNWARD_BEYOND_CM = 65534

# A ground station's link; ranges as on a companion's.
DEFAULT_INTERVAL_S = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 1.0 / 15.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 0.1,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.2,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 0.25,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 0.2,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 2.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    mavlink.MAVLINK_MSG_ID_ORBIT_EXECUTION_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: 0.1,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_CURRENT_MODE: 2.0,
    mavlink.MAVLINK_MSG_ID_WIND_COV: 2.0,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_PING: 10.0,
}


class Px4Telemetry(Telemetry):
    gps_fix = mavlink.GPS_FIX_TYPE_3D_FIX
    gps_dilution = (70, 110)
    gps_accuracy_mm = (900, 1780, 400)
    home_quaternion = (1.0, 0.0, 0.0, 0.0)
    parameter_capability = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE

    _vehicle: Px4
    _pings = 0

    def builders(self) -> dict[int, Builder]:
        builders = super().builders() | {
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission_current,
            mavlink.MAVLINK_MSG_ID_ORBIT_EXECUTION_STATUS: self._orbit_status,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: self._position_target,
            mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: self._ranges,
            mavlink.MAVLINK_MSG_ID_CURRENT_MODE: self._current_mode,
            mavlink.MAVLINK_MSG_ID_WIND_COV: self._wind,
            mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: self._estimator_status,
            mavlink.MAVLINK_MSG_ID_PING: self._ping,
        }
        if self._vehicle.release < (1, 15):
            del builders[mavlink.MAVLINK_MSG_ID_CURRENT_MODE]
        return builders

    def _sys_status(self) -> Any:
        healthy = _HEALTHY if self._vehicle.ready else _HEALTHY_BEFORE_READY
        return mavlink.MAVLink_sys_status_message(
            _PRESENT, _ENABLED, healthy, 454, 16200, -1, self.battery_percent, *(0,) * 6
        )

    def _mission_current(self) -> Any:
        px4 = self._vehicle
        if px4.release < (1, 15):
            return mavlink.MAVLink_mission_current_message(px4.mission.index)
        fence_id, rally_id = (px4.transfers[kind].store.opaque_id() or 0 for kind in px4.mission_types[1:])
        base = mavlink.MAVLink_mission_current_message(
            px4.mission.index,
            len(px4.mission.items()) or 65535,
            px4.mission_state if px4.release >= (1, 17) else mavlink.MISSION_STATE_UNKNOWN,
            1 if px4.mode == Mode.MISSION else 2,
        )
        return Extended(base, px4.mission.mission_id, fence_id, rally_id)

    def _orbit_status(self) -> Any:
        circle = self._vehicle.navigator.circle
        if circle is None or not self._craft.flying:
            return None
        return mavlink.MAVLink_orbit_execution_status_message(
            self._vehicle.boot_us,
            circle.radius_m if circle.clockwise else -circle.radius_m,
            mavlink.MAV_FRAME_GLOBAL,
            *self.place_e7(*circle.centre.ground_m),
            self.altitude_m(circle.centre.height_m),
        )

    def _position_target(self) -> Any:
        px4 = self._vehicle
        if not self._craft.flying or px4.mode in BY_PILOT:
            return None
        goal = px4.navigator.goal
        return mavlink.MAVLink_position_target_global_int_message(
            px4.boot_ms,
            mavlink.MAV_FRAME_GLOBAL_INT,
            0,
            *self.place_e7(*goal.ground_m),
            self.altitude_m(goal.height_m),
            *(NAN,) * 8,
        )

    def _ranges(self) -> list[Any]:
        """Return its own downward sensor, and what another component last reported."""
        height_m = self._craft.height_m
        height_cm = round(height_m * 100.0) if height_m < _DOWNWARD_MAX_M else _DOWNWARD_BEYOND_CM
        downward = mavlink.MAVLink_distance_sensor_message(
            self._vehicle.boot_ms,
            0,
            round(_DOWNWARD_MAX_M * 100.0),
            height_cm,
            mavlink.MAV_DISTANCE_SENSOR_LASER,
            0,
            mavlink.MAV_SENSOR_ROTATION_PITCH_270,
            0,
        )
        relayed, self._vehicle.relayed_range = self._vehicle.relayed_range, None
        return [downward] if relayed is None else [downward, relayed]

    def _current_mode(self) -> Any:
        standard = _STANDARD_MODES.get(self._vehicle.mode, mavlink.MAV_STANDARD_MODE_NON_STANDARD)
        return mavlink.MAVLink_current_mode_message(standard, self._vehicle.mode, self._vehicle.mode)

    def _wind(self) -> Any:
        wind = self._craft.wind
        return mavlink.MAVLink_wind_cov_message(
            self._vehicle.boot_us,
            wind.north_m_s,
            wind.east_m_s,
            0.0,
            1.0,
            0.0,
            self.altitude_m(self._craft.height_m),
            0.0,
            0.0,
        )

    def _estimator_status(self) -> Any:
        flags = 831 if self._vehicle.ready else 167  # position known absolutely, or only attitude
        if self._vehicle.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND:
            flags |= mavlink.ESTIMATOR_CONST_POS_MODE  # at rest it is held
        return mavlink.MAVLink_estimator_status_message(self._vehicle.boot_us, flags, *(0.01,) * 6, 0.5, 0.8)

    def _ping(self) -> Any:
        self._pings += 1
        return mavlink.MAVLink_ping_message(self._vehicle.boot_us, self._pings, 0, 0)
