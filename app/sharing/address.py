"""Addresses like ``udp://HOST:PORT``: read early, resolved before anything is connected."""

from __future__ import annotations

import re
import socket
from dataclasses import dataclass

from sidelong.app.errors import InputError

_FORM = re.compile(r"([a-z]+)://(\[[0-9a-fA-F:]+\]|[^:/\[\]]+):(\d{1,5})")


@dataclass(frozen=True, slots=True)
class NetworkAddress:
    scheme: str
    host: str
    port: int

    @staticmethod
    def read(text: str, schemes: tuple[str, ...]) -> NetworkAddress:
        """Return the address. Raises ValueError that shows what one looks like."""
        match = _FORM.fullmatch(text)
        if match is None or match[1] not in schemes or not 0 < int(match[3]) < 65536:
            forms = " or ".join(f"{scheme}://HOST:PORT" for scheme in schemes)
            raise ValueError(f"{text!r:.80} is no address; give one like {forms}")
        return NetworkAddress(match[1], match[2].strip("[]"), int(match[3]))

    def resolved(self, name: str) -> tuple[str, int]:
        """Return (number of the host, port). Raises InputError that begins with ``name``."""
        try:
            return socket.gethostbyname(self.host), self.port
        except OSError as error:
            raise InputError(f"{name}: the host {self.host:.80} is not known.") from error
