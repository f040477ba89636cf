"""Simulated payloads that speak their makers' protocols: what each sees, how it answers, and its port."""

from __future__ import annotations

import contextlib
import math
import re
import socket
import struct
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import xor
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.payload.payload import Measurement, TargetGeometry
from sidelong.sitl.settings import Quirks, Settings
from sidelong.sitl.world.airframe import quaternion


@dataclass(frozen=True, slots=True)
class DeviceView:
    """What laser and gimbal measure now."""

    range_m: float | None  # slant range; None: no echo
    bearing_rad: float  # of the sight, from the aircraft's nose, clockwise
    elevation_rad: float  # of the sight, above the horizon
    lean_rad: float = 0.0  # of the camera off the horizon, right side down


_ON_TARGET_DEG = 0.5


class Device(ABC):
    """A payload at the end of a wire, over which some of its bytes arrive changed.

    commanded_deg: yaw to the right and pitch, as last commanded.
    """

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        self.quirks = quirks
        self.commanded_deg: tuple[float, float] | None = None
        self._rates_deg_s, self._turned_s = (0.0, 0.0), 0.0
        self._rng = rng
        self._received = bytearray()

    def receive(self, data: bytes, now_s: float, seen: DeviceView) -> list[bytes]:
        """Process bytes and return the answers, as they arrive."""
        self._received += data
        seen = self._steered(now_s, seen)
        answers = (self._answer(request, now_s, seen) for request in self._requests())
        return self._carried([frame for frames in answers for frame in frames])

    def stream(self, now_s: float, seen: DeviceView) -> list[bytes]:
        """Return what is sent unasked at this time, as it arrives; to be called at each step."""
        return self._carried(self._streamed(now_s, self._steered(now_s, seen)))

    def _steered(self, now_s: float, seen: DeviceView) -> DeviceView:
        """Return what it sees where it has been turned; its laser has an echo of the target alone."""
        elapsed_s, self._turned_s = now_s - self._turned_s, now_s
        if not self.quirks.steered:
            return seen
        target_deg = math.degrees(seen.bearing_rad), math.degrees(seen.elevation_rad)
        yaw_deg, pitch_deg = (
            angle + rate * elapsed_s
            for angle, rate in zip(self.commanded_deg or target_deg, self._rates_deg_s, strict=True)
        )
        self.commanded_deg = yaw_deg, pitch_deg
        off_deg = math.hypot(math.remainder(yaw_deg - target_deg[0], 360.0), pitch_deg - target_deg[1])
        range_m = seen.range_m if off_deg < _ON_TARGET_DEG else None
        return DeviceView(range_m, math.radians(yaw_deg), math.radians(pitch_deg))

    @abstractmethod
    def _answer(self, request: Any, now_s: float, seen: DeviceView) -> list[bytes]: ...

    def _streamed(self, now_s: float, seen: DeviceView) -> list[bytes]:
        return []

    def _carried(self, frames: list[bytes]) -> list[bytes]:
        for number, frame in enumerate(frames):
            if self._rng.random() < self.quirks.damaged:
                at = int(self._rng.integers(len(frame)))
                changed = bytes((frame[at] ^ int(self._rng.integers(1, 256)),))
                frames[number] = frame[:at] + changed + frame[at + 1 :]
        return frames

    @abstractmethod
    def _requests(self) -> Iterator[Any]:
        """Remove the whole requests from what was received."""

    def _signed(self, yaw: float) -> float:
        """Return a yaw to the right as this device counts it, or the other way round."""
        return -yaw if self.quirks.yaw_mirrored else yaw

    def _echo_m(self, seen: DeviceView) -> float | None:
        """Return the range within the laser's reach."""
        return seen.range_m if seen.range_m is not None and seen.range_m <= self.quirks.reach_m else None


def _whole_frames(
    buffer: bytearray, least: int, size_of: Callable[[bytes], int], is_whole: Callable[[bytes], bool]
) -> Iterator[bytes]:
    """Remove whole frames from a buffer. size_of: bytes of the frame that begins so, 0 where none does."""
    while len(buffer) >= least:
        size = size_of(bytes(buffer[:least]))
        if size > len(buffer):
            return
        frame = bytes(buffer[:size])
        if size and is_whole(frame):
            del buffer[:size]
            yield frame
        else:
            del buffer[0]


# -- SIYI

_SIYI_STREAM_HZ = (0, 2, 4, 5, 10, 20, 50, 100)
_SIYI_ANGLES = 1
_SIYI_FIXED = {  # answers that never change, by command
    0x01: bytes((5, 2, 0, 0x6E, 3, 4, 0, 0x7A, 1, 0, 0, 0x6B)),  # firmware
    0x02: b"7A1130111\0\0\0",  # hardware
    0x0A: bytes((0, 0, 0, 0, 1, 1, 0)),  # configuration: follow mode, the right way up
}
_SIYI_RANGE_MIN_M, _SIYI_RATE_DEG_S = 5.0, 90.0


class SimulatedSiyi(Device):
    """A SIYI ZT30, by the A8 mini manual v1.5, section 3.3 (UART / UDP control through SDK).

    Answers requests, and streams the requested data.
    """

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        super().__init__(quirks, rng)
        self._number = 0
        self._streams_s: dict[int, tuple[float, float]] = {}  # period and next time, by kind

    def _streamed(self, now_s: float, seen: DeviceView) -> list[bytes]:
        frames = []
        for kind, (period_s, next_s) in self._streams_s.items():
            if now_s >= next_s - 1e-9:
                self._streams_s[kind] = period_s, next_s + period_s
                frames += self._angles(seen) if kind == _SIYI_ANGLES else self._laser(seen)
        return frames

    def _answer(self, request: bytes, now_s: float, seen: DeviceView) -> list[bytes]:
        command, data = request[7], request[8:-2]
        if command in _SIYI_FIXED:
            return [self._frame(command, _SIYI_FIXED[command])]
        if command == 0x0D:
            return self._angles(seen)
        if command == 0x07 and len(data) == 2:
            yaw, pitch = struct.unpack("<bb", data)
            self._rates_deg_s = self._signed(yaw) * _SIYI_RATE_DEG_S / 100.0, pitch * _SIYI_RATE_DEG_S / 100.0
            return [self._frame(0x07, b"\x01")]
        if command == 0x0E and len(data) == 4:
            yaw, pitch = struct.unpack("<hh", data)
            self.commanded_deg = -self._signed(yaw) / 10.0, pitch / 10.0
            return [self._frame(0x0E, self._tenths(seen))]
        if command == 0x15:
            return self._laser(seen)
        if command == 0x25 and len(data) == 2 and data[1] < len(_SIYI_STREAM_HZ):
            self._streams_s.pop(data[0], None)
            if data[1] and self.quirks.streams:
                self._streams_s[data[0]] = 1.0 / _SIYI_STREAM_HZ[data[1]], now_s
            return [self._frame(0x25, data[:1])]
        return []

    def _angles(self, seen: DeviceView) -> list[bytes]:
        return [self._frame(0x0D, self._tenths(seen) + bytes(6))]

    def _tenths(self, seen: DeviceView) -> bytes:
        """Return yaw (to the left), pitch and roll in tenths of a degree."""
        yaw, roll, pitch = _joint_angles_rad(seen)
        return struct.pack("<hhh", *(round(math.degrees(a) * 10.0) for a in (-self._signed(yaw), pitch, roll)))

    def _laser(self, seen: DeviceView) -> list[bytes]:
        range_m, count = self._echo_m(seen), 0
        if range_m is not None and range_m >= _SIYI_RANGE_MIN_M:
            count = min(round(range_m / (self.quirks.range_unit_m or 0.1)), 65535)
        elif self.quirks.silent_beyond:
            return []
        return [self._frame(0x15, count.to_bytes(2, "little"))]

    def _frame(self, command: int, data: bytes) -> bytes:
        """Return an answer; answers are numbered by themselves, whatever the number of the request."""
        self._number = (self._number + 1) % 65536
        frame = b"\x55\x66\x02" + len(data).to_bytes(2, "little") + self._number.to_bytes(2, "little")
        frame += bytes((command,)) + data
        return frame + _siyi_crc(frame).to_bytes(2, "little")

    def _requests(self) -> Iterator[bytes]:
        return _whole_frames(self._received, 10, self._size, self._is_whole)

    @staticmethod
    def _size(head: bytes) -> int:
        size = 10 + head[3] + 256 * head[4]
        return size if head.startswith(b"\x55\x66") and size <= 100 else 0

    @staticmethod
    def _is_whole(frame: bytes) -> bool:
        return _siyi_crc(frame[:-2]) == frame[-2] + 256 * frame[-1]


def _siyi_crc(data: bytes) -> int:
    """Return the CRC of the manual, bit by bit: x^16 + x^12 + x^5 + 1, from zero."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
        crc &= 0xFFFF
    return crc


def _joint_angles_rad(seen: DeviceView) -> tuple[float, float, float]:
    """Return yaw, roll and pitch of a gimbal whose joints follow each other in this order, looking along the sight.

    With the outer joint at yaw and the middle one at roll, the inner joint's pitch p raises the sight by
    asin(cos(roll) sin(p)) and carries it sideways by atan(sin(roll) tan(p)).
    """
    pitch = math.asin(max(-1.0, min(1.0, math.sin(seen.elevation_rad) / math.cos(seen.lean_rad))))
    sideways = math.atan2(math.sin(seen.lean_rad) * math.sin(pitch), math.cos(pitch))
    return math.remainder(seen.bearing_rad - sideways, math.tau), seen.lean_rad, pitch


# -- Topotek

_TOPOTEK_FRAME = re.compile(rb"#[Tt][Pp]([A-Z])([A-Z])([0-9A-F])([rw])([A-Z0-9]{3})")
_TOPOTEK_HEAD_BYTES = 10
_TOPOTEK_ANGLES_S, _TOPOTEK_RANGE_S = 0.05, 0.1
_TOPOTEK_SENDS_ANGLES_S = 3.0  # after a request


class SimulatedTopotek(Device):
    """A Topotek gimbal camera: frames of text with two hex digits of checksum.

    Sends angles for some seconds after a request, and ranges while it is ranging.
    """

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        super().__init__(quirks, rng)
        self._angles_until_s = -math.inf
        self._ranging = False
        self._angles_next_s = self._range_next_s = 0.0

    def _requests(self) -> Iterator[tuple[bytes, bytes, bytes]]:
        """Remove the whole requests; yields command, r or w, and data."""
        while (match := _TOPOTEK_FRAME.search(received := bytes(self._received))) is not None:
            end = match.start() + _TOPOTEK_HEAD_BYTES + int(match[3], 16)
            body, checksum = received[match.start() : end], received[end : end + 2]
            if len(checksum) < 2:
                break
            if checksum == _topotek_checksum(body):
                del self._received[: end + 2]
                yield match[5], match[4], body[_TOPOTEK_HEAD_BYTES:]
            else:
                del self._received[: match.start() + 1]
        del self._received[:-100]

    def _streamed(self, now_s: float, seen: DeviceView) -> list[bytes]:
        frames = []
        if now_s <= self._angles_until_s and now_s >= self._angles_next_s - 1e-9:
            self._angles_next_s = now_s + _TOPOTEK_ANGLES_S
            frames.append(self._angles(seen))
        if self.quirks.streams and self._ranging and now_s >= self._range_next_s - 1e-9:
            self._range_next_s = now_s + _TOPOTEK_RANGE_S
            frames += self._range(seen)
        return frames

    def _answer(self, request: tuple[bytes, bytes, bytes], now_s: float, seen: DeviceView) -> list[bytes]:
        command, control, data = request
        if command == b"PA2":
            return [_topotek_frame(b"G", b"PA2", b"KHP30S90")]
        if command == b"VSN":
            return [_topotek_frame(b"D", b"VSN", b"1.3.7")]
        if command == b"GIA":
            self._angles_until_s = now_s + _TOPOTEK_SENDS_ANGLES_S if data == b"01" else -math.inf
        elif command == b"LRF" and control == b"w":
            self._ranging = data in (b"01", b"03")
        elif command == b"LRF":
            return self._range(seen) if self._ranging else []
        elif command in (b"GAY", b"GIP") and len(data) == 6:
            (count,) = struct.unpack(">h", bytes.fromhex(data[:4].decode()))
            yaw_deg, pitch_deg = self.commanded_deg or (0.0, 0.0)
            at_yaw = command == b"GAY"
            self.commanded_deg = (self._signed(count / 100.0), pitch_deg) if at_yaw else (yaw_deg, -count / 100.0)
        return []

    def _angles(self, seen: DeviceView) -> bytes:
        angles = (math.remainder(self._signed(seen.bearing_rad), math.tau), -seen.elevation_rad, seen.lean_rad)
        data = b"".join(b"%04X" % (round(math.degrees(angle_rad) * 100.0) % 65536) for angle_rad in angles)
        return _topotek_frame(b"G", b"GIA", data)

    def _range(self, seen: DeviceView) -> list[bytes]:
        if (range_m := self._echo_m(seen)) is None:
            return [] if self.quirks.silent_beyond else [_topotek_frame(b"M", b"LRF", b"ERR")]
        return [_topotek_frame(b"M", b"LRF", b"%07.1f" % (range_m / (self.quirks.range_unit_m or 1.0)))]


def _topotek_frame(source: bytes, command: bytes, data: bytes) -> bytes:
    body = b"#tp" + source + b"U" + b"%X" % len(data) + b"r" + command + data
    return body + _topotek_checksum(body)


def _topotek_checksum(body: bytes) -> bytes:
    return b"%02X" % (sum(body) % 256)


# -- Viewpro

_VIEWPRO_STATUS_BYTES = 41
_VIEWPRO_NAMES = {b"\xe4": b"A40TPRO\0\0\0", b"\xd0": b"S20240115" + bytes(11)}  # model and firmware
_VIEWPRO_UNIT_DEG = 360.0 / 65536.0


class SimulatedViewpro(Device):
    """A Viewpro gimbal camera: the ViewLink protocol over a serial line, or in its envelope over TCP.

    Answers each handshake with a status; its laser is off until it is switched on.
    """

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        super().__init__(quirks, rng)
        self.over_tcp = False  # whether its frames go in the envelope for TCP
        self.aircraft_deg: tuple[float, float, float] | None = None  # roll, pitch (nose up) and yaw, as it was sent
        self._number = 0
        self._ranging = False

    def _answer(self, request: bytes, now_s: float, seen: DeviceView) -> list[bytes]:
        number, data = request[4], request[5:-1]
        if number == 0x00:
            return [self._frame(0x40, self._status(seen))]
        if number == 0x01 and data[:1] in _VIEWPRO_NAMES:
            return [self._frame(0x02, data[:1] + _VIEWPRO_NAMES[data[:1]])]
        if number == 0x1C and len(data) == 2:
            laser = data[0] >> 5
            self._ranging = {2: True, 3: True, 5: False}.get(laser, self._ranging)
        if number == 0x1A and len(data) == 9 and data[0] == 0x0B:
            yaw, down = (count * _VIEWPRO_UNIT_DEG for count in struct.unpack_from(">hh", data, 1))
            self.commanded_deg = self._signed(yaw), -down
        if number == 0xB1 and len(data) == 42:
            roll, down, yaw = (count * _VIEWPRO_UNIT_DEG for count in struct.unpack_from(">hhh", data, 8))
            self.aircraft_deg = roll, -down, yaw
        return []

    def _status(self, seen: DeviceView) -> bytes:
        """Return the blocks T1 (22 bytes), F1 (1), B1 (6) and D1 (12)."""
        status = bytearray(_VIEWPRO_STATUS_BYTES)
        roll = round((math.degrees(seen.lean_rad) + 90.0) * 4095.0 / 180.0)
        status[23:25] = (0x3000 | roll).to_bytes(2, "big")  # the upper four bits are the mode
        status[25:27] = _viewpro_angle(self._signed(seen.bearing_rad))
        status[27:29] = _viewpro_angle(-seen.elevation_rad)
        if self._ranging and (range_m := self._echo_m(seen)) is not None:
            count = round(range_m / (self.quirks.range_unit_m or 0.1))
            status[33:35] = min(count, 65535).to_bytes(2, "big")
        return bytes(status)

    def _frame(self, number: int, data: bytes) -> bytes:
        self._number = (self._number + 1) % 4
        body = bytes((self._number * 64 + len(data) + 3, number)) + data
        frame = b"\x55\xaa\xdc" + body + bytes((_viewpro_check(body),))
        if not self.over_tcp:
            return frame
        return b"\xeb\x90" + bytes((len(frame),)) + frame + bytes((sum(frame) % 256,))

    def _requests(self) -> Iterator[bytes]:
        return _whole_frames(self._received, 6, self._size, self._is_whole)

    @staticmethod
    def _size(head: bytes) -> int:
        size = 3 + head[3] % 64
        return size if head.startswith(b"\x55\xaa\xdc") and size >= 6 else 0

    @staticmethod
    def _is_whole(frame: bytes) -> bool:
        return _viewpro_check(frame[3:-1]) == frame[-1]


def _viewpro_check(data: bytes) -> int:
    return reduce(xor, data, 0)


def _viewpro_angle(angle_rad: float) -> bytes:
    turn = math.remainder(angle_rad, math.tau) / math.tau
    return (round(turn * 65536.0) % 65536).to_bytes(2, "big")


# -- Gremsy

_GREMSY_SYSTEM, _PAYLOAD, _CAMERA, _GIMBAL = 1, 26, 101, 154
_RANGE_INDEX, _PARAMETERS = 2, 28
_LASER_PERIODS_S = {0: 1.0, 1: 0.25, 2: 0.1}
_ATTITUDE = mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS
_LOCKED = 4 | 8 | 32  # roll and pitch to the horizon, yaw relative to the aircraft


class SimulatedGremsy(Device):
    """A Gremsy VIO: payload parameters and a gimbal device, both by MAVLink on a port of their own.

    Streams the requested data, by the index of a parameter or the number of a message.
    """

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        super().__init__(quirks, rng)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._senders = {part: mavlink.MAVLink(None, _GREMSY_SYSTEM, part) for part in (_PAYLOAD, _CAMERA, _GIMBAL)}
        self._laser_s: float | None = None  # its period
        self._periods_s = {"heartbeat": 1.0}
        self._next_s: dict[str, float] = {}

    def _requests(self) -> Iterator[Any]:
        data, self._received = self._received, bytearray()
        yield from self._parser.parse_buffer(data) or ()

    def _answer(self, request: Any, now_s: float, seen: DeviceView) -> list[bytes]:
        kind, target = request.get_type(), getattr(request, "target_component", None)
        if kind == "COMMAND_LONG" and request.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            if target == _PAYLOAD and round(request.param1) == _RANGE_INDEX and self.quirks.streams:
                self._periods_s["range"] = request.param2 * 1e-6
            elif target == _GIMBAL and round(request.param1) == _ATTITUDE:
                self._periods_s["angles"] = request.param2 * 1e-6
        elif kind == "PARAM_EXT_SET" and target == _CAMERA and request.param_id == "LRF_MODE":
            value = request.param_value
            number = (value.encode("latin-1") if isinstance(value, str) else bytes(value)).ljust(1, b"\0")[0]
            self._laser_s = _LASER_PERIODS_S.get(number)
        elif kind == "PARAM_REQUEST_READ" and target == _PAYLOAD and request.param_id == "LRF_RANGE":
            return self._range(seen)
        elif kind == "GIMBAL_DEVICE_SET_ATTITUDE" and target == _GIMBAL:
            w, x, y, z = request.q
            forward, right, down = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
            self.commanded_deg = math.degrees(math.atan2(right, forward)), math.degrees(-math.asin(down))
        return []

    def _streamed(self, now_s: float, seen: DeviceView) -> list[bytes]:
        frames: list[bytes] = []
        if self._is_due("heartbeat", now_s):
            for part, kind in ((_PAYLOAD, 0), (_CAMERA, mavlink.MAV_TYPE_CAMERA), (_GIMBAL, mavlink.MAV_TYPE_GIMBAL)):
                frames.append(self._packed(part, mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3)))
        if self._is_due("range", now_s):
            frames += self._range(seen)
        if self._is_due("angles", now_s):
            frames.append(self._angles(now_s, seen))
        return frames

    def _is_due(self, what: str, now_s: float) -> bool:
        if what not in self._periods_s or now_s < self._next_s.get(what, 0.0) - 1e-9:
            return False
        self._next_s[what] = now_s + self._periods_s[what]
        return True

    def _range(self, seen: DeviceView) -> list[bytes]:
        range_m = self._echo_m(seen) if self._laser_s is not None else None
        if range_m is None and self.quirks.silent_beyond:
            return []
        value = (range_m or 0.0) / (self.quirks.range_unit_m or 1.0)
        message = mavlink.MAVLink_param_value_message(b"LRF_RANGE", value, 9, _PARAMETERS, _RANGE_INDEX)
        return [self._packed(_PAYLOAD, message)]

    def _angles(self, now_s: float, seen: DeviceView) -> bytes:
        pointing = list(quaternion(seen.lean_rad, seen.elevation_rad, self._signed(seen.bearing_rad)))
        message = mavlink.MAVLink_gimbal_device_attitude_status_message(
            0, 0, round(now_s * 1000.0), _LOCKED, pointing, math.nan, math.nan, math.nan, 0
        )
        return self._packed(_GIMBAL, message)

    def _packed(self, part: int, message: Any) -> bytes:
        sender = self._senders[part]
        data: bytes = message.pack(sender)
        sender.seq = (sender.seq + 1) % 256
        return data


# -- all of them

OVER_TCP = ("viewpro",)
"""Those that listen for a TCP connection; the others take datagrams."""

DEVICES: dict[str, Callable[[Quirks, np.random.Generator], Device]] = {
    "siyi": SimulatedSiyi,
    "viewpro": SimulatedViewpro,
    "gremsy": SimulatedGremsy,
    "topotek": SimulatedTopotek,
}


def device_of(settings: Settings) -> Device | None:
    """Return the device of a vehicle, None where its payload has no port of its own."""
    if not settings.device:
        return None
    kind = settings.device.partition("@")[0]
    return DEVICES[kind](settings.quirks, np.random.default_rng(settings.seed))


_LEAN = 0.05  # of the aircraft's bank, by which a stabilised camera leans in a turn


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
        """Time on the device's clock."""

    def receive_device(self, data: bytes) -> list[bytes]:
        """Process bytes at the device's port and return its answers."""
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


Address = tuple[str, int]

_DATAGRAM_MAX = 4096


class DevicePort:
    """The port of a device: by UDP it answers its latest client and streams to it, by TCP it serves only that one."""

    def __init__(self, kind: str, wired: Wired, address: Address) -> None:
        self._wired = wired
        self._peer: Address | None = None
        self._client: socket.socket | None = None  # by TCP
        self._over_tcp = kind.partition("@")[0] in OVER_TCP
        if self._over_tcp:
            self._socket = socket.create_server(address)
        else:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.bind(address)
        self._socket.setblocking(False)

    @property
    def sockets(self) -> list[socket.socket]:
        """Return the sockets that ``receive`` reads, to wait for them."""
        return [self._socket] if self._client is None else [self._socket, self._client]

    def send(self) -> None:
        """Send what the device has to send by now."""
        self._send(self._wired.take_device())

    def receive(self) -> None:
        """Take what has arrived, and send the device's replies."""
        with contextlib.suppress(BlockingIOError):
            if self._over_tcp:
                self._receive_tcp()
            while not self._over_tcp:
                with contextlib.suppress(ConnectionError):  # the client has gone
                    data, self._peer = self._socket.recvfrom(_DATAGRAM_MAX)
                    self._send(self._wired.receive_device(data))

    def _receive_tcp(self) -> None:
        with contextlib.suppress(BlockingIOError):
            client, _ = self._socket.accept()
            self._drop()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client
        if self._client is not None:
            data = b""
            with contextlib.suppress(ConnectionError):
                data = self._client.recv(_DATAGRAM_MAX)
            if data:
                self._send(self._wired.receive_device(data))
            else:
                self._drop()

    def close(self) -> None:
        self._drop()
        self._socket.close()

    def _send(self, frames: Sequence[bytes]) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            if self._client is not None:
                self._client.sendall(b"".join(frames))
        for frame in frames:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                if self._peer is not None:
                    self._socket.sendto(frame, self._peer)

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
