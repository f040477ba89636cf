"""SIYI gimbal cameras: ZT30 (with laser), ZT6, ZR10, ZR30, A8 mini, A2 mini (without).

Frame: ``55 66``, control, length of the data (u16), sequence number (u16), command, data, CRC16; all little-endian.
The CRC has the polynomial 0x1021 and begins with 0.

Sources: SIYI A8 mini user manual v1.5, section 3.3; ArduPilot ``AP_Mount_Siyi`` (Plane-4.6.3); mzahana/siyi_sdk on
GitHub. They contradict each other in the unit of the range (manual: decimetres; ArduPilot: metres). Not every
firmware sends the streams that are requested: what does not come is polled.
"""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx
from collections.abc import Sequence

from sidelong.app.link.framing import Framer
from sidelong.app.payload import driver
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.rotations import from_roll_pitch_yaw, multiply

_HEADER = b"\x55\x66"
_HEAD = struct.Struct("<2sBHHB")
_CRC_BYTES, _DATA_MAX_BYTES = 2, 64
_ACK_WANTED = 1
_FIRMWARE, _HARDWARE_ID, _CONFIGURATION, _ATTITUDE, _SET_ANGLES, _RANGE, _STREAM = 1, 2, 0x0A, 0x0D, 0x0E, 0x15, 0x25
_AIRCRAFT = 0x22
_STREAMS = {_ATTITUDE: ("angles", b"\x01\x05"), _RANGE: ("range", b"\x02\x04")}  # kind and frequency: 20, 10 Hz
_MODELS = {0x6B: "ZR10", 0x73: "A8 mini", 0x75: "A2 mini", 0x78: "ZR30", 0x7A: "ZT30", 0x83: "ZT6"}
_WITH_LASER = ("ZT30",)
_PAN_LIMITS_RAD = dict.fromkeys(("A8 mini", "ZR10"), (math.radians(-135.0), math.radians(135.0)))
_PITCH_MIN_RAD, _PITCH_MAX_RAD = math.radians(-90.0), math.radians(25.0)
_FRAMES: dict[int, driver.Frame] = {0: "vehicle", 1: "vehicle", 2: "body"}  # by motion mode: lock, follow, FPV
_UPSIDE_DOWN = 2
_RANGE_UNIT_M, _RANGE_MIN_M = 0.1, 5.0
_RANGE_NONE = 0xFFFF
_PERIODS_S = {"angles": 0.05, "range": 0.1, "identity": 1.0, "aircraft": 0.1}
_STREAMING_S = 0.5  # without a measurement for this long, they are polled


class SiyiDriver(driver.FramedDriver):
    def __init__(self, settings: driver.DriverSettings) -> None:
        framer = Framer((_HEADER,), _length, _is_intact)
        super().__init__(settings, framer, _PERIODS_S, _RANGE_UNIT_M, yaw_sign=-1.0)
        self._sequence = 0
        self._frame: driver.Frame = "vehicle"
        self._upside_down = False
        self._streamed_s: dict[int, float] = {}  # when a stream was requested, or brought a measurement

    def restart(self, now_s: float) -> None:
        super().restart(now_s)
        self._streamed_s.clear()

    def due(self, now_s: float) -> list[bytes]:
        """Return the requests to send now: streams, and polls for data without a stream."""
        requests: list[bytes] = []
        if self._due["identity"].is_due(now_s):
            if not self.identity.model:
                requests.append(self._request(now_s, _HARDWARE_ID))
            if not self.identity.firmware:
                requests.append(self._request(now_s, _FIRMWARE))
            requests.append(self._request(now_s, _CONFIGURATION))
        for command, (name, stream) in _STREAMS.items():
            if command == _RANGE and self.identity.has_laser is False:
                continue
            if command not in self._streamed_s:
                self._streamed_s[command] = now_s
                requests.append(self._request(now_s, _STREAM, stream))
                continue
            streams = now_s - self._streamed_s[command] <= _STREAMING_S
            if not streams and not self._trips.awaits(command, now_s) and self._due[name].is_due(now_s):
                requests.append(self._request(now_s, command))
        return requests

    def aircraft(self, pose: driver.AircraftPose, now_s: float) -> Sequence[bytes]:
        """Return the aircraft's attitude for the gimbal's own stabilisation, at 10 Hz."""
        if not self._due["aircraft"].is_due(now_s):
            return ()
        angles = struct.pack("<Ifff12x", round(1000.0 * now_s), pose.roll_rad, pose.pitch_rad, pose.yaw_rad)
        return (self._frame_of(_AIRCRAFT, angles),)

    def point(self, pitch_rad: float, yaw_rad: float) -> Sequence[bytes]:
        least_rad, most_rad = self.identity.pan_limits_rad or (-math.pi, math.pi)
        yaw_rad = min(max(wrap_rad(yaw_rad), least_rad), most_rad)
        pitch_rad = min(max(pitch_rad, _PITCH_MIN_RAD), _PITCH_MAX_RAD)
        angles_rad = self._yaw_sign * yaw_rad, self._pitch_sign * pitch_rad
        data = struct.pack("<hh", *(round(10.0 * math.degrees(angle_rad)) for angle_rad in angles_rad))
        return (self._frame_of(_SET_ANGLES, data),)

    def _request(self, now_s: float, command: int, data: bytes = b"") -> bytes:
        self._trips.sent(command, now_s)
        return self._frame_of(command, data)

    def _frame_of(self, command: int, data: bytes) -> bytes:
        frame = encode(command, data, self._sequence)
        self._sequence = (self._sequence + 1) & 0xFFFF
        return frame

    def _measured(self, frame: bytes, now_s: float) -> Sequence[driver.Measured | None]:
        *_, command = _HEAD.unpack_from(frame)
        data = frame[_HEAD.size : -_CRC_BYTES]
        if not data or command == _STREAM:
            return ()  # what we sent, on a line that echoes: an answer has data
        if command in _STREAMS and not self._trips.awaits(command, now_s):
            self._streamed_s[command] = now_s
        time_s = self._trips.measured_s(command, now_s)
        match command:
            case 0x0D if len(data) >= 6:
                return (self._angles(time_s, data),)
            case 0x15 if len(data) == 2:
                return (self._range(time_s, data),)
            case 0x02:
                self._take_model(data)
            case 0x01 if len(data) >= 8 and any(data[:3]):
                self.identity.firmware = f"{data[6]}.{data[5]}.{data[4]}"
            case 0x0A if len(data) >= 6:
                self._frame, self._upside_down = _FRAMES.get(data[4], "vehicle"), data[5] == _UPSIDE_DOWN
        return ()

    def _take_model(self, data: bytes) -> None:
        code = data[0]
        if code not in _MODELS:  # some firmware sends the two digits as text
            try:
                code = int(data[:2], 16)
            except ValueError:
                code = 0
        self.identity.model = _MODELS.get(code, f"unknown (hardware id {data[:2].hex(' ')})")
        self.identity.pan_limits_rad = _PAN_LIMITS_RAD.get(self.identity.model)
        self.identity.has_laser = self.identity.model in _WITH_LASER if code in _MODELS else None

    def _angles(self, time_s: float, data: bytes) -> driver.AnglesMeasured:
        yaw_rad, pitch_rad, roll_rad = (math.radians(0.1 * tenths) for tenths in struct.unpack_from("<hhh", data))
        yaw_rad, pitch_rad = self._yaw_sign * yaw_rad, self._pitch_sign * pitch_rad
        if self._upside_down:
            pitch_rad, yaw_rad = -wrap_rad(pitch_rad + math.pi), -yaw_rad
        turned = multiply(from_roll_pitch_yaw(0.0, 0.0, yaw_rad), from_roll_pitch_yaw(roll_rad, 0.0, 0.0))
        quaternion = multiply(turned, from_roll_pitch_yaw(0.0, pitch_rad, 0.0))  # yaw, roll, pitch
        return self._attitude(time_s, quaternion, self._frame)

    def _range(self, time_s: float, data: bytes) -> driver.RangeMeasured | None:
        (count,) = struct.unpack("<H", data)
        slant_range_m = count * self._range_unit_m
        if slant_range_m < _RANGE_MIN_M or count == _RANGE_NONE:
            return None
        return driver.RangeMeasured(time_s, slant_range_m)


def encode(command: int, data: bytes, sequence: int) -> bytes:
    """Return a frame that asks for an acknowledgement."""
    body = _HEAD.pack(_HEADER, _ACK_WANTED, len(data), sequence, command) + data
    return body + crc_hqx(body, 0).to_bytes(_CRC_BYTES, "little")


def _length(buffer: bytes) -> int | None:
    if len(buffer) < 5:
        return None
    data_bytes = int.from_bytes(buffer[3:5], "little")
    return _HEAD.size + data_bytes + _CRC_BYTES if data_bytes <= _DATA_MAX_BYTES else 0


def _is_intact(frame: bytes) -> bool:
    return crc_hqx(frame[:-_CRC_BYTES], 0) == int.from_bytes(frame[-_CRC_BYTES:], "little")
