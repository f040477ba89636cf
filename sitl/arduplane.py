"""A simulated ArduPlane as a ground program meets it: modes, mission, guidance, parameters, telemetry, terrain.

Guidance is that of its waypoint and loiter code: L1 by S. Park, J. Deyst, J. P. How, "A New Nonlinear Guidance Logic
for Trajectory Tracking", AIAA 2004-4900, with a PD term on circles. Neither branch for circles has an integral, so an
airframe that turns less than its bank promises flies a larger circle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.autopilot import NAN, AutopilotTelemetry, SimulatedAutopilot
from sidelong.sitl.protocol.commands import ACCEPTED, DENIED, FAILED, UNSUPPORTED, Command
from sidelong.sitl.protocol.parameters import INT8, INT16, INT32, REAL32, Parameters
from sidelong.sitl.protocol.radio import Station
from sidelong.sitl.protocol.transfer import (
    ABSOLUTE_FRAMES,
    ACCEPTED_ITEMS,
    RELATIVE_FRAMES,
    Item,
    ItemRefused,
    Store,
    TransferQuirks,
)
from sidelong.sitl.settings import Release, Settings
from sidelong.sitl.world.airframe import (
    AirframeParameters,
    LocalPosition,
    SimulatedAirframe,
)

_CAPTURE_MAX = math.sin(math.pi / 4)  # a line is met at 45 degrees at most
_INTEGRAL_MAX_RAD = 0.1
_PASSED_S = 3.0
_RIGHT_ANGLE_RAD = math.pi / 2
NAVIGATION_PERIOD_S = 0.1


class L1Guidance:
    """Lateral acceleration towards a line or a circle, and what was computed on the way, for telemetry."""

    def __init__(self, period_s: float = 17.0, damping: float = 0.75, integral_gain: float = 0.02) -> None:
        self.period_s, self.damping, self.integral_gain = period_s, damping, integral_gain
        self.length_m = self.cross_track_m = self.nav_bearing_rad = self._bearing_integral_rad = 0.0
        self.on_circle = False

    def towards_line(
        self, craft: SimulatedAirframe, start_m: tuple[float, float], end_m: tuple[float, float], dt_s: float
    ) -> float:
        """Return the lateral acceleration, m/s^2, to the right, that joins and follows the line."""
        self.on_circle = False
        speed_m_s, course_rad = max(0.1, craft.ground_speed_m_s), craft.course_rad
        self.length_m = self.damping * self.period_s * speed_m_s / math.pi
        line_east_m, line_north_m = end_m[0] - start_m[0], end_m[1] - start_m[1]
        line_m = math.hypot(line_east_m, line_north_m)
        if line_m < 1e-6:
            line_east_m, line_north_m = end_m[0] - craft.east_m, end_m[1] - craft.north_m
        line_rad = math.atan2(line_east_m, line_north_m)
        from_start_m = (craft.east_m - start_m[0], craft.north_m - start_m[1])
        sine, cosine = math.sin(line_rad), math.cos(line_rad)
        along_m = from_start_m[0] * sine + from_start_m[1] * cosine
        self.cross_track_m = from_start_m[0] * cosine - from_start_m[1] * sine  # positive right of the line
        start_distance_m = math.hypot(*from_start_m)
        if start_distance_m > self.length_m and along_m < -_CAPTURE_MAX * start_distance_m:
            aim_rad = math.atan2(-from_start_m[0], -from_start_m[1])
        elif along_m > line_m + _PASSED_S * speed_m_s:
            aim_rad = math.atan2(end_m[0] - craft.east_m, end_m[1] - craft.north_m)
        else:
            offset = max(-_CAPTURE_MAX, min(_CAPTURE_MAX, self.cross_track_m / self.length_m))
            turn_in_rad = math.asin(offset)
            if abs(turn_in_rad) < math.radians(5.0):
                integral_rad = self._bearing_integral_rad + turn_in_rad * self.integral_gain * dt_s
                self._bearing_integral_rad = max(-_INTEGRAL_MAX_RAD, min(_INTEGRAL_MAX_RAD, integral_rad))
            aim_rad = line_rad - turn_in_rad - self._bearing_integral_rad
        self.nav_bearing_rad = aim_rad
        return self._pursue(aim_rad - course_rad, speed_m_s)

    def towards_circle(
        self, craft: SimulatedAirframe, centre_m: tuple[float, float], radius_m: float, clockwise: bool
    ) -> float:
        """Return the lateral acceleration, m/s^2, to the right, that captures the circle and then holds it."""
        # Comparisons in place of max(), as the airframe has them.
        velocity_east_m_s, velocity_north_m_s = craft.velocity_east_m_s, craft.velocity_north_m_s
        speed_m_s = math.hypot(velocity_east_m_s, velocity_north_m_s)
        course_rad = math.atan2(velocity_east_m_s, velocity_north_m_s) if speed_m_s else craft.heading_rad
        speed_m_s = speed_m_s if speed_m_s > 1.0 else 1.0
        self.length_m = self.damping * self.period_s * speed_m_s / math.pi
        east_m, north_m = craft.east_m - centre_m[0], craft.north_m - centre_m[1]
        distance_m = math.hypot(east_m, north_m)
        distance_m = distance_m if distance_m > 0.1 else 0.1
        out_east, out_north = east_m / distance_m, north_m / distance_m
        outward_m_s = velocity_east_m_s * out_east + velocity_north_m_s * out_north
        rightward_m_s = velocity_east_m_s * out_north - velocity_north_m_s * out_east
        turn = 1.0 if clockwise else -1.0
        tangential_m_s = turn * rightward_m_s  # positive the right way round
        natural_rad_s = math.tau / self.period_s
        self.cross_track_m = distance_m - radius_m
        self.nav_bearing_rad = math.atan2(-east_m, -north_m)
        capture_m_s2 = self._pursue(self.nav_bearing_rad - course_rad, speed_m_s)
        hold_m_s2 = natural_rad_s**2 * self.cross_track_m + 2.0 * self.damping * natural_rad_s * outward_m_s
        if outward_m_s > 0.0 and tangential_m_s < 0.0:  # the wrong way round: do not turn further outward
            hold_m_s2 = max(0.0, hold_m_s2)
        least_m = 0.5 * radius_m
        circle_m_s2 = turn * (hold_m_s2 + tangential_m_s**2 / (distance_m if distance_m > least_m else least_m))
        self.on_circle = not (self.cross_track_m > 0.0 and turn * capture_m_s2 < turn * circle_m_s2)
        return circle_m_s2 if self.on_circle else capture_m_s2

    def _pursue(self, angle_rad: float, speed_m_s: float) -> float:
        angle_rad = angle_rad if -math.pi < angle_rad < math.pi else math.remainder(angle_rad, math.tau)
        is_ahead = -_RIGHT_ANGLE_RAD < angle_rad < _RIGHT_ANGLE_RAD
        sine = math.sin(angle_rad) if is_ahead else 1.0 if angle_rad > 0.0 else -1.0
        return 4.0 * self.damping**2 * speed_m_s**2 / self.length_m * sine


_LINE_RADII = 3.0  # a circle further away than this many radii is approached along the leg to its centre


@dataclass(slots=True)
class Loiter:
    """Progress on a circle. reached_s: when it was captured, or its centre passed."""

    clockwise: bool
    reached_s: float | None = None
    turned_rad: float = 0.0
    last_bearing_rad: float | None = None


class ArduPlaneNavigator:
    """It widens radii in thin air by the squared ratio of airspeeds, so that the bank stays that of sea level."""

    def __init__(self, craft: SimulatedAirframe, parameters: Parameters) -> None:
        self._craft, self._parameters = craft, parameters
        self.guidance = L1Guidance()
        self.goal = self._origin = LocalPosition(0.0, 0.0, 0.0)
        self.loiter = Loiter(clockwise=True)
        self._tuned_at = -1  # changes of parameters when the guidance was tuned
        self._on_track = self._track_next = False  # the leg is to be followed, not just its end reached
        self._turn_ahead_rad = _RIGHT_ANGLE_RAD

    def start_over(self) -> None:
        """Let the next leg begin here, untracked, as after a takeoff or a change of mode."""
        self._track_next = False

    def go_to(self, goal: LocalPosition, then: LocalPosition | None, clockwise: bool) -> None:
        """Make ``goal`` the end of the next leg; ``then`` is what follows it in the mission."""
        if self._track_next:
            self._origin, self._on_track = self.goal, True
        else:
            self._origin, self._on_track, self._track_next = LocalPosition.of(self._craft), False, True
        self.goal = goal
        if self._behind_goal():
            self._origin = LocalPosition.of(self._craft)
        self.loiter = Loiter(clockwise)
        self._turn_ahead_rad = _RIGHT_ANGLE_RAD
        if then is not None:
            course_rad, next_rad = self._origin.bearing_rad(goal), goal.bearing_rad(then)
            self._turn_ahead_rad = abs(math.remainder(next_rad - course_rad, math.tau))

    def circle(self, centre: LocalPosition, clockwise: bool) -> None:
        """Head straight for a circle, without a line to follow."""
        self._origin, self.goal, self._on_track = LocalPosition.of(self._craft), centre, False
        self.loiter = Loiter(clockwise)

    def fly_leg(self, acceptance_m: float) -> tuple[str | None, float]:
        """Return the word for how the leg ended (None: it has not) and the lateral acceleration.

        acceptance_m 0: by WP_RADIUS, in proportion to the turn that follows, or past the finish line.
        """
        lateral_m_s2 = self.fly_line()
        if acceptance_m <= 0.0:
            reach_m = min(self._parameters["WP_RADIUS"] * self._craft.true_airspeed_ratio**2, self.guidance.length_m)
            acceptance_m = reach_m * min(1.0, self._turn_ahead_rad / _RIGHT_ANGLE_RAD)
        if self.goal.distance_m(self._craft) <= acceptance_m:
            return "Reached", lateral_m_s2
        return "Passed" if self._behind_goal() else None, lateral_m_s2

    def fly_line(self) -> float:
        """Return the lateral acceleration that follows the leg to the goal, m/s^2."""
        if self._tuned_at != self._parameters.changes:
            self._tune()
        craft, goal = self._craft, self.goal
        start_m = self._origin.ground_m if self._on_track else (craft.east_m, craft.north_m)
        return self.guidance.towards_line(craft, start_m, goal.ground_m, NAVIGATION_PERIOD_S)

    def fly_circle(self, radius_m: float, now_s: float, by_line: bool) -> float:
        """Return the lateral acceleration onto the goal's circle, m/s^2; by_line: approach a far one along a leg."""
        loiter, craft, goal, guidance = self.loiter, self._craft, self.goal, self.guidance
        radius_m *= craft.true_airspeed_ratio**2
        approaches = by_line and self._on_track and loiter.reached_s is None
        if approaches and goal.distance_m(craft) > _LINE_RADII * radius_m:
            return self.fly_line()
        if self._tuned_at != self._parameters.changes:
            self._tune()
        lateral_m_s2 = guidance.towards_circle(craft, (goal.east_m, goal.north_m), radius_m, loiter.clockwise)
        if loiter.reached_s is None and (guidance.on_circle or self._behind_goal()):
            loiter.reached_s = now_s
        if guidance.on_circle or loiter.last_bearing_rad is not None:
            bearing_rad = guidance.nav_bearing_rad  # that of the centre
            if loiter.last_bearing_rad is not None:
                step_rad = bearing_rad - loiter.last_bearing_rad
                if not -math.pi < step_rad < math.pi:
                    step_rad = math.remainder(step_rad, math.tau)
                loiter.turned_rad += step_rad if loiter.clockwise else -step_rad
            loiter.last_bearing_rad = bearing_rad
        return lateral_m_s2

    def _tune(self) -> None:
        self._tuned_at = self._parameters.changes
        self.guidance.period_s = self._parameters.within("NAVL1_PERIOD", 1.0, 60.0)
        self.guidance.damping = self._parameters.within("NAVL1_DAMPING", 0.1, 2.0)
        self.guidance.integral_gain = self._parameters["NAVL1_XTRACK_I"]

    def _behind_goal(self) -> bool:
        """Whether the finish line, square to the leg through its end, is passed."""
        leg_east_m, leg_north_m = self.goal.east_m - self._origin.east_m, self.goal.north_m - self._origin.north_m
        east_m, north_m = self._craft.east_m - self.goal.east_m, self._craft.north_m - self.goal.north_m
        return leg_east_m * east_m + leg_north_m * north_m >= 0.0


NAVIGATION = {  # items that are flown, with their names in texts
    mavlink.MAV_CMD_NAV_WAYPOINT: "WP",
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: "LoitUnlim",
    mavlink.MAV_CMD_NAV_LOITER_TURNS: "LoitTurns",
    mavlink.MAV_CMD_NAV_LOITER_TIME: "LoitTime",
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: "RTL",
    mavlink.MAV_CMD_NAV_LAND: "Land",
    mavlink.MAV_CMD_NAV_TAKEOFF: "Takeoff",
    mavlink.MAV_CMD_NAV_LOITER_TO_ALT: "LoitAltitude",
}
_ANY_YAW = {
    mavlink.MAV_CMD_NAV_WAYPOINT,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM,
    mavlink.MAV_CMD_NAV_LAND,
    mavlink.MAV_CMD_NAV_TAKEOFF,
}  # whose param 4 may be NaN


class MissionState(IntEnum):
    STOPPED = mavlink.MISSION_STATE_NOT_STARTED
    RUNNING = mavlink.MISSION_STATE_ACTIVE
    COMPLETE = mavlink.MISSION_STATE_COMPLETE


class ArduPlaneMission(Store):
    """Storage and sequence. ``on_start`` is called with each item that begins, navigation or immediate."""

    def __init__(
        self,
        home: Item,
        say: Callable[[int, str], None],
        on_start: Callable[[int, Item], None],
        armed: Callable[[], bool],
    ) -> None:
        super().__init__(with_checksum=False)
        self._home, self._say, self._on_start, self._armed = home, say, on_start, armed
        self.state = MissionState.STOPPED
        self.index = 0  # of the item that is flown, or would be; 0: none yet
        self.item: Item | None = None  # the copy that is flown

    def current_index(self) -> int:
        return self.index

    def begin(self, count: int) -> int:
        del self._items[count:]
        return self.finish() if count == 0 else ACCEPTED_ITEMS

    def put(self, index: int, item: Item, current: bool) -> None:  # ArduPilot ignores the flag
        refuse_no_numbers(item)
        stored = self._home if index == 0 else as_stored(item)
        if index < len(self._items):
            self._items[index] = stored
        elif index == len(self._items):
            self._items.append(stored)
        else:
            raise ItemRefused(mavlink.MAV_MISSION_ERROR)

    def finish(self) -> int:
        self._say(mavlink.MAV_SEVERITY_INFO, "Flight plan received")
        return ACCEPTED_ITEMS

    def abandon(self) -> None:
        """Leave what has arrived where it is."""

    def clear(self) -> int:
        if self.state is MissionState.RUNNING and self._armed():
            return int(mavlink.MAV_MISSION_ERROR)
        self._items.clear()
        self.state, self.index, self.item = MissionState.STOPPED, 0, None
        return ACCEPTED_ITEMS

    @property
    def reported_state(self) -> int:
        return int(mavlink.MISSION_STATE_NO_MISSION if len(self._items) <= 1 else self.state)

    def stop(self) -> None:
        """Leave a running mission where it is."""
        if self.state == MissionState.RUNNING:
            self.state = MissionState.STOPPED

    def resume(self) -> None:
        """Fly the current item as it is stored now; from the first if there is none or the mission had ended."""
        index = self.index if self.state == MissionState.STOPPED and 0 < self.index < len(self._items) else 1
        self.state = MissionState.RUNNING
        self._start_from(index)

    def set_current(self, index: int) -> bool:
        """Make an item current, and fly it if the mission runs; False: there is none."""
        if not 0 <= index < len(self._items) or len(self._items) <= 1:
            return False
        index = max(1, index)
        if self.state == MissionState.RUNNING:
            self._start_from(index)
        else:
            self.state, self.index = MissionState.STOPPED, index
        return True

    def advance(self) -> None:
        self._start_from(self.index + 1)

    def following(self) -> Item | None:
        """Return the next item that flies somewhere; None: none follows."""
        return next((item for item in self._items[self.index + 1 :] if item.command in NAVIGATION), None)

    def _start_from(self, index: int) -> None:
        for number, item in enumerate(self._items[index:], index):
            if item.command in NAVIGATION:
                self.index, self.item = number, item
            self._on_start(number, item)
            if item.command in NAVIGATION:
                return
        self.state, self.item = MissionState.COMPLETE, None


def refuse_no_numbers(item: Item) -> None:
    """Raise ItemRefused for the first param that is no number, where it has to be one."""
    for number, value in enumerate(item.params):
        if math.isinf(value) or (math.isnan(value) and (number < 3 or item.command not in _ANY_YAW)):
            raise ItemRefused(mavlink.MAV_MISSION_INVALID_PARAM1 + number)


def as_stored(item: Item) -> Item:
    """Return the item as the vehicle gives it back. Raises ItemRefused."""
    first, second, third, fourth = item.params
    params: tuple[float, ...]
    match item.command:
        case mavlink.MAV_CMD_NAV_WAYPOINT:
            params = (0.0, float(min(255, _whole(second))), float(min(255, _whole(third))))
        case mavlink.MAV_CMD_NAV_LOITER_UNLIM:
            params = (0.0, 0.0, _signed_whole(third))
        case mavlink.MAV_CMD_NAV_LOITER_TURNS:
            turns = math.floor(first * 256.0) / 256.0 if 0 < first < 1 else float(min(255, _whole(first)))
            radius_m = abs(third)
            kept_m = float(math.floor(radius_m)) if radius_m <= 255 else 10.0 * min(255, math.floor(radius_m / 10.0))
            params = (turns, 0.0, math.copysign(kept_m, third), float(fourth > 0))
        case mavlink.MAV_CMD_NAV_LOITER_TIME:
            params = (float(_whole(first)), 0.0, -1.0 if third < 0 else 1.0, float(fourth > 0))
        case mavlink.MAV_CMD_NAV_LOITER_TO_ALT:
            params = (0.0, _signed_whole(second), 0.0, float(fourth > 0))
        case mavlink.MAV_CMD_NAV_TAKEOFF | mavlink.MAV_CMD_NAV_LAND:
            params = (float(_whole(first)),)
        case mavlink.MAV_CMD_DO_CHANGE_SPEED:
            return item
        case mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH | mavlink.MAV_CMD_DO_LAND_START:
            params = ()
        case _:
            raise ItemRefused(mavlink.MAV_MISSION_UNSUPPORTED)
    if not item.has_position:
        raise ItemRefused(mavlink.MAV_MISSION_UNSUPPORTED_FRAME)
    above_home = item.frame in RELATIVE_FRAMES
    frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT if above_home else mavlink.MAV_FRAME_GLOBAL
    altitude_m = math.trunc(item.altitude_m * 100.0) / 100.0
    return replace(item.with_params(*params), frame=frame, altitude_m=altitude_m, autocontinue=1)


def _whole(value: float) -> int:
    return int(max(0.0, value)) if math.isfinite(value) else 0


def _signed_whole(value: float) -> float:
    return math.copysign(float(math.floor(abs(value))), value) if math.isfinite(value) else 0.0


_SPACING_M = 100
_ACROSS, _UP, _SQUARE = 8, 7, 4
_METRES_PER_DEG = 111_318.84502145034  # ArduPilot's LATLON_TO_M, in degrees


class TerrainDatabase:
    """Terrain heights (AMSL) around a position, as far as they have been received."""

    def __init__(self, latitude_deg: float, longitude_deg: float) -> None:
        self._origin_deg = latitude_deg, longitude_deg
        self._step_deg = _SPACING_M / _METRES_PER_DEG
        self._blocks: dict[tuple[int, int], npt.NDArray[np.float64]] = {}

    def request(self, latitude_deg: float, longitude_deg: float) -> Any:
        """Return the TERRAIN_REQUEST for what is missing of the block about a place; None where nothing is."""
        corner, heights, _, _ = self._block(latitude_deg, longitude_deg)
        mask = sum(1 << bit for bit in range(_ACROSS * _UP) if np.isnan(_square(heights, bit)).any())
        return mavlink.MAVLink_terrain_request_message(*corner, _SPACING_M, mask) if mask else None

    def take(self, data: Any) -> None:
        """Store the heights of a TERRAIN_DATA that belongs to a known block."""
        for (row, column), heights in self._blocks.items():
            if (data.lat, data.lon) == self._corner_e7(row, column) and data.grid_spacing == _SPACING_M:
                _square(heights, data.gridbit)[:] = np.reshape(data.data, (_SQUARE, _SQUARE))

    def report(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Any:
        """Return the TERRAIN_REPORT of a place; its spacing is 0 where the height is not known."""
        _, heights, x, y = self._block(latitude_deg, longitude_deg)
        column, row = int(x), int(y)
        u, v = x - column, y - row
        (sw, se), (nw, ne) = heights[row : row + 2, column : column + 2].tolist()
        ground_m = (1 - v) * ((1 - u) * sw + u * se) + v * ((1 - u) * nw + u * ne)
        known = not math.isnan(ground_m)
        pending = sum(int(np.isnan(block).sum()) for block in self._blocks.values()) // _SQUARE**2
        place_e7 = round(latitude_deg * 1e7), round(longitude_deg * 1e7)
        answer_m = (_SPACING_M, ground_m, altitude_m - ground_m) if known else (0, 0.0, 0.0)
        loaded = len(self._blocks) * _ACROSS * _UP - pending
        return mavlink.MAVLink_terrain_report_message(*place_e7, *answer_m, pending, loaded)

    def _block(
        self, latitude_deg: float, longitude_deg: float
    ) -> tuple[tuple[int, int], npt.NDArray[np.float64], float, float]:
        """Return corner (1e-7 degrees) and posts of the block about a place, and where among the posts that is."""
        rows, columns = _UP * _SQUARE - 1, _ACROSS * _SQUARE - 1
        y = (latitude_deg - self._origin_deg[0]) / self._step_deg
        row = math.floor(y / rows)
        shrunk = math.cos(math.radians(self._corner_e7(row, 0)[0] * 1e-7))
        x = (longitude_deg - self._origin_deg[1]) / (self._step_deg / shrunk)
        column = math.floor(x / columns)
        heights = self._blocks.setdefault((row, column), np.full((rows + 1, columns + 1), np.nan))
        return self._corner_e7(row, column), heights, x - column * columns, y - row * rows

    def _corner_e7(self, row: int, column: int) -> tuple[int, int]:
        south_deg = self._origin_deg[0] + row * (_UP * _SQUARE - 1) * self._step_deg
        step_east_deg = self._step_deg / math.cos(math.radians(round(south_deg * 1e7) * 1e-7))
        west_deg = self._origin_deg[1] + column * (_ACROSS * _SQUARE - 1) * step_east_deg
        return round(south_deg * 1e7), round(west_deg * 1e7)


def _square(heights: npt.NDArray[np.float64], bit: int) -> npt.NDArray[np.float64]:
    row, column = _SQUARE * (bit // _ACROSS), _SQUARE * (bit % _ACROSS)
    return heights[row : row + _SQUARE, column : column + _SQUARE]


# MAV_SYS_STATUS bits as the stock simulator sends them.
_PRESENT = 0x1261FC3F
_ENABLED = 0x1261803F
_HEALTHY = 0x1231803F
_HEALTHY_BEFORE_READY = 0x0211803F  # before the EKF and the pre-arm checks are content
_CONTROLLERS = 0x00007C00  # enabled and healthy once armed

# What REQUEST_DATA_STREAM turns on and off together.
_GROUPS: dict[int, list[int]] = {
    stream: [getattr(mavlink, f"MAVLINK_MSG_ID_{name}") for name in names.split()]
    for stream, names in {
        mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
            "SYS_STATUS MISSION_CURRENT GPS_RAW_INT NAV_CONTROLLER_OUTPUT POSITION_TARGET_GLOBAL_INT"
        ),
        mavlink.MAV_DATA_STREAM_POSITION: "GLOBAL_POSITION_INT LOCAL_POSITION_NED",
        mavlink.MAV_DATA_STREAM_EXTRA1: "ATTITUDE",
        mavlink.MAV_DATA_STREAM_EXTRA2: "VFR_HUD",
        mavlink.MAV_DATA_STREAM_EXTRA3: (
            "SYSTEM_TIME BATTERY_STATUS WIND EKF_STATUS_REPORT TERRAIN_REQUEST TERRAIN_REPORT"
        ),
    }.items()
}
_STREAMED = [message_id for group in _GROUPS.values() for message_id in group]
DATA_STREAMS = _GROUPS | {mavlink.MAV_DATA_STREAM_ALL: _STREAMED}
DEFAULT_INTERVAL_S = dict.fromkeys((mavlink.MAVLINK_MSG_ID_HEARTBEAT, *_STREAMED), 1.0)


class ArduPlaneTelemetry(AutopilotTelemetry):
    gps_fix = mavlink.GPS_FIX_TYPE_RTK_FIXED
    gps_dilution = (121, 200)
    gps_accuracy_mm = (300, 300, 0)
    home_quaternion = (NAN, NAN, NAN, NAN)
    parameter_capability = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    # Before, TERRAIN_REPORT comes with each request for terrain.
    since_release: ClassVar = {mavlink.MAVLINK_MSG_ID_TERRAIN_REPORT: (4, 6)}

    _vehicle: SimulatedArduPlane

    def sys_status(self) -> Any:
        controllers = _CONTROLLERS if self._vehicle.armed else 0
        healthy = _HEALTHY if self._vehicle.ready else _HEALTHY_BEFORE_READY
        return mavlink.MAVLink_sys_status_message(
            _PRESENT, _ENABLED | controllers, healthy | controllers, 0, 12600, 1000, self.battery_percent, *(0,) * 6
        )

    def mission_current(self) -> Any:
        mission, flies = self._vehicle.mission, self._vehicle.mode == ArduPlaneMode.AUTO
        if self._vehicle.release < (4, 5):
            return mavlink.MAVLink_mission_current_message(mission.index)
        total = max(0, len(mission.items()) - 1)
        return mavlink.MAVLink_mission_current_message(mission.index, total, mission.reported_state, int(flies))

    def nav_controller_output(self) -> Any:
        plane, craft, navigator = self._vehicle, self._craft, self._vehicle.navigator
        goal, guidance = navigator.goal, navigator.guidance
        return mavlink.MAVLink_nav_controller_output_message(
            math.degrees(plane.roll_goal_rad),
            math.degrees(craft.pitch_rad),
            round(math.degrees(math.remainder(guidance.nav_bearing_rad, math.tau))),
            round(math.degrees(plane.here.bearing_rad(goal))),
            min(65535, round(goal.distance_m(craft))),
            plane.height_goal_m - craft.height_m,
            plane.airspeed_goal_m_s - craft.airspeed_m_s / craft.true_airspeed_ratio,
            guidance.cross_track_m,
        )

    def position_target_global_int(self) -> Any:
        plane, goal = self._vehicle, self._vehicle.navigator.goal
        if plane.mode not in SELF_FLYING or plane.mode == ArduPlaneMode.TAKEOFF or not plane.armed:
            return None
        place = *self.place_e7(*goal.ground_m), self.altitude_m(goal.height_m)
        only_position = 0xFDF8
        return mavlink.MAVLink_position_target_global_int_message(
            plane.boot_ms, mavlink.MAV_FRAME_GLOBAL, only_position, *place, *(0.0,) * 8
        )

    def wind(self) -> Any:
        wind = self._craft.wind
        from_deg = math.degrees(math.atan2(-wind.east_m_s, -wind.north_m_s))
        return mavlink.MAVLink_wind_message(from_deg, math.hypot(wind.east_m_s, wind.north_m_s), 0.0)

    def terrain_request(self) -> Any:
        terrain = self._vehicle.terrain
        if terrain is None:
            return None
        request = terrain.request(*self._place_deg)
        if self._vehicle.release >= (4, 6):
            return request
        return [*([] if request is None else [request]), self.terrain_report()]

    def terrain_report(self) -> Any:
        terrain = self._vehicle.terrain
        return None if terrain is None else terrain.report(*self._place_deg, self.altitude_m(self._craft.height_m))

    @property
    def _place_deg(self) -> tuple[float, float]:
        return self._vehicle.plane.latitude_longitude_deg(self._craft.east_m, self._craft.north_m)

    def ekf_status_report(self) -> Any:
        flags = 831 if self._vehicle.ready else 167  # position known absolutely, or only attitude
        return mavlink.MAVLink_ekf_status_report_message(flags, *(0.01,) * 5)


_FORMER: dict[str, tuple[Release, str, int, float]] = {  # renamed in, name before, its type and unit
    "AIRSPEED_CRUISE": ((4, 5), "TRIM_ARSPD_CM", INT32, 0.01),
    "AIRSPEED_MIN": ((4, 5), "ARSPD_FBW_MIN", INT16, 1.0),
    "AIRSPEED_MAX": ((4, 5), "ARSPD_FBW_MAX", INT16, 1.0),
    "ROLL_LIMIT_DEG": ((4, 5), "LIM_ROLL_CD", INT16, 0.01),
    "RTL_ALTITUDE": ((4, 5), "ALT_HOLD_RTL", INT32, 0.01),
    "MAV_GCS_SYSID": ((4, 7), "SYSID_MYGCS", INT16, 1.0),
    "MAV_SYSID": ((4, 7), "SYSID_THISMAV", INT16, 1.0),
}


def arduplane_parameters(settings: Settings) -> Parameters:
    """Return the parameters a ground program looks at, with the stock simulator's values."""
    airspeed_m_s = settings.airspeed_m_s
    off = "FS_GCS_ENABL", "FS_LONG_ACTN", "FS_SHORT_ACTN", "FENCE_ENABLE", "FENCE_TOTAL", "MIS_RESTART"
    table: dict[str, tuple[int, float]] = {
        **dict.fromkeys((*off, "RNGFND1_TYPE"), (INT8, 0.0)),
        **dict.fromkeys(("RTL_RADIUS", "FENCE_OPTIONS", "MIS_TOTAL"), (INT16, 0.0)),
        **dict.fromkeys(("ARMING_MIS_ITEMS", "STAT_RUNTIME"), (INT32, 0.0)),
        "AIRSPEED_CRUISE": (REAL32, airspeed_m_s),
        "AIRSPEED_MIN": (INT16, math.floor(min(10.0, 0.7 * airspeed_m_s))),
        "AIRSPEED_MAX": (INT16, math.ceil(max(30.0, 1.35 * airspeed_m_s))),
        "ROLL_LIMIT_DEG": (REAL32, 65.0),
        "WP_LOITER_RAD": (INT16, 80.0),
        "WP_RADIUS": (INT16, 50.0),
        "RTL_ALTITUDE": (REAL32, 100.0),
        "TKOFF_ALT": (INT16, 50.0),
        "NAVL1_PERIOD": (REAL32, 17.0),
        "NAVL1_DAMPING": (REAL32, 0.75),
        "NAVL1_XTRACK_I": (REAL32, 0.02),
        "FS_LONG_TIMEOUT": (REAL32, 5.0),
        "FS_SHORT_TIMEOUT": (REAL32, 1.5),
        "MAV_GCS_SYSID": (INT16, 255.0),
        "MAV_SYSID": (INT16, settings.system_id),
        "FENCE_ACTION": (INT8, 1.0),
    }
    release, former = settings.release_or_newest, {}
    for name, (renamed_in, old_name, kind, unit) in _FORMER.items():
        if release < renamed_in:
            table[old_name] = (kind, table.pop(name)[1] / unit)
            former[name] = (old_name, unit)
    return Parameters(table, bytewise=False, former=former)


class ArduPlaneMode(IntEnum):
    MANUAL = 0
    FBWA = 5
    CRUISE = 7
    AUTO = 10
    RTL = 11
    LOITER = 12
    TAKEOFF = 13
    GUIDED = 15


SELF_FLYING = set(ArduPlaneMode) - {ArduPlaneMode.MANUAL, ArduPlaneMode.FBWA, ArduPlaneMode.CRUISE}
# The stock simulator's airframe turns less than its bank would in a coordinated turn. With L1, which has no
# integral on circles, that is why it flies 116 m for 100, 69 for 50 and 167 for 150 at 22 m/s.
BUILD = AirframeParameters(turn_efficiency=0.78)
_INITIAL_HEADING_RAD = math.radians(353.0)
_MODE_FLAGS: int = (
    mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
)
_TAKEOFF_OVERSHOOT_M = 10.0  # the climb is kept up until the height is passed
_DEFAULT_AIRSPEED = -2.0
QUIRKS = TransferQuirks(
    asks_with_int=False,
    retry_s=1.0,
    timeout_s=8.0,
    max_items=724,
    partial_writes=True,
    reads_in_order=False,
    busy_result=mavlink.MAV_MISSION_DENIED,
    restarts=True,
    wrong_sequence_result=mavlink.MAV_MISSION_INVALID_SEQUENCE,
    repeats_final_ack=False,
    timeout_result=mavlink.MAV_MISSION_OPERATION_CANCELLED,
    timeout_severity=mavlink.MAV_SEVERITY_WARNING,
    timeout_text="Mission upload timeout",
)


class SimulatedArduPlane(SimulatedAutopilot):
    autopilot_id = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    modes, first_mode = ArduPlaneMode, ArduPlaneMode.MANUAL
    self_flying = SELF_FLYING
    mode_flags = _MODE_FLAGS, _MODE_FLAGS | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
    taken_over_mode = ArduPlaneMode.FBWA
    navigation_period_s = NAVIGATION_PERIOD_S
    receives_once_a_loop = True
    home_known_s = 21.7
    ready_s = 22.9
    unknown_interval_result = DENIED
    unknown_request_result = FAILED
    preflight_failure = "PreArm: AHRS: waiting for home"
    arming_refusal = (FAILED, "Arm: AHRS: waiting for home")
    armed_text, landed_text = "Throttle armed", "Throttle disarmed"
    roll_limit_parameter = "ROLL_LIMIT_DEG"
    quirks = QUIRKS
    default_interval_s = DEFAULT_INTERVAL_S

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, BUILD, _INITIAL_HEADING_RAD, arduplane_parameters(settings))
        home = self.home
        home_deg = home.latitude_deg, home.longitude_deg
        x, y = (round(angle_deg * 1e7) for angle_deg in home_deg)
        home_item = Item(mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_FRAME_GLOBAL, (0.0,) * 4, x, y, home.altitude_m)
        self.mission = ArduPlaneMission(home_item, self.say, self._start_item, lambda: self.armed)
        self.navigator = ArduPlaneNavigator(self.craft, self.parameters)
        self._guided_radius_m = 0.0
        self._ordered_airspeed_m_s: float | None = None
        self._min_ground_speed_m_s = 0.0
        self._cruise_at, self._cruise_m_s = -1, 0.0
        self.handlers |= {
            mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: self._on_set_current,
            mavlink.MAV_CMD_MISSION_START: self._on_mission_start,
            mavlink.MAV_CMD_DO_REPOSITION: self._on_reposition,
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _: self.change_mode(ArduPlaneMode.RTL),
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: lambda _: self.change_mode(ArduPlaneMode.LOITER),
            mavlink.MAV_CMD_NAV_TAKEOFF: lambda _: FAILED,  # only for quadplanes
            mavlink.MAV_CMD_DO_CHANGE_SPEED: self._on_change_speed,
        }
        # ArduPlane requests missing heights; here only if there is terrain.
        self.terrain = TerrainDatabase(*home_deg) if settings.terrain else None
        self.attach(self.mission, ArduPlaneTelemetry(self))

    def custom_mode(self, main: int, sub: int) -> int:
        return main

    def set_mode(self, mode: int) -> bool:
        if mode not in list(ArduPlaneMode):
            return False
        if mode == self.mode:
            return True
        self.mission.stop()
        self.mode = ArduPlaneMode(mode)
        self.lifting_off = False
        self.navigator.start_over()
        match mode:
            case ArduPlaneMode.AUTO:
                self.mission.resume()
            case ArduPlaneMode.TAKEOFF:
                self._begin_takeoff(self.parameters["TKOFF_ALT"])
            case ArduPlaneMode.RTL:
                radius_m = self.parameters["RTL_RADIUS"] or self.parameters["WP_LOITER_RAD"]
                self._circle_at(LocalPosition(0.0, 0.0, self.parameters["RTL_ALTITUDE"]), radius_m >= 0)
            case _:
                self._guided_radius_m = 0.0
                self._circle_at(self.here, self.parameters["WP_LOITER_RAD"] >= 0)
        return True

    def on_armed(self) -> None:
        super().on_armed()
        self.broadcast_now(mavlink.MAVLINK_MSG_ID_HOME_POSITION)

    def handle_own(self, station: Station, message: Any, kind: str) -> None:
        if kind == "REQUEST_DATA_STREAM":
            interval_s = 1.0 / message.req_message_rate if message.start_stop and message.req_message_rate else 0.0
            for message_id in DATA_STREAMS.get(message.req_stream_id, ()):
                station.stream(message_id, interval_s, self.now_s)
        elif kind == "TERRAIN_DATA" and self.terrain is not None:
            self.terrain.take(message)
        else:
            super().handle_own(station, message, kind)

    def is_ground_station(self, heartbeat: Any) -> bool:
        return bool(heartbeat.get_srcSystem() == self.parameters["MAV_GCS_SYSID"])

    def watch_links(self) -> None:
        """Enter and leave the failsafe of a lost ground station."""
        enabled = self.parameters["FS_GCS_ENABL"]
        if not enabled or (enabled == 3 and self.mode != ArduPlaneMode.AUTO) or not self.craft.flying:
            return
        silent_s = self.ground_silent_s
        if silent_s < self.parameters["FS_LONG_TIMEOUT"]:
            self.failsafe = False
        elif not self.failsafe:
            self.failsafe = True
            self.say(mavlink.MAV_SEVERITY_WARNING, "GCS Failsafe On")
            action = self.parameters["FS_LONG_ACTN"]
            if action == 1 or (action == 0 and self.mode not in (ArduPlaneMode.AUTO, ArduPlaneMode.GUIDED)):
                self.set_mode(ArduPlaneMode.RTL)

    @property
    def airspeed_goal_m_s(self) -> float:
        ordered_m_s = self._ordered_airspeed_m_s if self.mode in (ArduPlaneMode.AUTO, ArduPlaneMode.GUIDED) else None
        if self._cruise_at != self.parameters.changes:
            self._cruise_at = self.parameters.changes
            self._cruise_m_s = self.parameters.within("AIRSPEED_CRUISE", 5.0, 60.0)
        cruise_m_s = self._cruise_m_s if ordered_m_s is None else ordered_m_s
        if self._min_ground_speed_m_s <= 0.0:
            return cruise_m_s
        missing_m_s = max(0.0, self._min_ground_speed_m_s - self.craft.ground_speed_m_s)
        return min(cruise_m_s + missing_m_s, max(cruise_m_s, self.parameters["AIRSPEED_MAX"]))

    def navigate(self) -> float:
        """Fly the mode for a navigation period; return the required lateral acceleration, m/s^2."""
        match self.mode:
            case ArduPlaneMode.AUTO:
                return self._navigate_mission()
            case ArduPlaneMode.GUIDED:
                return self._fly_circle(self._guided_radius_m, by_line=False)
            case ArduPlaneMode.LOITER:
                return self._fly_circle(0.0, by_line=False)
            case ArduPlaneMode.RTL:
                return self._fly_circle(abs(self.parameters["RTL_RADIUS"]), by_line=False)
            case ArduPlaneMode.TAKEOFF if self._climbed_out():
                self.set_mode(ArduPlaneMode.LOITER)
        return 0.0  # sticks in the middle

    def _navigate_mission(self) -> float:
        item, index = self.mission.item, self.mission.index
        if item is None:
            complete = self.mission.state is MissionState.COMPLETE and len(self.mission.items()) > 1
            text = "Mission complete, changing mode to RTL"
            self.say(mavlink.MAV_SEVERITY_INFO, text if complete else "Aircraft in auto without a running mission")
            self.set_mode(ArduPlaneMode.RTL)
            return 0.0
        done, lateral_m_s2 = self._fly_item(item)
        if done:
            self.radio.broadcast(mavlink.MAVLink_mission_item_reached_message(index))
            self.mission.advance()
        return lateral_m_s2

    def _fly_item(self, item: Item) -> tuple[bool, float]:
        loiter, first = self.navigator.loiter, item.params[0]
        match item.command:
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                return self._climbed_out(), 0.0
            case mavlink.MAV_CMD_NAV_WAYPOINT:
                return self._fly_leg(item.params[1])
            case mavlink.MAV_CMD_NAV_LAND:
                self.descend_to(self.navigator.goal)
                return False, self.navigator.fly_line()
            case mavlink.MAV_CMD_NAV_LOITER_UNLIM:
                return False, self._fly_circle(abs(item.params[2]))
            case mavlink.MAV_CMD_NAV_LOITER_TURNS:
                lateral_m_s2 = self._fly_circle(abs(item.params[2]))
                return loiter.turned_rad > first * math.tau, lateral_m_s2
            case mavlink.MAV_CMD_NAV_LOITER_TIME:
                lateral_m_s2 = self._fly_circle(0.0)  # this item has no room for a radius
                return loiter.reached_s is not None and self.now_s - loiter.reached_s > first, lateral_m_s2
            case mavlink.MAV_CMD_NAV_LOITER_TO_ALT:
                lateral_m_s2 = self._fly_circle(abs(item.params[1]))
                at_height = abs(self.craft.height_m - self.navigator.goal.height_m) < 5.0
                return at_height and loiter.turned_rad > 0.0, lateral_m_s2
        return False, 0.0

    def _start_item(self, index: int, item: Item) -> None:
        if item.command == mavlink.MAV_CMD_DO_CHANGE_SPEED:
            self._change_speed(item.params[0], item.params[1])
        if item.command not in NAVIGATION:
            return
        self.say(mavlink.MAV_SEVERITY_INFO, f"Mission: {index} {NAVIGATION[item.command]}")
        if item.command == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            self.set_mode(ArduPlaneMode.RTL)
        elif item.command == mavlink.MAV_CMD_NAV_TAKEOFF:
            self._begin_takeoff(self.place_of(item).height_m)
        else:
            following = self.mission.following()
            radius = item.params[1 if item.command == mavlink.MAV_CMD_NAV_LOITER_TO_ALT else 2]
            then = self.place_of(following) if following is not None and following.latitude_e7 else None
            goal = self.place_of(item)
            self.height_goal_m = goal.height_m
            self.navigator.go_to(goal, then, clockwise=math.copysign(1.0, radius) > 0)

    def _begin_takeoff(self, height_m: float) -> None:
        self.navigator.circle(LocalPosition(self.craft.east_m, self.craft.north_m, height_m), clockwise=True)
        self.height_goal_m = height_m + _TAKEOFF_OVERSHOOT_M

    def _climbed_out(self) -> bool:
        """Climb straight ahead; True when the height of the takeoff is passed."""
        if not self.craft.flying:
            self.lifting_off = self.armed
            return False
        if self.craft.height_m < self.navigator.goal.height_m:
            return False
        self.say(mavlink.MAV_SEVERITY_INFO, f"Takeoff complete at {self.craft.height_m:.2f}m")
        self.navigator.start_over()
        return True

    def _fly_leg(self, acceptance_m: float) -> tuple[bool, float]:
        verb, lateral_m_s2 = self.navigator.fly_leg(acceptance_m)
        if verb is None:
            return False, lateral_m_s2
        distance_m = self.navigator.goal.distance_m(self.craft)
        self.say(mavlink.MAV_SEVERITY_INFO, f"{verb} waypoint #{self.mission.index} dist {distance_m:.0f}m")
        return True, lateral_m_s2

    def _circle_at(self, centre: LocalPosition, clockwise: bool) -> None:
        self.height_goal_m = centre.height_m
        self.navigator.circle(centre, clockwise)

    def _fly_circle(self, radius_m: float, by_line: bool = True) -> float:
        """radius_m 0 or 1: that of the parameter."""
        loiter = self.navigator.loiter
        if radius_m <= 1.0:
            default_m = self.parameters["WP_LOITER_RAD"]
            radius_m = abs(default_m)
            loiter.clockwise = loiter.clockwise and default_m >= 0
        was_reached = loiter.reached_s is not None
        lateral_m_s2 = self.navigator.fly_circle(radius_m, self.now_s, by_line)
        if self.mode == ArduPlaneMode.GUIDED and loiter.reached_s is not None and not was_reached:
            self.radio.broadcast(mavlink.MAVLink_mission_item_reached_message(0))
        return lateral_m_s2

    def set_current_item(self, index: int) -> bool:
        # By MISSION_SET_CURRENT the leg begins here. The command forgets the old leg only once the new one has begun,
        # which then leads from the goal before, and the leg after it begins where the aircraft is by then.
        self.navigator.start_over()
        return self.mission.set_current(index)

    def _on_set_current(self, command: Command) -> int:
        index = int(command.number(1))
        if not 0 <= index < len(self.mission.items()):
            return DENIED
        if not self.mission.set_current(index):
            return FAILED
        self.navigator.start_over()
        self.broadcast_now(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)
        return ACCEPTED

    def _on_mission_start(self, command: Command) -> int:
        if command.number(1) or command.number(2):
            return DENIED
        self.set_mode(ArduPlaneMode.AUTO)
        return ACCEPTED

    def _on_reposition(self, command: Command) -> int:
        if command.frame is None:
            return UNSUPPORTED
        if command.frame not in ABSOLUTE_FRAMES and command.frame not in RELATIVE_FRAMES:
            return DENIED
        latitude_deg, longitude_deg, altitude_m = command.params[4:7]
        if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0 and math.isfinite(altitude_m)):  # NaN too
            return DENIED
        change_mode = int(command.number(2)) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
        if not change_mode and self.mode != ArduPlaneMode.GUIDED:
            return FAILED
        height_m = altitude_m if command.frame in RELATIVE_FRAMES else altitude_m - self.home.altitude_m
        ground_m = self.here.ground_m
        if latitude_deg or longitude_deg:
            ground_m = self.plane.east_north_m(latitude_deg, longitude_deg)
        self.set_mode(ArduPlaneMode.GUIDED)
        # The sign of the radius is ignored; param 4 sets the direction. Without a valid radius the last one is kept.
        # Releases before 4.5 take NaN for counter-clockwise, those before 4.4 have no radius of its own.
        direction = command.number(4) if self.release >= (4, 5) else command.param(4)
        clockwise = direction == 0.0
        radius_m = command.number(3) if self.release >= (4, 4) else 0.0
        if radius_m > 0.0:
            self._guided_radius_m = float(math.floor(radius_m))
        else:
            clockwise = clockwise and self.parameters["WP_LOITER_RAD"] >= 0
        self._circle_at(LocalPosition(*ground_m, height_m), clockwise)
        return ACCEPTED

    def _on_change_speed(self, command: Command) -> int:
        return ACCEPTED if self._change_speed(command.param(1), command.param(2)) else FAILED

    def _change_speed(self, kind: float, speed_m_s: float) -> bool:
        within = self.parameters["AIRSPEED_MIN"] <= speed_m_s <= self.parameters["AIRSPEED_MAX"]
        if kind == mavlink.SPEED_TYPE_GROUNDSPEED:
            self._min_ground_speed_m_s = speed_m_s
            self.say(mavlink.MAV_SEVERITY_INFO, f"Set groundspeed {speed_m_s:.0f}")
        elif kind == mavlink.SPEED_TYPE_AIRSPEED and speed_m_s == _DEFAULT_AIRSPEED:
            self._ordered_airspeed_m_s = None
        elif kind == mavlink.SPEED_TYPE_AIRSPEED and within:
            self._ordered_airspeed_m_s = speed_m_s
            self.say(mavlink.MAV_SEVERITY_INFO, f"Set airspeed {speed_m_s:.0f} m/s")
        else:
            return False
        return True
