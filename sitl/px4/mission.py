"""PX4's mission: stored as a whole, replaced when an upload completes, and checked for feasibility afterwards.

An acknowledgement only confirms that the items have arrived. An upload equal to the stored mission changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.protocol.transfer import RELATIVE_FRAMES, Item, ItemRefused, Store, checksum
from sidelong.sitl.settings import HomePosition
from sidelong.sitl.world.geodesy import HomePlane

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
        self.mission_id = 0
        self.index = 0

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
        return int(mavlink.MAV_MISSION_ACCEPTED)

    def clear(self) -> int:
        self._items, self.mission_id, self.index = [], 0, 0
        self._on_swap()
        return int(mavlink.MAV_MISSION_ACCEPTED)

    def navigation_from(self, index: int) -> int | None:
        """Return the first item from ``index`` on that is flown."""
        return next((i for i in range(index, len(self._items)) if self._items[i].command in NAVIGATION), None)


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
    if entrance.has_position:
        drop_m = _above_home_m(entrance, home) - _above_home_m(land, home)
        if drop_m <= 0.0:
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
        if drop_m > run_m * math.tan(math.radians(landing_angle_deg + _LANDING_ANGLE_SPARE_DEG)):
            return (
                "Mission rejected: the landing glide slope is steeper than the vehicle setting of "
                f"{landing_angle_deg:.1f} degrees."
            )
    return None


def _above_home_m(item: Item, home: HomePosition) -> float:
    return item.altitude_m if item.frame in RELATIVE_FRAMES else item.altitude_m - home.altitude_m


def _compass_deg(angle_deg: float) -> float:
    return angle_deg if math.isnan(angle_deg) else angle_deg % 360.0
