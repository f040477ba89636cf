"""PX4 as a ground program meets it, flying a fixed wing: modes, path following, mission, commands, telemetry."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

from pymavlink.dialects.v20 import all as mavlink

from sitl.airframe import Build
from sitl.autopilot import Autopilot, Place
from sitl.commands import ACCEPTED, DENIED, FAILED, REJECTED, UNSUPPORTED, Command
from sitl.fence import PointStore
from sitl.items import Item
from sitl.parameters import INT32, REAL32, Parameters
from sitl.pathfollowing import PathFollower
from sitl.px4_mission import Px4Mission, refusal
from sitl.radio import Station
from sitl.settings import Settings
from sitl.telemetry import NAN, common_builders, quaternion
from sitl.transfer import Manners, Store, Transfer
from sitl.wire import mission_current

_MANNERS = Manners(
    asks_with_int=True,
    retry_s=0.25,
    timeout_s=5.0,
    max_items=2000,
    partial_writes=False,
    busy_result=mavlink.MAV_MISSION_ERROR,
    restarts=False,
    wrong_sequence_result=None,
    repeats_final_ack=True,
    timeout_result=None,
    timeout_severity=mavlink.MAV_SEVERITY_CRITICAL,
    timeout_text="Operation timeout\t",
)
_UNSUPPORTED_FRAME = 9  # VEHICLE_CMD_RESULT_UNSUPPORTED_MAV_FRAME, unknown to many programs
_SWITCH_FRACTION = 0.32  # of the follower's bound: where a waypoint counts as reached
_RECHECK_S = 0.8  # an infeasible mission keeps its successor from starting for so long
_REACHED_REPEATS = 10
_DOWNWARD_MAX_M = 100.0
_DOWNWARD_BEYOND_CM = 65534


def _mode(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


class Mode(IntEnum):
    MANUAL = _mode(1)
    ALTCTL = _mode(2)
    POSCTL = _mode(3)
    TAKEOFF = _mode(4, 2)
    HOLD = _mode(4, 3)
    MISSION = _mode(4, 4)
    RTL = _mode(4, 5)
    LAND = _mode(4, 6)
    STABILIZED = _mode(7)


_BY_PILOT = (Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.STABILIZED)


@dataclass(frozen=True, slots=True)
class _Circle:
    centre: Place
    radius_m: float
    clockwise: bool


class Px4(Autopilot):
    autopilot_id = mavlink.MAV_AUTOPILOT_PX4
    first_mode = Mode.HOLD
    navigation_period_s = 0.04
    ready_s = 8.0
    unknown_message_result = FAILED
    arming_refusal = (REJECTED, "Arming denied: Resolve system health failures first\t")
    default_interval_s: ClassVar[dict[int, float]] = {
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
        mavlink.MAVLINK_MSG_ID_PING: 10.0,
    }

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, Build(), 0.0, _parameters(settings))
        self.follower = PathFollower()
        self.mission = Px4Mission(self._on_swap)
        stores: tuple[Store, ...] = (self.mission, PointStore(True), PointStore(True))
        for mission_type, store in zip(self.mission_types, stores, strict=True):
            self.transfers[mission_type] = Transfer(
                mission_type, store, self.radio, _MANNERS, settings.link_rate, self.say
            )
        self._circle: _Circle | None = None
        self._goal = self._previous = Place(0.0, 0.0, 0.0)
        self._item: Item | None = None
        self._loitering_since_s: float | None = None
        self._finished = False
        self._was_flown = False
        self._refusal: str | None = "No valid mission available"
        self._valid_from_s = 0.0
        self._reached: tuple[int, int, float] | None = None  # index, repeats left, next time
        self._relayed_range: Any = None
        self._link_lost_s: float | None = None
        self._ping = 0
        self.parameters.on_change = self._on_parameter
        self._handlers |= {
            mavlink.MAV_CMD_MISSION_START: self._on_mission_start,
            mavlink.MAV_CMD_DO_REPOSITION: self._on_reposition,
            mavlink.MAV_CMD_DO_ORBIT: self._on_orbit,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._on_takeoff,
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _: ACCEPTED if self.set_mode(Mode.RTL) else REJECTED,
            mavlink.MAV_CMD_NAV_LAND: lambda _: ACCEPTED if self.set_mode(Mode.LAND) else REJECTED,
            mavlink.MAV_CMD_DO_CHANGE_SPEED: self._on_change_speed,
        }
        self._builders |= common_builders(self)
        self._builders |= self._own_builders()

    @property
    def roll_limit_rad(self) -> float:
        return math.radians(self.parameters["FW_R_LIM"])

    @property
    def base_mode(self) -> int:
        if self.mode in _BY_PILOT:
            flags = mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        else:
            flags = mavlink.MAV_MODE_FLAG_AUTO_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
            flags |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        flags |= mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        return int(flags | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0))

    # Modes.

    def mode_of_command(self, base_mode: int, main: int, sub: int) -> int | None:
        if not base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED or _mode(main, sub) not in list(Mode):
            return None
        return _mode(main, sub)

    def set_mode(self, mode: int) -> bool:
        if mode not in list(Mode):
            return False
        if mode == Mode.MISSION and not self._mission_valid:
            # The change is acknowledged all the same; what is flown tells.
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "No valid mission available, loitering\t")
            mode = Mode.HOLD
        if mode == self.mode:
            return True
        left, self.mode = self.mode, Mode(mode)
        self.lifting_off = False
        self._circle = self._item = None
        if left == Mode.MISSION:
            self._was_flown = True
        if mode == Mode.MISSION:
            self._begin_mission()
        elif mode == Mode.RTL:
            radius_m = self.parameters["RTL_LOITER_RAD"]
            self._circle = _Circle(Place(0.0, 0.0, self.parameters["RTL_RETURN_ALT"]), radius_m, True)
        elif mode == Mode.LAND:
            self._previous, self._goal = self.here, Place(self.craft.east_m, self.craft.north_m, 0.0)
        elif mode != Mode.TAKEOFF:
            self._hold_here()
        return True

    def on_armed(self) -> None:
        self.say(mavlink.MAV_SEVERITY_INFO, "Armed by external command\t")
        if self.mode == Mode.MISSION and self._item is None:
            self._begin_mission()

    def on_landed(self) -> None:
        self.disarm()
        self.say(mavlink.MAV_SEVERITY_INFO, "Landing detected\t")

    def watch_links(self) -> None:
        if not self.parameters["NAV_DLL_ACT"] or self.gcs_heard_s is None or not self.craft.flying:
            return
        silent_s = (self.now_s - self.gcs_heard_s) / self.settings.link_rate
        if silent_s < self.parameters["COM_DL_LOSS_T"]:
            self._link_lost_s = None
        elif self._link_lost_s is None:
            self._link_lost_s = self.now_s
            self.say(mavlink.MAV_SEVERITY_WARNING, "Connection to ground station lost\t")
            self.set_mode(Mode.HOLD)
        elif (self.now_s - self._link_lost_s) / self.settings.link_rate > self.parameters["COM_FAIL_ACT_T"]:
            self.set_mode(Mode.RTL if self.parameters["NAV_DLL_ACT"] == 2 else self.mode)

    def _hold_here(self) -> None:
        self.height_goal_m = self.craft.height_m
        if self.craft.flying:
            self._circle = self._default_circle(self.here)

    def _default_circle(self, centre: Place) -> _Circle:
        radius_m = self.parameters["NAV_LOITER_RAD"]
        return _Circle(centre, abs(radius_m), radius_m >= 0)

    # Navigation.

    def navigate(self, dt_s: float) -> float:
        self._repeat_reached()
        if self.mode == Mode.MISSION:
            lateral_m_s2 = self._navigate_mission()
        elif self.mode == Mode.TAKEOFF:
            lateral_m_s2 = 0.0
            if self._climbed_out():
                self.set_mode(Mode.HOLD)
                self._circle = self._default_circle(self._goal)
        elif self.mode == Mode.LAND:
            lateral_m_s2 = self._descend()
        elif self._circle is not None:
            lateral_m_s2 = self._fly_circle(self._circle)
        else:
            lateral_m_s2 = 0.0
        return lateral_m_s2

    def _fly_circle(self, circle: _Circle) -> float:
        self.height_goal_m = circle.centre.height_m
        self._goal = circle.centre
        # A circle tighter than the roll limit allows is silently flown wider.
        least_m = self.craft.airspeed_m_s**2 / (9.80665 * math.tan(self.roll_limit_rad))
        radius_m = max(circle.radius_m, least_m)
        return self.follower.towards_circle(self.craft, circle.centre.ground_m, radius_m, circle.clockwise)

    def _navigate_mission(self) -> float:
        item = self._item
        if item is None or not self.armed:
            return 0.0
        match item.command:
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                done, lateral_m_s2 = self._climbed_out(), 0.0
            case mavlink.MAV_CMD_NAV_WAYPOINT:
                done, lateral_m_s2 = self._fly_leg(item)
            case mavlink.MAV_CMD_NAV_LAND:
                done, lateral_m_s2 = False, self._descend()
            case _:
                done, lateral_m_s2 = self._fly_loiter_item(item)
        if done:
            self._report_reached(self.mission.index)
            self._previous = self._goal
            self._start_item(self.mission.index + 1)
        return lateral_m_s2

    def _fly_leg(self, item: Item) -> tuple[bool, float]:
        if not self.craft.flying:
            self.lifting_off = True
            return False, 0.0
        goal, craft = self._goal, self.craft
        if self._circle is not None:  # waiting at the waypoint for its height
            return abs(craft.height_m - goal.height_m) < self.parameters["NAV_FW_ALT_RAD"], self._fly_circle(
                self._circle
            )
        lateral_m_s2 = self.follower.towards_line(craft, self._previous.ground_m, goal.ground_m)
        reach_m = item.params[1] if item.params[1] > 0 else self.parameters["NAV_ACC_RAD"]
        reach_m = max(reach_m, _SWITCH_FRACTION * self.follower.bound_m)
        if goal.distance_m(craft) > reach_m:
            return False, lateral_m_s2
        if abs(craft.height_m - goal.height_m) >= self.parameters["NAV_FW_ALT_RAD"]:
            self._circle = self._default_circle(goal)
            return False, lateral_m_s2
        return True, lateral_m_s2

    def _fly_loiter_item(self, item: Item) -> tuple[bool, float]:
        circle = self._circle
        if circle is None:
            return False, 0.0
        if not self.craft.flying:
            self.lifting_off = True
            return False, 0.0
        lateral_m_s2 = self._fly_circle(circle)
        if self._loitering_since_s is None:
            if circle.centre.distance_m(self.craft) > circle.radius_m + self.parameters["NAV_ACC_RAD"]:
                return False, lateral_m_s2
            self._loitering_since_s = self.now_s
        at_height = abs(self.craft.height_m - circle.centre.height_m) < self.parameters["NAV_FW_ALT_RAD"]
        if item.command == mavlink.MAV_CMD_NAV_LOITER_TIME:
            return at_height and self.now_s - self._loitering_since_s >= item.params[0], lateral_m_s2
        return at_height and item.command == mavlink.MAV_CMD_NAV_LOITER_TO_ALT, lateral_m_s2

    def _climbed_out(self) -> bool:
        if not self.craft.flying:
            self.lifting_off = self.armed
            return False
        # The item counts as reached a little above its height.
        self.height_goal_m = self._goal.height_m + 10.0
        return self.craft.height_m >= self._goal.height_m + 0.5

    def _descend(self) -> float:
        self.height_goal_m = min(self.craft.height_m, self._goal.distance_m(self.craft) / 8.0) - 2.0
        return self.follower.towards_line(self.craft, self._previous.ground_m, self._goal.ground_m)

    # Mission.

    @property
    def _mission_valid(self) -> bool:
        return self._refusal is None and self.now_s >= self._valid_from_s

    def _on_swap(self) -> None:
        """Other items have come: check them, and fly them at once when in MISSION."""
        was_infeasible = self._refusal is not None and self._refusal.startswith("Mission rejected")
        self._finished = self._was_flown = False
        self._check_mission(was_infeasible)
        if self.mode != Mode.MISSION:
            return
        if self._refusal is None:
            self._previous = self.here
            self._start_item(self.mission.index)
        else:
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "No valid mission available, loitering\t")
            self.set_mode(Mode.HOLD)

    def _check_mission(self, was_infeasible: bool) -> None:
        self._refusal = refusal(self.mission.items(), int(self.parameters["MIS_TKO_LAND_REQ"]))
        if self._refusal is not None:
            if self.mission.items():
                self.say(mavlink.MAV_SEVERITY_CRITICAL, f"{self._refusal}\t")
        elif was_infeasible:
            self._valid_from_s = self.now_s + _RECHECK_S

    def _on_parameter(self, name: str, _value: float) -> None:
        if name == "MIS_TKO_LAND_REQ":
            self._check_mission(was_infeasible=False)
        elif name == "FW_AIRSPD_TRIM":
            self.airspeed_goal_m_s = self.parameters[name]

    def _begin_mission(self) -> None:
        if self._finished:
            self.mission.index, self._finished = 0, False
        self.say(mavlink.MAV_SEVERITY_INFO, "Executing Mission\t")
        self._previous = self.here
        self.airspeed_goal_m_s = self.parameters["FW_AIRSPD_TRIM"]
        self._start_item(self.mission.index)

    def _start_item(self, index: int) -> None:
        items = self.mission.items()
        flown = self.mission.navigation_from(index)
        for item in items[index : len(items) if flown is None else flown]:
            if item.command == mavlink.MAV_CMD_DO_CHANGE_SPEED:
                self._change_speed(item.params[1])
        if flown is not None and items[flown].command == mavlink.MAV_CMD_NAV_TAKEOFF and self.craft.flying:
            self._start_item(flown + 1)  # no takeoff in the air
            return
        if flown is None:
            self._finished = True
            self.say(mavlink.MAV_SEVERITY_INFO, "Mission finished, loitering\t")
            self.set_mode(Mode.HOLD)
            return
        item = items[flown]
        self.mission.index, self._item = flown, item
        self._circle, self._loitering_since_s = None, None
        if item.command == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            self.set_mode(Mode.RTL)
            return
        self._goal = self.place_of(item)
        self.height_goal_m = self._goal.height_m
        radius_param = {
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: 2,
            mavlink.MAV_CMD_NAV_LOITER_TIME: 2,
            mavlink.MAV_CMD_NAV_LOITER_TO_ALT: 1,
        }.get(item.command)
        if radius_param is not None:
            radius_m = item.params[radius_param]
            if math.isnan(radius_m) or radius_m == 0.0:
                radius_m = self.parameters["NAV_LOITER_RAD"]
            self._circle = _Circle(self._goal, abs(radius_m), radius_m > 0.0)

    def _report_reached(self, index: int) -> None:
        self._reached = (index, _REACHED_REPEATS, self.now_s)
        self._repeat_reached()

    def _repeat_reached(self) -> None:
        if self._reached is None or self.now_s < self._reached[2]:
            return
        index, left, due_s = self._reached
        self.radio.broadcast(mavlink.MAVLink_mission_item_reached_message(index))
        self._reached = (index, left - 1, due_s + 1.0) if left > 0 else None

    # Commands.

    def on_command(self, station: Station, command: Command) -> None:
        if command.frame is not None and command.frame != mavlink.MAV_FRAME_GLOBAL_INT:
            self.radio.send(station, command.acknowledgement(_UNSUPPORTED_FRAME))
            return
        super().on_command(station, command)

    def handle_own(self, station: Station, message: Any, kind: str) -> None:
        if kind == "DISTANCE_SENSOR":
            self.take_range(message)
        elif kind == "SET_MODE" and message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            self.set_mode(message.custom_mode)
        else:
            super().handle_own(station, message, kind)

    def take_range(self, message: Any) -> None:
        """Another component's range becomes a sensor of this vehicle, stamped with its arrival."""
        self._relayed_range = mavlink.MAVLink_distance_sensor_message(
            self.boot_ms,
            message.min_distance,
            message.max_distance,
            message.current_distance,
            message.type,
            message.id,
            message.orientation,
            message.covariance,
            message.horizontal_fov,
            message.vertical_fov,
            message.quaternion,
            max(0, message.signal_quality - 1),
        )

    def set_current_item(self, index: int) -> bool:
        if not 0 <= index < len(self.mission.items()):
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "WPM: WP CURR CMD: Not in list\t")
            return False
        if index == self.mission.index:
            return True
        self.mission.index, self._finished = index, False
        if self.mode == Mode.MISSION:
            self._previous = self.here
            self._start_item(index)
        return True

    def _on_mission_start(self, command: Command) -> int:
        first = command.param(1)
        if not self._mission_valid:
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "Mission start denied! No valid mission\t")
            return DENIED
        if not -1 <= first < len(self.mission.items()):
            return DENIED
        if not self.armed and not self.ready:
            return REJECTED
        if not self.armed:
            self.armed = True
            self.on_armed()
        return ACCEPTED if self.set_mode(Mode.MISSION) else REJECTED

    def _on_reposition(self, command: Command) -> int:
        flags = command.param(2)
        if math.isnan(flags) or int(flags) != 1:
            return UNSUPPORTED
        centre = self._centre_of(command)
        self.set_mode(Mode.HOLD)
        if self.craft.flying:
            self._circle = self._default_circle(centre)
        return ACCEPTED

    def _on_orbit(self, command: Command) -> int:
        centre = self._centre_of(command)
        radius_m = command.param(1)
        self.set_mode(Mode.HOLD)
        if self.craft.flying:
            circle = self._default_circle(centre)
            self._circle = circle if math.isnan(radius_m) else _Circle(centre, abs(radius_m), radius_m >= 0.0)
        return ACCEPTED

    def _centre_of(self, command: Command) -> Place:
        """Return the place in params 5 to 7, altitude above sea level; what is NaN is here."""
        latitude_deg, longitude_deg, altitude_m = command.params[4:7]
        here = self.here
        east_m, north_m = here.ground_m
        if not (math.isnan(latitude_deg) or math.isnan(longitude_deg)):
            east_m, north_m = self.plane.east_north_m(latitude_deg, longitude_deg)
        height_m = here.height_m if math.isnan(altitude_m) else altitude_m - self.home.altitude_m
        return Place(east_m, north_m, height_m)

    def _on_takeoff(self, command: Command) -> int:
        if self.craft.flying:
            return REJECTED
        altitude_m = command.param(7)
        height_m = self.parameters["MIS_TAKEOFF_ALT"]
        if not math.isnan(altitude_m):
            height_m = altitude_m - self.home.altitude_m
        self.set_mode(Mode.TAKEOFF)
        self._goal = Place(self.craft.east_m, self.craft.north_m, height_m)
        return ACCEPTED

    def _on_change_speed(self, command: Command) -> int:
        self._change_speed(command.param(2))
        return ACCEPTED

    def _change_speed(self, speed_m_s: float) -> None:
        if speed_m_s > 0.0:
            limits = self.parameters["FW_AIRSPD_MIN"], self.parameters["FW_AIRSPD_MAX"]
            self.airspeed_goal_m_s = max(limits[0], min(limits[1], speed_m_s))

    # Telemetry.

    def _own_builders(self) -> dict[int, Callable[[], Any]]:
        return {
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission_current,
            mavlink.MAVLINK_MSG_ID_ORBIT_EXECUTION_STATUS: self._orbit_status,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: self._position_target,
            mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: self._ranges,
            mavlink.MAVLINK_MSG_ID_CURRENT_MODE: self._current_mode,
            mavlink.MAVLINK_MSG_ID_WIND_COV: self._wind,
            mavlink.MAVLINK_MSG_ID_PING: self._ping_message,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._version,
        }

    def _sys_status(self) -> Any:
        healthy = 0x1320C83F if self.ready else 0x0320C83F
        return mavlink.MAVLink_sys_status_message(
            0x300403F, 0x301403F, healthy, 454, 16200, -1, self._battery_percent, *(0,) * 6
        )

    @property
    def _battery_percent(self) -> int:
        return max(5, 100 - int(self.now_s / 108.0))

    def _gps_raw(self) -> Any:
        craft = self.craft
        latitude_deg, longitude_deg = self.plane.latitude_longitude_deg(craft.east_m, craft.north_m)
        altitude_mm = round((self.home.altitude_m + craft.height_m) * 1000.0)
        return mavlink.MAVLink_gps_raw_int_message(
            self.boot_us,
            mavlink.GPS_FIX_TYPE_3D_FIX,
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            altitude_mm,
            70,
            110,
            round(craft.ground_speed_m_s * 100.0),
            round(math.degrees(craft.course_rad) * 100.0) % 36000,
            10,
            altitude_mm,
            900,
            1780,
            400,
        )

    def _home_position(self) -> Any:
        if not self.ready:
            return None
        home = self.home
        return mavlink.MAVLink_home_position_message(
            round(home.latitude_deg * 1e7),
            round(home.longitude_deg * 1e7),
            round(home.altitude_m * 1000.0),
            0.0,
            0.0,
            0.0,
            list(quaternion(0.0, 0.0, 0.0)),
            0.0,
            0.0,
            0.0,
            self.boot_us,
        )

    @property
    def _mission_state(self) -> int:
        if not self.mission.items():
            return int(mavlink.MISSION_STATE_NO_MISSION)
        if self._finished:
            return int(mavlink.MISSION_STATE_COMPLETE)
        if self.mode == Mode.MISSION:
            return int(mavlink.MISSION_STATE_ACTIVE)
        return int(mavlink.MISSION_STATE_PAUSED if self._was_flown else mavlink.MISSION_STATE_NOT_STARTED)

    def _mission_current(self) -> Any:
        fence, rally = (self.transfers[kind].store.opaque_id() or 0 for kind in self.mission_types[1:])
        base = mavlink.MAVLink_mission_current_message(
            self.mission.index,
            len(self.mission.items()) or 65535,
            self._mission_state,
            1 if self.mode == Mode.MISSION else 2,
        )
        return mission_current(base, self.mission.mission_id, fence, rally)

    def _orbit_status(self) -> Any:
        circle = self._circle
        if circle is None or not self.craft.flying:
            return None
        latitude_deg, longitude_deg = self.plane.latitude_longitude_deg(*circle.centre.ground_m)
        return mavlink.MAVLink_orbit_execution_status_message(
            self.boot_us,
            circle.radius_m if circle.clockwise else -circle.radius_m,
            mavlink.MAV_FRAME_GLOBAL,
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            self.home.altitude_m + circle.centre.height_m,
        )

    def _position_target(self) -> Any:
        if not self.craft.flying or self.mode in _BY_PILOT:
            return None
        latitude_deg, longitude_deg = self.plane.latitude_longitude_deg(*self._goal.ground_m)
        return mavlink.MAVLink_position_target_global_int_message(
            self.boot_ms,
            mavlink.MAV_FRAME_GLOBAL_INT,
            0,
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            self.home.altitude_m + self._goal.height_m,
            *(NAN,) * 8,
        )

    def _ranges(self) -> list[Any]:
        """Return its own downward sensor, and what another component last reported."""
        height_m = self.craft.height_m
        height_cm = round(height_m * 100.0) if height_m < _DOWNWARD_MAX_M else _DOWNWARD_BEYOND_CM
        downward = mavlink.MAVLink_distance_sensor_message(
            self.boot_ms, 0, 10000, height_cm, 0, 0, mavlink.MAV_SENSOR_ROTATION_PITCH_270, 0, 0.0, 0.0, [0.0] * 4, 0
        )
        relayed, self._relayed_range = self._relayed_range, None
        return [downward] if relayed is None else [downward, relayed]

    def _current_mode(self) -> Any:
        standard = {
            Mode.MISSION: mavlink.MAV_STANDARD_MODE_MISSION,
            Mode.RTL: mavlink.MAV_STANDARD_MODE_SAFE_RECOVERY,
            Mode.LAND: mavlink.MAV_STANDARD_MODE_LAND,
            Mode.TAKEOFF: mavlink.MAV_STANDARD_MODE_TAKEOFF,
        }.get(Mode(self.mode), 0)
        return mavlink.MAVLink_current_mode_message(standard, self.mode, self.mode)

    def _wind(self) -> Any:
        wind = self.craft.wind
        altitude_m = self.home.altitude_m + self.craft.height_m
        return mavlink.MAVLink_wind_cov_message(
            self.boot_us, wind.north_m_s, wind.east_m_s, 0.0, 1.0, 0.0, altitude_m, 0.0, 0.0
        )

    def _ping_message(self) -> Any:
        self._ping += 1
        return mavlink.MAVLink_ping_message(self.boot_us, self._ping, 0, 0)

    def _version(self) -> Any:
        capabilities = (
            mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
            | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
            | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        )
        return mavlink.MAVLink_autopilot_version_message(
            capabilities, 1 << 24 | 17 << 16, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, self.system_id
        )


def _parameters(settings: Settings) -> Parameters:
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
        "RTL_RETURN_ALT": (REAL32, 60.0),
        "RTL_LOITER_RAD": (REAL32, 80.0),
        "GF_ACTION": (INT32, 2),
        "GF_MAX_HOR_DIST": (REAL32, 0.0),
        "GF_MAX_VER_DIST": (REAL32, 0.0),
        "MAV_SYS_ID": (INT32, settings.system_id),
        "MAV_TYPE": (INT32, 1),
    }
    return Parameters(table, bytewise=True)
