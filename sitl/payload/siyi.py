"""A simulated SIYI ZT30, by the A8 mini manual v1.5, section 3.3 (UART / UDP control through SDK)."""

from __future__ import annotations

import math

import numpy as np

from sidelong.sitl.payload.device import Seen, Wire, joint_angles_rad
from sidelong.sitl.settings import Quirks

_STREAM_HZ = (0, 2, 4, 5, 10, 20, 50, 100)
_ANGLES, _LASER = 1, 2
_HARDWARE = b"7A1130111\0\0\0"
_FIRMWARE = bytes((5, 2, 0, 0x6E, 3, 4, 0, 0x7A, 1, 0, 0, 0x6B))
_CONFIGURATION = bytes((0, 0, 0, 0, 1, 1, 0))  # follow mode, the right way up
_RANGE_MIN_M = 5.0


class SimulatedSiyi:
    """Answers requests, and streams the requested data."""

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        self.quirks = quirks
        self.commanded_deg: tuple[float, float] | None = None  # yaw to the right and pitch, as last commanded
        self._wire = Wire(quirks.damaged, rng)
        self._received = bytearray()
        self._number = 0
        self._streams_s: dict[int, tuple[float, float]] = {}  # period and next time, by kind

    def receive(self, data: bytes, now_s: float, seen: Seen) -> list[bytes]:
        self._received += data
        answers = []
        while (request := self._next_request()) is not None:
            answers += self._answer(*request, now_s, seen)
        return self._wire.carry(answers)

    def stream(self, now_s: float, seen: Seen) -> list[bytes]:
        frames = []
        for kind, (period_s, next_s) in self._streams_s.items():
            if now_s >= next_s - 1e-9:
                self._streams_s[kind] = period_s, next_s + period_s
                frames += self._angles(seen) if kind == _ANGLES else self._laser(seen)
        return self._wire.carry(frames)

    def _next_request(self) -> tuple[int, bytes] | None:
        """Return command and data of the next whole request."""
        buffer = self._received
        while len(buffer) >= 10:
            size = 10 + buffer[3] + 256 * buffer[4]
            if buffer[:2] != b"\x55\x66" or size > 100:
                del buffer[0]
                continue
            if len(buffer) < size:
                return None
            frame = bytes(buffer[:size])
            if _crc(frame[:-2]) != frame[-2] + 256 * frame[-1]:
                del buffer[0]
                continue
            del buffer[:size]
            return frame[7], frame[8:-2]
        return None

    def _answer(self, command: int, data: bytes, now_s: float, seen: Seen) -> list[bytes]:
        if command == 0x01:
            return [self._frame(0x01, _FIRMWARE)]
        if command == 0x02:
            return [self._frame(0x02, _HARDWARE)]
        if command == 0x0A:
            return [self._frame(0x0A, _CONFIGURATION)]
        if command == 0x0D:
            return self._angles(seen)
        if command == 0x0E and len(data) == 4:
            yaw, pitch = (_signed(data[at] + 256 * data[at + 1]) / 10.0 for at in (0, 2))
            self.commanded_deg = (yaw if self.quirks.yaw_mirrored else -yaw), pitch
            return [self._frame(0x0E, b"".join(self._tenths(seen)))]
        if command == 0x15:
            return self._laser(seen)
        if command == 0x25 and len(data) == 2 and data[1] < len(_STREAM_HZ):
            self._streams_s.pop(data[0], None)
            if data[1] and self.quirks.streams:
                self._streams_s[data[0]] = 1.0 / _STREAM_HZ[data[1]], now_s
            return [self._frame(0x25, data[:1])]
        return []

    def _angles(self, seen: Seen) -> list[bytes]:
        return [self._frame(0x0D, b"".join(self._tenths(seen)) + bytes(6))]

    def _tenths(self, seen: Seen) -> list[bytes]:
        """Return yaw (to the left), pitch and roll in tenths of a degree."""
        yaw, roll, pitch = joint_angles_rad(seen)
        left = yaw if self.quirks.yaw_mirrored else -yaw
        return [(round(math.degrees(angle) * 10.0) & 0xFFFF).to_bytes(2, "little") for angle in (left, pitch, roll)]

    def _laser(self, seen: Seen) -> list[bytes]:
        quirks, count = self.quirks, 0
        if seen.range_m is not None and _RANGE_MIN_M <= seen.range_m <= quirks.reach_m:
            count = min(round(seen.range_m / (quirks.range_unit_m or 0.1)), 65535)
        elif quirks.silent_beyond:
            return []
        return [self._frame(0x15, count.to_bytes(2, "little"))]

    def _frame(self, command: int, data: bytes) -> bytes:
        """Return an answer; answers are numbered by themselves, whatever the number of the request."""
        self._number = (self._number + 1) % 65536
        frame = b"\x55\x66\x02" + len(data).to_bytes(2, "little") + self._number.to_bytes(2, "little")
        frame += bytes((command,)) + data
        return frame + _crc(frame).to_bytes(2, "little")


def _crc(data: bytes) -> int:
    """Return the CRC of the manual, bit by bit: x^16 + x^12 + x^5 + 1, from zero."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
        crc &= 0xFFFF
    return crc


def _signed(value: int) -> int:
    return value - 65536 if value >= 32768 else value
