"""Beacon input: a cooperative target sends its own position as FOLLOW_TARGET or cursor on target (CoT) by UDP.

A beacon position is one more measurement of the target. It passes the same plausibility check as laser and camera.
Its time of measurement is the time of reception, minus the age of a CoT event. sidelong uses one beacon: the
configured one (by system id, uid or call sign), or the only one received. If it receives several beacons and none is
configured, it rejects all of them.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from xml.etree import ElementTree

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.errors import InputError
from sidelong.app.sharing.address import Address
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import BEACON_MESSAGES, Source, TargetFixReading

_FOLLOW_TARGET, _COT = BEACON_MESSAGES[:2]
_UNKNOWN_ERROR_M = 9_999_999.0
_AGE_MAX_S = 2.0
_AGE_USED_S = 0.9  # the plausibility check treats stamps that are always older as a clock offset
_DATAGRAM_MAX = 8192
_POSITION_VALID = 1


@dataclass(frozen=True, slots=True)
class BeaconReport:
    """One beacon's message.

    Attributes:
        names: system id, or uid and call sign; the configured name may match any of them.
        sigma_m: position error, 1 sigma, m; 0 where the message has none.
    """

    message: str
    names: tuple[str, ...]
    latitude_deg: float
    longitude_deg: float
    sigma_m: float
    age_s: float = 0.0


def decode(data: bytes, now: datetime) -> list[BeaconReport]:
    """Return the positions in a datagram; an empty list if it is damaged or of another kind."""
    if data.lstrip()[:1] == b"<":
        received = _cot(data, now)
        return [received] if received is not None else []
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return [
        BeaconReport(
            _FOLLOW_TARGET,
            (str(message.get_srcSystem()),),
            message.lat * 1e-7,
            message.lon * 1e-7,
            message.position_cov[0] if math.isfinite(message.position_cov[0]) else 0.0,
        )
        for message in parser.parse_buffer(data) or ()
        if message.get_type() == _FOLLOW_TARGET and message.est_capabilities & _POSITION_VALID
    ]


def _cot(data: bytes, now: datetime) -> BeaconReport | None:
    if b"<!" in data:  # no valid event needs entities
        return None
    with suppress(ElementTree.ParseError, ValueError, KeyError, UnicodeError, LookupError):
        event = ElementTree.fromstring(data)
        point, contact = event.find("point"), event.find("detail/contact")
        if event.tag != "event" or point is None:
            return None
        stamp = datetime.fromisoformat(event.attrib["time"])
        error_m = float(point.attrib.get("ce", "nan"))
        return BeaconReport(
            _COT,
            (event.attrib["uid"], contact.attrib.get("callsign", "") if contact is not None else ""),
            float(point.attrib["lat"]),
            float(point.attrib["lon"]),
            error_m if 0.0 < error_m < _UNKNOWN_ERROR_M else 0.0,
            (now - stamp.astimezone(UTC)).total_seconds(),
        )
    return None


class BeaconInput(asyncio.DatagramProtocol):
    """Forwards the readings of one beacon, and reports each reason for a rejection once.

    Args:
        plane: The local plane of the mission.
        name: The configured beacon; None: the only one received.
        sigma_m: Position error, 1 sigma, m, of a beacon that does not send its own.
        now_s: Returns the time of the vehicle's clock, s.
        put: Called with each reading.
        announce: Called with each message for the operator.
        now: Returns the time of day in UTC.
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
    ) -> None:
        self._plane, self._name, self._sigma_m = plane, name, sigma_m
        self._now_s, self._put, self._announce, self._now = now_s, put, announce, now
        self._first: str | None = None
        self._several = False
        self._announced: set[str] = set()
        self._transport: asyncio.BaseTransport | None = None

    async def listen(self, address: Address) -> None:
        """Begin to listen. Raises InputError when the address is not free or not here."""
        try:
            self._transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: self, local_addr=(address.host, address.port)
            )
        except OSError as error:
            reason = error.strerror or "it is not known"
            raise InputError(
                f"sharing.beacon: {address.host}:{address.port} cannot be listened to ({reason})."
            ) from error

    def stop(self) -> None:
        if self._transport is not None:
            self._transport.close()

    def datagram_received(self, data: bytes, addr: object) -> None:
        if len(data) <= _DATAGRAM_MAX:
            for report in decode(data, self._now()):
                self._take(report)

    def _take(self, report: BeaconReport) -> None:
        if not self._is_ours(report) or self._now_s() == -math.inf:
            return
        if not -_AGE_MAX_S <= report.age_s <= _AGE_MAX_S:
            self._announce_once(
                "the beacon's clock is off, or its messages are late, by more than 2 s: it is not used"
            )
            return
        if not (abs(report.latitude_deg) <= 90.0 and abs(report.longitude_deg) <= 180.0):
            return
        east_m, north_m = self._plane.east_north_m(report.latitude_deg, report.longitude_deg)
        self._announce_once(f"the beacon {report.names[-1] or report.names[0]} reports the target's position")
        self._put(
            TargetFixReading(
                self._now_s() - min(max(report.age_s, 0.0), _AGE_USED_S),
                east_m,
                north_m,
                report.sigma_m or self._sigma_m,
                Source(report.message, 0),
            )
        )

    def _is_ours(self, received: BeaconReport) -> bool:
        if self._name is not None:
            return self._name in received.names
        if self._first is None:
            self._first = received.names[0]
        if received.names[0] != self._first:
            self._several = True
            self._announce_once("several beacons are received: none is used; select one with sharing.beacon_name")
        return not self._several

    def _announce_once(self, text: str) -> None:
        if text not in self._announced:
            self._announced.add(text)
            self._announce(text)
