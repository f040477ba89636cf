"""Viewpro gimbal cameras, by the ViewLink protocol.

Frame: ``55 AA DC``, a byte with the length (bits 0 to 5) and a frame counter (bits 6 and 7), frame id, data, XOR of
everything after the header. Numbers are big-endian. Over TCP each frame sent is wrapped in ``EB 90``, its length and
the sum of its bytes.

Sources: ArduPilot ``AP_Mount_Viewpro`` (Plane-4.6.3); the vendor's ViewLink protocol V3.4.9 as described in public
programs. Where the range is beyond 6553.5 m, V3.4.9 has a third byte that is not read here.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from functools import reduce
from operator import xor

from sidelong.app.link.framing import Framer
from sidelong.app.payload import driver
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.rotations import from_roll_pitch_yaw

_HEADER, _TCP_HEADER = b"\x55\xaa\xdc", b"\xeb\x90"
_LENGTH_BITS = 0x3F
_HANDSHAKE, _QUERY, _REPLY, _SERVO, _CAMERA, _STATUS, _AIRCRAFT = 0x00, 0x01, 0x02, 0x1A, 0x1C, 0x40, 0xB1
_FIRMWARE, _MODEL = 0xD0, 0xE4
_FOLLOW_YAW, _ABSOLUTE_ANGLES = 0x03, 0x0B
_RANGING_CONTINUOUSLY = 2 << 13
_STATUS_MIN_BYTES = 35
_ANGLE_UNIT_RAD, _ROLL_UNIT_DEG = math.tau / 65536.0, 180.0 / 4095.0
_RANGE_UNIT_M = 0.1
_PERIODS_S = {"handshake": 0.1, "identity": 1.0, "laser": 1.0, "aircraft": 0.1}
_POSITION_KNOWN = 0x0F
_ATTITUDE_AND_POSITION = 0x07


class ViewproDriver(driver.FramedDriver):
    def __init__(self, settings: driver.DriverSettings) -> None:
        framer = Framer((_HEADER,), _length, lambda frame: _xor(frame[3:]) == 0)
        super().__init__(settings, framer, _PERIODS_S, _RANGE_UNIT_M, pitch_sign=-1.0)
        self._counter = 0
        self._range_s = -math.inf

    def due(self, now_s: float) -> list[bytes]:
        """Return the requests to send now: each handshake is answered by a status frame."""
        requests: list[bytes] = []
        if self._due["identity"].is_due(now_s):
            if not self.identity.model:
                requests.append(self._frame(_QUERY, bytes((_MODEL,)) + bytes(9)))
            if not self.identity.firmware:
                requests.append(self._frame(_QUERY, bytes((_FIRMWARE,)) + bytes(9)))
        if self._due["laser"].is_due(now_s) and now_s - self._range_s > _PERIODS_S["laser"]:
            requests.append(self._frame(_CAMERA, struct.pack(">H", _RANGING_CONTINUOUSLY)))
        if not self._trips.awaits(_STATUS, now_s) and self._due["handshake"].is_due(now_s):
            self._trips.sent(_STATUS, now_s)
            requests.append(self._frame(_HANDSHAKE, b"\0"))
        return requests

    def aircraft(self, pose: driver.AircraftPose, now_s: float) -> Sequence[bytes]:
        """Return the aircraft's attitude and position for the gimbal's own stabilisation, at 10 Hz."""
        if not self._due["aircraft"].is_due(now_s):
            return ()
        course_rad = math.atan2(pose.velocity_east_m_s, pose.velocity_north_m_s)
        roll, pitch, yaw, course = map(_angle, (pose.roll_rad, -pose.pitch_rad, pose.yaw_rad, course_rad))
        place = round(pose.latitude_deg * 1e7), round(pose.longitude_deg * 1e7), round(pose.altitude_m * 1e3)
        velocity_m_s = pose.velocity_north_m_s, pose.velocity_east_m_s, -pose.velocity_up_m_s
        north, east, down = (round(each_m_s * 100.0) for each_m_s in velocity_m_s)
        angles, velocity = (roll, pitch, yaw, 0, course), (north, east, 0, down)
        known = _ATTITUDE_AND_POSITION, *angles, _POSITION_KNOWN
        return (self._frame(_AIRCRAFT, struct.pack(">B7xHHHH3xHBiiihhHh", *known, *place, *velocity)),)

    def point(self, pitch_rad: float, yaw_rad: float) -> Sequence[bytes]:
        """Return the commands that turn the gimbal, in its mode of following the aircraft's yaw."""
        commands = []
        if not self._follows:
            self._follows = True
            commands.append(self._frame(_SERVO, bytes((_FOLLOW_YAW,)) + bytes(8)))
        yaw, pitch = _angle(self._yaw_sign * yaw_rad), _angle(self._pitch_sign * pitch_rad)
        angles = struct.pack(">BHH4x", _ABSOLUTE_ANGLES, yaw, pitch)
        commands.append(self._frame(_SERVO, angles))
        return commands

    def _frame(self, frame_id: int, data: bytes) -> bytes:
        self._counter = (self._counter + 1) & 3
        frame = encode(frame_id, data, self._counter)
        return wrapped(frame) if self._settings.over_tcp else frame

    def _measured(self, frame: bytes, now_s: float) -> list[driver.Measured]:
        frame_id, data = frame[4], frame[5:-1]
        if frame_id == _REPLY and data:
            self._identify(data)
        if frame_id != _STATUS or len(data) < _STATUS_MIN_BYTES:
            return []
        time_s = self._trips.measured_s(_STATUS, now_s)
        measured: list[driver.Measured] = [self._angles(time_s, data)]
        (count,) = struct.unpack_from(">H", data, 33)
        if count:
            self._range_s, self.identity.has_laser = now_s, True
            measured.append(driver.RangeMeasured(time_s, count * self._range_unit_m))
        return measured

    def _identify(self, data: bytes) -> None:
        text = data[1:].split(b"\0")[0].decode("ascii", "replace").strip()
        if data[0] == _MODEL:
            self.identity.model = text or "Viewpro"
        elif data[0] == _FIRMWARE:
            self.identity.firmware = text or "unknown"

    def _angles(self, time_s: float, data: bytes) -> driver.AnglesMeasured:
        roll, yaw, pitch = struct.unpack_from(">Hhh", data, 23)
        roll_rad = math.radians((roll & 0x0FFF) * _ROLL_UNIT_DEG - 90.0)
        yaw_rad, pitch_rad = self._yaw_sign * yaw * _ANGLE_UNIT_RAD, self._pitch_sign * pitch * _ANGLE_UNIT_RAD
        return self._attitude(time_s, from_roll_pitch_yaw(roll_rad, pitch_rad, yaw_rad))


def encode(frame_id: int, data: bytes, counter: int = 0) -> bytes:
    """Return a frame as it goes over a serial line."""
    body = bytes(((counter & 3) << 6 | len(data) + 3, frame_id)) + data
    return _HEADER + body + bytes((_xor(body),))


def wrapped(frame: bytes) -> bytes:
    """Return a frame as it goes over TCP."""
    return _TCP_HEADER + bytes((len(frame),)) + frame + bytes((sum(frame) & 0xFF,))


def _length(buffer: bytes) -> int | None:
    if len(buffer) < 4:
        return None
    length = buffer[3] & _LENGTH_BITS
    return len(_HEADER) + length if length >= 3 else 0


def _xor(data: bytes) -> int:
    return reduce(xor, data, 0)


def _angle(angle_rad: float) -> int:
    return round(wrap_rad(angle_rad) / _ANGLE_UNIT_RAD) & 0xFFFF
