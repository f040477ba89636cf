"""A simulated Viewpro gimbal camera: the ViewLink protocol over a serial line, or in its envelope over TCP."""

from __future__ import annotations

import math

import numpy as np

from sidelong.sitl.payload.device import Seen, Wire
from sidelong.sitl.settings import Quirks

_STATUS_BYTES = 41
_MODEL, _FIRMWARE = b"A40TPRO\0\0\0", b"S20240115" + bytes(11)


class SimulatedViewpro:
    """Answers each handshake with a status; its laser is off until it is switched on."""

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        self.quirks = quirks
        self.over_tcp = False  # whether its frames go in the envelope for TCP
        self.commanded_deg: tuple[float, float] | None = None
        self.aircraft_deg: tuple[float, float, float] | None = None  # roll, pitch (nose up) and yaw, as it was sent
        self._wire = Wire(quirks.damaged, rng)
        self._received = bytearray()
        self._number = 0
        self._ranging = False

    def receive(self, data: bytes, now_s: float, seen: Seen) -> list[bytes]:
        self._received += data
        answers: list[bytes] = []
        while (frame := self._next_frame()) is not None:
            answers += self._answer(frame[4], frame[5:-1], seen)
        return self._wire.carry(answers)

    def stream(self, now_s: float, seen: Seen) -> list[bytes]:
        return []

    def _next_frame(self) -> bytes | None:
        buffer = self._received
        while len(buffer) >= 6:
            size = 3 + buffer[3] % 64
            if buffer[:3] != b"\x55\xaa\xdc" or size < 6:
                del buffer[0]
                continue
            if len(buffer) < size:
                return None
            frame = bytes(buffer[:size])
            if _check(frame[3:-1]) != frame[-1]:
                del buffer[0]
                continue
            del buffer[:size]
            return frame
        return None

    def _answer(self, number: int, data: bytes, seen: Seen) -> list[bytes]:
        if number == 0x00:
            return [self._frame(0x40, self._status(seen))]
        if number == 0x01 and data[:1] == b"\xe4":
            return [self._frame(0x02, b"\xe4" + _MODEL)]
        if number == 0x01 and data[:1] == b"\xd0":
            return [self._frame(0x02, b"\xd0" + _FIRMWARE)]
        if number == 0x1C and len(data) == 2:
            laser = data[0] >> 5
            self._ranging = {2: True, 3: True, 5: False}.get(laser, self._ranging)
        if number == 0x1A and len(data) == 9 and data[0] == 0x0B:
            yaw, down = (_signed(data[at] * 256 + data[at + 1]) * 360.0 / 65536.0 for at in (1, 3))
            self.commanded_deg = (-yaw if self.quirks.yaw_mirrored else yaw), -down
        if number == 0xB1 and len(data) == 42:
            roll, down, yaw = (_signed(data[at] * 256 + data[at + 1]) * 360.0 / 65536.0 for at in (8, 10, 12))
            self.aircraft_deg = roll, -down, yaw
        return []

    def _status(self, seen: Seen) -> bytes:
        """Return the blocks T1 (22 bytes), F1 (1), B1 (6) and D1 (12)."""
        status = bytearray(_STATUS_BYTES)
        yaw = -seen.bearing_rad if self.quirks.yaw_mirrored else seen.bearing_rad
        roll = round((math.degrees(seen.lean_rad) + 90.0) * 4095.0 / 180.0)
        status[23:25] = (0x3000 | roll).to_bytes(2, "big")  # the upper four bits are the mode
        status[25:27] = _angle(yaw)
        status[27:29] = _angle(-seen.elevation_rad)
        if self._ranging and seen.range_m is not None and seen.range_m <= self.quirks.reach_m:
            count = round(seen.range_m / (self.quirks.range_unit_m or 0.1))
            status[33:35] = min(count, 65535).to_bytes(2, "big")
        return bytes(status)

    def _frame(self, number: int, data: bytes) -> bytes:
        self._number = (self._number + 1) % 4
        body = bytes((self._number * 64 + len(data) + 3, number)) + data
        frame = b"\x55\xaa\xdc" + body + bytes((_check(body),))
        if not self.over_tcp:
            return frame
        return b"\xeb\x90" + bytes((len(frame),)) + frame + bytes((sum(frame) % 256,))


def _check(data: bytes) -> int:
    check = 0
    for byte in data:
        check = check ^ byte
    return check


def _angle(angle_rad: float) -> bytes:
    turn = math.remainder(angle_rad, math.tau) / math.tau
    return (round(turn * 65536.0) % 65536).to_bytes(2, "big")


def _signed(value: int) -> int:
    return value - 65536 if value >= 32768 else value
