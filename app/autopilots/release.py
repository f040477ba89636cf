"""Releases of an autopilot's firmware, as AUTOPILOT_VERSION reports them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

_STAGES = {0: "dev", 64: "alpha", 128: "beta", 192: "rc"}  # FIRMWARE_VERSION_TYPE; 255: official


@dataclass(frozen=True, slots=True, order=True)
class Release:
    """A firmware release.

    Attributes:
        major: First number.
        minor: Second number.
        patch: Third number.
        stage: dev, alpha, beta or rc; "" for an official release. Releases are compared without it.
        commit: First digits of the source's commit, "" where it is not reported. Releases are compared without it.
    """

    major: int
    minor: int
    patch: int = 0
    stage: str = field(default="", compare=False)
    commit: str = field(default="", compare=False)

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.patch}" + (f"-{self.stage}" if self.stage else "")

    @property
    def series(self) -> str:
        """Major and minor number, such as ``4.6``."""
        return f"{self.major}.{self.minor}"


def release_in(fields: Mapping[str, Any]) -> Release | None:
    """Return the release that the fields of an AUTOPILOT_VERSION name, None where the autopilot leaves it at 0."""
    version = int(fields["flight_sw_version"])
    if not version >> 8:
        return None
    numbers = version >> 24, version >> 16 & 0xFF, version >> 8 & 0xFF
    return Release(*numbers, _STAGES.get(version & 0xFF, ""), _commit(fields.get("flight_custom_version") or ()))


def _commit(data: Sequence[int]) -> str:
    """Return the commit: ArduPilot sends its digits as text, PX4 as a number, its lowest byte first."""
    text = bytes(data).rstrip(b"\0")
    if all(digit in b"0123456789abcdef" for digit in text):
        return text.decode()
    return bytes(reversed(data)).hex()[:8]
