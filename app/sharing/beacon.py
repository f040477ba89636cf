"""Beacon input: a cooperative target sends its own position by UDP, or the vehicle's receiver passes on a contact.

Forms: FOLLOW_TARGET and GLOBAL_POSITION_INT of MAVLink, cursor on target (CoT) as XML or TAK protobuf, NMEA 0183. A
position counts as measured when it is received, minus the age of a CoT event. Of several beacons only the configured
one is used (by system id, uid, call sign or address); none, if none is configured.
"""

from __future__ import annotations

import asyncio
import math
import socket
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import reduce
from operator import xor
from typing import Any
from xml.etree import ElementTree

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.errors import InputError, missing_package
from sidelong.app.network import Allowances, NetworkAddress
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import BEACON_MESSAGES, Source, TargetFixReading

_FOLLOW_TARGET, _COT = BEACON_MESSAGES[:2]
_GLOBAL_POSITION, _NMEA = BEACON_MESSAGES[-2:]
_UNKNOWN_ERROR_M = 9_999_999.0
_AGE_MAX_S = 2.0
_AGE_USED_S = 0.9  # the plausibility check treats stamps that are always older as a clock offset
_SILENT_S = 15.0  # after which another beacon is no longer received
_POSITION_VALID = 1
_TAK_XML, _TAK_PROTOBUF = b"\xbf\x00\xbf", b"\xbf\x01\xbf"  # TAK protocol, mesh form
# What is decoded, at most: of a datagram, of one sender and of all. A datagram costs time even if it is short.
_DATAGRAM_MAX_BYTES, _DATAGRAM_COST_BYTES = 8192, 200
_SENDER_BYTES_S, _ALL_BYTES_S = 32 << 10, 64 << 10
_SENDERS_MAX = 256
_UNREAD_MAX = 10  # datagrams without a position before this is announced


@dataclass(frozen=True, slots=True)
class BeaconReport:
    """names: system id, uid and call sign, or address. sigma_m: position error, 1 sigma; 0 where there is none."""

    message: str
    names: tuple[str, ...]
    latitude_deg: float
    longitude_deg: float
    sigma_m: float = 0.0
    age_s: float = 0.0


def decode(data: bytes, now: datetime, sender: str = "") -> list[BeaconReport]:
    """Return the positions in a datagram, none if it is damaged. Raises InputError if takproto is missing."""
    if data.startswith(_TAK_PROTOBUF):
        return list(_tak_protobuf(data, now))
    data = data.removeprefix(_TAK_XML).lstrip()
    with suppress(ElementTree.ParseError, ValueError, KeyError, LookupError):
        if data[:1] == b"<":
            return list(_cot(data.decode(), now))
        if data[:1] == b"$":
            return list(_nmea(data.decode("ascii"), sender))[:1]  # RMC and GGA have the same position
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        return list(filter(None, map(_of_mavlink, parser.parse_buffer(data) or ())))
    return []


def _of_mavlink(message: Any) -> BeaconReport | None:
    kind = message.get_type()
    if kind not in (_FOLLOW_TARGET, _GLOBAL_POSITION) or not (message.lat or message.lon):
        return None
    if kind == _FOLLOW_TARGET and not message.est_capabilities & _POSITION_VALID:
        return None
    sigma_m = message.position_cov[0] if kind == _FOLLOW_TARGET and math.isfinite(message.position_cov[0]) else 0.0
    return BeaconReport(kind, (str(message.get_srcSystem()),), message.lat * 1e-7, message.lon * 1e-7, sigma_m)


def _cot(text: str, now: datetime) -> Iterator[BeaconReport]:
    """Yield the position of an event in XML; entities, which no valid event needs, are not expanded."""
    event = ElementTree.fromstring(text) if "<!" not in text else None
    point = None if event is None or event.tag != "event" else event.find("point")
    if event is None or point is None:
        return
    contact, about = event.find("detail/contact"), point.attrib
    callsign = contact.attrib.get("callsign", "") if contact is not None else ""
    age_s = (now - datetime.fromisoformat(event.attrib["time"]).astimezone(UTC)).total_seconds()
    kind, names = (event.attrib["type"], event.attrib.get("how", "")), (event.attrib["uid"], callsign)
    yield from _event(kind, names, float(about["lat"]), float(about["lon"]), float(about.get("ce", "nan")), age_s)


def _tak_protobuf(data: bytes, now: datetime) -> Iterator[BeaconReport]:
    try:
        from takproto import parse_proto  # noqa: PLC0415  # an extra
    except ImportError as error:
        raise missing_package("a beacon that sends TAK protobuf", "takproto", "let it send XML") from error
    try:
        event = parse_proto(bytearray(data)).cotEvent
    except Exception:  # protobuf's DecodeError, which is no ValueError in all versions
        return
    names, age_s = (event.uid, event.detail.contact.callsign), now.timestamp() - 1e-3 * event.sendTime
    yield from _event((event.type, event.how), names, event.lat, event.lon, event.ce, age_s)


def _event(
    kind: tuple[str, str], names: tuple[str, str], lat: float, lon: float, error_m: float, age_s: float
) -> Iterator[BeaconReport]:
    """Yield an event's position, unless its type and how are those of a chat, ping, drawing or mark by hand."""
    if kind[0].startswith("a-") and not kind[1].startswith("h-"):
        yield BeaconReport(_COT, names, lat, lon, error_m if 0.0 < error_m < _UNKNOWN_ERROR_M else 0.0, age_s)


def _nmea(text: str, sender: str) -> Iterator[BeaconReport]:
    """Yield the positions of RMC and GGA sentences with a fix; their only name is the sender's address."""
    for line in text.split():
        body, _, checksum = line[1:].partition("*")
        words = body.split(",")
        first, state, no_fix = {"RMC": (3, 2, "V"), "GGA": (2, 6, "0")}.get(words[0][2:], (0, 0, ""))
        valid = first and words[state] not in ("", no_fix)
        if valid and int(checksum, 16) == reduce(xor, body.encode("ascii")):
            latitude, north, longitude, east = words[first : first + 4]
            latitude_deg = (int(latitude[:2]) + float(latitude[2:]) / 60.0) * (-1.0 if north == "S" else 1.0)
            longitude_deg = (int(longitude[:3]) + float(longitude[3:]) / 60.0) * (-1.0 if east == "W" else 1.0)
            yield BeaconReport(_NMEA, (sender,), latitude_deg, longitude_deg)


def _join(own: socket.socket, group: str) -> None:
    """Join a multicast group on each network interface. Raises OSError if none can be."""
    refused, joined = OSError("there is no network interface"), 0
    for index, _ in socket.if_nameindex():
        request = struct.pack("4s4si", socket.inet_aton(group), socket.inet_aton("0.0.0.0"), index)  # ip_mreqn
        try:
            own.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
            joined += 1
        except OSError as error:
            refused = error
    if not joined:
        raise refused


class BeaconInput(asyncio.DatagramProtocol):
    """Forwards the readings of one beacon by ``put``, and reports each reason for a rejection once.

    name: None for the only one received. sigma_m: position error, 1 sigma, where the beacon sends none. Times: now_s
    of the vehicle's clock, now in UTC, clock_s of a clock that is never set.
    """

    def __init__(
        self,
        plane: LocalPlane,
        name: str | None,
        sigma_m: float,
        now_s: Callable[[], float],
        put: Callable[[TargetFixReading], object],
        announce: Callable[[str], object],
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._plane, self._name, self._sigma_m, self._clock_s = plane, name, sigma_m, clock_s
        self._now_s, self._put, self._announce, self._now = now_s, put, announce, now
        self._of_sender = Allowances(_SENDER_BYTES_S, _SENDER_BYTES_S, _SENDERS_MAX)
        self._of_all = Allowances(_ALL_BYTES_S, _ALL_BYTES_S)
        self._received_s: dict[str, float] = {}
        self._several = False
        self._unread: int | None = 0  # datagrams so far; None once a position was among them
        self._announced: set[str] = set()
        self._transport: asyncio.BaseTransport | None = None

    async def listen(self, address: NetworkAddress) -> None:
        """Begin to listen. Raises InputError for an address that is not free or here, or a group not joined."""
        own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        own.setblocking(False)
        try:
            host = socket.gethostbyname(address.host)
            multicast = 224 <= int(host.partition(".")[0]) < 240
            if multicast:
                own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # other programs listen to it, too
            own.bind((host, address.port))
            if multicast:
                _join(own, host)
            self._transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(lambda: self, sock=own)
        except OSError as error:
            own.close()
            where, reason = f"{address.host}:{address.port}", error.strerror or "it is not known"
            raise InputError(f"sharing.beacon: {where} cannot be listened to ({reason}).") from error

    def stop(self) -> None:
        if self._transport is not None:
            self._transport.close()

    def datagram_received(self, data: bytes, addr: object) -> None:
        """Decode a datagram; drop what is too large or too frequent, announce once what cannot be read."""
        sender = str(addr[0]) if isinstance(addr, tuple) else ""
        cost, clock_s = len(data) + _DATAGRAM_COST_BYTES, self._clock_s()
        allowed = self._of_sender.used(sender, clock_s, cost) and self._of_all.used("", clock_s, cost)
        if len(data) > _DATAGRAM_MAX_BYTES or not allowed:
            self._announce_once(
                f"more than {_SENDER_BYTES_S >> 10} KiB/s of one sender, or datagrams of more than "
                f"{_DATAGRAM_MAX_BYTES >> 10} KiB, arrive at the beacon's port: they are dropped"
            )
            return
        try:
            reports = decode(data, self._now(), sender)
        except InputError as error:
            self._announce_once(str(error))
            return
        if reports:
            self._unread = None
        elif self._unread is not None:
            self._unread += 1
            if self._unread == _UNREAD_MAX:
                self._announce_once(
                    f"datagrams arrive at the beacon's port from {sender}, none with a position that is read: let it "
                    "send FOLLOW_TARGET, GLOBAL_POSITION_INT, cursor on target (XML, TAK protobuf) or NMEA (RMC, GGA)"
                )
        for report in reports:
            self._take(report)

    def _take(self, report: BeaconReport) -> None:
        if not self._is_ours(report) or self._now_s() == -math.inf:
            return
        if not -_AGE_MAX_S <= report.age_s <= _AGE_MAX_S:
            self._announce_once("the beacon's clock is off, or its messages come late, by over 2 s: it is not used")
            return
        if not (abs(report.latitude_deg) <= 90.0 and abs(report.longitude_deg) <= 180.0):
            return
        east_m, north_m = self._plane.east_north_m(report.latitude_deg, report.longitude_deg)
        self._announce_once(f"the beacon {report.names[-1] or report.names[0]} reports the target's position")
        measured_s = self._now_s() - min(max(report.age_s, 0.0), _AGE_USED_S)
        sigma_m = report.sigma_m or self._sigma_m
        self._put(TargetFixReading(measured_s, east_m, north_m, sigma_m, Source(report.message, 0)))

    def _is_ours(self, received: BeaconReport) -> bool:
        if self._name is not None:
            return self._name in received.names
        name, now_s = received.names[0], self._clock_s()
        self._received_s = {k: at_s for k, at_s in self._received_s.items() if now_s - at_s <= _SILENT_S}
        if name in self._received_s or len(self._received_s) < _SENDERS_MAX:
            self._received_s[name] = now_s
        several = len(self._received_s) > 1
        if several != self._several:
            self._several = several
            self._announce(
                "several beacons are received: none is used; select one with sharing.beacon_name"
                if several
                else f"only the beacon {received.names[-1] or name} is still received: it is used"
            )
        return not several

    def _announce_once(self, text: str) -> None:
        if text not in self._announced:
            self._announced.add(text)
            self._announce(text)


_ADSB, _AIS = "ADSB_VEHICLE", "AIS_VESSEL"
_ADSB_COORDINATES_VALID, _AIS_ACCURATE = 1, 1
_CONTACT_SIGMA_M, _AIS_ACCURATE_SIGMA_M = 15.0, 5.0
_REPEATED_S = 0.9  # a report that is no newer than this repeats the last one: ages are whole seconds


class ContactBeacon:
    """Forwards the positions of one contact of the vehicle's own ADS-B or AIS receiver, each of them once.

    name: ``adsb:ICAO`` (six hexadecimal digits) or ``ais:MMSI`` (nine digits).
    """

    def __init__(
        self,
        name: str,
        plane: LocalPlane,
        now_s: Callable[[], float],
        put: Callable[[TargetFixReading], object],
        announce: Callable[[str], object],
    ) -> None:
        kind, _, number = name.lower().partition(":")
        of_kind = (_ADSB, "ICAO_address", 16) if kind == "adsb" else (_AIS, "MMSI", 10)
        self._name, (self._message, self._id_field, base) = name, of_kind
        self._id = int(number, base)
        self._plane, self._now_s, self._put, self._announce = plane, now_s, put, announce
        self._measured_s = -math.inf

    def on_message(self, name: str, fields: Mapping[str, Any]) -> None:
        """Take the position of the chosen AIS or ADS-B contact; another, old, repeated or invalid one is ignored."""
        if name != self._message or self._now_s() == -math.inf or int(fields[self._id_field]) != self._id:
            return
        if abs(fields["lat"]) > 900_000_000 or abs(fields["lon"]) > 1_800_000_000:
            return
        if self._message == _ADSB and not int(fields["flags"]) & _ADSB_COORDINATES_VALID:
            return
        age_s = float(fields["tslc"])
        measured_s = self._now_s() - age_s
        if measured_s - self._measured_s <= _REPEATED_S or age_s > _AGE_MAX_S:
            return
        if self._measured_s == -math.inf:
            self._announce(f"the contact {self._name} is received: it is used as the beacon")
        self._measured_s = measured_s
        east_m, north_m = self._plane.east_north_m(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
        accurate = self._message == _AIS and int(fields["flags"]) & _AIS_ACCURATE
        sigma_m = _AIS_ACCURATE_SIGMA_M if accurate else _CONTACT_SIGMA_M
        self._put(TargetFixReading(measured_s, east_m, north_m, sigma_m, Source(self._message, 0)))
