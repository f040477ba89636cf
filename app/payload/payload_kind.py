"""What is known of a payload protocol before one speaks it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sidelong.app.payload.driver import DriverSettings, PayloadDriver


@dataclass(frozen=True, slots=True)
class PayloadKind:
    """A protocol.

    Attributes:
        name: the value of ``payload.kind``.
        about: what it covers, in a few words.
        url: where its devices are found as delivered.
        make: returns a driver for one connection.
    """

    name: str
    about: str
    url: str
    make: Callable[[DriverSettings], PayloadDriver]
