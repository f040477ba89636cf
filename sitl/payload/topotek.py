"""A simulated Topotek gimbal camera: frames of text with two hex digits of checksum."""

from __future__ import annotations

import math
import re
import struct

import numpy as np

from sidelong.sitl.payload.device import Device, DeviceView
from sidelong.sitl.settings import Quirks

_FRAME = re.compile(rb"#[Tt][Pp]([A-Z])([A-Z])([0-9A-F])([rw])([A-Z0-9]{3})")
_HEAD_BYTES = 10
_ANGLES_S, _RANGE_S = 0.05, 0.1
_SENDS_ANGLES_S = 3.0  # after a request


class SimulatedTopotek(Device):
    """Sends angles for some seconds after a request, and ranges while it is ranging."""

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        super().__init__(quirks, rng)
        self._angles_until_s = -math.inf
        self._ranging = False
        self._angles_next_s = self._range_next_s = 0.0
        self._yaw_deg = self._pitch_deg = 0.0

    def _answers(self, now_s: float, seen: DeviceView) -> list[bytes]:
        answers: list[bytes] = []
        while (found := _FRAME.search(received := bytes(self._received))) is not None:
            end = found.start() + _HEAD_BYTES + int(found[3], 16)
            body, checksum = received[found.start() : end], received[end : end + 2]
            if len(checksum) < 2:
                break
            if checksum == _checksum(body):
                del self._received[: end + 2]
                answers += self._answer(found[5], found[4], body[_HEAD_BYTES:], now_s, seen)
            else:
                del self._received[: found.start() + 1]
        del self._received[:-100]
        return answers

    def _streamed(self, now_s: float, seen: DeviceView) -> list[bytes]:
        frames = []
        if now_s <= self._angles_until_s and now_s >= self._angles_next_s - 1e-9:
            self._angles_next_s = now_s + _ANGLES_S
            frames.append(self._angles(seen))
        if self.quirks.streams and self._ranging and now_s >= self._range_next_s - 1e-9:
            self._range_next_s = now_s + _RANGE_S
            frames += self._range(seen)
        return frames

    def _answer(self, command: bytes, control: bytes, data: bytes, now_s: float, seen: DeviceView) -> list[bytes]:
        if command == b"PA2":
            return [_frame(b"G", b"r", b"PA2", b"KHP30S90")]
        if command == b"VSN":
            return [_frame(b"D", b"r", b"VSN", b"1.3.7")]
        if command == b"GIA":
            self._angles_until_s = now_s + _SENDS_ANGLES_S if data == b"01" else -math.inf
        elif command == b"LRF" and control == b"w":
            self._ranging = data in (b"01", b"03")
        elif command == b"LRF":
            return self._range(seen) if self._ranging else []
        elif command in (b"GAY", b"GIP") and len(data) == 6:
            (count,) = struct.unpack(">h", bytes.fromhex(data[:4].decode()))
            angle_deg = count / 100.0
            if command == b"GAY":
                self._yaw_deg = self._signed(angle_deg)
            else:
                self._pitch_deg = -angle_deg
            self.commanded_deg = self._yaw_deg, self._pitch_deg
        return []

    def _angles(self, seen: DeviceView) -> bytes:
        angles = (math.remainder(self._signed(seen.bearing_rad), math.tau), -seen.elevation_rad, seen.lean_rad)
        return _frame(
            b"G", b"r", b"GIA", b"".join(b"%04X" % (round(math.degrees(a) * 100.0) % 65536) for a in angles)
        )

    def _range(self, seen: DeviceView) -> list[bytes]:
        if (range_m := self._echo_m(seen)) is None:
            return [] if self.quirks.silent_beyond else [_frame(b"M", b"r", b"LRF", b"ERR")]
        return [_frame(b"M", b"r", b"LRF", b"%07.1f" % (range_m / (self.quirks.range_unit_m or 1.0)))]


def _frame(source: bytes, control: bytes, command: bytes, data: bytes) -> bytes:
    body = b"#tp" + source + b"U" + b"%X" % len(data) + control + command + data
    return body + _checksum(body)


def _checksum(body: bytes) -> bytes:
    return b"%02X" % (sum(body) % 256)
