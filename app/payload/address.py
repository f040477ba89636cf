"""Where a payload is: ``udp://HOST:PORT``, ``tcp://HOST:PORT`` or ``serial:///dev/NAME:BAUD``, and short forms."""

from __future__ import annotations

import re

from sidelong.app.errors import InputError
from sidelong.app.network import NetworkAddress
from sidelong.app.payload.registry import KIND_NAMES, MAVLINK, kind_by_name

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
    """Return kind and URL of a payload as the command line names it.

    Args:
        option: the option, for the error.
        text: ``siyi://``, ``siyi://HOST``, ``siyi://HOST:PORT``, ``siyi:///dev/NAME:BAUD`` or ``mavlink``.

    Returns:
        The kind; the URL, None where no host or device is named.

    Raises:
        InputError: the text has another form, or there is no such kind.
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
