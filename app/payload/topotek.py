"""Topotek gimbal cameras: frames of text.

Frame: ``#TP`` (``#tp`` where the data have no fixed length), source and destination, number of data characters as one
hex digit, ``r`` or ``w``, three letters of the command, data, and the sum of all bytes before as two hex digits.

Source: ArduPilot ``AP_Mount_Topotek`` (Plane-4.6.3). The gimbal counts pitch downwards.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from sidelong.app.link.framing import Framer
from sidelong.app.payload.driver import AnglesMeasured, DriverSettings, FramedDriver, Measured, RangeMeasured
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.rotations import from_roll_pitch_yaw

_HEADERS = (b"#TP", b"#tp")
_HEAD_BYTES, _CHECKSUM_BYTES = 10, 2
_HEX = b"0123456789ABCDEF"
_GIMBAL, _LENS, _SYSTEM = "G", "M", "D"
_ANGLES_MESSAGES = (b"GIA", b"GIC")
_ANGLE_UNIT_RAD = math.radians(0.01)
_SPEED = 99  # the greatest
_QUERY = "00"  # data of a query
_PERIODS_S = {"identity": 1.0, "angles": 1.0, "range": 0.1, "ranging": 1.0}
_PUSHED_S = 0.5  # without a range for this long, it is polled


class TopotekDriver(FramedDriver):
    def __init__(self, settings: DriverSettings) -> None:
        super().__init__(settings, Framer(_HEADERS, _length, _is_intact), _PERIODS_S, pitch_sign=-1.0)
        self._pushed_s = self._range_s = -math.inf

    def due(self, now_s: float) -> list[bytes]:
        """Return the requests to send now. Angles, and the range of most firmware, then come unasked for a while."""
        requests: list[bytes] = []
        if self._due["identity"].is_due(now_s):
            if not self.identity.model:
                requests.append(encode(_GIMBAL, "r", "PA2", _QUERY))
            self._trips.sent(b"VSN", now_s)
            requests.append(encode(_SYSTEM, "r", "VSN", _QUERY))
        if self._due["angles"].is_due(now_s):
            requests.append(encode(_GIMBAL, "w", "GIA", "01"))
        if self._due["ranging"].is_due(now_s) and now_s - self._range_s > _PERIODS_S["ranging"]:
            self._pushed_s = now_s
            requests.append(encode(_LENS, "w", "LRF", "03"))
        pushed = now_s - self._pushed_s <= _PUSHED_S
        if not pushed and not self._trips.awaits(b"LRF", now_s) and self._due["range"].is_due(now_s):
            self._trips.sent(b"LRF", now_s)
            requests.append(encode(_LENS, "r", "LRF", _QUERY))
        return requests

    def point(self, pitch_rad: float, yaw_rad: float) -> Sequence[bytes]:
        """Return the commands that turn the gimbal, in its mode of following the aircraft."""
        commands = []
        if not self._follows:
            self._follows = True
            commands.append(encode(_GIMBAL, "w", "PTZ", "07"))
        for command, angle_rad in (("GAY", self._yaw_sign * yaw_rad), ("GIP", self._pitch_sign * pitch_rad)):
            hundredths_deg = round(wrap_rad(angle_rad) / _ANGLE_UNIT_RAD) & 0xFFFF
            commands.append(encode(_GIMBAL, "w", command, f"{hundredths_deg:04X}{_SPEED:02X}", fixed=False))
        return commands

    def _measured(self, frame: bytes, now_s: float) -> Sequence[Measured | None]:
        command, data = frame[7:_HEAD_BYTES], frame[_HEAD_BYTES:-_CHECKSUM_BYTES]
        if data == _QUERY.encode():
            return ()  # what we sent, on a line that echoes
        if command == b"LRF" and not self._trips.awaits(command, now_s):
            self._pushed_s = now_s
        time_s = self._trips.measured_s(command, now_s)
        if command in _ANGLES_MESSAGES and len(data) == 12:
            return (self._angles(time_s, data),)
        if command == b"LRF":
            return (self._range(time_s, now_s, data),)
        text = data.decode("ascii", "replace").strip()
        if command == b"PA2":
            self.identity.model = text or "Topotek"
        elif command == b"VSN":
            self.identity.firmware = text
        return ()

    def _angles(self, time_s: float, data: bytes) -> AnglesMeasured | None:
        try:
            yaw, pitch, roll = struct.unpack(">hhh", bytes.fromhex(data.decode("ascii")))
        except (ValueError, struct.error):  # the latter of white space among the digits
            return None
        roll_rad, pitch_rad, yaw_rad = (
            wrap_rad(sign * count * _ANGLE_UNIT_RAD)
            for sign, count in ((1.0, roll), (self._pitch_sign, pitch), (self._yaw_sign, yaw))
        )
        return self._attitude(time_s, from_roll_pitch_yaw(roll_rad, pitch_rad, yaw_rad))

    def _range(self, time_s: float, now_s: float, data: bytes) -> RangeMeasured | None:
        whole, _, tenth = data.partition(b".")  # 12345.6, or ERR
        if not (whole.isdigit() and tenth.isdigit()):
            return None
        slant_range_m = float(data) * self._range_unit_m
        if slant_range_m <= 0.0:
            return None
        self._range_s, self.identity.has_laser = now_s, True
        return RangeMeasured(time_s, slant_range_m)


def encode(destination: str, control: str, command: str, data: str, *, fixed: bool = True) -> bytes:
    """Return a frame from the serial line (U) to a part of the camera."""
    body = f"{'#TP' if fixed else '#tp'}U{destination}{len(data):X}{control}{command}{data}".encode("ascii")
    return body + b"%02X" % (sum(body) & 0xFF)


def _length(buffer: bytes) -> int | None:
    if len(buffer) < 6:
        return None
    data_bytes = _HEX.find(buffer[5:6])
    return _HEAD_BYTES + data_bytes + _CHECKSUM_BYTES if data_bytes >= 0 else 0


def _is_intact(frame: bytes) -> bool:
    return frame[-_CHECKSUM_BYTES:] == b"%02X" % (sum(frame[:-_CHECKSUM_BYTES]) & 0xFF)
