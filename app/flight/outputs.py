"""The configured external outputs, and the configured beacon."""

from __future__ import annotations

import ssl
from collections.abc import Callable, Iterator, Mapping

from sidelong.app.config import SharingSection
from sidelong.app.link.message import Message
from sidelong.app.sharing.address import NetworkAddress
from sidelong.app.sharing.beacon import BeaconInput
from sidelong.app.sharing.contact import ContactBeacon, is_contact
from sidelong.app.sharing.cot import CotNames, CotOutput
from sidelong.app.sharing.follow import AltitudeAt, FollowTargetOutput, NmeaOutput
from sidelong.app.sharing.senders import DatagramSender, Sender, StreamSender, tls_context
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import TargetFixReading

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
    plane: LocalPlane,
    target_altitude_m: AltitudeAt,
    latest: Mapping[str, Message],
    announce: Callable[[str], None],
) -> Iterator[Output]:
    """Yield the displays, each to be stopped at the end; to be called in the running event loop.

    ``latest`` holds the vehicle's latest message of each name; the callback receives the state of the connections.
    target_altitude_m: returns the target's altitude above the sea at a place (east, north). Raises InputError as
    :func:`check_hosts` and :func:`tls_of`.
    """
    if sharing.cot is not None:
        address = NetworkAddress.read(sharing.cot, ("udp", "tcp", "tls"))
        sender: Sender
        if address.scheme == "udp":
            sender = DatagramSender(address, _COT)
        else:
            sender = StreamSender(address, tls_of(sharing), sharing.cot_server_name, announce)
        names = CotNames(
            sharing.cot_type,
            sharing.cot_callsign,
            sharing.cot_own_type,
            sharing.cot_own_callsign,
            sharing.cot_team,
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
