"""A simulated SIYI ZT30, by the A8 mini manual v1.5, section 3.3 (UART / UDP control through SDK)."""

from __future__ import annotations

import math
import struct

import numpy as np

from sidelong.sitl.payload.device import Device, DeviceView, joint_angles_rad
from sidelong.sitl.settings import Quirks

_STREAM_HZ = (0, 2, 4, 5, 10, 20, 50, 100)
_ANGLES = 1
_FIXED = {  # answers that never change, by command
    0x01: bytes((5, 2, 0, 0x6E, 3, 4, 0, 0x7A, 1, 0, 0, 0x6B)),  # firmware
    0x02: b"7A1130111\0\0\0",  # hardware
    0x0A: bytes((0, 0, 0, 0, 1, 1, 0)),  # configuration: follow mode, the right way up
}
_RANGE_MIN_M = 5.0


class SimulatedSiyi(Device):
    """Answers requests, and streams the requested data."""

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        super().__init__(quirks, rng)
        self._number = 0
        self._streams_s: dict[int, tuple[float, float]] = {}  # period and next time, by kind

    def _answers(self, now_s: float, seen: DeviceView) -> list[bytes]:
        answers = []
        while (request := self._next_frame(10, _size, _is_whole)) is not None:
            answers += self._answer(request[7], request[8:-2], now_s, seen)
        return answers

    def _streamed(self, now_s: float, seen: DeviceView) -> list[bytes]:
        frames = []
        for kind, (period_s, next_s) in self._streams_s.items():
            if now_s >= next_s - 1e-9:
                self._streams_s[kind] = period_s, next_s + period_s
                frames += self._angles(seen) if kind == _ANGLES else self._laser(seen)
        return frames

    def _answer(self, command: int, data: bytes, now_s: float, seen: DeviceView) -> list[bytes]:
        if command in _FIXED:
            return [self._frame(command, _FIXED[command])]
        if command == 0x0D:
            return self._angles(seen)
        if command == 0x0E and len(data) == 4:
            yaw, pitch = struct.unpack("<hh", data)
            self.commanded_deg = -self._signed(yaw) / 10.0, pitch / 10.0
            return [self._frame(0x0E, self._tenths(seen))]
        if command == 0x15:
            return self._laser(seen)
        if command == 0x25 and len(data) == 2 and data[1] < len(_STREAM_HZ):
            self._streams_s.pop(data[0], None)
            if data[1] and self.quirks.streams:
                self._streams_s[data[0]] = 1.0 / _STREAM_HZ[data[1]], now_s
            return [self._frame(0x25, data[:1])]
        return []

    def _angles(self, seen: DeviceView) -> list[bytes]:
        return [self._frame(0x0D, self._tenths(seen) + bytes(6))]

    def _tenths(self, seen: DeviceView) -> bytes:
        """Return yaw (to the left), pitch and roll in tenths of a degree."""
        yaw, roll, pitch = joint_angles_rad(seen)
        return struct.pack("<hhh", *(round(math.degrees(a) * 10.0) for a in (-self._signed(yaw), pitch, roll)))

    def _laser(self, seen: DeviceView) -> list[bytes]:
        range_m, count = self._echo_m(seen), 0
        if range_m is not None and range_m >= _RANGE_MIN_M:
            count = min(round(range_m / (self.quirks.range_unit_m or 0.1)), 65535)
        elif self.quirks.silent_beyond:
            return []
        return [self._frame(0x15, count.to_bytes(2, "little"))]

    def _frame(self, command: int, data: bytes) -> bytes:
        """Return an answer; answers are numbered by themselves, whatever the number of the request."""
        self._number = (self._number + 1) % 65536
        frame = b"\x55\x66\x02" + len(data).to_bytes(2, "little") + self._number.to_bytes(2, "little")
        frame += bytes((command,)) + data
        return frame + _crc(frame).to_bytes(2, "little")


def _size(head: bytes) -> int:
    size = 10 + head[3] + 256 * head[4]
    return size if head.startswith(b"\x55\x66") and size <= 100 else 0


def _is_whole(frame: bytes) -> bool:
    return _crc(frame[:-2]) == frame[-2] + 256 * frame[-1]


def _crc(data: bytes) -> int:
    """Return the CRC of the manual, bit by bit: x^16 + x^12 + x^5 + 1, from zero."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
        crc &= 0xFFFF
    return crc
