"""A simulated PX4 with a fixed wing as a ground program meets it: modes, mission, guidance, commands, failsafe.

Guidance is a nonlinear path follower with the path's curvature fed forward, after T. Stastny, R. Siegwart, "On Flying
Backwards: Preventing Run-away of Small, Low-speed, Fixed-wing UAVs in Strong Winds", IROS 2019: the bearing blends
from straight at the path (far away) to along it (on it).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, ClassVar

from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.autopilot import NAN, AutopilotTelemetry, SimulatedAutopilot
from sidelong.sitl.protocol.commands import ACCEPTED, DENIED, FAILED, REJECTED, UNSUPPORTED, Command
from sidelong.sitl.protocol.parameters import INT32, REAL32, Parameters
from sidelong.sitl.protocol.radio import Extended, Station
from sidelong.sitl.protocol.transfer import (
    ACCEPTED_ITEMS,
    RELATIVE_FRAMES,
    Item,
    ItemRefused,
    Store,
    TransferQuirks,
    checksum,
)
from sidelong.sitl.settings import HomePosition, Settings
from sidelong.sitl.world.airframe import GRAVITY_M_S2, AirframeParameters, LocalPosition, SimulatedAirframe
from sidelong.sitl.world.geodesy import HomePlane


class PathFollower:
    def __init__(self, period_s: float = 10.0, damping: float = 0.7071) -> None:
        self.period_s, self.damping = period_s, damping

    def towards_line(
        self, craft: SimulatedAirframe, start_m: tuple[float, float], end_m: tuple[float, float]
    ) -> float:
        """Return the lateral acceleration, m/s^2, to the right, that joins and follows a line through two points."""
        tangent_rad = math.atan2(end_m[0] - start_m[0], end_m[1] - start_m[1])
        sine, cosine = math.sin(tangent_rad), math.cos(tangent_rad)
        right_m = (craft.east_m - end_m[0]) * cosine - (craft.north_m - end_m[1]) * sine
        return self._follow(craft, tangent_rad, right_m, curvature_per_m=0.0)

    def towards_circle(
        self, craft: SimulatedAirframe, centre_m: tuple[float, float], radius_m: float, clockwise: bool
    ) -> float:
        """Return the lateral acceleration, m/s^2, to the right, that joins and follows the circle."""
        east_m, north_m = craft.east_m - centre_m[0], craft.north_m - centre_m[1]
        distance_m = math.hypot(east_m, north_m)
        outward_rad = math.atan2(east_m, north_m) if distance_m > 0.1 else craft.course_rad
        turn = 1.0 if clockwise else -1.0
        tangent_rad = outward_rad + turn * math.pi / 2
        return self._follow(craft, tangent_rad, -turn * (distance_m - radius_m), turn / max(1.0, distance_m))

    def _follow(self, craft: SimulatedAirframe, tangent_rad: float, right_m: float, curvature_per_m: float) -> float:
        """right_m: how far the craft is to the right of the path."""
        speed_m_s = max(1.0, craft.ground_speed_m_s)
        bound_m = speed_m_s * self.period_s * self.damping
        closeness = 1.0 - min(1.0, abs(right_m) / bound_m)
        look_ahead_rad = math.pi / 2 * closeness**2  # 90 degrees: along the path
        lean_rad = math.pi / 2 - look_ahead_rad
        heading_rad, turn_ratio = self._heading_for(craft, tangent_rad - math.copysign(lean_rad, right_m))
        error_rad = math.remainder(heading_rad - craft.heading_rad, math.tau)
        gain_per_s = 4.0 * math.pi * self.damping / self.period_s
        correction = math.copysign(1.0, error_rad) if abs(error_rad) > math.pi / 2 else math.sin(error_rad)
        on_path_rad_s = curvature_per_m * speed_m_s * math.sin(look_ahead_rad) ** 2
        return craft.airspeed_m_s * (gain_per_s * correction + turn_ratio * on_path_rad_s)

    @staticmethod
    def _heading_for(craft: SimulatedAirframe, course_rad: float) -> tuple[float, float]:
        """Return the heading that makes good the course in this wind, and d(heading) / d(course)."""
        wind, airspeed_m_s = craft.wind, craft.airspeed_m_s
        sine, cosine = math.sin(course_rad), math.cos(course_rad)
        cross_m_s = wind.east_m_s * cosine - wind.north_m_s * sine  # wind to the right of the course
        along_m_s = wind.east_m_s * sine + wind.north_m_s * cosine
        drift_rad = math.asin(max(-0.95, min(0.95, cross_m_s / airspeed_m_s)))
        return course_rad - drift_rad, 1.0 + along_m_s / (airspeed_m_s * math.cos(drift_rad))


@dataclass(frozen=True, slots=True)
class LoiterGoal:
    centre: LocalPosition
    radius_m: float
    clockwise: bool


class Px4Navigator:
    def __init__(self, craft: SimulatedAirframe, parameters: Parameters) -> None:
        self._craft, self._parameters = craft, parameters
        self.follower = PathFollower()
        self.goal = LocalPosition(0.0, 0.0, 0.0)
        self._origin: LocalPosition | None = None  # of the leg; None: it leads from wherever the aircraft is
        self.circle: LoiterGoal | None = None
        self._inside_since_s: float | None = None

    def go_to(self, goal: LocalPosition, *, from_here: bool) -> None:
        """Make ``goal`` the end of the leg that begins where the last one ended, or of no leg at all."""
        self._origin = None if from_here else self.goal
        self.goal, self.circle, self._inside_since_s = goal, None, None

    def fly_around(self, centre: LocalPosition, signed_radius_m: float = math.nan) -> None:
        """Circle: positive clockwise; 0 or no number for the parameter's radius."""
        if not math.isfinite(signed_radius_m) or signed_radius_m == 0.0:
            signed_radius_m = self._parameters["NAV_LOITER_RAD"]
        self.goal, self._inside_since_s = centre, None
        self.circle = LoiterGoal(centre, abs(signed_radius_m), signed_radius_m > 0.0)

    def at_height(self) -> bool:
        """Whether the goal's height is reached, by NAV_FW_ALT_RAD."""
        return abs(self._craft.height_m - self.goal.height_m) < self._parameters["NAV_FW_ALT_RAD"]

    def fly_leg(self) -> tuple[bool, float]:
        """Return whether the waypoint is reached, and the lateral acceleration; waits there for its height.

        An item's own acceptance radius is not heeded. One that no leg leads to is not passed but orbited.
        """
        if self.circle is not None:
            return self.at_height(), self.fly_circle()
        lateral_m_s2 = self.fly_line()
        if self.goal.distance_m(self._craft) > self._parameters["NAV_ACC_RAD"] and not self._beyond_goal():
            return False, lateral_m_s2
        if not self.at_height():
            self.fly_around(self.goal)
            return False, lateral_m_s2
        return True, lateral_m_s2

    def fly_line(self) -> float:
        """Return the lateral acceleration that follows the leg to the goal, m/s^2; 0 on the ground."""
        if not self._craft.flying:
            return 0.0
        self._tune()
        origin = self._origin or LocalPosition.of(self._craft)
        return self.follower.towards_line(self._craft, origin.ground_m, self.goal.ground_m)

    def fly_circle(self) -> float:
        """Return the lateral acceleration that follows the circle, m/s^2; 0 on the ground and without a circle."""
        circle = self.circle
        if circle is None or not self._craft.flying:
            return 0.0
        self._tune()
        # A circle tighter than the roll limit allows is silently flown wider.
        limit_m_s2 = GRAVITY_M_S2 * math.tan(math.radians(self._parameters.within("FW_R_LIM", 5.0, 80.0)))
        radius_m = max(circle.radius_m, self._craft.airspeed_m_s**2 / limit_m_s2)
        return self.follower.towards_circle(self._craft, circle.centre.ground_m, radius_m, circle.clockwise)

    def inside_for_s(self, now_s: float) -> float | None:
        """Return how long the circle has been flown, None while it is not yet reached."""
        circle = self.circle
        if circle is None:
            return None
        if self._inside_since_s is None:
            if circle.centre.distance_m(self._craft) > circle.radius_m + self._parameters["NAV_ACC_RAD"]:
                return None
            self._inside_since_s = now_s
        return now_s - self._inside_since_s

    def _beyond_goal(self) -> bool:
        """Whether the line through the goal, square to the leg, is passed."""
        if self._origin is None:
            return False
        course_rad = self._origin.bearing_rad(self.goal)
        east_m, north_m = self._craft.east_m - self.goal.east_m, self._craft.north_m - self.goal.north_m
        return east_m * math.sin(course_rad) + north_m * math.cos(course_rad) > 0.0

    def _tune(self) -> None:
        self.follower.period_s = self._parameters.within("NPFG_PERIOD", 1.0, 100.0)
        self.follower.damping = self._parameters.within("NPFG_DAMPING", 0.1, 2.0)


TAKEOFF = mavlink.MAV_CMD_NAV_TAKEOFF
LAND = mavlink.MAV_CMD_NAV_LAND
NAVIGATION = {
    mavlink.MAV_CMD_NAV_WAYPOINT,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM,
    mavlink.MAV_CMD_NAV_LOITER_TIME,
    mavlink.MAV_CMD_NAV_LOITER_TO_ALT,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,
    LAND,
    TAKEOFF,
}
_LANDING_ANGLE_SPARE_DEG = 0.1
_IMMEDIATE = {mavlink.MAV_CMD_DO_CHANGE_SPEED, mavlink.MAV_CMD_DO_LAND_START}


class Px4Mission(Store):
    """Storage; ``on_swap`` is called when other items have come."""

    def __init__(self, on_swap: Callable[[], None]) -> None:
        super().__init__(with_checksum=True)
        self._on_swap = on_swap
        self._arriving_current: int | None = None
        self.mission_id = self.index = 0

    def current_index(self) -> int:
        return self.index

    def opaque_id(self) -> int:
        return self.mission_id

    def begin(self, count: int) -> int:
        self._arriving_current = None
        return super().begin(count)

    def put(self, index: int, item: Item, current: bool) -> None:
        super().put(index, as_stored(item), current)
        if current:
            self._arriving_current = index

    def finish(self) -> int:
        arrived_id = checksum(self._arriving)
        if arrived_id != self.mission_id:
            self._items, self.mission_id = self._arriving, arrived_id
            if self._arriving_current is not None:
                self.index = self._arriving_current
            self.index = min(self.index, len(self._items) - 1)
            self._on_swap()
        self._arriving = []
        return ACCEPTED_ITEMS

    def clear(self) -> int:
        self._items, self.mission_id, self.index = [], 0, 0
        self._on_swap()
        return ACCEPTED_ITEMS


def as_stored(item: Item) -> Item:
    """Return the item as PX4 gives it back. Raises ItemRefused."""
    first, second, third, fourth = item.params
    match item.command:
        case mavlink.MAV_CMD_NAV_WAYPOINT:
            params = (first, second, 0.0, _compass_deg(fourth))
        case mavlink.MAV_CMD_NAV_LOITER_UNLIM:
            params = (0.0, 0.0, third, _compass_deg(fourth))
        case mavlink.MAV_CMD_NAV_LOITER_TIME:
            params = (first, float(second > 0), third, float(fourth > 0))
        case mavlink.MAV_CMD_NAV_LOITER_TO_ALT:
            params = (float(first > 0), second, 0.0, float(fourth > 0))
        case mavlink.MAV_CMD_NAV_TAKEOFF:
            params = (0.0, 0.0, 0.0, _compass_deg(fourth))
        case mavlink.MAV_CMD_NAV_LAND:
            params = (0.0, second, 0.0, _compass_deg(fourth))
        case command if command in _IMMEDIATE or command == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return item
        case _:
            raise ItemRefused(mavlink.MAV_MISSION_UNSUPPORTED)
    if not item.has_position:
        raise ItemRefused(mavlink.MAV_MISSION_UNSUPPORTED_FRAME)
    relative = item.frame in RELATIVE_FRAMES
    frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT if relative else mavlink.MAV_FRAME_GLOBAL_INT
    return Item(item.command, frame, params, item.latitude_e7, item.longitude_e7, item.altitude_m, item.autocontinue)


def refusal(
    items: list[Item], home: HomePosition, takeoff_land_required: int, landing_angle_deg: float = 5.0
) -> str | None:
    """Return why a mission cannot be flown, by MIS_TKO_LAND_REQ and FW_LND_ANG; None if it can."""
    commands = [item.command for item in items]
    if not any(command in NAVIGATION for command in commands):
        return "No valid mission available"
    has_takeoff, has_land = TAKEOFF in commands, LAND in commands
    if commands.count(mavlink.MAV_CMD_DO_LAND_START) > 1:
        return "Mission rejected: more than one land start."
    if has_land and (reason := _landing_refusal(items, commands.index(LAND), home, landing_angle_deg)) is not None:
        return reason
    required = {
        1: (has_takeoff, "Mission rejected: Takeoff waypoint required."),
        2: (has_land, "Mission rejected: Landing waypoint/pattern required."),
        3: (has_takeoff and has_land, "Mission rejected: Takeoff or Landing item missing."),
        4: (has_takeoff == has_land, "Mission rejected: Add Takeoff and Landing item or remove both."),
    }
    met, text = required.get(takeoff_land_required, (True, ""))
    return None if met else text


def _landing_refusal(items: list[Item], index: int, home: HomePosition, landing_angle_deg: float) -> str | None:
    """Return why a plane cannot land at item ``index``: what leads there must be flat, and outside of its circle."""
    if index == 0:
        return "Mission rejected: starts with land waypoint."
    entrance, land = items[index - 1], items[index]
    if not entrance.has_position:
        return None
    height_m, land_m = (i.altitude_m - (i.frame not in RELATIVE_FRAMES) * home.altitude_m for i in (entrance, land))
    if height_m <= land_m:
        return "Mission rejected: the approach waypoint must be above the landing point."
    if entrance.command not in (mavlink.MAV_CMD_NAV_LOITER_TO_ALT, mavlink.MAV_CMD_NAV_WAYPOINT):
        return "Mission rejected: unsupported landing approach entrance waypoint type."
    plane = HomePlane(land.latitude_deg, land.longitude_deg)
    run_m = math.hypot(*plane.east_north_m(entrance.latitude_deg, entrance.longitude_deg))
    if entrance.command == mavlink.MAV_CMD_NAV_LOITER_TO_ALT:
        radius_m = abs(entrance.params[1])
        if run_m <= radius_m:
            return "Mission rejected: the landing point must be outside the orbit radius."
        run_m = math.sqrt(run_m**2 - radius_m**2)  # it leaves the circle along the tangent
    if height_m - land_m <= run_m * math.tan(math.radians(landing_angle_deg + _LANDING_ANGLE_SPARE_DEG)):
        return None
    limit = f"the vehicle setting of {landing_angle_deg:.1f} degrees."
    return f"Mission rejected: the landing glide slope is steeper than {limit}"


def _compass_deg(angle_deg: float) -> float:
    return angle_deg if math.isnan(angle_deg) else angle_deg % 360.0


def custom_mode(main: int, sub: int = 0) -> int:
    """Return PX4's custom mode of a main and a sub mode."""
    return main << 16 | sub << 24


class Px4Mode(IntEnum):
    MANUAL = custom_mode(1)
    ALTCTL = custom_mode(2)
    POSCTL = custom_mode(3)
    TAKEOFF = custom_mode(4, 2)
    HOLD = custom_mode(4, 3)
    MISSION = custom_mode(4, 4)
    RTL = custom_mode(4, 5)
    LAND = custom_mode(4, 6)
    STABILIZED = custom_mode(7)


class LinkLost(mavlink.MAVLink_message):  # type: ignore[misc]  # pymavlink has no types
    """EVENT, unknown to pymavlink, with commander_failsafe_enter_hold: "GCS connection loss", RTL after a delay."""

    crc_extra = 160

    def __init__(self, time_boot_ms: int, delay_s: float) -> None:
        super().__init__(410, "EVENT")
        self._arguments = struct.pack("<IBHB", Px4Mode.MISSION, 6, round(delay_s), 2)
        self._time_boot_ms = time_boot_ms

    def pack(self, packer: Any) -> bytes:
        """Return the EVENT message, which pymavlink's dialect lacks, as a frame."""
        body = struct.pack("<IIHBBB40s", 0x1D11DF6, self._time_boot_ms, 1, 0, 0, 0x42, self._arguments)
        return bytes(self._pack(packer, self.crc_extra, body))


# MAV_SYS_STATUS bits as the stock simulator sends them.
_PRESENT = 0x300403F
_ENABLED = 0x301403F
_HEALTHY = 0x1320C83F
_HEALTHY_BEFORE_READY = 0x0320C83F

_STANDARD_MODES: dict[int, int] = {
    Px4Mode.MISSION: mavlink.MAV_STANDARD_MODE_MISSION,
    Px4Mode.RTL: mavlink.MAV_STANDARD_MODE_SAFE_RECOVERY,
    Px4Mode.LAND: mavlink.MAV_STANDARD_MODE_LAND,
    Px4Mode.TAKEOFF: mavlink.MAV_STANDARD_MODE_TAKEOFF,
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


class Px4Telemetry(AutopilotTelemetry):
    gps_fix = mavlink.GPS_FIX_TYPE_3D_FIX
    gps_dilution = (70, 110)
    gps_accuracy_mm = (900, 1780, 400)
    home_quaternion = (1.0, 0.0, 0.0, 0.0)
    parameter_capability = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    since_release: ClassVar = {mavlink.MAVLINK_MSG_ID_CURRENT_MODE: (1, 15)}

    _vehicle: SimulatedPx4
    _pings = 0

    def sys_status(self) -> Any:
        healthy = _HEALTHY if self._vehicle.ready else _HEALTHY_BEFORE_READY
        return mavlink.MAVLink_sys_status_message(
            _PRESENT, _ENABLED, healthy, 454, 16200, -1, self.battery_percent, *(0,) * 6
        )

    def mission_current(self) -> Any:
        px4 = self._vehicle
        if px4.release < (1, 15):
            return mavlink.MAVLink_mission_current_message(px4.mission.index)
        fence_id, rally_id = (px4.transfers[kind].store.opaque_id() or 0 for kind in (1, 2))
        state = px4.mission_state if px4.release >= (1, 17) else mavlink.MISSION_STATE_UNKNOWN
        flies, total = 1 if px4.mode == Px4Mode.MISSION else 2, len(px4.mission.items()) or 65535
        base = mavlink.MAVLink_mission_current_message(px4.mission.index, total, state, flies)
        return Extended(base, px4.mission.mission_id, fence_id, rally_id)

    def orbit_execution_status(self) -> Any:
        circle = self._vehicle.navigator.circle
        if circle is None or not self._craft.flying:
            return None
        radius_m = circle.radius_m if circle.clockwise else -circle.radius_m
        place = *self.place_e7(*circle.centre.ground_m), self.altitude_m(circle.centre.height_m)
        return mavlink.MAVLink_orbit_execution_status_message(
            self._vehicle.boot_us, radius_m, mavlink.MAV_FRAME_GLOBAL, *place
        )

    def position_target_global_int(self) -> Any:
        px4, goal = self._vehicle, self._vehicle.navigator.goal
        if not self._craft.flying or px4.mode not in SELF_FLYING:
            return None
        place = *self.place_e7(*goal.ground_m), self.altitude_m(goal.height_m)
        return mavlink.MAVLink_position_target_global_int_message(
            px4.boot_ms, mavlink.MAV_FRAME_GLOBAL_INT, 0, *place, *(NAN,) * 8
        )

    def distance_sensor(self) -> list[Any]:
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

    def current_mode(self) -> Any:
        standard = _STANDARD_MODES.get(self._vehicle.mode, mavlink.MAV_STANDARD_MODE_NON_STANDARD)
        return mavlink.MAVLink_current_mode_message(standard, self._vehicle.mode, self._vehicle.mode)

    def wind_cov(self) -> Any:
        wind, altitude_m = self._craft.wind, self.altitude_m(self._craft.height_m)
        mean_and_variance = wind.north_m_s, wind.east_m_s, 0.0, 1.0, 0.0
        return mavlink.MAVLink_wind_cov_message(self._vehicle.boot_us, *mean_and_variance, altitude_m, 0.0, 0.0)

    def estimator_status(self) -> Any:
        flags = 831 if self._vehicle.ready else 167  # position known absolutely, or only attitude
        if self._vehicle.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND:
            flags |= mavlink.ESTIMATOR_CONST_POS_MODE  # at rest it is held
        return mavlink.MAVLink_estimator_status_message(self._vehicle.boot_us, flags, *(0.01,) * 6, 0.5, 0.8)

    def ping(self) -> Any:
        self._pings += 1
        return mavlink.MAVLink_ping_message(self._vehicle.boot_us, self._pings, 0, 0)


def px4_parameters(settings: Settings) -> Parameters:
    """Return the parameters a ground program looks at, with the stock simulator's values."""
    airspeed_m_s = settings.airspeed_m_s
    table: dict[str, tuple[int, float]] = {
        "FW_AIRSPD_MIN": (REAL32, min(10.0, 0.7 * airspeed_m_s)),
        "FW_AIRSPD_MAX": (REAL32, max(20.0, 1.35 * airspeed_m_s)),
        "FW_AIRSPD_TRIM": (REAL32, airspeed_m_s),
        "FW_R_LIM": (REAL32, 50.0),
        "NAV_LOITER_RAD": (REAL32, 80.0),
        "NAV_ACC_RAD": (REAL32, 10.0),
        "NAV_FW_ALT_RAD": (REAL32, 10.0),
        "NPFG_PERIOD": (REAL32, 10.0),
        "NPFG_DAMPING": (REAL32, 0.7071),
        "NAV_DLL_ACT": (INT32, 0),
        "NAV_RCL_ACT": (INT32, 2),
        "COM_DL_LOSS_T": (INT32, 10),
        "COM_FAIL_ACT_T": (REAL32, 5.0),
        "COM_RC_IN_MODE": (INT32, 1),
        "COM_OF_LOSS_T": (REAL32, 1.0),
        "MIS_TKO_LAND_REQ": (INT32, 2),
        "MIS_TAKEOFF_ALT": (REAL32, 30.0),
        "FW_LND_ANG": (REAL32, 5.0),
        "RTL_RETURN_ALT": (REAL32, 60.0),
        "RTL_LOITER_RAD": (REAL32, 80.0),
        "GF_ACTION": (INT32, 2),
        "GF_MAX_HOR_DIST": (REAL32, 0.0),
        "GF_MAX_VER_DIST": (REAL32, 0.0),
        "MAV_SYS_ID": (INT32, settings.system_id),
        "MAV_TYPE": (INT32, 1),
    }
    release = settings.release_or_newest
    if release < (1, 14):
        del table["MIS_TKO_LAND_REQ"]
    return Parameters(table, bytewise=True, reports_errors=release >= (1, 18))


SELF_FLYING = (Px4Mode.TAKEOFF, Px4Mode.HOLD, Px4Mode.MISSION, Px4Mode.RTL, Px4Mode.LAND)
_MODE_FLAGS: int = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED


QUIRKS = TransferQuirks(
    asks_with_int=True,
    retry_s=0.25,
    timeout_s=5.0,
    max_items=2000,
    partial_writes=False,
    reads_in_order=True,
    busy_result=mavlink.MAV_MISSION_ERROR,
    restarts=False,
    wrong_sequence_result=None,
    repeats_final_ack=True,
    timeout_result=None,
    timeout_severity=mavlink.MAV_SEVERITY_CRITICAL,
    timeout_text="Operation timeout\t",
)
_RECHECK_S = 0.8  # delay before a mission starts after an infeasible one
_REACHED_REPEATS = 10
_CLIMB_OVER_M = 10.0  # a takeoff is flown above its height
_SIGNED_RADIUS_PARAM = {
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: 2,
    mavlink.MAV_CMD_NAV_LOITER_TIME: 2,
    mavlink.MAV_CMD_NAV_LOITER_TO_ALT: 1,
}


class SimulatedPx4(SimulatedAutopilot):
    autopilot_id = mavlink.MAV_AUTOPILOT_PX4
    modes, first_mode = Px4Mode, Px4Mode.HOLD
    self_flying = SELF_FLYING
    mode_flags = (
        _MODE_FLAGS | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED,
        _MODE_FLAGS | mavlink.MAV_MODE_FLAG_AUTO_ENABLED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED,
    )
    taken_over_mode = Px4Mode.POSCTL
    navigation_period_s = 0.04
    receives_once_a_loop = False
    home_known_s = 3.0
    ready_s = 8.0
    unknown_interval_result = FAILED
    unknown_request_result = DENIED
    preflight_failure = "Preflight Fail: ekf2 missing data\t"
    arming_refusal = (REJECTED, "Arming denied: Resolve system health failures first\t")
    armed_text, landed_text = "Armed by external command\t", "Landing detected\t"
    roll_limit_parameter = "FW_R_LIM"
    default_interval_s = DEFAULT_INTERVAL_S
    unsigned_messages = SimulatedAutopilot.unsigned_messages | {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE,
        mavlink.MAVLINK_MSG_ID_COLLISION,
    }

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, AirframeParameters(), 0.0, px4_parameters(settings))
        self.quirks = replace(QUIRKS, names_lists=self.release >= (1, 15))
        self.mission = Px4Mission(self._on_swap)
        self.navigator = Px4Navigator(self.craft, self.parameters)
        self._item: Item | None = None  # being flown
        self._finished = self._interrupted = False
        self._refusal: str | None = refusal([], self.home, 0)
        self._valid_from_s = 0.0
        self._reached: tuple[int, int, float] | None = None  # index, repeats left, next time
        self.relayed_range: Any = None  # the latest range of another component, until it is sent
        self._ordered_airspeed_m_s: float | None = None
        self.parameters.on_change = self._on_parameter
        self.handlers |= {
            mavlink.MAV_CMD_MISSION_START: self._on_mission_start,
            mavlink.MAV_CMD_DO_REPOSITION: self._on_reposition,
            mavlink.MAV_CMD_DO_ORBIT: lambda command: self._hold_around(command, command.param(1)),
            mavlink.MAV_CMD_NAV_TAKEOFF: self._on_takeoff,
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _: self.change_mode(Px4Mode.RTL),
            mavlink.MAV_CMD_NAV_LAND: lambda _: self.change_mode(Px4Mode.LAND),
            mavlink.MAV_CMD_DO_CHANGE_SPEED: self._on_change_speed,
        }
        self.attach(self.mission, Px4Telemetry(self))

    def custom_mode(self, main: int, sub: int) -> int:
        return custom_mode(main, sub)

    def set_mode(self, mode: int) -> bool:
        if mode not in list(Px4Mode):
            return False
        if mode == Px4Mode.MISSION and not self._mission_valid:
            # The change is acknowledged all the same; only the flight shows the failure.
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "No valid mission available, loitering\t")
            mode = Px4Mode.HOLD
        if mode == self.mode:
            return True
        self._interrupted = self._interrupted or self.mode == Px4Mode.MISSION
        self.mode = Px4Mode(mode)
        self.lifting_off, self._item, self._ordered_airspeed_m_s, self.navigator.circle = False, None, None, None
        match mode:
            case Px4Mode.MISSION:
                self._begin_mission()
            case Px4Mode.RTL:
                home = LocalPosition(0.0, 0.0, self.parameters["RTL_RETURN_ALT"])
                self._circle_at(home, self.parameters["RTL_LOITER_RAD"])
            case Px4Mode.LAND:
                self.navigator.go_to(LocalPosition(self.craft.east_m, self.craft.north_m, 0.0), from_here=True)
            case Px4Mode.TAKEOFF:
                self._begin_takeoff(self.parameters["MIS_TAKEOFF_ALT"])
            case _:
                self.height_goal_m = self.craft.height_m
                if self.craft.flying:
                    self._circle_at(self.here)
        return True

    def _on_set_mode(self, command: Command) -> int:
        if self.mode_of_command(command) == Px4Mode.MISSION and not self._mission_valid:
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "Switching to Mission is currently not available\t")
            return REJECTED
        return super()._on_set_mode(command)

    def watch_links(self) -> None:
        """Enter and leave the failsafe of a lost ground station."""
        action = self.parameters["NAV_DLL_ACT"]
        if not action or not self.craft.flying:
            return
        lost_for_s = self.ground_silent_s - self.parameters["COM_DL_LOSS_T"]
        if lost_for_s < 0.0:
            self.failsafe = False
        elif not self.failsafe:
            self.failsafe = True
            # No ground station is received, so that PX4 sends no text, either.
            self.radio.broadcast(LinkLost(self.boot_ms, self.parameters["COM_FAIL_ACT_T"]))
            self.set_mode(Px4Mode.HOLD)
        elif action == 2 and lost_for_s > self.parameters["COM_FAIL_ACT_T"]:
            self.set_mode(Px4Mode.RTL)

    @property
    def airspeed_goal_m_s(self) -> float:
        ordered_m_s = self._ordered_airspeed_m_s
        return self.parameters.within("FW_AIRSPD_TRIM", 5.0, 60.0) if ordered_m_s is None else ordered_m_s

    def navigate(self) -> float:
        """Fly the mode for a navigation period; return the required lateral acceleration, m/s^2."""
        self._repeat_reached()
        match self.mode:
            case Px4Mode.MISSION:
                return self._navigate_mission()
            case Px4Mode.TAKEOFF if self._climbed_out():
                goal = self.navigator.goal
                self.set_mode(Px4Mode.HOLD)
                self._circle_at(goal)
            case Px4Mode.LAND:
                self.descend_to(self.navigator.goal)
                return self.navigator.fly_line()
            case Px4Mode.HOLD | Px4Mode.RTL:
                return self.navigator.fly_circle()
        return 0.0  # sticks in the middle

    def _circle_at(self, centre: LocalPosition, signed_radius_m: float = math.nan) -> None:
        self.height_goal_m = centre.height_m
        self.navigator.fly_around(centre, signed_radius_m)

    def _navigate_mission(self) -> float:
        item = self._item
        if item is None or not self.armed or not self.craft.flying:
            self.lifting_off = self.lifting_off or (item is not None and self.armed)
            return 0.0
        done, lateral_m_s2 = self._fly_item(item)
        if done:
            self._reached = (self.mission.index, _REACHED_REPEATS, self.now_s)
            self._start_item(self.mission.index + 1, from_here=item.command == mavlink.MAV_CMD_NAV_TAKEOFF)
        return lateral_m_s2

    def _fly_item(self, item: Item) -> tuple[bool, float]:
        match item.command:
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                return self._climbed_out(), 0.0
            case mavlink.MAV_CMD_NAV_WAYPOINT:
                return self.navigator.fly_leg()
            case mavlink.MAV_CMD_NAV_LAND:
                self.descend_to(self.navigator.goal)
                return False, self.navigator.fly_line()
            case _:
                inside_s = self.navigator.inside_for_s(self.now_s)
                arrived = inside_s is not None and self.navigator.at_height()
                done = arrived and (
                    item.command == mavlink.MAV_CMD_NAV_LOITER_TO_ALT
                    or (item.command == mavlink.MAV_CMD_NAV_LOITER_TIME and (inside_s or 0.0) >= item.params[0])
                )
                return done, self.navigator.fly_circle()

    def _begin_takeoff(self, height_m: float) -> None:
        self.navigator.go_to(LocalPosition(self.craft.east_m, self.craft.north_m, height_m), from_here=True)
        self.height_goal_m = height_m + _CLIMB_OVER_M

    def _climbed_out(self) -> bool:
        if not self.craft.flying:
            self.lifting_off = self.armed
            return False
        return self.craft.height_m >= self.navigator.goal.height_m + 0.5

    @property
    def _mission_valid(self) -> bool:
        return self._refusal is None and self.now_s >= self._valid_from_s

    @property
    def mission_state(self) -> int:
        """MISSION_STATE, as PX4 1.17 reports it."""
        state: int = mavlink.MISSION_STATE_PAUSED if self._interrupted else mavlink.MISSION_STATE_NOT_STARTED
        if not self.mission.items():
            state = mavlink.MISSION_STATE_NO_MISSION
        elif self._finished:
            state = mavlink.MISSION_STATE_COMPLETE
        elif self.mode == Px4Mode.MISSION:
            state = mavlink.MISSION_STATE_ACTIVE
        return state

    def _on_swap(self) -> None:
        """Check the items that have come, and fly them at once when in MISSION."""
        was_rejected = self._refusal is not None and self._refusal.startswith("Mission rejected")
        self._finished = self._interrupted = False
        self._check_mission(was_rejected)
        if self.mode != Px4Mode.MISSION:
            return
        if self._refusal is None:
            self._start_item(self.mission.index, from_here=True)
        else:
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "No valid mission available, loitering\t")
            self.set_mode(Px4Mode.HOLD)

    def _check_mission(self, was_rejected: bool) -> None:
        required = int(self.parameters.get("MIS_TKO_LAND_REQ", 0))  # releases before 1.14 require none
        self._refusal = refusal(self.mission.items(), self.home, required, self.parameters["FW_LND_ANG"])
        if self._refusal is not None and self.mission.items():
            self.say(mavlink.MAV_SEVERITY_CRITICAL, f"{self._refusal}\t")
        elif was_rejected:
            self._valid_from_s = self.now_s + _RECHECK_S

    def _on_parameter(self, name: str, _value: float) -> None:
        if name in ("MIS_TKO_LAND_REQ", "FW_LND_ANG"):
            self._check_mission(was_rejected=False)

    def _begin_mission(self) -> None:
        if self._finished:
            self.mission.index, self._finished = 0, False
        self.say(mavlink.MAV_SEVERITY_INFO, "Executing Mission\t")
        self._start_item(self.mission.index, from_here=True)

    def _start_item(self, index: int, *, from_here: bool) -> None:
        items = self.mission.items()
        flown = next((i for i in range(index, len(items)) if items[i].command in NAVIGATION), None)
        for item in items[index:flown]:
            if item.command == mavlink.MAV_CMD_DO_CHANGE_SPEED:
                self._order_airspeed(item.params[1])
        if flown is None:
            self._finished = True
            self.say(mavlink.MAV_SEVERITY_INFO, "Mission finished, loitering\t")
            self.set_mode(Px4Mode.HOLD)
            return
        item, place = items[flown], self.place_of(items[flown])
        if item.command == mavlink.MAV_CMD_NAV_TAKEOFF and self.craft.flying:
            self._start_item(flown + 1, from_here=from_here)  # no takeoff in the air
            return
        self.mission.index, self._item = flown, item
        self.broadcast_now(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)
        self.height_goal_m = place.height_m
        if item.command == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            self.set_mode(Px4Mode.RTL)
        elif item.command == mavlink.MAV_CMD_NAV_TAKEOFF:
            self._begin_takeoff(place.height_m)
        elif item.command in _SIGNED_RADIUS_PARAM:
            self._circle_at(place, item.params[_SIGNED_RADIUS_PARAM[item.command]])
        else:
            self.navigator.go_to(place, from_here=from_here)

    def _repeat_reached(self) -> None:
        if self._reached is None or self.now_s < self._reached[2]:
            return
        index, left, due_s = self._reached
        self.radio.broadcast(mavlink.MAVLink_mission_item_reached_message(index))
        self._reached = (index, left - 1, due_s + 1.0) if left > 0 else None

    def take_range(self, message: Any) -> None:
        """Relay a range as a sensor of its own, stamped with its arrival."""
        measured = (getattr(message, name) for name in message.fieldnames[1:-1])
        quality = max(0, message.signal_quality - 1)
        self.relayed_range = mavlink.MAVLink_distance_sensor_message(self.boot_ms, *measured, quality)

    def handle_own(self, station: Station, message: Any, kind: str) -> None:
        if kind == "DISTANCE_SENSOR":
            self.take_range(message)
        else:
            super().handle_own(station, message, kind)

    def set_current_item(self, index: int) -> bool:
        if not 0 <= index < len(self.mission.items()):
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "WPM: WP CURR CMD: Not in list\t")
            return False
        if index != self.mission.index:
            self.mission.index, self._finished = index, False
            if self.mode == Px4Mode.MISSION:
                self._start_item(index, from_here=True)
        return True

    def _on_mission_start(self, command: Command) -> int:
        if not self._mission_valid:
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "Mission start denied! No valid mission\t")
            return DENIED
        if not -1 <= command.param(1) < len(self.mission.items()):
            return DENIED
        if not self.armed and self.arm() != ACCEPTED:
            return REJECTED
        return ACCEPTED if self.set_mode(Px4Mode.MISSION) else REJECTED

    def _on_reposition(self, command: Command) -> int:
        if int(command.number(2)) != mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE:
            return UNSUPPORTED
        return self._hold_around(command, math.nan)

    def _hold_around(self, command: Command, signed_radius_m: float) -> int:
        """Hold around the place in params 5 to 7, altitude above sea level in any frame; what is NaN is here."""
        latitude_deg, longitude_deg, altitude_m = command.params[4:7]
        ground_m, height_m = self.here.ground_m, self.craft.height_m
        if math.isfinite(latitude_deg) and math.isfinite(longitude_deg):
            ground_m = self.plane.east_north_m(latitude_deg, longitude_deg)
        if math.isfinite(altitude_m):
            height_m = altitude_m - self.home.altitude_m
        self.set_mode(Px4Mode.HOLD)
        if self.craft.flying:
            self._circle_at(LocalPosition(*ground_m, height_m), signed_radius_m)
        return ACCEPTED

    def _on_takeoff(self, command: Command) -> int:
        if self.craft.flying:
            return REJECTED
        self.set_mode(Px4Mode.TAKEOFF)
        altitude_m = command.param(7)
        if math.isfinite(altitude_m):
            self._begin_takeoff(altitude_m - self.home.altitude_m)
        return ACCEPTED

    def _on_change_speed(self, command: Command) -> int:
        self._order_airspeed(command.number(2))
        return ACCEPTED

    def _order_airspeed(self, speed_m_s: float) -> None:
        if speed_m_s > 0.0:
            min_m_s, max_m_s = self.parameters["FW_AIRSPD_MIN"], self.parameters["FW_AIRSPD_MAX"]
            self._ordered_airspeed_m_s = max(min_m_s, min(max_m_s, speed_m_s))
