"""ArduPlane: item 0 is home, arm before AUTO, whole metres of radius, a mission ends in a circle or goes home."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

from pymavlink import mavutil

from app.autopilots.arduplane_transfer import read_mission, write_items
from app.autopilots.autopilot import CircleOrder, Home, Limits, raw_item, select_by_message
from app.autopilots.parameters import RequiredParameter, required_airspeed
from app.link.link import RawItem, UploadResult
from app.link.message import Message
from app.link.vehicle import Answer, Vehicle
from mission.core.requirement import Wind
from mission.upload.items import Item
from mission.upload.line_tracking import LineTracking, arduplane

_mav = mavutil.mavlink
_CUSTOM_MODE_ENABLED = 1
_AUTO, _RTL = 10, 11
_SPEED_UNCHANGED = -1.0
_READ_S = 5.0
_FAILSAFE = "without heartbeats of system MAV_GCS_SYSID (not sidelong's) the failsafe takes the aircraft"


class ArduPlane:
    """``Autopilot`` for ArduPlane 4.x."""

    name = "ArduPlane"
    mission_mode, circle_mode = "AUTO", "GUIDED"
    min_items = 24
    relevant_parameters: ClassVar[Mapping[str, Mapping[float, str]]] = {
        "AIRSPEED_CRUISE": {},
        "AIRSPEED_MIN": {},
        "AIRSPEED_MAX": {},
        "ROLL_LIMIT_DEG": {},
        "WP_LOITER_RAD": {},
        "WP_RADIUS": {},
        "MAV_GCS_SYSID": {},
        "FS_GCS_ENABL": {
            0.0: "losing the link does nothing: it circles on for ever",
            1.0: _FAILSAFE,
            2.0: _FAILSAFE,
            3.0: _FAILSAFE,
        },
        "FS_LONG_ACTN": {1.0: "in a failsafe it flies home", 2.0: "in a failsafe it glides"},
        "FENCE_ENABLE": {1.0: "a fence is active: give it in [fences] too, or it ends the mission"},
    }

    def required_parameters(self, values: Mapping[str, float], airspeed_m_s: float) -> tuple[RequiredParameter, ...]:
        return required_airspeed(values, "AIRSPEED_CRUISE", airspeed_m_s)

    def head(self, home: Home) -> tuple[RawItem, ...]:
        # Whatever is put at 0 is silently replaced by home: put home there.
        return (
            RawItem(
                _mav.MAV_CMD_NAV_WAYPOINT,
                _mav.MAV_FRAME_GLOBAL,
                0.0,
                0.0,
                0.0,
                0.0,
                round(home.latitude_deg * 1e7),
                round(home.longitude_deg * 1e7),
                home.altitude_m,
            ),
        )

    def tail(self, home: Home) -> tuple[RawItem, ...]:
        return ()

    def tracking(self, airspeed_m_s: float, wind: Wind) -> LineTracking:
        return arduplane(airspeed_m_s, wind)

    def raw(self, item: Item) -> RawItem:
        raw = raw_item(item)
        if item.command == _mav.MAV_CMD_NAV_LOITER_UNLIM:
            return replace(raw, param3=float(round(raw.param3)))
        return raw

    async def store(
        self,
        vehicle: Vehicle,
        held: Sequence[RawItem | None],
        items: Sequence[RawItem],
        current: int,
        timeout_s: float,
    ) -> UploadResult:
        if len(held) != len(items):
            return await write_items(vehicle, items, range(len(items)), timeout_s)
        differing = [seq for seq in range(len(items)) if items[seq] != held[seq]]
        if not differing:
            return UploadResult.ACCEPTED
        return await write_items(vehicle, items, range(differing[0], differing[-1] + 1), timeout_s)

    async def stored(self, vehicle: Vehicle) -> tuple[RawItem, ...] | None:
        return await read_mission(vehicle, _READ_S)

    async def arm(self, vehicle: Vehicle) -> Answer:
        return await vehicle.command(_mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    async def disarm(self, vehicle: Vehicle) -> Answer:
        return await vehicle.command(_mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)

    async def start_mission(self, vehicle: Vehicle) -> Answer:
        return await vehicle.command(_mav.MAV_CMD_DO_SET_MODE, _CUSTOM_MODE_ENABLED, _AUTO)

    async def select(self, vehicle: Vehicle, first: int, line: Sequence[RawItem]) -> bool:
        return await select_by_message(vehicle, first, first + len(line))

    async def fly_circle(self, vehicle: Vehicle, order: CircleOrder, take_over: bool) -> Answer:
        # Only COMMAND_INT is understood, the sign of a radius says nothing, and it is kept in whole metres. Without
        # the flag it is refused in any other mode, so it cannot take the aircraft out of somebody's hands.
        return await vehicle.command_int(
            _mav.MAV_CMD_DO_REPOSITION,
            _mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
            (
                _SPEED_UNCHANGED,
                float(_mav.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE if take_over else 0),
                float(max(1, round(abs(order.signed_radius_m)))),
                float(order.signed_radius_m < 0.0),
            ),
            order.x,
            order.y,
            order.height_m,
        )

    def told_circle(self, message: Message) -> CircleOrder | None:
        if message.name != "POSITION_TARGET_GLOBAL_INT":
            return None
        fields = message.fields
        return CircleOrder(fields["lat_int"], fields["lon_int"], 0.0, fields["alt"], 0.0)

    async def return_home(self, vehicle: Vehicle) -> Answer:
        return await vehicle.command(_mav.MAV_CMD_DO_SET_MODE, _CUSTOM_MODE_ENABLED, _RTL)

    def limits(self, values: Mapping[str, float]) -> Limits:
        names = ("ROLL_LIMIT_DEG", "AIRSPEED_MIN", "AIRSPEED_MAX", "AIRSPEED_CRUISE")
        return Limits(*map(values.get, names))
