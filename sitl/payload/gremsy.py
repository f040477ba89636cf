"""A simulated Gremsy VIO: payload parameters and a gimbal device, both by MAVLink on a port of their own."""

from __future__ import annotations

import math

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.payload.device import Device, DeviceView
from sidelong.sitl.settings import Quirks
from sidelong.sitl.world.airframe import quaternion

_SYSTEM, _PAYLOAD, _CAMERA, _GIMBAL = 1, 26, 101, 154
_RANGE_INDEX, _PARAMETERS = 2, 28
_LASER_PERIODS_S = {0: 1.0, 1: 0.25, 2: 0.1}
_ATTITUDE = mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS
_LOCKED = 4 | 8 | 32  # roll and pitch to the horizon, yaw relative to the aircraft


class SimulatedGremsy(Device):
    """Streams the requested data, by the index of a parameter or the number of a message."""

    def __init__(self, quirks: Quirks, rng: np.random.Generator) -> None:
        super().__init__(quirks, rng)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._senders = {part: mavlink.MAVLink(None, _SYSTEM, part) for part in (_PAYLOAD, _CAMERA, _GIMBAL)}
        self._laser_s: float | None = None  # its period
        self._periods_s: dict[str, float] = {}
        self._next_s = {"range": 0.0, "angles": 0.0, "heartbeat": 0.0}

    def _answers(self, now_s: float, seen: DeviceView) -> list[bytes]:
        answers: list[bytes] = []
        data, self._received = self._received, bytearray()
        for message in self._parser.parse_buffer(data) or ():
            kind, target = message.get_type(), getattr(message, "target_component", None)
            if kind == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                if target == _PAYLOAD and round(message.param1) == _RANGE_INDEX and self.quirks.streams:
                    self._periods_s["range"] = message.param2 * 1e-6
                elif target == _GIMBAL and round(message.param1) == _ATTITUDE:
                    self._periods_s["angles"] = message.param2 * 1e-6
            elif kind == "PARAM_EXT_SET" and target == _CAMERA and message.param_id == "LRF_MODE":
                value = message.param_value
                number = (value.encode("latin-1") if isinstance(value, str) else bytes(value)).ljust(1, b"\0")[0]
                self._laser_s = _LASER_PERIODS_S.get(number)
            elif kind == "PARAM_REQUEST_READ" and target == _PAYLOAD and message.param_id == "LRF_RANGE":
                answers += self._range(seen)
            elif kind == "GIMBAL_DEVICE_SET_ATTITUDE" and target == _GIMBAL:
                w, x, y, z = message.q
                forward, right, down = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
                self.commanded_deg = math.degrees(math.atan2(right, forward)), math.degrees(-math.asin(down))
        return answers

    def _streamed(self, now_s: float, seen: DeviceView) -> list[bytes]:
        frames: list[bytes] = []
        if self._is_due("heartbeat", 1.0, now_s):
            for part, kind in ((_PAYLOAD, 0), (_CAMERA, mavlink.MAV_TYPE_CAMERA), (_GIMBAL, mavlink.MAV_TYPE_GIMBAL)):
                frames.append(self._packed(part, mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3)))
        if "range" in self._periods_s and self._is_due("range", self._periods_s["range"], now_s):
            frames += self._range(seen)
        if "angles" in self._periods_s and self._is_due("angles", self._periods_s["angles"], now_s):
            frames.append(self._angles(now_s, seen))
        return frames

    def _is_due(self, what: str, period_s: float, now_s: float) -> bool:
        if now_s < self._next_s[what] - 1e-9:
            return False
        self._next_s[what] = now_s + period_s
        return True

    def _range(self, seen: DeviceView) -> list[bytes]:
        range_m = self._echo_m(seen) if self._laser_s is not None else None
        if range_m is None:
            if self.quirks.silent_beyond:
                return []
            range_m = 0.0
        value = range_m / (self.quirks.range_unit_m or 1.0)
        message = mavlink.MAVLink_param_value_message(b"LRF_RANGE", value, 9, _PARAMETERS, _RANGE_INDEX)
        return [self._packed(_PAYLOAD, message)]

    def _angles(self, now_s: float, seen: DeviceView) -> bytes:
        pointing = list(quaternion(seen.lean_rad, seen.elevation_rad, self._signed(seen.bearing_rad)))
        message = mavlink.MAVLink_gimbal_device_attitude_status_message(
            0, 0, round(now_s * 1000.0), _LOCKED, pointing, math.nan, math.nan, math.nan, 0
        )
        return self._packed(_GIMBAL, message)

    def _packed(self, part: int, message: object) -> bytes:
        sender = self._senders[part]
        data: bytes = message.pack(sender)  # type: ignore[attr-defined]
        sender.seq = (sender.seq + 1) % 256
        return data
