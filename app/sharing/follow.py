"""The estimate as what follow modes of other autopilots and ground stations take: FOLLOW_TARGET, and NMEA 0183."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from datetime import UTC, datetime
from functools import reduce
from operator import xor

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.sharing.senders import Sender
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Present

_FOLLOW_EVERY_S, _HEARTBEAT_EVERY_S, _NMEA_EVERY_S = 0.2, 1.0, 1.0
_POSITION_AND_VELOCITY = 0b11
_COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
_KNOTS_PER_M_S = 3600.0 / 1852.0

AltitudeAt = Callable[[float, float], float]


class _Periodic:
    """An ``Observer`` that sends the target once every ``every_s`` of the wall clock; it sends no lost target.

    It always sends the target that its aircraft watched first: a follower must not be redirected to another one.
    altitude_m returns the target's altitude above the sea at a place (east, north).
    """

    def __init__(self, sender: Sender, plane: LocalPlane, altitude_m: AltitudeAt, every_s: float) -> None:
        self._sender, self._plane, self._altitude_m, self._every_s = sender, plane, altitude_m, every_s
        self._next_s = -math.inf
        self._target = ""

    def show(self, snapshot: Present) -> None:
        estimate, now_s = snapshot.estimate, time.monotonic()
        if now_s < self._next_s or estimate is None or estimate.quality is TrackQuality.LOST:
            return
        self._target = self._target or snapshot.target
        if snapshot.target != self._target:
            return
        self._next_s = now_s + self._every_s
        position_m = estimate.position_m(snapshot.time_s)
        self._announce(estimate, snapshot.time_s, position_m, self._altitude_m(*position_m))

    def stop(self) -> None:
        self._sender.stop()

    def _announce(
        self, estimate: TargetEstimate, time_s: float, position_m: tuple[float, float], altitude_m: float
    ) -> None:
        raise NotImplementedError


class FollowTargetOutput(_Periodic):
    """Sends FOLLOW_TARGET of system ``system_id``, which ArduPilot's FOLL_SYSID names."""

    def __init__(self, sender: Sender, plane: LocalPlane, altitude_m: AltitudeAt, system_id: int) -> None:
        super().__init__(sender, plane, altitude_m, _FOLLOW_EVERY_S)
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=_COMPONENT)
        self._heartbeat_s = -math.inf

    def _announce(
        self, estimate: TargetEstimate, time_s: float, position_m: tuple[float, float], altitude_m: float
    ) -> None:
        now_s = time.monotonic()
        if now_s >= self._heartbeat_s + _HEARTBEAT_EVERY_S:
            self._heartbeat_s = now_s
            kind, none = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
            self._send(mavlink.MAVLink_heartbeat_message(kind, none, 0, 0, mavlink.MAV_STATE_ACTIVE, 3))
        latitude_deg, longitude_deg = self._plane.latitude_longitude_deg(*position_m)
        sigma_m = math.sqrt(max(float(estimate.covariance[0, 0] + estimate.covariance[1, 1]), 0.0))
        self._send(
            mavlink.MAVLink_follow_target_message(
                round(time_s * 1000.0),
                _POSITION_AND_VELOCITY,
                round(latitude_deg * 1e7),
                round(longitude_deg * 1e7),
                altitude_m,
                [estimate.velocity_north_m_s, estimate.velocity_east_m_s, 0.0],
                [0.0] * 3,
                [1.0, 0.0, 0.0, 0.0],
                [0.0] * 3,
                [sigma_m, 0.0, 0.0],
                0,
            )
        )

    def _send(self, message: mavlink.MAVLink_message) -> None:
        self._sender.send(bytes(message.pack(self._mav)))
        self._mav.seq = (self._mav.seq + 1) % 256


class NmeaOutput(_Periodic):
    """Sends the target's position as a GPS receiver sends its own: RMC and GGA."""

    def __init__(
        self,
        sender: Sender,
        plane: LocalPlane,
        altitude_m: AltitudeAt,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        super().__init__(sender, plane, altitude_m, _NMEA_EVERY_S)
        self._now = now

    def _announce(
        self, estimate: TargetEstimate, time_s: float, position_m: tuple[float, float], altitude_m: float
    ) -> None:
        latitude_deg, longitude_deg = self._plane.latitude_longitude_deg(*position_m)
        now = self._now().astimezone(UTC)
        clock = now.strftime("%H%M%S.") + f"{now.microsecond // 10_000:02d}"
        place = f"{_degrees(latitude_deg, 2, 'NS')},{_degrees(longitude_deg, 3, 'EW')}"
        knots, course_deg = _KNOTS_PER_M_S * estimate.speed_m_s, math.degrees(estimate.course_rad) % 360.0
        dilution = max(estimate.ellipse_95.semi_major_m / 5.0, 0.1)
        self._sender.send(
            _sentence(f"GPRMC,{clock},A,{place},{knots:.2f},{course_deg:.2f},{now:%d%m%y},,,A")
            + _sentence(f"GPGGA,{clock},{place},1,08,{dilution:.1f},{altitude_m:.1f},M,,M,,")
        )


def _degrees(angle_deg: float, digits: int, signs: str) -> str:
    minutes = round(abs(angle_deg) * 60.0, 5)
    return f"{int(minutes // 60.0):0{digits}d}{minutes % 60.0:08.5f},{signs[angle_deg < 0.0]}"


def _sentence(body: str) -> bytes:
    return f"${body}*{reduce(xor, body.encode('ascii')):02X}\r\n".encode("ascii")
