"""Where the page is served, and the map under it."""

from __future__ import annotations

import ipaddress
import os
import socket
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sidelong.app.config import DisplaySection
from sidelong.app.errors import InputError

if TYPE_CHECKING:
    from sidelong.app.view.background import Background

LOOPBACK = ("127.0.0.1", "localhost")


@dataclass(frozen=True, slots=True)
class PageAddress:
    """Address of the page. Any host but loopback requires a token, part of the printed URL. Port 0: any free port.

    cert, key: PEM files, for TLS. Raises InputError for a host that is no IPv4 address, and one file alone.
    """

    host: str = LOOPBACK[0]
    port: int = 8420
    cert: Path | None = None
    key: Path | None = None
    map: Background | None = None
    opens_browser: bool = False

    def __post_init__(self) -> None:
        if not self.host.strip():
            raise InputError("display.host is empty; give an address of this machine, or leave it out for loopback.")
        if set(self.host) <= set("0123456789.") or ":" in self.host:
            try:
                ipaddress.IPv4Address(self.host)
            except ValueError as error:
                raise InputError(
                    f"display.host: {self.host} is not an IPv4 address; give one of this machine, or 0.0.0.0 for all."
                ) from error
        if (self.cert is None) != (self.key is None):
            raise InputError(
                "display.certificate_file and display.key_file belong together; give both, as PEM files."
            )
        for path in (self.cert, self.key):
            if path is not None and not path.is_file():
                raise InputError(f"{path} is no file; give the certificate and its key as PEM files.")

    @property
    def is_local(self) -> bool:
        return self.host in LOOPBACK

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


def page_address(view: bool, display: DisplaySection, port: int | None = None) -> PageAddress | None:
    """Return where a command serves its page, None where it shows none. Raises InputError."""
    if display.map_file is not None and not display.map_file.is_file():
        raise InputError(f"display.map_file: there is no file {display.map_file}.")
    if not view:
        return None
    under = None
    if display.map_file is not None:
        from sidelong.app.view.background import background  # noqa: PLC0415  # SQLite, which few need

        try:
            under = background(display.map_file, display.map_bounds)
        except InputError as error:
            raise InputError(f"display.map_file: {error}") from error
    port = display.port if port is None else port
    return PageAddress(display.host, port, display.certificate_file, display.key_file, under)
