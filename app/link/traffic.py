"""Other aircraft near the own one, by what receivers and other vehicles on the links report of them.

ADSB_VEHICLE comes from receivers of ADS-B and FLARM (uAvionix pings among them), GLOBAL_POSITION_INT from other
vehicles, OPEN_DRONE_ID_LOCATION from receivers of Remote ID.

Source: MAVLink common message set; ASTM F3411 for Remote ID.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field

from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT, has_fix
from sidelong.estimators.frames import LocalPlane, wrap_rad
from sidelong.mission.core.fleet import Neighbour
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.geometry.separation import NEAR_COLLISION_M, WELL_CLEAR_M

_EVERY_S, _FORGOTTEN_S = 1.0, 30.0
_COORDINATES, _ALTITUDE, _HEADING, _VELOCITY, _VERTICAL = 1, 2, 4, 8, 128  # ADSB_FLAGS_VALID_*
_FAR_M = 20_000.0
_UNKNOWN_COURSE = 36_000  # hundredths of a degree, and more
_UNKNOWN_ALTITUDE_M, _UNKNOWN_SPEED = -1000.0, 25_500
_ON_GROUND = 1  # MAV_ODID_STATUS
_TURN_OVER_S, _TURN_MAX_RAD_S, _TURN_MIN_RAD_S = 6.0, 0.35, 0.015
_OWN_M, _OWN_M_S = 60.0, 4.0


@dataclass(eq=False)
class TrafficReader:
    """Reads messages of all senders; ``report`` returns each aircraft once a second."""

    _plane: LocalPlane
    _home_altitude_m: float  # of the home that heights refer to, above mean sea level
    _own_ids: Collection[int]  # system ids of the own aircraft
    _now_s: Callable[[], float]
    # State and height of the own aircraft, which its own transponder reports, too.
    _own: Callable[[], tuple[AircraftState, float] | None] = lambda: None
    _ignored: Collection[str] = ()  # names of those that are none to keep clear of, such as the target's beacon
    _known: dict[str, Neighbour] = field(default_factory=dict)
    _geoid_m: float = 0.0  # height of the mean sea level above the ellipsoid

    @property
    def aircraft(self) -> tuple[Neighbour, ...]:
        """The aircraft that were reported lately."""
        now_s = self._now_s()
        self._known = {name: one for name, one in self._known.items() if now_s - one.state.time_s < _FORGOTTEN_S}
        return tuple(self._known.values())

    def report(self, message: Message, member: str = "") -> Neighbour | None:
        """Return the aircraft that a message reports, None where it reports none or did so within the last second.

        member: name of the fleet's aircraft that sent it, if this program has yielded it.
        """
        fields, now_s, clear_m, climb_m_s = message.fields, self._now_s(), NEAR_COLLISION_M, 0.0
        is_own = message.system_id in self._own_ids
        if message.name == "GLOBAL_POSITION_INT":
            if (is_own and not member) or message.component_id != AUTOPILOT_COMPONENT:
                return None
            name, altitude_m = member or f"system {message.system_id}", fields["alt"] * 1e-3
            velocity = fields["vy"] * 1e-2, fields["vx"] * 1e-2
            course_rad, speed_m_s, climb_m_s = math.atan2(*velocity), math.hypot(*velocity), -fields["vz"] * 1e-2
            clear_m = (0.0, 0.0) if member else clear_m
        elif message.name == "ADSB_VEHICLE" and not member:
            flags, needed, clear_m = int(fields["flags"]), _COORDINATES | _ALTITUDE, WELL_CLEAR_M
            if flags & needed != needed:
                return None
            name, altitude_m = f"ADS-B {int(fields['ICAO_address']):06X}", fields["altitude"] * 1e-3
            knows_course = flags & _HEADING and fields["heading"] < _UNKNOWN_COURSE
            course_rad = math.radians(fields["heading"] * 1e-2) if knows_course else 0.0
            speed_m_s = fields["hor_velocity"] * 1e-2 if knows_course and flags & _VELOCITY else 0.0
            climb_m_s = fields["ver_velocity"] * 1e-2 if flags & _VERTICAL else 0.0
        elif message.name == "OPEN_DRONE_ID_LOCATION" and not member:
            sender = bytes(fields["id_or_mac"])  # of another aircraft; zeros for what the own one sends
            altitude_m = fields["altitude_geodetic"] - self._geoid_m
            if not any(sender) or fields["status"] == _ON_GROUND or altitude_m <= _UNKNOWN_ALTITUDE_M:
                return None
            name = f"Remote ID {sender.rstrip(bytes(1)).hex()}"
            knows_course = fields["direction"] <= _UNKNOWN_COURSE and fields["speed_horizontal"] < _UNKNOWN_SPEED
            course_rad = math.radians(fields["direction"] * 1e-2) if knows_course else 0.0
            speed_m_s = fields["speed_horizontal"] * 1e-2 if knows_course else 0.0
            fields = {"lat": fields["latitude"], "lon": fields["longitude"]}
        else:
            if message.name == "GPS_RAW_INT" and is_own and fields.get("alt_ellipsoid"):
                self._geoid_m = (fields["alt_ellipsoid"] - fields["alt"]) * 1e-3
            return None
        before = self._known.get(name)
        if name in self._ignored:
            return None
        if not (has_fix(fields) and math.isfinite(now_s)) or (before and now_s < before.state.time_s + _EVERY_S):
            return None
        east_m, north_m = self._plane.east_north_m(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
        if math.hypot(east_m, north_m) > _FAR_M:
            return None
        curvature_per_m = 0.0 if before is None else _curvature_per_m(before.state, now_s, course_rad, speed_m_s)
        state = AircraftState(now_s, east_m, north_m, course_rad, speed_m_s, curvature_per_m)
        found = Neighbour(
            name, state, altitude_m - self._home_altitude_m, False, "", climb_m_s=climb_m_s, clear_m=clear_m
        )
        if not member and self._is_own(found):
            return None
        self._known[name] = found
        return found

    def _is_own(self, found: Neighbour) -> bool:
        """Return whether a report is of the own transponder: at the own place and as fast in the same direction."""
        own = self._own()
        if own is None:
            return False
        (mine, height_m), theirs = own, found.state
        apart_m = math.dist((mine.east_m, mine.north_m, height_m), (theirs.east_m, theirs.north_m, found.height_m))
        return apart_m < _OWN_M and math.dist(_velocity_m_s(mine), _velocity_m_s(theirs)) < _OWN_M_S


def _velocity_m_s(state: AircraftState) -> tuple[float, float]:
    return (state.ground_speed_m_s * math.sin(state.course_rad), state.ground_speed_m_s * math.cos(state.course_rad))


def _curvature_per_m(before: AircraftState, now_s: float, course_rad: float, speed_m_s: float) -> float:
    """Return how the path of an aircraft bends, smoothed over some reports; 0 for one that hardly turns."""
    passed_s = now_s - before.time_s
    if passed_s > _TURN_OVER_S or speed_m_s < 1.0:
        return 0.0
    turn_rad_s = wrap_rad(course_rad - before.course_rad) / passed_s
    known_rad_s = before.curvature_per_m * before.ground_speed_m_s
    turn_rad_s = known_rad_s + min(passed_s / _TURN_OVER_S * 3.0, 1.0) * (turn_rad_s - known_rad_s)
    return turn_rad_s / speed_m_s if _TURN_MIN_RAD_S < abs(turn_rad_s) < _TURN_MAX_RAD_S else 0.0
