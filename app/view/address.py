"""Where the page is served."""

from __future__ import annotations

from dataclasses import dataclass

LOOPBACK = ("127.0.0.1", "localhost")
DEFAULT_PORT = 8420


@dataclass(frozen=True, slots=True)
class Address:
    """Anything but loopback asks for a token, which the printed address then carries. Port 0 takes a free one."""

    host: str = LOOPBACK[0]
    port: int = DEFAULT_PORT
