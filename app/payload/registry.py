"""The payloads that have a driver: a new one is a module in this folder and a line here.

Other distributions add theirs by the entry point group ``sidelong.payloads``, each a ``PayloadKind``.
"""

from __future__ import annotations

import re

from sidelong.app.errors import InputError
from sidelong.app.network import NetworkAddress
from sidelong.app.payload.driver import DriverSettings, PayloadDriver, PayloadKind
from sidelong.app.payload.siyi import SiyiDriver
from sidelong.app.payload.topotek import TopotekDriver
from sidelong.app.payload.viewpro import ViewproDriver
from sidelong.app.plugins import with_plugins


def _gremsy(settings: DriverSettings) -> PayloadDriver:
    from sidelong.app.payload.gremsy import GremsyDriver  # noqa: PLC0415  # a configuration is read without MAVLink

    return GremsyDriver(settings)


MAVLINK = "mavlink"
"""The value of ``payload.kind`` for a payload that speaks MAVLink itself, or through the autopilot: no driver."""

_OWN = (
    PayloadKind("siyi", "SIYI gimbal cameras (ZT30, ZT6, ZR10, A8 mini)", "udp://192.168.144.25:37260", SiyiDriver),
    PayloadKind("viewpro", "Viewpro gimbal cameras (ViewLink)", "tcp://192.168.2.119:2000", ViewproDriver),
    PayloadKind("gremsy", "Gremsy payloads with a laser (VIO, Orus-L)", "udp://192.168.55.1:14566", _gremsy),
    PayloadKind("topotek", "Topotek gimbal cameras", "udp://192.168.144.108:9003", TopotekDriver),
)
PAYLOADS = with_plugins("sidelong.payloads", _OWN, ("about", "url", "make"), [MAVLINK])
KIND_NAMES = (MAVLINK, *(kind.name for kind in PAYLOADS))


def kind_by_name(name: str) -> PayloadKind:
    """Return the protocol of a name. Raises KeyError for one without a driver."""
    return {kind.name: kind for kind in PAYLOADS}[name]


_NETWORK = ("udp", "tcp")
_SERIAL = re.compile(r"serial://(/[^:]+):(\d{1,8})")
_SHORT = re.compile(r"([a-z]+)://(?:(/[^:]+)|([^:/\[\]]*))(?::(\d{1,8}))?")
_BAUD = 115_200


def checked_payload_url(url: str) -> str:
    """Return the URL. Raises ValueError that shows what one looks like."""
    if _SERIAL.fullmatch(url) is None:
        NetworkAddress.read(url, _NETWORK, ["serial:///dev/NAME:BAUD"])
    return url


def read_payload(option: str, text: str) -> tuple[str, str | None]:
    """Return kind and URL of a payload as the command line names it; the URL is None where no host is named.

    text: ``siyi://``, ``siyi://HOST``, ``siyi://HOST:PORT``, ``siyi:///dev/NAME:BAUD`` or ``mavlink``. Raises
    InputError that begins with the option.
    """
    if text in (MAVLINK, f"{MAVLINK}://"):
        return MAVLINK, None
    match = _SHORT.fullmatch(text)
    if match is not None and match[1] == MAVLINK:
        raise InputError(f"{option} {text!r:.80}: MAVLink comes by the vehicle's links; give {MAVLINK} alone.")
    if match is None or match[1] not in KIND_NAMES:
        raise InputError(
            f"{option} {text!r:.80}: give KIND://HOST[:PORT] or KIND:///dev/NAME[:BAUD]; "
            f"HOST is a name or an IPv4 address, KIND one of {', '.join(KIND_NAMES)}."
        )
    kind, device, host, number = match.groups()
    if device:
        return kind, f"serial://{device}:{number or _BAUD}"
    if not host:
        return kind, None
    scheme, _, usual_port = kind_by_name(kind).url.replace("//", "").split(":")
    try:
        return kind, checked_payload_url(f"{scheme}://{host}:{number or usual_port}")
    except ValueError as error:
        raise InputError(f"{option}: {error}.") from error


def resolved(url: str) -> str:
    """Return the URL with its host in numbers. Raises InputError for a host that is not known."""
    if _SERIAL.fullmatch(url) is not None:
        return url
    address = NetworkAddress.read(url, _NETWORK)
    host, port = address.resolved("payload.url")
    return f"{address.scheme}://{host}:{port}"
