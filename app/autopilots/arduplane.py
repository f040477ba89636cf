"""ArduPlane: item 0 is home, arm before AUTO, whole metres of radius, a mission ends in a circle or goes home."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from pymavlink.dialects.v20 import common as _mav

from sidelong.app.autopilots.autopilot import Limits
from sidelong.app.autopilots.required_parameter import RequiredParameter, required_airspeed
from sidelong.app.link.modes import AUTOPILOT_ARDUPILOT
from sidelong.mission.core.requirement import Wind
from sidelong.mission.exchange.dialect import CircleOrder, Home, ProtocolQuirks
from sidelong.mission.exchange.raw_item import RawItem, raw_item
from sidelong.mission.exchange.reports import PositionTargetReported, VehicleReport
from sidelong.mission.exchange.vehicle_command import VehicleCommand
from sidelong.mission.upload.items import Item
from sidelong.mission.upload.line_tracking import LineTracking, arduplane

_CUSTOM_MODE_ENABLED = 1
_AUTO, _RTL = 10, 11
_SPEED_UNCHANGED = -1.0
_FAILSAFE = "without heartbeats of system MAV_GCS_SYSID (not sidelong's) the failsafe takes the aircraft"


class ArduPlane:
    """``Autopilot`` for ArduPlane 4.x."""

    name = "ArduPlane"
    mav_autopilot = AUTOPILOT_ARDUPILOT
    quirks = ProtocolQuirks(stores_items_one_by_one=True, home_at_zero=True, reports_target_at_once=False)
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

    def arm(self) -> VehicleCommand:
        return VehicleCommand(_mav.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,))

    def disarm(self) -> VehicleCommand:
        return VehicleCommand(_mav.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,))

    def start_mission(self) -> VehicleCommand:
        return VehicleCommand(_mav.MAV_CMD_DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _AUTO))

    def return_home(self) -> VehicleCommand:
        return VehicleCommand(_mav.MAV_CMD_DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _RTL))

    def fly_circle(self, order: CircleOrder, take_over: bool) -> VehicleCommand:
        # Only COMMAND_INT is understood, the sign of a radius says nothing, and it is kept in whole metres. Without
        # the flag it is refused in any other mode, so it cannot take the aircraft out of somebody's hands.
        return VehicleCommand(
            _mav.MAV_CMD_DO_REPOSITION,
            (
                _SPEED_UNCHANGED,
                float(_mav.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE if take_over else 0),
                float(max(1, round(abs(order.signed_radius_m)))),
                float(order.signed_radius_m < 0.0),
            ),
            _mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
            order.x,
            order.y,
            order.height_m,
        )

    def reported_circle(self, report: VehicleReport) -> CircleOrder | None:
        if not isinstance(report, PositionTargetReported):
            return None
        return CircleOrder(report.x, report.y, 0.0, 0.0, 0.0)

    def limits(self, values: Mapping[str, float]) -> Limits:
        names = ("ROLL_LIMIT_DEG", "AIRSPEED_MIN", "AIRSPEED_MAX", "AIRSPEED_CRUISE")
        return Limits(*map(values.get, names))
