"""The telemetry of ArduPlane."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.arduplane.modes import Mode
from sidelong.sitl.protocol.telemetry import NAN, Builder, Telemetry

if TYPE_CHECKING:
    from sidelong.sitl.arduplane.vehicle import ArduPlane

# MAV_SYS_STATUS bits as the stock simulator sends them.
_PRESENT = 0x1261FC3F
_ENABLED = 0x1261803F
_HEALTHY = 0x1231803F
_HEALTHY_BEFORE_READY = 0x0211803F  # before the EKF and the pre-arm checks are content
_CONTROLLERS = 0x00007C00  # enabled and healthy once armed

# What REQUEST_DATA_STREAM turns on and off together.
_GROUPS: dict[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_MISSION_CURRENT,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
        mavlink.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
    ),
    mavlink.MAV_DATA_STREAM_POSITION: (
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_WIND,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
        mavlink.MAVLINK_MSG_ID_TERRAIN_REQUEST,
        mavlink.MAVLINK_MSG_ID_TERRAIN_REPORT,
    ),
}
_STREAMED = tuple(message_id for group in _GROUPS.values() for message_id in group)
DATA_STREAMS = _GROUPS | {mavlink.MAV_DATA_STREAM_ALL: _STREAMED}
DEFAULT_INTERVAL_S = dict.fromkeys((mavlink.MAVLINK_MSG_ID_HEARTBEAT, *_STREAMED), 1.0)


class ArduPlaneTelemetry(Telemetry):
    gps_fix = mavlink.GPS_FIX_TYPE_RTK_FIXED
    gps_dilution = (121, 200)
    gps_accuracy_mm = (300, 300, 0)
    home_quaternion = (NAN, NAN, NAN, NAN)
    parameter_capability = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST

    _vehicle: ArduPlane

    def builders(self) -> dict[int, Builder]:
        builders = super().builders() | {
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission_current,
            mavlink.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: self._nav_controller_output,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: self._position_target,
            mavlink.MAVLINK_MSG_ID_WIND: self._wind,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._ekf_status,
            mavlink.MAVLINK_MSG_ID_TERRAIN_REQUEST: self._terrain_request,
            mavlink.MAVLINK_MSG_ID_TERRAIN_REPORT: self._terrain_report,
        }
        if self._vehicle.release < (4, 6):  # no message of its own: it comes with each request for terrain
            del builders[mavlink.MAVLINK_MSG_ID_TERRAIN_REPORT]
        return builders

    def _sys_status(self) -> Any:
        controllers = _CONTROLLERS if self._vehicle.armed else 0
        healthy = _HEALTHY if self._vehicle.ready else _HEALTHY_BEFORE_READY
        return mavlink.MAVLink_sys_status_message(
            _PRESENT, _ENABLED | controllers, healthy | controllers, 0, 12600, 1000, self.battery_percent, *(0,) * 6
        )

    def _mission_current(self) -> Any:
        mission = self._vehicle.mission
        if self._vehicle.release < (4, 5):
            return mavlink.MAVLink_mission_current_message(mission.index)
        return mavlink.MAVLink_mission_current_message(
            mission.index,
            max(0, len(mission.items()) - 1),
            mission.reported_state,
            int(self._vehicle.mode == Mode.AUTO),
        )

    def _nav_controller_output(self) -> Any:
        plane, craft, navigator = self._vehicle, self._craft, self._vehicle.navigator
        goal, guidance = navigator.goal, navigator.guidance
        return mavlink.MAVLink_nav_controller_output_message(
            math.degrees(plane.roll_goal_rad),
            math.degrees(craft.pitch_rad),
            round(math.degrees(math.remainder(guidance.nav_bearing_rad, math.tau))),
            round(math.degrees(plane.here.bearing_rad(goal))),
            min(65535, round(goal.distance_m(craft))),
            plane.height_goal_m - craft.height_m,
            plane.airspeed_goal_m_s - craft.airspeed_m_s / plane.true_airspeed_ratio,
            guidance.cross_track_m,
        )

    def _position_target(self) -> Any:
        plane = self._vehicle
        if plane.mode not in (Mode.AUTO, Mode.GUIDED, Mode.LOITER, Mode.RTL) or not plane.armed:
            return None
        goal = plane.navigator.goal
        return mavlink.MAVLink_position_target_global_int_message(
            plane.boot_ms,
            mavlink.MAV_FRAME_GLOBAL,
            0xFDF8,  # only the position counts
            *self.place_e7(*goal.ground_m),
            self.altitude_m(goal.height_m),
            *(0.0,) * 8,
        )

    def _wind(self) -> Any:
        wind = self._craft.wind
        from_deg = math.degrees(math.atan2(-wind.east_m_s, -wind.north_m_s))
        return mavlink.MAVLink_wind_message(from_deg, math.hypot(wind.east_m_s, wind.north_m_s), 0.0)

    def _terrain_request(self) -> Any:
        terrain = self._vehicle.terrain
        if terrain is None:
            return None
        request = terrain.request(*self._place_deg)
        if self._vehicle.release >= (4, 6):
            return request
        return [*([] if request is None else [request]), self._terrain_report()]

    def _terrain_report(self) -> Any:
        terrain = self._vehicle.terrain
        return None if terrain is None else terrain.report(*self._place_deg, self.altitude_m(self._craft.height_m))

    @property
    def _place_deg(self) -> tuple[float, float]:
        return self._vehicle.plane.latitude_longitude_deg(self._craft.east_m, self._craft.north_m)

    def _ekf_status(self) -> Any:
        flags = 831 if self._vehicle.ready else 167  # position known absolutely, or only attitude
        return mavlink.MAVLink_ekf_status_report_message(flags, *(0.01,) * 5)
