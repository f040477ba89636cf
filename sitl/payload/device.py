"""A simulated payload that speaks its maker's protocol: what it sees, and how it answers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np


@dataclass(frozen=True, slots=True)
class Seen:
    """What laser and gimbal measure now.

    Attributes:
        range_m: slant range; None: no echo.
        bearing_rad: measured direction of the sight, from the aircraft's nose, clockwise.
        elevation_rad: measured direction of the sight above the horizon.
        lean_rad: how far the camera's roll is off the horizon, right side down.

    """

    range_m: float | None
    bearing_rad: float
    elevation_rad: float
    lean_rad: float = 0.0


class Device(Protocol):
    """A payload at the end of a wire."""

    def receive(self, data: bytes, now_s: float, seen: Seen) -> list[bytes]:
        """Take bytes and return the answers."""
        ...

    def stream(self, now_s: float, seen: Seen) -> list[bytes]:
        """Return what is sent unasked at this time; to be called at each step."""
        ...


@dataclass(slots=True)
class Wire:
    """Bytes from a device, some of which arrive changed."""

    damaged: float
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def carry(self, frames: list[bytes]) -> list[bytes]:
        """Return the frames as they arrive."""
        return [self._changed(frame) if self.rng.random() < self.damaged else frame for frame in frames]

    def _changed(self, frame: bytes) -> bytes:
        at = int(self.rng.integers(len(frame)))
        return frame[:at] + bytes((frame[at] ^ int(self.rng.integers(1, 256)),)) + frame[at + 1 :]


def joint_angles_rad(seen: Seen) -> tuple[float, float, float]:
    """Return yaw, roll and pitch of a gimbal whose joints follow each other in this order, looking along the sight.

    With the outer joint at yaw and the middle one at roll, the inner joint's pitch p raises the sight by
    asin(cos(roll) sin(p)) and carries it sideways by atan(sin(roll) tan(p)).
    """
    pitch = math.asin(max(-1.0, min(1.0, math.sin(seen.elevation_rad) / math.cos(seen.lean_rad))))
    sideways = math.atan2(math.sin(seen.lean_rad) * math.sin(pitch), math.cos(pitch))
    return math.remainder(seen.bearing_rad - sideways, math.tau), seen.lean_rad, pitch
