"""Where the page is served, and the map under it."""

from __future__ import annotations

import ipaddress
import os
import socket
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sidelong.app.errors import InputError

if TYPE_CHECKING:
    from sidelong.app.view.background import Background

LOOPBACK = ("127.0.0.1", "localhost")
DEFAULT_PORT = 8420


@dataclass(frozen=True, slots=True)
class Address:
    """Address of the page. Any host but loopback requires a token, part of the printed URL. Port 0: any free port.

    opens_browser: whether to open a browser on this desktop.
    map: background map file. cert, key: PEM files of the server's certificate and its key; with them the page
    is served over TLS. Raises InputError for an empty host, a number that is no IPv4 address, and one file without
    the other.
    """

    host: str = LOOPBACK[0]
    port: int = DEFAULT_PORT
    cert: Path | None = None
    key: Path | None = None
    map: Background | None = None
    opens_browser: bool = False

    def __post_init__(self) -> None:
        if not self.host.strip():
            raise InputError("--view-host is empty; give an address of this machine, or leave it out for loopback.")
        if set(self.host) <= set("0123456789.") or ":" in self.host:
            try:
                ipaddress.IPv4Address(self.host)
            except ValueError as error:
                raise InputError(
                    f"--view-host: {self.host} is not an IPv4 address; give one of this machine, or 0.0.0.0 for all."
                ) from error
        if (self.cert is None) != (self.key is None):
            raise InputError("--view-cert and --view-key belong together; give both, as PEM files.")
        for path in (self.cert, self.key):
            if path is not None and not path.is_file():
                raise InputError(f"{path} is no file; give the certificate and its key as PEM files.")

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach it."""
        return self.host in LOOPBACK

    @property
    def obstacle(self) -> str:
        """Why the page cannot be served now, '' if it can."""
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((self.host, self.port))
                probe.listen()  # two may bind a port, one may listen
            except OSError as error:
                return error.strerror or str(error)
        return ""

    @property
    def scheme(self) -> str:
        return "http" if self.cert is None else "https"


def is_desktop() -> bool:
    """Return whether a person at a desktop has started the program, so that a browser can be opened."""
    has_display = sys.platform == "darwin" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return has_display and sys.stdout.isatty()


def free_port(port: int) -> int:
    """Return a port of the loopback interface if it is free, else 0, which takes any."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        try:
            probe.bind((LOOPBACK[0], port))
        except OSError:
            return 0
    return port


def page_address(
    view: bool,
    host: str,
    port: int,
    cert: Path | None,
    key: Path | None,
    map_file: Path | None,
    map_bounds: str | None,
) -> Address | None:
    """Return where a command serves its page by its options, None where it shows none. Raises InputError."""
    if not view:
        if map_file is not None and not map_file.is_file():
            raise InputError(f"--map: there is no file {map_file}.")
        if map_file is not None or map_bounds is not None:
            raise InputError("--map lies under the live map; give --view with it.")
        if cert is not None or key is not None:
            raise InputError("--view-cert and --view-key protect the live map; give --view with them.")
        return None
    if map_file is None and map_bounds is not None:
        raise InputError("--map-bounds is the extent of the picture of --map; give both.")
    if map_file is None:
        return Address(host, port, cert, key)
    from sidelong.app.view.background import background  # noqa: PLC0415  # SQLite, which few need

    return Address(host, port, cert, key, background(map_file, map_bounds))
