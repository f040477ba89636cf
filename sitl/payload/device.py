"""A simulated payload that speaks its maker's protocol: what it sees, and how it answers."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sidelong.sitl.payload.payload import Measurement, TargetGeometry
from sidelong.sitl.settings import Quirks

_LEAN = 0.05  # of the aircraft's bank, by which a stabilised camera leans in a turn


@dataclass(frozen=True, slots=True)
class DeviceView:
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


class Device(ABC):
    """A payload at the end of a wire, over which some of its bytes arrive changed.

    commanded_deg: yaw to the right and pitch, as last commanded.
    """

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        self.quirks = quirks
        self.commanded_deg: tuple[float, float] | None = None
        self._rng = rng
        self._received = bytearray()

    def receive(self, data: bytes, now_s: float, seen: DeviceView) -> list[bytes]:
        """Take bytes and return the answers, as they arrive."""
        self._received += data
        return self._carried(self._answers(now_s, seen))

    def stream(self, now_s: float, seen: DeviceView) -> list[bytes]:
        """Return what is sent unasked at this time, as it arrives; to be called at each step."""
        return self._carried(self._streamed(now_s, seen))

    @abstractmethod
    def _answers(self, now_s: float, seen: DeviceView) -> list[bytes]:
        """Remove whole requests from what was received and return the answers."""

    def _streamed(self, now_s: float, seen: DeviceView) -> list[bytes]:
        return []

    def _carried(self, frames: list[bytes]) -> list[bytes]:
        return [self._changed(frame) if self._rng.random() < self.quirks.damaged else frame for frame in frames]

    def _changed(self, frame: bytes) -> bytes:
        at = int(self._rng.integers(len(frame)))
        return frame[:at] + bytes((frame[at] ^ int(self._rng.integers(1, 256)),)) + frame[at + 1 :]

    def _next_frame(
        self, least: int, size_of: Callable[[bytes], int], is_whole: Callable[[bytes], bool]
    ) -> bytes | None:
        """Remove the next whole frame from what was received. size_of: its bytes, 0 where none begins."""
        buffer = self._received
        while len(buffer) >= least:
            size = size_of(bytes(buffer[:least]))
            if size > len(buffer):
                return None
            frame = bytes(buffer[:size])
            if size and is_whole(frame):
                del buffer[:size]
                return frame
            del buffer[0]
        return None

    def _signed(self, yaw: float) -> float:
        """Return a yaw to the right as this device counts it, or the other way round."""
        return -yaw if self.quirks.yaw_mirrored else yaw

    def _echo_m(self, seen: DeviceView) -> float | None:
        """Return the range within the laser's reach."""
        return seen.range_m if seen.range_m is not None and seen.range_m <= self.quirks.reach_m else None


class Wired(ABC):
    """What the port of a device is connected to: a simulation or a companion, which looks at the target for it.

    latency_looks: how many looks ago the laser's present range was measured.
    """

    def __init__(self, device: Device | None, latency_looks: int) -> None:
        self.device = device
        self.unplugged = False  # the device neither receives nor answers
        self._seen: DeviceView | None = None
        self._streamed: list[bytes] = []
        self._slants_m: deque[float] = deque(maxlen=latency_looks + 1)  # true ones

    @property
    @abstractmethod
    def time_s(self) -> float:
        """The device's clock."""

    def receive_device(self, data: bytes) -> list[bytes]:
        """Take bytes at the device's port and return its answers."""
        if self.device is None or self._seen is None or self.unplugged:
            return []
        return self.device.receive(data, self.time_s, self._seen)

    def take_device(self) -> list[bytes]:
        """Return what the device has sent unasked since the last call."""
        streamed, self._streamed = self._streamed, []
        return [] if self.unplugged else streamed

    def look(
        self, device: Device, sight: TargetGeometry, latest: Measurement, heading_rad: float, roll_rad: float
    ) -> None:
        """Let the device look along the sight, with the errors of the latest measurement."""
        self._slants_m.append(sight.slant_range_m)
        self._seen = DeviceView(
            None if latest.range_m is None else self._slants_m[0] + latest.range_error_m,
            sight.bearing_rad + latest.bearing_error_rad - heading_rad,
            sight.elevation_rad + latest.elevation_error_rad,
            _LEAN * roll_rad,
        )
        self._streamed += device.stream(self.time_s, self._seen)


def joint_angles_rad(seen: DeviceView) -> tuple[float, float, float]:
    """Return yaw, roll and pitch of a gimbal whose joints follow each other in this order, looking along the sight.

    With the outer joint at yaw and the middle one at roll, the inner joint's pitch p raises the sight by
    asin(cos(roll) sin(p)) and carries it sideways by atan(sin(roll) tan(p)).
    """
    pitch = math.asin(max(-1.0, min(1.0, math.sin(seen.elevation_rad) / math.cos(seen.lean_rad))))
    sideways = math.atan2(math.sin(seen.lean_rad) * math.sin(pitch), math.cos(pitch))
    return math.remainder(seen.bearing_rad - sideways, math.tau), seen.lean_rad, pitch
