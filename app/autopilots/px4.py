"""PX4: acknowledgements prove nothing, so look at the mode flown; a mission needs a landing at its end."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

from pymavlink import mavutil

from app.autopilots.autopilot import CircleOrder, Home, Limits, at_place, raw_item, same_items, select_by_message
from app.autopilots.parameters import RequiredParameter, required_airspeed
from app.link.link import RawItem, UploadResult
from app.link.message import Message
from app.link.telemetry import AUTOPILOT_COMPONENT
from app.link.vehicle import Answer, Vehicle
from mission.core.requirement import Wind
from mission.upload.items import Item
from mission.upload.line_tracking import LineTracking, px4

_mav = mavutil.mavlink
_CUSTOM_MODE_ENABLED = 1
_AUTO, _MISSION, _RTL = 4, 4, 5
_APPROACH_M, _APPROACH_HEIGHT_M = 700.0, 40.0
_ENDS_FLIGHT = (5.0, 6.0)  # of NAV_DLL_ACT
_WANTS_TAKE_OFF, _WANTS_LANDING = (1.0, 3.0, 4.0), 2.0  # of MIS_TKO_LAND_REQ
_METRES_PER_DEGREE = 111_000.0
_TARGET = "POSITION_TARGET_GLOBAL_INT"
_READ_S = 5.0


class Px4:
    """``Autopilot`` for PX4 1.15 and later."""

    name = "PX4"
    mission_mode, circle_mode = "MISSION", "LOITER"
    min_items = 0
    relevant_parameters: ClassVar[Mapping[str, Mapping[float, str]]] = {
        "FW_AIRSPD_TRIM": {},
        "FW_AIRSPD_MIN": {},
        "FW_AIRSPD_MAX": {},
        "FW_R_LIM": {},
        "NAV_LOITER_RAD": {},
        "NAV_DLL_ACT": {
            0.0: "losing the link does nothing: it circles on for ever",
            1.0: "losing the link holds the aircraft where it is",
            2.0: "losing the link holds it, then flies it home",
            3.0: "losing the link lands it",
        },
        "COM_DL_LOSS_T": {},
        "MIS_TKO_LAND_REQ": {},
        "GF_ACTION": {},
        "GF_MAX_HOR_DIST": {},
    }

    def required_parameters(self, values: Mapping[str, float], airspeed_m_s: float) -> tuple[RequiredParameter, ...]:
        required_parameters = list(required_airspeed(values, "FW_AIRSPD_TRIM", airspeed_m_s))
        link_loss, landing = values.get("NAV_DLL_ACT"), values.get("MIS_TKO_LAND_REQ")
        if link_loss in _ENDS_FLIGHT:
            required_parameters.append(
                RequiredParameter("NAV_DLL_ACT", link_loss, 0.0, "losing the link would end the flight")
            )
        if landing in _WANTS_TAKE_OFF:
            why = "it asks for a take-off in every mission, and those in flight have none"
            required_parameters.append(RequiredParameter("MIS_TKO_LAND_REQ", landing, _WANTS_LANDING, why))
        return tuple(required_parameters)

    def head(self, home: Home) -> tuple[RawItem, ...]:
        return ()

    def tail(self, home: Home) -> tuple[RawItem, ...]:
        # MIS_TKO_LAND_REQ 2, the fixed-wing default, drops a mission without a landing to HOLD. The circle before
        # it never completes, so these items are only reached when somebody asks for the landing: a straight approach
        # to home from the south, flat enough and outside the circle where it begins, as PX4 demands.
        x, y = round(home.latitude_deg * 1e7), round(home.longitude_deg * 1e7)
        south_x = x - round(_APPROACH_M / _METRES_PER_DEGREE * 1e7)
        frame, nan = _mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, float("nan")
        return (
            RawItem(_mav.MAV_CMD_DO_LAND_START, _mav.MAV_FRAME_MISSION, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0),
            RawItem(_mav.MAV_CMD_NAV_LOITER_TO_ALT, frame, 0.0, 80.0, 0.0, 1.0, south_x, y, _APPROACH_HEIGHT_M),
            RawItem(_mav.MAV_CMD_NAV_LAND, frame, 0.0, 0.0, 0.0, nan, x, y, 0.0),
        )

    def tracking(self, airspeed_m_s: float, wind: Wind) -> LineTracking:
        return px4(airspeed_m_s, wind)

    def raw(self, item: Item) -> RawItem:
        return raw_item(item)

    async def store(
        self,
        vehicle: Vehicle,
        held: Sequence[RawItem | None],
        items: Sequence[RawItem],
        current: int,
        timeout_s: float,
    ) -> UploadResult:
        # Partial writes are ignored, and a list is taken whole or not at all.
        result = await vehicle.link.upload(items, current, timeout_s)
        if result is UploadResult.TIMEOUT:  # often only the last acknowledgement was lost
            downloaded = await self.stored(vehicle)
            if downloaded is not None and same_items(items, downloaded):
                return UploadResult.ACCEPTED
        return result

    async def stored(self, vehicle: Vehicle) -> tuple[RawItem, ...] | None:
        return await vehicle.link.download(_READ_S)

    async def arm(self, vehicle: Vehicle) -> Answer:
        return await vehicle.command(_mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    async def disarm(self, vehicle: Vehicle) -> Answer:
        return await vehicle.command(_mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)

    async def start_mission(self, vehicle: Vehicle) -> Answer:
        return await vehicle.command(_mav.MAV_CMD_DO_SET_MODE, _CUSTOM_MODE_ENABLED, _AUTO, _MISSION)

    async def select(self, vehicle: Vehicle, first: int, line: Sequence[RawItem]) -> bool:
        # MISSION_CURRENT comes once a second only; where it flies to is told at once, if that is a new place.
        def on_line(message: Message | None) -> bool:
            if message is None or message.name != _TARGET or message.component_id != AUTOPILOT_COMPONENT:
                return False
            return any(at_place(message.fields["lat_int"], message.fields["lon_int"], item) for item in line)

        was_on_line = on_line(vehicle.latest.get(_TARGET))
        return await select_by_message(
            vehicle, first, first + len(line), lambda message: not was_on_line and on_line(message)
        )

    async def fly_circle(self, vehicle: Vehicle, order: CircleOrder, take_over: bool) -> Answer:
        # DO_REPOSITION ignores the radius. Frames other than 5 are answered with a result that crashes MAVSDK 4.1.
        return await vehicle.command_int(
            _mav.MAV_CMD_DO_ORBIT,
            _mav.MAV_FRAME_GLOBAL_INT,
            (order.signed_radius_m, math.nan, 0.0, math.nan),
            order.x,
            order.y,
            order.altitude_m,
        )

    def told_circle(self, message: Message) -> CircleOrder | None:
        if message.name != "ORBIT_EXECUTION_STATUS":
            return None
        fields = message.fields
        return CircleOrder(fields["x"], fields["y"], 0.0, fields["z"], fields["radius"])

    async def return_home(self, vehicle: Vehicle) -> Answer:
        return await vehicle.command(_mav.MAV_CMD_DO_SET_MODE, _CUSTOM_MODE_ENABLED, _AUTO, _RTL)

    def limits(self, values: Mapping[str, float]) -> Limits:
        names = ("FW_R_LIM", "FW_AIRSPD_MIN", "FW_AIRSPD_MAX", "FW_AIRSPD_TRIM")
        return Limits(*map(values.get, names))
