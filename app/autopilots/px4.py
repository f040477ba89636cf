"""PX4: acknowledgements prove nothing, so look at the mode flown; a mission needs a landing at its end."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pymavlink.dialects.v20 import all as _mav

from sidelong.app.autopilots.autopilot import (
    Limits,
    Parameter,
    Purpose,
    Release,
    RequiredParameter,
    SupportedReleases,
    required_airspeed,
)
from sidelong.mission.core.requirement import Wind
from sidelong.mission.exchange.dialect import CircleOrder, Home, ProtocolQuirks
from sidelong.mission.exchange.reports import OrbitReported, VehicleReport
from sidelong.mission.exchange.vehicle_command import VehicleCommand
from sidelong.mission.geometry.progress import STILL_AIR
from sidelong.mission.upload.line_tracking import LineTracking
from sidelong.mission.upload.mission_item import MissionItem, e7

_CUSTOM_MODE_ENABLED = 1
_AUTO, _MISSION, _RTL, _PRECLAND = 4, 4, 5, 9
_APPROACH_M, _APPROACH_HEIGHT_M = 700.0, 40.0
_ENDS_FLIGHT = (5.0, 6.0)  # of NAV_DLL_ACT
_WANTS_TAKE_OFF, _WANTS_LANDING = (1.0, 3.0, 4.0), 2.0  # of MIS_TKO_LAND_REQ
_ACCEPTANCE_M = 10.0  # NAV_ACC_RAD; an item's own is not heeded
_METRES_PER_DEGREE = 111_000.0
_V1_14 = Release(1, 14)
_LINK_LOST = {
    0.0: "losing the link does nothing: it keeps circling",
    1.0: "losing the link holds the aircraft where it is",
    2.0: "losing the link holds it, then flies it home",
    3.0: "losing the link lands it",
}
# Where the cause stands in the arguments of commander_failsafe_enter and commander_failsafe_enter_hold. Source: PX4,
# src/modules/commander/failsafe/framework.cpp (an id is the FNV-1a of the name) and src/lib/events/enums.json.
_FAILSAFE_CAUSE_AT = {0x194CA8A: 5, 0x1D11DF6: 7}
_FAILSAFE_CAUSES = (
    *("", "Manual control loss", "GCS connection loss"),
    *("Low battery level", "Critical battery level", "Emergency battery level", "Remaining flight time low"),
)
_PARAMETERS = (
    Parameter("FW_AIRSPD_TRIM", Purpose.AIRSPEED),
    Parameter("FW_AIRSPD_MIN", Purpose.AIRSPEED),
    Parameter("FW_AIRSPD_MAX", Purpose.AIRSPEED),
    Parameter("FW_R_LIM", Purpose.BANK_LIMIT),
    Parameter("NAV_LOITER_RAD", Purpose.CIRCLE),
    Parameter("NAV_DLL_ACT", Purpose.GROUND_STATION, notes=_LINK_LOST),
    Parameter("COM_DL_LOSS_T", Purpose.GROUND_STATION),
    Parameter("MIS_TKO_LAND_REQ", Purpose.MISSION_ITEMS, since=_V1_14),
    Parameter("GF_ACTION", Purpose.FENCE),
    Parameter("GF_MAX_HOR_DIST", Purpose.FENCE),
)


class Px4:
    name, key = "PX4", "px4"
    mav_autopilot = int(_mav.MAV_AUTOPILOT_PX4)
    releases = SupportedReleases(
        _V1_14, Release(1, 18), "the choice of a mission's take-off and landing (MIS_TKO_LAND_REQ)"
    )
    parameters: tuple[Parameter, ...] = _PARAMETERS
    packs_integers_bytewise = True
    quirks = ProtocolQuirks(stores_items_one_by_one=False, home_at_zero=False, reports_target_at_once=True)
    mission_mode, circle_mode = "MISSION", "LOITER"
    # DO_ORBIT selects Hold, also over a mode that the pilot has selected since the last heartbeat, and a pilot's own
    # Hold is the same mode. Journals of flights by command are still replayed.
    circles_refused = "PX4 obeys an orbit in any flight mode and would leave one that the pilot has just selected"
    min_items = 0

    def mode_name(self, base_mode: int, custom_mode: int) -> str:
        if (custom_mode >> 16 & 0xFF, custom_mode >> 24) == (_AUTO, _PRECLAND):  # pymavlink lacks it
            return "PRECLAND"
        from pymavlink import mavutil  # noqa: PLC0415  # it loads another dialect, and much else

        return str(mavutil.interpret_px4_mode(base_mode, custom_mode))

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

    def head(self, home: Home) -> tuple[MissionItem, ...]:
        """Return the items at the beginning of every mission."""
        return ()

    def tail(self, home: Home) -> tuple[MissionItem, ...]:
        # MIS_TKO_LAND_REQ 2, the fixed-wing default, drops a mission without a landing to HOLD. The circle before
        # it never completes, so these items are only reached if a landing is commanded: a straight approach
        # to home from the south, flat enough and outside the circle where it begins, as PX4 demands.
        """Return the items that close every mission without ever being reached."""
        x, y = e7((home.latitude_deg, home.longitude_deg))
        south_x = x - round(_APPROACH_M / _METRES_PER_DEGREE * 1e7)
        frame, nan = _mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, float("nan")
        return (
            MissionItem(_mav.MAV_CMD_DO_LAND_START, _mav.MAV_FRAME_MISSION, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0),
            MissionItem(_mav.MAV_CMD_NAV_LOITER_TO_ALT, frame, 0.0, 80.0, 0.0, 1.0, south_x, y, _APPROACH_HEIGHT_M),
            MissionItem(_mav.MAV_CMD_NAV_LAND, frame, 0.0, 0.0, 0.0, nan, x, y, 0.0),
        )

    def tracking(self, airspeed_m_s: float, wind: Wind = STILL_AIR) -> LineTracking:
        # A mission set current begins without a line, and NPFG turns tightly enough to orbit a waypoint too near.
        return LineTracking(
            airspeed_m_s,
            wind,
            period_s=10.0,
            damping=0.7071,
            switch_s=_ACCEPTANCE_M / airspeed_m_s,
            first_s=2.5,
            first_is_line=False,
        )

    def stored(self, item: MissionItem) -> MissionItem:
        """Return the item as PX4 stores it."""
        return item

    def start_mission(self) -> VehicleCommand:
        return VehicleCommand(_mav.MAV_CMD_DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _AUTO, _MISSION))

    def return_home(self) -> VehicleCommand:
        return VehicleCommand(_mav.MAV_CMD_DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _AUTO, _RTL))

    def fly_circle(self, order: CircleOrder, take_over: bool) -> VehicleCommand:
        # DO_REPOSITION ignores the radius. Frames other than 5 are answered with a result that crashes MAVSDK 4.1.
        params, frame = (order.signed_radius_m, math.nan, 0.0, math.nan), _mav.MAV_FRAME_GLOBAL_INT
        return VehicleCommand(_mav.MAV_CMD_DO_ORBIT, params, frame, order.x, order.y, order.altitude_m)

    def reported_circle(self, report: VehicleReport) -> CircleOrder | None:
        """Return the circle that a report states, radius 0: none; None for other reports."""
        if not isinstance(report, OrbitReported):
            return None
        return CircleOrder(report.x, report.y, 0.0, 0.0, report.signed_radius_m)

    def failsafe_cause(self, event_id: int, arguments: Sequence[int]) -> str:
        at = _FAILSAFE_CAUSE_AT.get(event_id)
        return "" if at is None or arguments[at] >= len(_FAILSAFE_CAUSES) else _FAILSAFE_CAUSES[arguments[at]]

    def renewed_failsafe(self, values: Mapping[str, float], station_id: int) -> str:
        # Any heartbeat of MAV_TYPE_GCS renews the clock of the data link, whatever its system id.
        """Return the failsafe, in words, that heartbeats of this ground station (system id) keep from acting."""
        action = values.get("NAV_DLL_ACT", 0.0)
        after_s = values.get("COM_DL_LOSS_T", math.nan)
        return f"NAV_DLL_ACT = {action:g} after COM_DL_LOSS_T = {after_s:g} s" * (action > 0.0)

    def limits(self, values: Mapping[str, float]) -> Limits:
        names = ("FW_R_LIM", "FW_AIRSPD_MIN", "FW_AIRSPD_MAX", "FW_AIRSPD_TRIM")
        return Limits(*map(values.get, names))
