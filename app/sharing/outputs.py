"""External outputs: cursor on target (CoT), and for follow modes and ground stations FOLLOW_TARGET and NMEA 0183.

CoT has one XML event per second for the target and one for the aircraft. Its ``ce``, a 1-sigma error, is the long
axis of the estimate's ellipse. While the target is not seen, its event has the position and the ellipse that are
predicted; the others have none for a lost track. A message that the network does not accept at once is dropped.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import ssl
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Protocol
from uuid import NAMESPACE_DNS, uuid5
from xml.etree import ElementTree

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.errors import InputError
from sidelong.app.network import NetworkAddress
from sidelong.estimators.estimate import TargetEstimate, TrackQuality, confidence_ellipse
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Present
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.route.route import Route, RouteProgress, describe

_CONNECT_TIMEOUT_S, _AGAIN_AFTER_S = 10.0, 5.0
_BACKLOG_MAX_BYTES = 64 << 10


class Sender(Protocol):
    def send(self, data: bytes) -> None: ...

    def stop(self) -> None: ...


class DatagramSender:
    """Sends by UDP. Raises InputError, naming ``name``, for a host that is not known."""

    def __init__(self, address: NetworkAddress, name: str) -> None:
        self._to = address.resolved(name)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            self._socket.sendto(data, self._to)

    def stop(self) -> None:
        self._socket.close()


class StreamSender:
    """Sends by TCP or TLS and reconnects automatically; create it in the running event loop.

    It discards what a server forwards of its other clients, and announces a connection made or lost.
    """

    def __init__(
        self,
        address: NetworkAddress,
        tls: ssl.SSLContext | None,
        server_name: str | None,
        announce: Callable[[str], None],
    ) -> None:
        self._address, self._tls, self._announce = address, tls, announce
        self._server_name = None if tls is None else server_name or address.host
        self._writer: asyncio.StreamWriter | None = None
        self._announced = ""
        self._task = asyncio.create_task(self._run())

    def send(self, data: bytes) -> None:
        writer = self._writer
        if writer is not None and writer.transport.get_write_buffer_size() < _BACKLOG_MAX_BYTES:
            writer.write(data)

    def stop(self) -> None:
        self._task.cancel()

    async def _run(self) -> None:
        where = f"{self._address.scheme}://{self._address.host}:{self._address.port}"
        while True:
            try:
                await self._connected(where)
                self._announce_once(f"{where} has closed the connection; trying again")
            except (OSError, TimeoutError) as error:
                self._announce_once(f"{where} cannot be reached ({_reason(error)}); trying again")
            await asyncio.sleep(_AGAIN_AFTER_S)

    async def _connected(self, where: str) -> None:
        host, port = self._address.host, self._address.port
        opening = asyncio.open_connection(host, port, ssl=self._tls, server_hostname=self._server_name)
        reader, writer = await asyncio.wait_for(opening, _CONNECT_TIMEOUT_S)
        self._writer = writer
        self._announce_once(f"sending to {where}")
        try:
            while await reader.read(_BACKLOG_MAX_BYTES):
                pass
        finally:
            self._writer = None
            writer.close()

    def _announce_once(self, text: str) -> None:
        if text != self._announced:
            self._announced = text
            self._announce(text)


def tls_context(certificate: Path | None, key: Path | None, authority: Path | None, name: str) -> ssl.SSLContext:
    """Return a client's TLS context; authority None: the system's. Raises InputError that begins with ``name``."""
    try:
        context = ssl.create_default_context(cafile=authority)
        if authority is not None:
            # Since Python 3.13 a certificate must state its key usage; those of private authorities rarely do.
            context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    except (OSError, ValueError) as error:  # ValueError: a name with a zero in it
        raise InputError(
            f"{name}: {authority} holds no certificates ({_reason(error)}); give a PEM file in {name}_authority_file."
        ) from error
    if certificate is not None:
        try:
            context.load_cert_chain(certificate, key, password=lambda: _refused(name))
        except (OSError, ValueError) as error:
            raise InputError(
                f"{name}: {certificate} and its key cannot be used ({_reason(error)}); give PEM files in "
                f"{name}_certificate_file and {name}_key_file."
            ) from error
    elif key is not None:
        raise InputError(f"{name}: {key} is given without its certificate; give {name}_certificate_file.")
    return context


def _refused(name: str) -> str:
    raise InputError(f"{name}: the key is protected by a password; remove it with openssl pkey -in KEY -out NEW.")


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "no answer"
    if isinstance(error, ssl.SSLError):
        return str(getattr(error, "verify_message", "") or error.reason or "TLS failed")
    return str(getattr(error, "strerror", None) or error or error.__class__.__name__)


_FOLLOW_EVERY_S, _HEARTBEAT_EVERY_S, _NMEA_EVERY_S = 0.2, 1.0, 1.0
_POSITION_AND_VELOCITY = 0b11
_COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
_KNOTS_PER_M_S = 3600.0 / 1852.0

AltitudeAt = Callable[[float, float], float]
_Place = tuple[float, float, float]  # latitude and longitude in degrees, altitude above the sea in m


class _Periodic:
    """An ``Observer`` that sends the target once every ``every_s`` of the wall clock, unless its track is lost.

    It is always the target watched first: a follower must not be redirected. altitude_m: above the sea.
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
        place = *self._plane.latitude_longitude_deg(*position_m), self._altitude_m(*position_m)
        self._announce(estimate, snapshot.time_s, place)

    def stop(self) -> None:
        self._sender.stop()

    def _announce(self, estimate: TargetEstimate, time_s: float, place: _Place) -> None:
        raise NotImplementedError


class FollowTargetOutput(_Periodic):
    """Sends FOLLOW_TARGET of system ``system_id``, which ArduPilot's FOLL_SYSID names."""

    def __init__(self, sender: Sender, plane: LocalPlane, altitude_m: AltitudeAt, system_id: int) -> None:
        super().__init__(sender, plane, altitude_m, _FOLLOW_EVERY_S)
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=_COMPONENT)
        self._heartbeat_s = -math.inf

    def _announce(self, estimate: TargetEstimate, time_s: float, place: _Place) -> None:
        (latitude_deg, longitude_deg, altitude_m), now_s = place, time.monotonic()
        if now_s >= self._heartbeat_s + _HEARTBEAT_EVERY_S:
            self._heartbeat_s = now_s
            kind, none = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
            self._send(mavlink.MAVLink_heartbeat_message(kind, none, 0, 0, mavlink.MAV_STATE_ACTIVE, 3))
        sigma_m = math.sqrt(max(float(estimate.covariance[0, 0] + estimate.covariance[1, 1]), 0.0))
        where = round(latitude_deg * 1e7), round(longitude_deg * 1e7), altitude_m
        velocity_ned_m_s = [estimate.velocity_north_m_s, estimate.velocity_east_m_s, 0.0]
        attitude = [0.0] * 3, [1.0, 0.0, 0.0, 0.0], [0.0] * 3  # with acceleration and rates: not known
        self._send(
            mavlink.MAVLink_follow_target_message(
                round(time_s * 1000.0),
                _POSITION_AND_VELOCITY,
                *where,
                velocity_ned_m_s,
                *attitude,
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

    def _announce(self, estimate: TargetEstimate, time_s: float, place: _Place) -> None:
        latitude_deg, longitude_deg, altitude_m = place
        now = self._now().astimezone(UTC)
        clock = now.strftime("%H%M%S.") + f"{now.microsecond // 10_000:02d}"
        where = f"{_degrees(latitude_deg, 2, 'NS')},{_degrees(longitude_deg, 3, 'EW')}"
        knots, course_deg = _KNOTS_PER_M_S * estimate.speed_m_s, math.degrees(estimate.course_rad) % 360.0
        dilution = max(estimate.ellipse_95.semi_major_m / 5.0, 0.1)
        self._sender.send(
            _sentence(f"GPRMC,{clock},A,{where},{knots:.2f},{course_deg:.2f},{now:%d%m%y},,,A")
            + _sentence(f"GPGGA,{clock},{where},1,08,{dilution:.1f},{altitude_m:.1f},M,,M,,")
        )


def _degrees(angle_deg: float, digits: int, signs: str) -> str:
    minutes = round(abs(angle_deg) * 60.0, 5)
    return f"{int(minutes // 60.0):0{digits}d}{minutes % 60.0:08.5f},{signs[angle_deg < 0.0]}"


def _sentence(body: str) -> bytes:
    return f"${body}*{reduce(xor, body.encode('ascii')):02X}\r\n".encode("ascii")


_MACHINE_FUSED, _MACHINE_GPS = "m-f", "m-g"
_UNKNOWN = "9999999.0"
_ONE_SIGMA = 1.0 - math.exp(-0.5)  # the share of a two-dimensional Gaussian within one sigma
_SEND_EVERY_S = 1.0
PLAIN_CALLSIGN = "target"
_STALE_AFTER, _ROUTE_STALE_AFTER = timedelta(seconds=10.0), timedelta(seconds=180.0)
_DRAWN_LINE = "u-d-f"
_ROUTE_EVERY_S, _ROUTE_POINTS = 60.0, 40
_SENSOR_POINT = "b-m-p-s-p-i"
_LatLon = tuple[float, float]  # degrees


@dataclass(frozen=True, slots=True)
class CotNames:
    """How target and aircraft are to be shown: types of the CoT schema, call signs, and the team of the aircraft.

    callsign: a fleet's target has its own name unless it is given another one. view_deg: horizontal and vertical
    field of view of the aircraft's sensor; None: not sent. video: its address; '': there is none.
    """

    type: str = "a-n-G"
    callsign: str = PLAIN_CALLSIGN
    own_type: str = "a-f-A-C-F"
    own_callsign: str = "sidelong"
    team: str = "Cyan"
    view_deg: tuple[float, float] | None = None
    video: str = ""


def lasting_uid(callsign: str) -> str:
    """Return the same uid at each start on this computer: the map keeps one symbol for one call sign."""
    return f"sidelong-{uuid5(NAMESPACE_DNS, f'{socket.gethostname()}/{callsign}').hex[:8]}"


def target_event(
    estimate: TargetEstimate,
    plane: LocalPlane,
    time_s: float,
    now: datetime,
    uid: str,
    names: CotNames = CotNames(),
    route: RouteProgress | None = None,
) -> bytes:
    """Return the event for the target at ``time_s`` of the vehicle's clock, which is ``now`` by the wall's."""
    error_m = confidence_ellipse(estimate.covariance[:2, :2], _ONE_SIGMA).semi_major_m
    place = plane.latitude_longitude_deg(*estimate.position_m(time_s))
    event = _event(uid, names.type, _MACHINE_FUSED, now, place, ce=f"{error_m:.1f}")
    detail = _detail(event, names.callsign, estimate.course_rad, estimate.speed_m_s)
    remarks = ElementTree.SubElement(detail, "remarks")
    remarks.text = f"sidelong: track {estimate.quality}, within {estimate.ellipse_95.semi_major_m:.1f} m with 95 %"
    if route is not None:
        remarks.text += f"; {describe(route)}"
    return _encoded(event)


def aircraft_event(
    aircraft: AircraftState,
    plane: LocalPlane,
    now: datetime,
    uid: str,
    height_above_ellipsoid_m: float | None,
    names: CotNames = CotNames(),
    looks_m: tuple[float, float, float] | None = None,
) -> bytes:
    """Return the event for the aircraft; looks_m: how far east, north and below of it its sensor looks."""
    place = plane.latitude_longitude_deg(aircraft.east_m, aircraft.north_m)
    hae = _UNKNOWN if height_above_ellipsoid_m is None else f"{height_above_ellipsoid_m:.1f}"
    event = _event(uid, names.own_type, _MACHINE_GPS, now, place, hae=hae)
    detail = _detail(event, names.own_callsign, aircraft.course_rad, aircraft.ground_speed_m_s)
    ElementTree.SubElement(detail, "__group", name=names.team, role="Team Member")
    if names.video:
        ElementTree.SubElement(detail, "__video", url=names.video)
    if looks_m is not None and names.view_deg is not None:
        east_m, north_m, down_m = looks_m
        away_m = math.hypot(east_m, north_m)
        numbers = {
            "azimuth": math.degrees(math.atan2(east_m, north_m)) % 360.0,
            "elevation": -math.degrees(math.atan2(down_m, away_m)),
            "range": math.hypot(away_m, down_m),
            "fov": names.view_deg[0],
            "vfov": names.view_deg[1],
            "roll": 0.0,
        }
        texts = {name: f"{number:.1f}" for name, number in numbers.items()}
        ElementTree.SubElement(detail, "sensor", texts, model="sidelong", type="r", version="0.6")
    return _encoded(event)


def sensor_point_event(
    place_m: tuple[float, float], plane: LocalPlane, now: datetime, uid: str, names: CotNames = CotNames()
) -> bytes:
    """Return the CoT event of where the payload looks, (east, north) m in the plane."""
    place = plane.latitude_longitude_deg(*place_m)
    event = _event(f"{uid}.SPI", _SENSOR_POINT, _MACHINE_FUSED, now, place)
    detail = ElementTree.SubElement(event, "detail")
    ElementTree.SubElement(detail, "contact", callsign=f"{names.own_callsign}.SPI")
    ElementTree.SubElement(detail, "link", uid=uid, type=names.own_type, relation="p-p")
    return _encoded(event)


def route_event(route: Route, plane: LocalPlane, now: datetime, uid: str, callsign: str) -> bytes:
    """Return the CoT event that draws a route; the caller's ``uid`` replaces an older one."""
    places = [plane.latitude_longitude_deg(*point) for point in route.outline_m(_ROUTE_POINTS).tolist()]
    event = _event(uid, _DRAWN_LINE, _MACHINE_FUSED, now, places[0], _ROUTE_STALE_AFTER)
    detail = ElementTree.SubElement(event, "detail")
    for latitude_deg, longitude_deg in places:
        ElementTree.SubElement(detail, "link", point=f"{latitude_deg:.6f},{longitude_deg:.6f}")
    ElementTree.SubElement(detail, "contact", callsign=callsign)
    return _encoded(event)


def _event(
    uid: str, kind: str, how: str, now: datetime, place: _LatLon, lasts: timedelta = _STALE_AFTER, **known_m: str
) -> ElementTree.Element:
    """Return an event at a latitude and longitude; known_m: its height above the ellipsoid (hae) and error (ce)."""
    at, stale = _utc(now), _utc(now + lasts)
    event = ElementTree.Element("event", version="2.0", uid=uid, type=kind, how=how, time=at, start=at, stale=stale)
    where = {"lat": f"{place[0]:.7f}", "lon": f"{place[1]:.7f}"}
    ElementTree.SubElement(event, "point", where | dict.fromkeys(("hae", "ce", "le"), _UNKNOWN) | known_m)
    return event


def _detail(event: ElementTree.Element, callsign: str, course_rad: float, speed_m_s: float) -> ElementTree.Element:
    detail = ElementTree.SubElement(event, "detail")
    ElementTree.SubElement(detail, "contact", callsign=callsign)
    course = f"{math.degrees(course_rad) % 360.0:.1f}"
    ElementTree.SubElement(detail, "track", course=course, speed=f"{speed_m_s:.2f}")
    return detail


def _encoded(event: ElementTree.Element) -> bytes:
    text: bytes = ElementTree.tostring(event, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _utc(at: datetime) -> str:
    return at.astimezone(UTC).replace(tzinfo=None).isoformat(timespec="milliseconds") + "Z"


class CotOutput:
    """An ``Observer`` that sends both by ``sender``. height_m returns the aircraft's ellipsoidal height if known."""

    def __init__(
        self,
        sender: Sender,
        plane: LocalPlane,
        names: CotNames = CotNames(),
        height_m: Callable[[], float | None] = lambda: None,
    ) -> None:
        self._sender, self._plane, self._names, self._height_m = sender, plane, names, height_m
        self._own_uid = f"{lasting_uid(names.own_callsign)}-{names.own_callsign}"
        self._next_s = self._route_s = -math.inf

    def show(self, snapshot: Present) -> None:
        """Send aircraft, target and sensor point each second, a route less often."""
        estimate, now_s = snapshot.estimate, time.monotonic()
        if now_s < self._next_s or snapshot.aircraft is None:
            return
        self._next_s, now = now_s + _SEND_EVERY_S, datetime.now(UTC)
        names, own, from_m = self._names, snapshot.aircraft, snapshot.from_target_m
        looks_m = None if from_m is None else (-from_m[0], -from_m[1], snapshot.height_m)
        self._sender.send(aircraft_event(own, self._plane, now, self._own_uid, self._height_m(), names, looks_m))
        if estimate is not None:
            place_m = estimate.position_m(snapshot.time_s)
            self._sender.send(sensor_point_event(place_m, self._plane, now, self._own_uid, names))
            if snapshot.target and names.callsign == PLAIN_CALLSIGN:
                names = replace(names, callsign=snapshot.target)
            uid = f"{lasting_uid(names.callsign)}-target"
            route = snapshot.route
            self._sender.send(target_event(estimate, self._plane, snapshot.time_s, now, uid, names, route))
            if route is not None and now_s >= self._route_s + _ROUTE_EVERY_S:
                self._route_s = now_s
                name = f"route of {names.callsign}"
                self._sender.send(route_event(route.route, self._plane, now, f"{uid}-route", name))

    def stop(self) -> None:
        self._sender.stop()
