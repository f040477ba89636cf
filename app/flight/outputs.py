"""The configured external outputs, the configured beacon, and what points the gimbal at the estimate.

Without a tracking camera the laser then measures whatever is there: the camera or the operator must correct it.
"""

from __future__ import annotations

import math
import ssl
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.config import CameraSection, SharingSection, is_contact
from sidelong.app.flight.streams import OneTask
from sidelong.app.link.message import Message
from sidelong.app.link.vehicle import LinkError, Vehicle
from sidelong.app.network import NetworkAddress
from sidelong.app.sharing.beacon import BeaconInput, ContactBeacon
from sidelong.app.sharing.outputs import (
    AltitudeAt,
    CotNames,
    CotOutput,
    DatagramSender,
    FollowTargetOutput,
    NmeaOutput,
    Sender,
    StreamSender,
    tls_context,
)
from sidelong.estimators.estimate import TargetEstimate, confidence_ellipse
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.rotations import rotate
from sidelong.estimators.sensing.readings import TargetFixReading
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.control.present import Present
from sidelong.mission.exchange.vehicle_command import describe_result
from sidelong.mission.upload.mission_item import e7

_COT, _FOLLOW_TARGET, _NMEA = "sharing.cot", "sharing.follow_target", "sharing.nmea"
Output = CotOutput | FollowTargetOutput | NmeaOutput


def check_hosts(sharing: SharingSection) -> None:
    """Raise InputError for a host that is not known, before anything flies."""
    for name, text in ((_COT, sharing.cot), (_FOLLOW_TARGET, sharing.follow_target), (_NMEA, sharing.nmea)):
        if text is not None:
            NetworkAddress.read(text, ("udp", "tcp", "tls")).resolved(name)


def tls_of(sharing: SharingSection) -> ssl.SSLContext | None:
    """Return how CoT is encrypted, None where it is not. Raises InputError, which names field and file."""
    if sharing.cot is None or not sharing.cot.startswith("tls:"):
        return None
    return tls_context(sharing.cot_certificate_file, sharing.cot_key_file, sharing.cot_authority_file, _COT)


def outputs(
    sharing: SharingSection,
    camera: CameraSection,
    plane: LocalPlane,
    target_altitude_m: AltitudeAt,
    latest: Mapping[str, Message],
    announce: Callable[[str], None],
) -> Iterator[Output]:
    """Yield the displays, each to be stopped at the end; to be called in the running event loop.

    latest: the vehicle's messages. announce: receives the state of the connections. Raises InputError as
    :func:`check_hosts` and :func:`tls_of`.
    """
    if sharing.cot is not None:
        address = NetworkAddress.read(sharing.cot, ("udp", "tcp", "tls"))
        sender: Sender
        if address.scheme == "udp":
            sender = DatagramSender(address, _COT)
        else:
            sender = StreamSender(address, tls_of(sharing), sharing.cot_server_name, announce)
        across_deg, down_deg = map(math.degrees, camera.view_rad())
        names = CotNames(
            type=sharing.cot_type,
            callsign=sharing.cot_callsign,
            own_type=sharing.cot_own_type,
            own_callsign=sharing.cot_own_callsign,
            team=sharing.cot_team,
            view_deg=(across_deg, down_deg),
            video=camera.video_uri,
        )
        yield CotOutput(sender, plane, names, lambda: height_above_ellipsoid_m(latest))
    if sharing.follow_target is not None:
        udp = DatagramSender(NetworkAddress.read(sharing.follow_target, ("udp",)), _FOLLOW_TARGET)
        yield FollowTargetOutput(udp, plane, target_altitude_m, sharing.follow_target_system_id)
    if sharing.nmea is not None:
        udp = DatagramSender(NetworkAddress.read(sharing.nmea, ("udp",)), _NMEA)
        yield NmeaOutput(udp, plane, target_altitude_m)


async def open_beacon(
    sharing: SharingSection,
    plane: LocalPlane,
    now_s: Callable[[], float],
    put: Callable[[TargetFixReading], object],
    announce: Callable[[str], object] = lambda _text: None,
    listeners: list[Callable[[Message], object]] | None = None,
) -> BeaconInput | None:
    """Return the configured beacon's input, to be stopped at the end; None without one on a socket of its own.

    listeners: of the vehicle's messages, through which a traffic contact is received.

    Raises InputError when its address is not free or not here.
    """
    if sharing.beacon is None:
        return None
    if is_contact(sharing.beacon):
        if listeners is not None:
            contact = ContactBeacon(sharing.beacon, plane, now_s, put, announce)
            listeners.append(lambda message: contact.on_message(message.name, message.fields))
        return None
    beacon = BeaconInput(plane, sharing.beacon_name, sharing.beacon_sigma_m, now_s, put, announce)
    await beacon.listen(NetworkAddress.read(sharing.beacon, ("udp",)))
    return beacon


def height_above_ellipsoid_m(latest: Mapping[str, Message]) -> float | None:
    """Return the aircraft's value, None if its receiver does not report the geoid height."""
    gps, position = latest.get("GPS_RAW_INT"), latest.get("GLOBAL_POSITION_INT")
    if gps is None or position is None or not gps.fields.get("alt_ellipsoid"):
        return None
    geoid_mm = gps.fields["alt_ellipsoid"] - gps.fields["alt"]
    return float(position.fields["alt"] + geoid_mm) * 1e-3


# Of the vehicle's time; in the second one a circling aircraft turns by 4 degrees.
_BY_VEHICLE_EVERY_S, _BY_PAYLOAD_EVERY_S = 1.0, 0.2
_ONE_SIGMA = 1.0 - math.exp(-0.5)


@dataclass(eq=False)
class GimbalPointer:
    """An ``Observer`` that sends CAMERA_TRACKING_GEO_STATUS and DO_SET_ROI_LOCATION, once a second at most.

    A target that is not seen is looked for where it is predicted. Nothing is sent before the mission or after a
    yield; a pending command is then cancelled.
    """

    _vehicle: Vehicle
    _plane: LocalPlane
    _target_altitude_m: AltitudeAt
    _announce: Callable[[str], None]
    _always: bool = True  # False: only while a fleet requires the payload on another target
    _next_s: float = -math.inf
    _sending: OneTask = field(default_factory=OneTask)
    _points: bool = True

    def show(self, snapshot: Present) -> None:
        """Send the estimate if it is due; stop once sidelong has no control. The event loop must be running."""
        if not snapshot.phase.in_control or not (self._always or snapshot.turn_payload):
            self.stop()
            return
        estimate, aircraft = snapshot.estimate, snapshot.aircraft
        if estimate is None or aircraft is None:
            return
        if snapshot.time_s < self._next_s or self._sending.is_running:
            return
        self._next_s = snapshot.time_s + _BY_VEHICLE_EVERY_S
        east_m, north_m = estimate.position_m(snapshot.time_s)
        range_m = math.hypot(aircraft.east_m - east_m, aircraft.north_m - north_m)
        self._sending.begin(lambda: self._send(estimate, east_m, north_m, range_m))

    def stop(self) -> None:
        self._sending.stop()

    async def _send(self, estimate: TargetEstimate, east_m: float, north_m: float, range_m: float) -> None:
        x, y = e7(self._plane.latitude_longitude_deg(east_m, north_m))
        z = self._target_altitude_m(east_m, north_m)
        try:
            await self._vehicle.link.send("CAMERA_TRACKING_GEO_STATUS", _geo_status(estimate, x, y, z, range_m))
            if not self._points:
                return
            # PX4 takes no other frame than this one, and MAVSDK does not survive its refusal of others.
            result = await self._vehicle.command_int(
                mavlink.MAV_CMD_DO_SET_ROI_LOCATION, mavlink.MAV_FRAME_GLOBAL_INT, (0.0,), x, y, z
            )
        except LinkError:
            return  # the next one is due in a second
        if result in (mavlink.MAV_RESULT_UNSUPPORTED, mavlink.MAV_RESULT_DENIED):
            self._points = False
            why = describe_result(result)
            self._announce(f"the vehicle does not point its gimbal ({why}); it is sent the target's place only")


@dataclass(eq=False)
class PayloadPointer:
    """An ``Observer`` that commands the gimbal's angles five times a second at most.

    A target that is not seen is looked for where it is predicted. Nothing is commanded before the mission or after a
    yield.
    """

    _point: Callable[[float, float], object]  # pitch and yaw in its mount, level and relative to the heading, rad
    _tracker: Tracker  # knows the mount and the gimbal's yaw error
    _target_height_m: Callable[[float, float], float]  # above home at a place (east, north)
    _next_s: float = -math.inf

    def show(self, snapshot: Present) -> None:
        """Point the gimbal at the estimated target if that is due."""
        estimate, aircraft, attitude = snapshot.estimate, snapshot.aircraft, snapshot.attitude
        if not snapshot.phase.in_control or estimate is None or aircraft is None or attitude is None:
            return
        if snapshot.time_s < self._next_s:
            return
        self._next_s = snapshot.time_s + _BY_PAYLOAD_EVERY_S
        target_east_m, target_north_m = estimate.position_m(snapshot.time_s)
        east_m, north_m = target_east_m - aircraft.east_m, target_north_m - aircraft.north_m
        down_m = snapshot.height_m - self._target_height_m(target_east_m, target_north_m)
        if not math.isfinite(down_m):
            return
        # The gimbal reports its yaw with the error, and so turns too far by it.
        yaw_rad = math.atan2(east_m, north_m) - attitude.yaw_rad + self._tracker.calibration.yaw_bias_rad
        level_m = math.hypot(east_m, north_m)
        w, x, y, z = self._tracker.parent_from_mount
        forward_m, right_m, down_m = rotate(
            (w, -x, -y, -z), (level_m * math.cos(yaw_rad), level_m * math.sin(yaw_rad), down_m)
        )
        self._point(-math.atan2(down_m, math.hypot(forward_m, right_m)), math.atan2(right_m, forward_m))


def _geo_status(estimate: TargetEstimate, x: int, y: int, z: float, range_m: float) -> dict[str, Any]:
    return {
        "tracking_status": mavlink.CAMERA_TRACKING_STATUS_FLAGS_ACTIVE,
        "lat": x,
        "lon": y,
        "alt": z,
        "h_acc": confidence_ellipse(estimate.covariance[:2, :2], _ONE_SIGMA).semi_major_m,
        "v_acc": math.nan,
        "vel_n": estimate.velocity_north_m_s,
        "vel_e": estimate.velocity_east_m_s,
        "vel_d": math.nan,
        "vel_acc": math.sqrt(float(max(estimate.covariance[2, 2], estimate.covariance[3, 3]))),
        "dist": range_m,
        "hdg": estimate.course_rad % (2.0 * math.pi),
        "hdg_acc": math.nan,
    }
