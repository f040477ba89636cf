"""The simulated payload: readings of laser and gimbal with noise, as MAVLink messages."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sidelong.app.link.message import DISTANCE_SENSOR_MAX_CM, Message
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.rotations import from_roll_pitch_yaw

PAYLOAD_COMPONENT = 154  # MAV_COMP_ID_GIMBAL
_SYSTEM = 1
_LOCKED_IN_EARTH_FRAME = 4 | 8 | 16 | 64  # roll, pitch and yaw lock; yaw counts from north
_DISTANCE_MIN_CM = 100
_ORIENTATION_CUSTOM, _COVARIANCE_UNKNOWN, _GOOD_QUALITY = 100, 255, 90


@dataclass(frozen=True, slots=True)
class PayloadErrors:
    """Errors of the readings.

    Attributes:
        range_sigma_m: one standard deviation of the slant range.
        angle_sigma_rad: one standard deviation of yaw and pitch of the line of sight.
        yaw_bias_rad: constant error of the yaw.
        pan_limit_rad: how far the gimbal pans to each side of the nose. A target beyond is not seen.
    """

    range_sigma_m: float = 0.8
    angle_sigma_rad: float = math.radians(0.35)
    yaw_bias_rad: float = math.radians(0.4)
    pan_limit_rad: float = math.pi


class Payload:
    """Laser and gimbal of the vehicle, both looking at the target."""

    def __init__(self, errors: PayloadErrors, rng: np.random.Generator) -> None:
        self._errors, self._rng = errors, rng

    def measure(
        self,
        time_s: float,
        boot_ms: int,
        east_m: float,
        north_m: float,
        up_m: float,
        *,
        heading_rad: float = 0.0,
        with_range: bool = True,
    ) -> list[Message]:
        """Return the readings of one moment.

        Args:
            time_s: the simulation's time.
            boot_ms: the vehicle's clock, in milliseconds.
            east_m: from the aircraft to the target.
            north_m: from the aircraft to the target.
            up_m: from the aircraft to the target, negative below.
            heading_rad: where the nose points, clockwise from north.
            with_range: whether the laser measures now.
        """
        errors, level_m = self._errors, math.hypot(east_m, north_m)
        range_noise, yaw_noise, pitch_noise = self._rng.standard_normal(3).tolist()
        yaw_rad = math.atan2(east_m, north_m) + errors.yaw_bias_rad + errors.angle_sigma_rad * yaw_noise
        pitch_rad = math.atan2(up_m, level_m) + errors.angle_sigma_rad * pitch_noise
        pan_rad = wrap_rad(yaw_rad - heading_rad)
        if abs(pan_rad) > errors.pan_limit_rad:  # the gimbal waits at its stop
            return [self.gimbal(boot_ms, heading_rad + math.copysign(errors.pan_limit_rad, pan_rad), pitch_rad)]
        range_m = math.hypot(east_m, north_m, up_m) + errors.range_sigma_m * range_noise
        return self.readings(time_s, boot_ms, yaw_rad, pitch_rad, range_m if with_range else None)

    def readings(
        self, _time_s: float, boot_ms: int, yaw_rad: float, pitch_rad: float, range_m: float | None
    ) -> list[Message]:
        """Return the messages of measured angles and, in the laser's reach, a measured range."""
        gimbal = self.gimbal(boot_ms, yaw_rad, pitch_rad)
        range_cm = 0 if range_m is None else round(100.0 * range_m)
        if not _DISTANCE_MIN_CM <= range_cm <= DISTANCE_SENSOR_MAX_CM:
            return [gimbal]
        laser = self.message(
            "DISTANCE_SENSOR",
            time_boot_ms=boot_ms,
            min_distance=_DISTANCE_MIN_CM,
            max_distance=DISTANCE_SENSOR_MAX_CM,
            current_distance=range_cm,
            id=1,
            orientation=_ORIENTATION_CUSTOM,
            covariance=_COVARIANCE_UNKNOWN,
            signal_quality=_GOOD_QUALITY,
            quaternion=[1.0, 0.0, 0.0, 0.0],
        )
        return [gimbal, laser]

    def gimbal(self, boot_ms: int, yaw_rad: float, pitch_rad: float) -> Message:
        """Return the report of the line of sight, relative to north."""
        return self.message(
            "GIMBAL_DEVICE_ATTITUDE_STATUS",
            time_boot_ms=boot_ms,
            q=list(from_roll_pitch_yaw(0.0, pitch_rad, yaw_rad)),
            flags=_LOCKED_IN_EARTH_FRAME,
            gimbal_device_id=0,
        )

    def message(self, name: str, **fields: object) -> Message:
        """Return a message of the payload."""
        return Message(name, _SYSTEM, PAYLOAD_COMPONENT, fields, 0.0)
