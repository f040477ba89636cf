"""Addresses like ``udp://HOST:PORT``, and what each sender may use of an input before anything of it is decoded."""

from __future__ import annotations

import re
import socket
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

from sidelong.app.errors import InputError

_FORM = re.compile(r"([a-z]+)://(\[[0-9a-fA-F:]+\]|[^:/\[\]]+):(\d{1,5})")


@dataclass(frozen=True, slots=True)
class NetworkAddress:
    """An address as it is configured: read early, resolved before anything is connected."""

    scheme: str
    host: str
    port: int

    @staticmethod
    def read(text: str, schemes: Sequence[str], others: Sequence[str] = ()) -> NetworkAddress:
        """Return the address. Raises ValueError that shows what one looks like, and ``others`` that serve there."""
        match = _FORM.fullmatch(text)
        if match is None or match[1] not in schemes or not 0 < int(match[3]) < 65536:
            forms = " or ".join((*others, *(f"{scheme}://HOST:PORT" for scheme in schemes)))
            raise ValueError(f"{text!r:.80} is no address; give one like {forms}, with a port from 1 to 65535")
        return NetworkAddress(match[1], match[2].strip("[]"), int(match[3]))

    def resolved(self, name: str) -> tuple[str, int]:
        """Return (number of the host, port). Raises InputError that begins with ``name``."""
        try:
            return socket.gethostbyname(self.host), self.port
        except OSError as error:
            raise InputError(f"{name}: the host {self.host:.80} is not known; give its address.") from error


class Allowances:
    """A bucket for each sender, filled by ``rate_s`` a second up to ``burst``; the oldest is dropped."""

    def __init__(self, burst: float, rate_s: float, senders_max: int = 500) -> None:
        self._burst, self._rate_s, self._senders_max = burst, rate_s, senders_max
        self._left: dict[Hashable, tuple[float, float]] = {}  # what is left, and since when

    def left(self, sender: Hashable, now_s: float) -> float:
        """Return the units that a sender has left."""
        left, at_s = self._left.get(sender, (self._burst, now_s))
        return min(self._burst, left + (now_s - at_s) * self._rate_s)

    def used(self, sender: Hashable, now_s: float, amount: float = 1.0) -> bool:
        """Return whether a sender has one unit left, and take an amount from it; a deficit is paid later."""
        left = self.left(sender, now_s)
        self._left.pop(sender, None)
        self._left[sender] = (left - amount if left >= 1.0 else left, now_s)
        if len(self._left) > self._senders_max:
            del self._left[next(iter(self._left))]
        return left >= 1.0
