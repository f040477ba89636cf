"""Where a link leads: the URLs that MAVSDK understands, checked beforehand."""

from __future__ import annotations

import re
import socket
from pathlib import Path

from sidelong.app.errors import InputError

_SCHEMES = "udpin://HOST:PORT, udpout://HOST:PORT, tcpout://HOST:PORT, tcpin://HOST:PORT, serial:///dev/NAME:BAUD"
_NETWORK_URL = re.compile(r"(udpin|udpout|tcpin|tcpout)://([^:/]+):(\d{1,9})")
_SERIAL_URL = re.compile(r"serial(?:_flowcontrol)?://(/[^:]+):\d+")
# MAVSDK's spelling until version 3.
_OLDER_URL = re.compile(r"(udp|tcp)://([^:/]*):(\d{1,9})")


def checked_form(url: str) -> None:
    """Raise InputError for a URL of another form than MAVSDK's; nothing is opened."""
    if _SERIAL_URL.fullmatch(url):
        return
    match = _NETWORK_URL.fullmatch(url)
    older = _OLDER_URL.fullmatch(url) if match is None else None
    if older is not None:
        raise InputError(f"{url!r} is an older spelling of MAVSDK's; use {_present_form(older)}.")
    if match is None:
        raise InputError(f"{url!r} is no link this can open; use one of {_SCHEMES}.")
    if not 0 < int(match[3]) < 65536:
        raise InputError(f"{url!r}: a port is a number from 1 to 65535, not {match[3]}.")


def checked_url(url: str) -> str:
    """Return the URL as MAVSDK understands it.

    Raises InputError for what it cannot open, a device that is not there, or a port in use.
    """
    checked_form(url)
    if serial := _SERIAL_URL.fullmatch(url):
        if not Path(serial[1]).exists():
            raise InputError(f"{url!r}: there is no device {serial[1]}; plug it in, or name another.")
        return url
    match = _NETWORK_URL.fullmatch(url)
    assert match is not None
    scheme, host, port = match[1], match[2], int(match[3])
    try:
        address = socket.gethostbyname(host)  # MAVSDK takes numbers only for its own end
    except OSError as error:
        raise InputError(f"{url!r}: the host {host} is not known; give its address in numbers.") from error
    if scheme.endswith("in"):
        _probe_port(url, scheme, address, port)
    return f"{scheme}://{address}:{port}"


def _present_form(older: re.Match[str]) -> str:
    """Return what replaces udp:// or tcp://: without a host or with any address it listens, except for TCP."""
    kind, host, port = older.groups()
    if kind == "tcp":
        return f"tcpout://{host or '127.0.0.1'}:{port}"
    listens = host in ("", "0.0.0.0")
    return f"udpin://0.0.0.0:{port}" if listens else f"udpin://{host}:{port} to listen there, or udpout:// to send"


def _probe_port(url: str, scheme: str, address: str, port: int) -> None:
    # A second process may bind a UDP port and silently steal the traffic of the first: check first.
    kind = socket.SOCK_DGRAM if scheme == "udpin" else socket.SOCK_STREAM
    with socket.socket(socket.AF_INET, kind) as probe:
        try:
            probe.bind((address, port))
        except OSError as error:
            raise InputError(
                f"{url!r}: port {port} cannot be opened ({error.strerror}); "
                "end the program that uses it (a ground station?) or give another port."
            ) from error
