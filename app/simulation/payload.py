"""The simulated payload: readings of laser and gimbal with noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.rotations import from_roll_pitch_yaw
from sidelong.estimators.sensing.readings import GimbalReading, RangeReading, Reading, Source

PAYLOAD_COMPONENT = 154  # MAV_COMP_ID_GIMBAL
RANGE_MIN_M, RANGE_MAX_M = 1.0, 655.35  # as a DISTANCE_SENSOR of one metre and more states them
_GIMBAL = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", PAYLOAD_COMPONENT)
_LASER = Source("DISTANCE_SENSOR", PAYLOAD_COMPONENT, 1, 100)  # of custom orientation
_QUALITY = 0.9


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
    ) -> list[Reading]:
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
    ) -> list[Reading]:
        """Return measured angles and, in the laser's reach, a measured range."""
        gimbal = self.gimbal(boot_ms, yaw_rad, pitch_rad)
        if range_m is None or not RANGE_MIN_M <= range_m <= RANGE_MAX_M:
            return [gimbal]
        stamp_s, level = boot_ms * 1e-3, (1.0, 0.0, 0.0, 0.0)
        return [gimbal, RangeReading(stamp_s, range_m, _LASER, None, _QUALITY, RANGE_MIN_M, RANGE_MAX_M, level)]

    def gimbal(self, boot_ms: int, yaw_rad: float, pitch_rad: float) -> Reading:
        """Return the line of sight, relative to north."""
        return GimbalReading(boot_ms * 1e-3, from_roll_pitch_yaw(0.0, pitch_rad, yaw_rad), "earth", _GIMBAL)
