"""A simulated Viewpro gimbal camera: the ViewLink protocol over a serial line, or in its envelope over TCP."""

from __future__ import annotations

import math
import struct
from functools import reduce
from operator import xor

import numpy as np

from sidelong.sitl.payload.device import Device, DeviceView
from sidelong.sitl.settings import Quirks

_STATUS_BYTES = 41
_NAMES = {b"\xe4": b"A40TPRO\0\0\0", b"\xd0": b"S20240115" + bytes(11)}  # model and firmware
_UNIT_DEG = 360.0 / 65536.0


class SimulatedViewpro(Device):
    """Answers each handshake with a status; its laser is off until it is switched on."""

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        super().__init__(quirks, rng)
        self.over_tcp = False  # whether its frames go in the envelope for TCP
        self.aircraft_deg: tuple[float, float, float] | None = None  # roll, pitch (nose up) and yaw, as it was sent
        self._number = 0
        self._ranging = False

    def _answers(self, now_s: float, seen: DeviceView) -> list[bytes]:
        answers: list[bytes] = []
        while (frame := self._next_frame(6, _size, _is_whole)) is not None:
            answers += self._answer(frame[4], frame[5:-1], seen)
        return answers

    def _answer(self, number: int, data: bytes, seen: DeviceView) -> list[bytes]:
        if number == 0x00:
            return [self._frame(0x40, self._status(seen))]
        if number == 0x01 and data[:1] in _NAMES:
            return [self._frame(0x02, data[:1] + _NAMES[data[:1]])]
        if number == 0x1C and len(data) == 2:
            laser = data[0] >> 5
            self._ranging = {2: True, 3: True, 5: False}.get(laser, self._ranging)
        if number == 0x1A and len(data) == 9 and data[0] == 0x0B:
            yaw, down = (count * _UNIT_DEG for count in struct.unpack_from(">hh", data, 1))
            self.commanded_deg = self._signed(yaw), -down
        if number == 0xB1 and len(data) == 42:
            roll, down, yaw = (count * _UNIT_DEG for count in struct.unpack_from(">hhh", data, 8))
            self.aircraft_deg = roll, -down, yaw
        return []

    def _status(self, seen: DeviceView) -> bytes:
        """Return the blocks T1 (22 bytes), F1 (1), B1 (6) and D1 (12)."""
        status = bytearray(_STATUS_BYTES)
        roll = round((math.degrees(seen.lean_rad) + 90.0) * 4095.0 / 180.0)
        status[23:25] = (0x3000 | roll).to_bytes(2, "big")  # the upper four bits are the mode
        status[25:27] = _angle(self._signed(seen.bearing_rad))
        status[27:29] = _angle(-seen.elevation_rad)
        if self._ranging and (range_m := self._echo_m(seen)) is not None:
            count = round(range_m / (self.quirks.range_unit_m or 0.1))
            status[33:35] = min(count, 65535).to_bytes(2, "big")
        return bytes(status)

    def _frame(self, number: int, data: bytes) -> bytes:
        self._number = (self._number + 1) % 4
        body = bytes((self._number * 64 + len(data) + 3, number)) + data
        frame = b"\x55\xaa\xdc" + body + bytes((_check(body),))
        if not self.over_tcp:
            return frame
        return b"\xeb\x90" + bytes((len(frame),)) + frame + bytes((sum(frame) % 256,))


def _size(head: bytes) -> int:
    size = 3 + head[3] % 64
    return size if head.startswith(b"\x55\xaa\xdc") and size >= 6 else 0


def _is_whole(frame: bytes) -> bool:
    return _check(frame[3:-1]) == frame[-1]


def _check(data: bytes) -> int:
    return reduce(xor, data, 0)


def _angle(angle_rad: float) -> bytes:
    turn = math.remainder(angle_rad, math.tau) / math.tau
    return (round(turn * 65536.0) % 65536).to_bytes(2, "big")
