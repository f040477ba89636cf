"""ArduPlane: item 0 is home, arm before AUTO, whole metres of radius, a mission ends in a circle or goes home."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

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
from sidelong.mission.exchange.reports import PositionTargetReported, VehicleReport
from sidelong.mission.exchange.vehicle_command import VehicleCommand
from sidelong.mission.geometry.progress import STILL_AIR
from sidelong.mission.upload.line_tracking import LineTracking
from sidelong.mission.upload.mission_item import MissionItem, e7

_CUSTOM_MODE_ENABLED = 1
_AUTO, _RTL = 10, 11
_SPEED_UNCHANGED = -1.0
_FAILSAFE = "without heartbeats of that system, which is not sidelong's, the failsafe takes the aircraft"
_LINK_LOST = {0.0: "losing the link does nothing: it keeps circling", 1.0: _FAILSAFE, 2.0: _FAILSAFE, 3.0: _FAILSAFE}
_IN_FAILSAFE = {1.0: "in a failsafe it flies home", 2.0: "in a failsafe it glides"}
_V4_5, _V4_7 = Release(4, 5), Release(4, 7)
_CENTI = 0.01
_ITEMS_IN_EVERY_TAKE_OFF = 8 | 32  # of ARMING_MIS_ITEMS: the take-off item; rally points are not mission items
_PARAMETERS = (
    Parameter("AIRSPEED_CRUISE", Purpose.AIRSPEED, since=_V4_5),
    Parameter("TRIM_ARSPD_CM", Purpose.AIRSPEED, "AIRSPEED_CRUISE", _CENTI, until=_V4_5),
    Parameter("AIRSPEED_MIN", Purpose.AIRSPEED, since=_V4_5),
    Parameter("ARSPD_FBW_MIN", Purpose.AIRSPEED, "AIRSPEED_MIN", until=_V4_5),
    Parameter("AIRSPEED_MAX", Purpose.AIRSPEED, since=_V4_5),
    Parameter("ARSPD_FBW_MAX", Purpose.AIRSPEED, "AIRSPEED_MAX", until=_V4_5),
    Parameter("ROLL_LIMIT_DEG", Purpose.BANK_LIMIT, since=_V4_5),
    Parameter("LIM_ROLL_CD", Purpose.BANK_LIMIT, "ROLL_LIMIT_DEG", _CENTI, until=_V4_5),
    Parameter("WP_LOITER_RAD", Purpose.CIRCLE),
    Parameter("WP_RADIUS", Purpose.CIRCLE),
    Parameter("MAV_GCS_SYSID", Purpose.GROUND_STATION, since=_V4_7),
    Parameter("SYSID_MYGCS", Purpose.GROUND_STATION, "MAV_GCS_SYSID", until=_V4_7),
    Parameter("FS_GCS_ENABL", Purpose.GROUND_STATION, notes=_LINK_LOST),
    Parameter("FS_LONG_ACTN", Purpose.GROUND_STATION, notes=_IN_FAILSAFE),
    Parameter("ARMING_MIS_ITEMS", Purpose.MISSION_ITEMS),
    Parameter("FENCE_ENABLE", Purpose.FENCE, notes={1.0: "a fence is active: what leaves it ends the mission"}),
    Parameter("FENCE_OPTIONS", Purpose.FENCE, since=_V4_5),
)


@cache
def _modes() -> dict[int, str]:
    """Return the modes by number. The import is late: it loads another dialect, and much else."""
    from pymavlink import mavutil  # noqa: PLC0415

    return dict(mavutil.mode_mapping_bynumber(_mav.MAV_TYPE_FIXED_WING))


class ArduPlane:
    name, key = "ArduPlane", "arduplane"
    mav_autopilot = int(_mav.MAV_AUTOPILOT_ARDUPILOTMEGA)
    releases = SupportedReleases(
        Release(4, 4), Release(4, 7), "a radius of their own for circles that are flown by command (DO_REPOSITION)"
    )
    parameters: tuple[Parameter, ...] = _PARAMETERS
    packs_integers_bytewise = False
    quirks = ProtocolQuirks(stores_items_one_by_one=True, home_at_zero=True, reports_target_at_once=False)
    mission_mode, circle_mode = "AUTO", "GUIDED"
    circles_refused = ""  # DO_REPOSITION is refused in another mode than GUIDED
    min_items = 24

    def mode_name(self, base_mode: int, custom_mode: int) -> str:
        return _modes().get(custom_mode, f"mode {custom_mode}")

    def required_parameters(self, values: Mapping[str, float], airspeed_m_s: float) -> tuple[RequiredParameter, ...]:
        required_parameters = list(required_airspeed(values, "AIRSPEED_CRUISE", airspeed_m_s))
        items = values.get("ARMING_MIS_ITEMS", 0.0)
        allowed = float(int(items) & _ITEMS_IN_EVERY_TAKE_OFF)
        if items != allowed:
            why = "arming asks for items that the mission for take-off does not have, such as a landing"
            required_parameters.append(RequiredParameter("ARMING_MIS_ITEMS", items, allowed, why))
        return tuple(required_parameters)

    def head(self, home: Home) -> tuple[MissionItem, ...]:
        # Whatever is put at 0 is silently replaced by home: put home there.
        """Return the items at the beginning of every mission."""
        place = *e7((home.latitude_deg, home.longitude_deg)), home.altitude_m
        return (MissionItem(_mav.MAV_CMD_NAV_WAYPOINT, _mav.MAV_FRAME_GLOBAL, 0.0, 0.0, 0.0, 0.0, *place),)

    def tail(self, home: Home) -> tuple[MissionItem, ...]:
        """Return the items that close every mission without ever being reached."""
        return ()

    def tracking(self, airspeed_m_s: float, wind: Wind = STILL_AIR) -> LineTracking:
        # The first waypoint counts as reached at once, a little late or early; the leg from it on is flown.
        return LineTracking(airspeed_m_s, wind)

    def stored(self, item: MissionItem) -> MissionItem:
        """Return the item as ArduPlane stores it."""
        if item.command == _mav.MAV_CMD_NAV_LOITER_UNLIM:
            return replace(item, param3=float(round(item.param3)))
        return item

    def start_mission(self) -> VehicleCommand:
        return VehicleCommand(_mav.MAV_CMD_DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _AUTO))

    def return_home(self) -> VehicleCommand:
        return VehicleCommand(_mav.MAV_CMD_DO_SET_MODE, (_CUSTOM_MODE_ENABLED, _RTL))

    def fly_circle(self, order: CircleOrder, take_over: bool) -> VehicleCommand:
        # Only COMMAND_INT is supported, the sign of the radius is ignored, and it is stored in whole metres. Without
        # the flag it is refused in any other mode, so it cannot override a pilot or another station.
        flags = float(_mav.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE if take_over else 0)
        radius_m, anticlockwise = float(max(1, round(abs(order.signed_radius_m)))), float(order.signed_radius_m < 0.0)
        params, frame = (_SPEED_UNCHANGED, flags, radius_m, anticlockwise), _mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
        return VehicleCommand(_mav.MAV_CMD_DO_REPOSITION, params, frame, order.x, order.y, order.height_m)

    def reported_circle(self, report: VehicleReport) -> CircleOrder | None:
        """Return the circle that a report states, None for other reports."""
        if not isinstance(report, PositionTargetReported):
            return None
        return CircleOrder(report.x, report.y, 0.0, 0.0, 0.0)

    def failsafe_cause(self, event_id: int, arguments: Sequence[int]) -> str:
        return ""  # it sends texts

    def renewed_failsafe(self, values: Mapping[str, float], station_id: int) -> str:
        # Only heartbeats of MAV_GCS_SYSID count.
        """Return the failsafe, in words, that heartbeats of this ground station (system id) keep from acting."""
        action = values.get("FS_GCS_ENABL", 0.0)
        is_its_own = values.get("MAV_GCS_SYSID") == station_id
        return f"FS_GCS_ENABL = {action:g} of ground station {station_id}" * (is_its_own and action > 0.0)

    def limits(self, values: Mapping[str, float]) -> Limits:
        names = ("ROLL_LIMIT_DEG", "AIRSPEED_MIN", "AIRSPEED_MAX", "AIRSPEED_CRUISE")
        return Limits(*map(values.get, names))
