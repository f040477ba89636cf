"""Aircraft that are not ours, as the links report them: ADSB_VEHICLE, and positions of other systems."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT, has_fix
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.fleet.events import ForeignAircraftReported

_EVERY_S = 1.0
_COORDINATES, _ALTITUDE, _HEADING, _VELOCITY = 1, 2, 4, 8  # ADSB_FLAGS_VALID_*
_FAR_M = 20_000.0
_UNKNOWN_COURSE = 36_000  # hundredths of a degree, and more


class ForeignAircraft:
    """Reads messages of all senders; ``report`` returns each aircraft once a second.

    own_ids: system ids of the fleet. now_s: mission time. home_altitude_m: of the home that heights refer to.
    """

    def __init__(
        self, plane: LocalPlane, home_altitude_m: float, own_ids: Collection[int], now_s: Callable[[], float]
    ) -> None:
        self._plane, self._home_altitude_m = plane, home_altitude_m
        self._own_ids, self._now_s = own_ids, now_s
        self._announced_s: dict[str, float] = {}

    def report(self, message: Message, member: str = "") -> ForeignAircraftReported | None:
        """Return the aircraft that a message reports, None where it reports none or did so within the last second.

        Args:
            message: A message of any sender.
            member: Name of the fleet's aircraft that sent it, if this program has yielded it.
        """
        fields, now_s = message.fields, self._now_s()
        if message.name == "GLOBAL_POSITION_INT":
            own = message.system_id in self._own_ids and not member
            if own or message.component_id != AUTOPILOT_COMPONENT:
                return None
            identity, altitude_mm = member or f"system {message.system_id}", fields["alt"]
            velocity = fields["vy"] * 1e-2, fields["vx"] * 1e-2
            course_rad, speed_m_s = math.atan2(*velocity), math.hypot(*velocity)
        elif message.name == "ADSB_VEHICLE" and not member:
            flags, needed = int(fields["flags"]), _COORDINATES | _ALTITUDE
            if flags & needed != needed:
                return None
            identity, altitude_mm = f"ADS-B {int(fields['ICAO_address']):06X}", fields["altitude"]
            knows_course = flags & _HEADING and fields["heading"] < _UNKNOWN_COURSE
            course_rad = math.radians(fields["heading"] * 1e-2) if knows_course else 0.0
            speed_m_s = fields["hor_velocity"] * 1e-2 if knows_course and flags & _VELOCITY else 0.0
        else:
            return None
        if (
            not (has_fix(fields) and math.isfinite(now_s))
            or now_s < self._announced_s.get(identity, -math.inf) + _EVERY_S
        ):
            return None
        east_m, north_m = self._plane.east_north_m(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
        if math.hypot(east_m, north_m) > _FAR_M:
            return None
        self._announced_s[identity] = now_s
        height_m = altitude_mm * 1e-3 - self._home_altitude_m
        flown = east_m, north_m, height_m, course_rad, speed_m_s
        return ForeignAircraftReported(identity, now_s, *flown, member=bool(member))
