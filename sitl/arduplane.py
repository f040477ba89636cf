"""ArduPlane 4.7 as a ground program meets it: modes, L1 navigation, mission, commands, telemetry."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

from pymavlink.dialects.v20 import all as mavlink

from sitl.airframe import Build
from sitl.arduplane_mission import ArduPlaneMission, MissionState
from sitl.autopilot import Autopilot, Place
from sitl.commands import ACCEPTED, DENIED, FAILED, UNSUPPORTED, Command
from sitl.fence import PointStore
from sitl.guidance import L1Guidance
from sitl.items import ABSOLUTE_FRAMES, RELATIVE_FRAMES, Item
from sitl.parameters import INT8, INT16, INT32, REAL32, Parameters
from sitl.settings import Settings
from sitl.telemetry import NAN, common_builders
from sitl.transfer import Manners, Store, Transfer

# The stock simulator's airframe turns less than a coordinated bank would: with L1, which has no integral on
# circles, that is why it flies 116 m for 100, 69 for 50 and 167 for 150 at 22 m/s.
_BUILD = Build(turn_efficiency=0.78)
_INITIAL_HEADING_RAD = math.radians(353.0)
_TAKEOFF_OVERSHOOT_M = 10.0  # the climb is kept up until the height is passed
_MANNERS = Manners(
    asks_with_int=False,
    retry_s=1.0,
    timeout_s=8.0,
    max_items=724,
    partial_writes=True,
    busy_result=mavlink.MAV_MISSION_DENIED,
    restarts=True,
    wrong_sequence_result=mavlink.MAV_MISSION_INVALID_SEQUENCE,
    repeats_final_ack=False,
    timeout_result=mavlink.MAV_MISSION_OPERATION_CANCELLED,
    timeout_severity=mavlink.MAV_SEVERITY_WARNING,
    timeout_text="Mission upload timeout",
)
_SENSORS_PRESENT = 0x1261FC3F
_SENSORS_ENABLED = 0x1261803F
_SENSORS_WAITING = 0x0211803F  # healthy before the EKF and the pre-arm checks are
_SENSORS_ARMED = 0x00007C00  # rate, attitude, yaw, altitude and position control


class Mode(IntEnum):
    MANUAL = 0
    FBWA = 5
    CRUISE = 7
    AUTO = 10
    RTL = 11
    LOITER = 12
    TAKEOFF = 13
    GUIDED = 15


_NAMES = {
    mavlink.MAV_CMD_NAV_WAYPOINT: "WP",
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: "LoitUnlim",
    mavlink.MAV_CMD_NAV_LOITER_TURNS: "LoitTurns",
    mavlink.MAV_CMD_NAV_LOITER_TIME: "LoitTime",
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: "RTL",
    mavlink.MAV_CMD_NAV_LAND: "Land",
    mavlink.MAV_CMD_NAV_TAKEOFF: "Takeoff",
    mavlink.MAV_CMD_NAV_LOITER_TO_ALT: "LoitAltitude",
}


@dataclass(slots=True)
class _Loiter:
    """The circle being flown. total_rad: how far round; reached: on it, or past its centre."""

    radius_m: float = 0.0
    clockwise: bool = True
    total_rad: float = 0.0
    last_bearing_rad: float | None = None
    reached_s: float | None = None


class ArduPlane(Autopilot):
    autopilot_id = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    first_mode = Mode.MANUAL
    navigation_period_s = 0.1
    ready_s = 23.0
    unknown_message_result = DENIED
    arming_refusal = (FAILED, "Arm: AHRS: waiting for home")
    default_interval_s: ClassVar[dict[int, float]] = dict.fromkeys(
        (
            mavlink.MAVLINK_MSG_ID_HEARTBEAT,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
            mavlink.MAVLINK_MSG_ID_ATTITUDE,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
            mavlink.MAVLINK_MSG_ID_VFR_HUD,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT,
            mavlink.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
            mavlink.MAVLINK_MSG_ID_WIND,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
        ),
        1.0,
    )

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, _BUILD, _INITIAL_HEADING_RAD, _parameters(settings))
        self.guidance = L1Guidance()
        home = self.home
        home_item = Item(
            mavlink.MAV_CMD_NAV_WAYPOINT,
            mavlink.MAV_FRAME_GLOBAL,
            (0.0, 0.0, 0.0, 0.0),
            round(home.latitude_deg * 1e7),
            round(home.longitude_deg * 1e7),
            home.altitude_m,
        )
        self.mission = ArduPlaneMission(home_item, self.say, self._start_item)
        self.mission.may_clear = lambda: not self.armed
        stores: tuple[Store, ...] = (self.mission, PointStore(False), PointStore(False))
        for mission_type, store in zip(self.mission_types, stores, strict=True):
            self.transfers[mission_type] = Transfer(
                mission_type, store, self.radio, _MANNERS, settings.link_rate, self.say
            )
        self._goal = self._previous = Place(0.0, 0.0, 0.0)
        self._on_track = False  # whether the leg from _previous to _goal is to be followed, or just its end
        self._track_next = True
        self._loiter = _Loiter()
        self._guided_radius_m = 0.0
        self._turn_ahead_rad = math.pi / 2
        self._failsafe = False
        self._handlers |= {
            mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: self._on_set_current,
            mavlink.MAV_CMD_MISSION_START: self._on_mission_start,
            mavlink.MAV_CMD_DO_REPOSITION: self._on_reposition,
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _: ACCEPTED if self.set_mode(Mode.RTL) else FAILED,
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: lambda _: ACCEPTED if self.set_mode(Mode.LOITER) else FAILED,
            mavlink.MAV_CMD_NAV_TAKEOFF: lambda _: FAILED,  # only for quadplanes
            mavlink.MAV_CMD_DO_CHANGE_SPEED: self._on_change_speed,
        }
        self._builders |= common_builders(self)
        self._builders |= self._own_builders()

    @property
    def roll_limit_rad(self) -> float:
        return math.radians(self.parameters["ROLL_LIMIT_DEG"])

    @property
    def base_mode(self) -> int:
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        flags |= mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if self.mode in (Mode.AUTO, Mode.RTL, Mode.LOITER, Mode.TAKEOFF, Mode.GUIDED):
            flags |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        return int(flags | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0))

    # Modes.

    def mode_of_command(self, base_mode: int, main: int, sub: int) -> int | None:
        return main if base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED and main in list(Mode) else None

    def set_mode(self, mode: int) -> bool:
        if mode not in list(Mode):
            return False
        if mode == self.mode:
            return True
        if mode == Mode.AUTO and len(self.mission.items()) <= 1:
            self.say(mavlink.MAV_SEVERITY_WARNING, "Mode change to AUTO denied: no mission")
            return False
        if self.mode == Mode.AUTO:
            self.mission.stop()
        self.mode = Mode(mode)
        self.lifting_off = False
        self.airspeed_goal_m_s = self.parameters["AIRSPEED_CRUISE"]
        if mode == Mode.AUTO:
            self._track_next = False
            self.mission.resume()
        elif mode == Mode.RTL:
            radius_m = self.parameters["RTL_RADIUS"] or self.parameters["WP_LOITER_RAD"]
            self._circle_at(Place(0.0, 0.0, self.parameters["RTL_ALTITUDE"]), abs(radius_m), radius_m >= 0)
        elif mode in (Mode.LOITER, Mode.GUIDED, Mode.CRUISE, Mode.FBWA, Mode.MANUAL):
            self._guided_radius_m = 0.0
            radius_m = self.parameters["WP_LOITER_RAD"]
            self._circle_at(self.here, abs(radius_m), radius_m >= 0)
        elif mode == Mode.TAKEOFF:
            self._begin_takeoff(self.parameters["TKOFF_ALT"])
        return True

    def on_armed(self) -> None:
        self.say(mavlink.MAV_SEVERITY_INFO, "Throttle armed")
        self.broadcast_now(mavlink.MAVLINK_MSG_ID_HOME_POSITION)

    def on_landed(self) -> None:
        self.disarm()
        self.say(mavlink.MAV_SEVERITY_INFO, "Throttle disarmed")

    def is_ground_station(self, heartbeat: Any) -> bool:
        return bool(heartbeat.get_srcSystem() == self.parameters["MAV_GCS_SYSID"])

    def watch_links(self) -> None:
        if not self.parameters["FS_GCS_ENABL"] or self.gcs_heard_s is None or not self.craft.flying:
            return
        silent_s = (self.now_s - self.gcs_heard_s) / self.settings.link_rate
        if silent_s < self.parameters["FS_LONG_TIMEOUT"]:
            self._failsafe = False
        elif not self._failsafe:
            self._failsafe = True
            self.say(mavlink.MAV_SEVERITY_WARNING, "GCS Failsafe")
            action = self.parameters["FS_LONG_ACTN"]
            if action == 1 or (action == 0 and self.mode not in (Mode.AUTO, Mode.GUIDED, Mode.LOITER)):
                self.set_mode(Mode.RTL)

    # Navigation.

    def navigate(self, dt_s: float) -> float:
        self.guidance.period_s = self.parameters["NAVL1_PERIOD"]
        self.guidance.damping = self.parameters["NAVL1_DAMPING"]
        match self.mode:
            case Mode.AUTO:
                return self._navigate_mission(dt_s)
            case Mode.GUIDED:
                return self._fly_circle(self._guided_radius_m, dt_s)
            case Mode.LOITER | Mode.RTL:
                return self._fly_circle(self._loiter.radius_m, dt_s)
            case Mode.TAKEOFF:
                if self._climbed_out():
                    self.set_mode(Mode.LOITER)
                return 0.0
            case _:  # sticks in the middle
                return 0.0

    def _navigate_mission(self, dt_s: float) -> float:
        item = self.mission.item
        if item is None:
            if self.mission.state == MissionState.COMPLETE:
                self.say(mavlink.MAV_SEVERITY_INFO, "Mission complete, changing mode to RTL")
                self.set_mode(Mode.RTL)
            return 0.0
        done, lateral_m_s2 = self._fly_item(item, dt_s)
        if done:
            self.radio.broadcast(mavlink.MAVLink_mission_item_reached_message(self.mission.index))
            self.mission.advance()
        return lateral_m_s2

    def _fly_item(self, item: Item, dt_s: float) -> tuple[bool, float]:
        """Return whether the item is done, and the lateral acceleration."""
        match item.command:
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                return self._climbed_out(), 0.0
            case mavlink.MAV_CMD_NAV_WAYPOINT:
                return self._fly_leg(item.params[1], dt_s)
            case mavlink.MAV_CMD_NAV_LAND:
                self.height_goal_m = min(self.height_goal_m, self._goal.distance_m(self.craft) / 8.0) - 2.0
                return False, self._follow_line(dt_s)
            case mavlink.MAV_CMD_NAV_LOITER_UNLIM:
                return False, self._fly_circle(abs(item.params[2]), dt_s)
            case mavlink.MAV_CMD_NAV_LOITER_TURNS:
                lateral_m_s2 = self._fly_circle(abs(item.params[2]), dt_s)
                return self._loiter.total_rad > item.params[0] * math.tau, lateral_m_s2
            case mavlink.MAV_CMD_NAV_LOITER_TIME:
                lateral_m_s2 = self._fly_circle(0.0, dt_s)  # this item has no room for a radius
                since_s = self._loiter.reached_s
                return since_s is not None and self.now_s - since_s > item.params[0], lateral_m_s2
            case mavlink.MAV_CMD_NAV_LOITER_TO_ALT:
                lateral_m_s2 = self._fly_circle(abs(item.params[1]), dt_s)
                at_height = abs(self.craft.height_m - self._goal.height_m) < 5.0
                return at_height and self._loiter.reached_s is not None, lateral_m_s2
            case _:
                return False, 0.0

    def _start_item(self, index: int, item: Item) -> None:
        match item.command:
            case mavlink.MAV_CMD_DO_CHANGE_SPEED:
                self._change_speed(item.params[0], item.params[1])
                return
            case mavlink.MAV_CMD_DO_LAND_START:
                return
        self.say(mavlink.MAV_SEVERITY_INFO, f"Mission: {index} {_NAMES[item.command]}")
        self.broadcast_now(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)
        match item.command:
            case mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                self.set_mode(Mode.RTL)
                return
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                self._begin_takeoff(self.place_of(item).height_m)
                return
        self._set_goal(self.place_of(item))
        turn_param = 1 if item.command == mavlink.MAV_CMD_NAV_LOITER_TO_ALT else 2
        self._loiter = _Loiter(clockwise=item.params[turn_param] >= 0)

    def _set_goal(self, goal: Place) -> None:
        if self._track_next:
            self._previous, self._on_track = self._goal, True
        else:
            self._previous, self._on_track, self._track_next = self.here, False, True
        self._goal = goal
        if self._past_finish_line():
            self._previous = self.here
        self.height_goal_m = goal.height_m
        following = self.mission.following()
        self._turn_ahead_rad = math.pi / 2
        if following is not None and following.has_position and following.latitude_e7:
            after = self.place_of(following)
            course_rad = math.atan2(goal.east_m - self._previous.east_m, goal.north_m - self._previous.north_m)
            next_rad = math.atan2(after.east_m - goal.east_m, after.north_m - goal.north_m)
            self._turn_ahead_rad = abs(math.remainder(next_rad - course_rad, math.tau))

    def _begin_takeoff(self, height_m: float) -> None:
        self._goal = Place(self.craft.east_m, self.craft.north_m, height_m)
        self.height_goal_m = height_m + _TAKEOFF_OVERSHOOT_M

    def _climbed_out(self) -> bool:
        """Climb straight ahead; True when the height of the takeoff is passed."""
        if not self.craft.flying:
            self.lifting_off = self.armed
            return False
        if self.craft.height_m < self._goal.height_m:
            return False
        self.say(mavlink.MAV_SEVERITY_INFO, f"Takeoff complete at {self.craft.height_m:.2f}m")
        self._track_next = False
        return True

    def _fly_leg(self, acceptance_m: float, dt_s: float) -> tuple[bool, float]:
        lateral_m_s2 = self._follow_line(dt_s)
        if acceptance_m <= 0.0:
            reach_m = min(self.parameters["WP_RADIUS"] * self.true_airspeed_ratio**2, self.guidance.length_m)
            acceptance_m = reach_m * min(1.0, self._turn_ahead_rad / (math.pi / 2))
        distance_m = self._goal.distance_m(self.craft)
        verb = "Reached" if distance_m <= acceptance_m else "Passed" if self._past_finish_line() else None
        if verb is None:
            return False, lateral_m_s2
        text = f"{verb} waypoint #{self.mission.index} dist {distance_m:.0f}m"
        self.say(mavlink.MAV_SEVERITY_INFO, text)
        return True, lateral_m_s2

    def _follow_line(self, dt_s: float) -> float:
        start = self._previous if self._on_track else self.here
        return self.guidance.towards_line(self.craft, start.ground_m, self._goal.ground_m, dt_s)

    def _past_finish_line(self) -> bool:
        """Whether the line through the goal, square to the leg, is behind."""
        leg_east_m, leg_north_m = (
            self._goal.east_m - self._previous.east_m,
            self._goal.north_m - self._previous.north_m,
        )
        east_m, north_m = self.craft.east_m - self._goal.east_m, self.craft.north_m - self._goal.north_m
        return leg_east_m * east_m + leg_north_m * north_m >= 0.0

    def _circle_at(self, centre: Place, radius_m: float, clockwise: bool) -> None:
        self._previous, self._goal = self.here, centre
        self._on_track = False
        self.height_goal_m = centre.height_m
        self._loiter = _Loiter(radius_m, clockwise)

    def _fly_circle(self, radius_m: float, dt_s: float) -> float:
        loiter = self._loiter
        if radius_m <= 1.0:
            default_m = self.parameters["WP_LOITER_RAD"]
            radius_m = abs(default_m)
            if self.mode != Mode.GUIDED:
                loiter.clockwise = loiter.clockwise and default_m >= 0
        loiter.radius_m = radius_m
        # ArduPlane widens circles in thin air, to keep the bank of sea level.
        scaled_m = radius_m * self.true_airspeed_ratio**2
        if loiter.reached_s is None and self._on_track and self._goal.distance_m(self.craft) > 3.0 * scaled_m:
            lateral_m_s2 = self._follow_line(dt_s)
        else:
            lateral_m_s2 = self.guidance.towards_circle(self.craft, self._goal.ground_m, scaled_m, loiter.clockwise)
        if self.guidance.on_circle or loiter.last_bearing_rad is not None:
            bearing_rad = math.atan2(self._goal.east_m - self.craft.east_m, self._goal.north_m - self.craft.north_m)
            if loiter.last_bearing_rad is not None:
                step_rad = math.remainder(bearing_rad - loiter.last_bearing_rad, math.tau)
                loiter.total_rad += step_rad if loiter.clockwise else -step_rad
            loiter.last_bearing_rad = bearing_rad
        if loiter.reached_s is None and (self.guidance.on_circle or self._past_finish_line()):
            loiter.reached_s = self.now_s
            if self.mode == Mode.GUIDED:
                self.radio.broadcast(mavlink.MAVLink_mission_item_reached_message(0))
        return lateral_m_s2

    # Commands.

    def set_current_item(self, index: int) -> bool:
        return self.mission.set_current(index)

    def _on_set_current(self, command: Command) -> int:
        index = int(command.param(1))
        if not 0 <= index < len(self.mission.items()):
            return DENIED
        if command.param(2) == 1.0:
            self.mission.state = MissionState.STOPPED if self.mode != Mode.AUTO else MissionState.RUNNING
        if not self.mission.set_current(index):
            return FAILED
        self.broadcast_now(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)
        return ACCEPTED

    def _on_mission_start(self, command: Command) -> int:
        if command.param(1) or command.param(2):
            return DENIED
        self.set_mode(Mode.AUTO)
        return ACCEPTED

    def _on_reposition(self, command: Command) -> int:
        if command.frame is None:
            return UNSUPPORTED
        latitude_deg, longitude_deg, altitude_m = command.params[4:7]
        if command.frame not in ABSOLUTE_FRAMES and command.frame not in RELATIVE_FRAMES:
            return DENIED
        if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):  # NaN too
            return DENIED
        flags = command.param(2)
        if not (int(0 if math.isnan(flags) else flags) & 1 or self.mode == Mode.GUIDED):
            return FAILED
        height_m = altitude_m if command.frame in RELATIVE_FRAMES else altitude_m - self.home.altitude_m
        if latitude_deg == 0.0 and longitude_deg == 0.0:
            east_m, north_m = self.craft.east_m, self.craft.north_m
        else:
            east_m, north_m = self.plane.east_north_m(latitude_deg, longitude_deg)
        yaw, radius_m = command.param(4), command.param(3)
        counter_clockwise = not (math.isnan(yaw) or yaw == 0.0)
        self.set_mode(Mode.GUIDED)
        if not math.isnan(radius_m) and radius_m > 0.0:
            self._guided_radius_m = float(math.floor(radius_m))
        else:
            counter_clockwise = counter_clockwise or self.parameters["WP_LOITER_RAD"] < 0
        self._circle_at(Place(east_m, north_m, height_m), self._guided_radius_m, not counter_clockwise)
        return ACCEPTED

    def _on_change_speed(self, command: Command) -> int:
        return ACCEPTED if self._change_speed(command.param(1), command.param(2)) else FAILED

    def _change_speed(self, kind: float, speed_m_s: float) -> bool:
        if kind != 0.0 or not self.parameters["AIRSPEED_MIN"] <= speed_m_s <= self.parameters["AIRSPEED_MAX"]:
            return False
        self.airspeed_goal_m_s = speed_m_s
        return True

    # Telemetry.

    def _own_builders(self) -> dict[int, Callable[[], Any]]:
        return {
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission_current,
            mavlink.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: self._nav_controller_output,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: self._position_target,
            mavlink.MAVLINK_MSG_ID_WIND: self._wind,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._ekf_status,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._version,
        }

    def _sys_status(self) -> Any:
        controls = _SENSORS_ARMED if self.armed else 0
        healthy = _SENSORS_ENABLED if self.ready else _SENSORS_WAITING
        return mavlink.MAVLink_sys_status_message(
            _SENSORS_PRESENT,
            _SENSORS_ENABLED | controls,
            healthy & ~0x00400000 | controls,
            0,
            12600,
            1000,
            99,
            *(0,) * 6,
        )

    def _gps_raw(self) -> Any:
        craft = self.craft
        latitude_deg, longitude_deg = self.plane.latitude_longitude_deg(craft.east_m, craft.north_m)
        altitude_mm = round((self.home.altitude_m + craft.height_m) * 1000.0)
        return mavlink.MAVLink_gps_raw_int_message(
            self.boot_us,
            mavlink.GPS_FIX_TYPE_RTK_FIXED,
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            altitude_mm,
            121,
            200,
            round(craft.ground_speed_m_s * 100.0),
            round(math.degrees(craft.course_rad) * 100.0) % 36000,
            10,
            altitude_mm,
            300,
            300,
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
            [NAN] * 4,
            0.0,
            0.0,
            0.0,
            self.boot_us,
        )

    def _mission_current(self) -> Any:
        mission = self.mission
        return mavlink.MAVLink_mission_current_message(
            mission.index,
            max(0, len(mission.items()) - 1),
            mission.reported_state,
            int(self.mode == Mode.AUTO),
        )

    def _nav_controller_output(self) -> Any:
        goal, craft = self._goal, self.craft
        bearing_rad = math.atan2(goal.east_m - craft.east_m, goal.north_m - craft.north_m)
        return mavlink.MAVLink_nav_controller_output_message(
            math.degrees(self.roll_goal_rad),
            math.degrees(craft.pitch_rad),
            round(math.degrees(math.remainder(self.guidance.nav_bearing_rad, math.tau))),
            round(math.degrees(bearing_rad)),
            min(65535, round(goal.distance_m(craft))),
            self.height_goal_m - craft.height_m,
            0.0,
            self.guidance.cross_track_m,
        )

    def _position_target(self) -> Any:
        if self.mode not in (Mode.AUTO, Mode.GUIDED, Mode.LOITER, Mode.RTL) or not self.armed:
            return None
        latitude_deg, longitude_deg = self.plane.latitude_longitude_deg(*self._goal.ground_m)
        return mavlink.MAVLink_position_target_global_int_message(
            self.boot_ms,
            mavlink.MAV_FRAME_GLOBAL,
            0xFDF8,
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            self.home.altitude_m + self._goal.height_m,
            *(0.0,) * 8,
        )

    def _wind(self) -> Any:
        wind = self.craft.wind
        from_deg = math.degrees(math.atan2(-wind.east_m_s, -wind.north_m_s))
        return mavlink.MAVLink_wind_message(from_deg, math.hypot(wind.east_m_s, wind.north_m_s), 0.0)

    def _ekf_status(self) -> Any:
        return mavlink.MAVLink_ekf_status_report_message(831 if self.ready else 167, *(0.01,) * 5)

    def _version(self) -> Any:
        capabilities = (
            mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
            | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
            | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        )
        return mavlink.MAVLink_autopilot_version_message(
            capabilities, 4 << 24 | 7 << 16, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0x1209, 0x5740, self.system_id
        )


def _parameters(settings: Settings) -> Parameters:
    airspeed_m_s = settings.airspeed_m_s
    table: dict[str, tuple[int, float]] = {
        "AIRSPEED_CRUISE": (REAL32, airspeed_m_s),
        "AIRSPEED_MIN": (INT16, math.floor(min(10.0, 0.7 * airspeed_m_s))),
        "AIRSPEED_MAX": (INT16, math.ceil(max(30.0, 1.35 * airspeed_m_s))),
        "ROLL_LIMIT_DEG": (REAL32, 65.0),
        "WP_LOITER_RAD": (INT16, 80.0),
        "WP_RADIUS": (INT16, 50.0),
        "RTL_RADIUS": (INT16, 0.0),
        "RTL_ALTITUDE": (REAL32, 100.0),
        "TKOFF_ALT": (REAL32, 50.0),
        "NAVL1_PERIOD": (REAL32, 17.0),
        "NAVL1_DAMPING": (REAL32, 0.75),
        "NAVL1_XTRACK_I": (REAL32, 0.02),
        "FS_GCS_ENABL": (INT8, 0.0),
        "FS_LONG_ACTN": (INT8, 0.0),
        "FS_LONG_TIMEOUT": (REAL32, 5.0),
        "FS_SHORT_ACTN": (INT8, 0.0),
        "FS_SHORT_TIMEOUT": (REAL32, 1.5),
        "MAV_GCS_SYSID": (INT16, 255.0),
        "MAV_SYSID": (INT16, settings.system_id),
        "FENCE_ENABLE": (INT8, 0.0),
        "FENCE_ACTION": (INT8, 1.0),
        "FENCE_TOTAL": (INT8, 0.0),
        "MIS_RESTART": (INT8, 0.0),
        "MIS_TOTAL": (INT16, 0.0),
        "RNGFND1_TYPE": (INT8, 0.0),
        "STAT_RUNTIME": (INT32, 0.0),
    }
    return Parameters(table, bytewise=False)
