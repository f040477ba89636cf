"""ArduPlane's mission: a list that is overwritten item by item, and one item that is flown from memory.

What flies is a copy: a new upload changes nothing until the item completes, the current item is set, or AUTO is
left and entered again. Item 0 is home, whatever was uploaded there. Fields without room in the vehicle's 15-byte
storage come back changed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum

from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.protocol.transfer import RELATIVE_FRAMES, Item, ItemRefused, Store

_ACCEPTED: int = mavlink.MAV_MISSION_ACCEPTED

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
        self._home = home
        self._say = say
        self._on_start = on_start
        self._armed = armed
        self.state = MissionState.STOPPED
        self.index = 0  # of the item that is flown, or would be; 0: none yet
        self.item: Item | None = None  # the copy that is flown

    # Storage, as the protocol sees it.

    def current_index(self) -> int:
        return self.index

    def begin(self, count: int) -> int:
        del self._items[count:]
        return self.finish() if count == 0 else _ACCEPTED

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
        return _ACCEPTED

    def abandon(self) -> None:
        """Leave what has arrived where it is."""

    def clear(self) -> int:
        if self.state is MissionState.RUNNING and self._armed():
            return int(mavlink.MAV_MISSION_ERROR)
        self._items.clear()
        self.state, self.index, self.item = MissionState.STOPPED, 0, None
        return _ACCEPTED

    # Sequence.

    @property
    def reported_state(self) -> int:
        return int(mavlink.MISSION_STATE_NO_MISSION if len(self._items) <= 1 else self.state)

    def stop(self) -> None:
        if self.state == MissionState.RUNNING:
            self.state = MissionState.STOPPED

    def resume(self) -> None:
        """Fly the current item as it is stored now; from the first if there is none or the mission had ended."""
        index = self.index if self.state == MissionState.STOPPED and 0 < self.index < len(self._items) else 1
        self.state = MissionState.RUNNING
        self._start_from(index)

    def set_current(self, index: int) -> bool:
        if not 0 <= index < len(self._items) or len(self._items) <= 1:
            return False
        index = max(1, index)
        if self.state == MissionState.RUNNING:
            self._start_from(index)
        else:
            self.state, self.index = MissionState.STOPPED, index
        return True

    def advance(self) -> None:
        """Go on: the current item is done."""
        self._start_from(self.index + 1)

    def following(self) -> Item | None:
        """Return the next navigation item in storage."""
        return next((item for item in self._items[self.index + 1 :] if item.command in NAVIGATION), None)

    def _start_from(self, index: int) -> None:
        while index < len(self._items):
            item = self._items[index]
            if item.command in NAVIGATION:
                self.index, self.item = index, item
                self._on_start(index, item)
                return
            self._on_start(index, item)
            index += 1
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
    relative = item.frame in RELATIVE_FRAMES
    frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT if relative else mavlink.MAV_FRAME_GLOBAL
    altitude_m = math.trunc(item.altitude_m * 100.0) / 100.0
    return replace(item.with_params(*params), frame=frame, altitude_m=altitude_m, autocontinue=1)


def _whole(value: float) -> int:
    return int(max(0.0, value)) if math.isfinite(value) else 0


def _signed_whole(value: float) -> float:
    return math.copysign(float(math.floor(abs(value))), value) if math.isfinite(value) else 0.0
