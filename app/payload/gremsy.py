"""Gremsy payloads with a laser (VIO, Orus-L): MAVLink on a port of their own.

The range is the payload parameter LRF_RANGE of component 26 (MAV_COMP_ID_USER2), sent as PARAM_VALUE or DEBUG at the
interval that SET_MESSAGE_INTERVAL asks for by the parameter's index. The gimbal is a MAVLink gimbal device.

Source: github.com/Gremsy/PayloadSdk (payloadSdkInterface.h and .cpp, vio_sdk.h).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.frames import FrameSplitter
from sidelong.app.link.telemetry import gimbal_frame
from sidelong.app.payload.driver import AnglesMeasured, DriverSettings, FramedDriver, Measured, RangeMeasured
from sidelong.estimators.rotations import from_roll_pitch_yaw

_OWN_COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER3
_PAYLOAD = mavlink.MAV_COMP_ID_USER2
_CAMERAS = range(mavlink.MAV_COMP_ID_CAMERA, mavlink.MAV_COMP_ID_CAMERA6 + 1)
_GIMBALS = (mavlink.MAV_COMP_ID_GIMBAL, *range(mavlink.MAV_COMP_ID_GIMBAL2, mavlink.MAV_COMP_ID_GIMBAL6 + 1))
_RANGE_NAME, _RANGE_INDEX = "LRF_RANGE", 2
_LASER_MODE, _LASER_10_HZ = "LRF_MODE", 2
_RANGE_PERIOD_S, _ANGLES_PERIOD_S = 0.1, 0.05
_PERIODS_S = {"heartbeat": 1.0, "ask": 1.0, "poll": 0.1}
_STREAMING_S = 0.5  # without a range for this long, it is polled
_RANGE_MAX_M = 30_000.0


class GremsyDriver(FramedDriver):
    def __init__(self, settings: DriverSettings) -> None:
        super().__init__(settings, FrameSplitter(), _PERIODS_S)
        self._encoder = mavlink.MAVLink(None, 1, _OWN_COMPONENT)
        self._decoder = mavlink.MAVLink(None)
        self._camera, self._gimbal, self._system = mavlink.MAV_COMP_ID_CAMERA2, mavlink.MAV_COMP_ID_GIMBAL, 1
        self._range_s = self._angles_s = self._streamed_s = -math.inf

    def due(self, now_s: float) -> list[bytes]:
        """Return the requests to send now: streams, laser, and polls of a range that is not streamed."""
        messages: list[Any] = []
        if self._due["heartbeat"].is_due(now_s):
            messages.append(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3
                )
            )
        if self._due["ask"].is_due(now_s):
            if now_s - self._streamed_s > _STREAMING_S:
                messages.append(self._interval(_PAYLOAD, _RANGE_INDEX, _RANGE_PERIOD_S))
            if now_s - self._range_s > _PERIODS_S["ask"]:
                messages.append(self._laser_on())
            if now_s - self._angles_s > _STREAMING_S:
                angles_id = mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS
                messages.append(self._interval(self._gimbal, angles_id, _ANGLES_PERIOD_S))
        streams = now_s - self._streamed_s <= _STREAMING_S
        if not streams and not self._trips.awaits(_RANGE_NAME, now_s) and self._due["poll"].is_due(now_s):
            self._trips.sent(_RANGE_NAME, now_s)
            name = _RANGE_NAME.encode()
            messages.append(mavlink.MAVLink_param_request_read_message(self._system, _PAYLOAD, name, _RANGE_INDEX))
        return [self._packed(message) for message in messages]

    def point(self, pitch_rad: float, yaw_rad: float) -> Sequence[bytes]:
        flags = (
            mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK
            | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
            | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
        )
        quaternion = list(from_roll_pitch_yaw(0.0, pitch_rad, yaw_rad))
        rates = (math.nan, math.nan, math.nan)
        message = mavlink.MAVLink_gimbal_device_set_attitude_message(
            self._system, self._gimbal, flags, quaternion, *rates
        )
        return (self._packed(message),)

    def _interval(self, component: int, number: int, period_s: float) -> Any:
        return mavlink.MAVLink_command_long_message(
            self._system, component, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, 1e6 * period_s, 0, 0, 0, 0, 1
        )

    def _laser_on(self) -> Any:
        value = struct.pack("<I", _LASER_10_HZ).ljust(128, b"\0")
        return mavlink.MAVLink_param_ext_set_message(
            self._system, self._camera, _LASER_MODE.encode(), value, mavlink.MAV_PARAM_EXT_TYPE_UINT32
        )

    def _packed(self, message: Any) -> bytes:
        data: bytes = message.pack(self._encoder)
        self._encoder.seq = (self._encoder.seq + 1) % 256
        return data

    def _measured(self, frame: bytes, now_s: float) -> Sequence[Measured | None]:
        try:
            message = self._decoder.decode(bytearray(frame))
        except mavlink.MAVError:
            return ()  # not what this dialect knows by that number
        component = message.get_srcComponent()
        match message.get_type():
            case "PARAM_VALUE" if component == _PAYLOAD and message.param_id == _RANGE_NAME:
                return (self._range(float(message.param_value), now_s),)
            case "DEBUG" if component == _PAYLOAD and message.ind == _RANGE_INDEX:
                return (self._range(float(message.value), now_s),)
            case "GIMBAL_DEVICE_ATTITUDE_STATUS" if component in _GIMBALS:
                return (self._angles(message, now_s),)
            case "CAMERA_INFORMATION":
                self.identity.model = bytes(message.model_name).split(b"\0")[0].decode("ascii", "replace").strip()
            case "HEARTBEAT":
                self._meet(message.get_srcSystem(), component)
        return ()

    def _meet(self, system: int, component: int) -> None:
        """Take the addresses of the payload's parts from their heartbeats."""
        if component == _PAYLOAD:
            self._system = system
        elif component in _CAMERAS:
            self._camera = component
        elif component in _GIMBALS:
            self._gimbal = component
        self.identity.model = self.identity.model or "Gremsy"

    def _range(self, value_m: float, now_s: float) -> RangeMeasured | None:
        if not self._trips.awaits(_RANGE_NAME, now_s):
            self._streamed_s = now_s
        time_s = self._trips.measured_s(_RANGE_NAME, now_s)
        slant_range_m = value_m * self._range_unit_m
        if not 0.0 < slant_range_m <= _RANGE_MAX_M:
            return None
        self._range_s, self.identity.has_laser = now_s, True
        return RangeMeasured(time_s, slant_range_m)

    def _angles(self, message: Any, now_s: float) -> AnglesMeasured | None:
        w, x, y, z = message.q
        if not abs(w * w + x * x + y * y + z * z - 1.0) < 0.1:  # so that NaN is refused, too
            return None
        self._angles_s = now_s
        if self._settings.flip_yaw:
            x, z = -x, -z
        if self._settings.flip_pitch:
            x, y = -x, -y
        return self._attitude(
            now_s - 0.5 * (self.round_trip_s or 0.0), (w, x, y, z), gimbal_frame(int(message.flags))
        )
