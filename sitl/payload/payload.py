"""Laser and gimbal of the simulated vehicle: they look at the true target, the noise comes on top."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.settings import GimbalFrame, PayloadSettings, RangeMessage
from sidelong.sitl.world.airframe import quaternion

PERIOD_S = 0.1
PAYLOAD_MESSAGES = ("DISTANCE_SENSOR", "RANGEFINDER", "GIMBAL_DEVICE_ATTITUDE_STATUS", "HEARTBEAT")
_RANGE_MIN_M = 1.0
_RANGE_MAX_M = 655.0  # DISTANCE_SENSOR counts centimetres in 16 bits
_OUTLIER_M = (15.0, 90.0)
_DROPOUT_S = (0.5, 8.0)
_SENSOR_ID = 1
_GOOD_QUALITY, _OUTLIER_QUALITY = 90, 35
_LOCKED = mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
_FLAGS = {
    GimbalFrame.EARTH: _LOCKED
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME,
    GimbalFrame.VEHICLE: _LOCKED | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME,
    GimbalFrame.UNNAMED: _LOCKED,
}


@dataclass(frozen=True, slots=True)
class TargetGeometry:
    """The true line from the laser to the target: bearing and elevation (negative looks down).

    clear: no hill is in between.
    """

    slant_range_m: float
    bearing_rad: float
    elevation_rad: float
    clear: bool = True

    @staticmethod
    def between(
        craft_m: tuple[float, float, float], target_m: tuple[float, float, float], clear: bool = True
    ) -> TargetGeometry:
        """Return the geometry of (east, north, up) m; ``clear``: no hill stands between."""
        east_m, north_m, up_m = (target - craft for target, craft in zip(target_m, craft_m, strict=True))
        level_m = math.hypot(east_m, north_m)
        return TargetGeometry(
            math.hypot(level_m, up_m), math.atan2(east_m, north_m), math.atan2(up_m, level_m), clear
        )


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the payload measures at one moment: nothing while a hill hides the target."""

    messages: list[Any]
    laser_valid: bool  # there is a range
    laser_outlier: bool  # and it is wrong
    range_m: float | None = None
    range_error_m: float = 0.0
    bearing_error_rad: float = 0.0
    elevation_error_rad: float = 0.0


class SimulatedPayload:
    """Measures at the requested times. Each kind of noise has its own random stream."""

    def __init__(self, settings: PayloadSettings, seed: np.random.SeedSequence) -> None:
        self._settings = settings
        self._sigma_rad, self._yaw_bias_rad, self._pan_limit_rad = map(
            math.radians, (settings.gimbal_sigma_deg, settings.gimbal_yaw_bias_deg, settings.pan_limit_deg)
        )
        self._range_rng, self._outlier_rng, self._gimbal_rng, self._dropout_rng = (
            np.random.default_rng(child) for child in seed.spawn(4)
        )
        self._dropout_begin_s, self._dropout_end_s = self._next_dropout(0.0)

    def measure(self, time_s: float, boot_ms: int, sight: TargetGeometry, heading_rad: float) -> Measurement:
        """Return what is measured along a sight; heading_rad: the aircraft's, for a yaw that is relative to it."""
        settings = self._settings
        while time_s >= self._dropout_end_s:
            self._dropout_begin_s, self._dropout_end_s = self._next_dropout(self._dropout_end_s)
        dropped = time_s >= self._dropout_begin_s
        range_m = sight.slant_range_m + settings.range_sigma_m * float(self._range_rng.standard_normal())
        chance, size, sign = self._outlier_rng.random(3)
        outlier = chance < settings.outlier_fraction
        if outlier:
            size_m = _OUTLIER_M[0] + size * (_OUTLIER_M[1] - _OUTLIER_M[0])
            range_m = max(_RANGE_MIN_M, range_m + math.copysign(size_m, sign - 0.5))
        valid = not dropped and _RANGE_MIN_M <= range_m <= _RANGE_MAX_M
        yaw_noise, pitch_noise = (float(noise) for noise in self._gimbal_rng.standard_normal(2))
        bearing_error_rad = self._yaw_bias_rad + self._sigma_rad * yaw_noise
        elevation_error_rad = self._sigma_rad * pitch_noise
        if not sight.clear:
            return Measurement([], False, False)
        yaw_rad, pitch_rad = sight.bearing_rad + bearing_error_rad, sight.elevation_rad + elevation_error_rad
        pan_rad = math.remainder(yaw_rad - heading_rad, math.tau)
        if abs(pan_rad) > self._pan_limit_rad:  # the gimbal waits at its stop, and the laser hits something else
            yaw_rad, valid = heading_rad + math.copysign(self._pan_limit_rad, pan_rad), False
        messages = [self._gimbal_message(boot_ms, pitch_rad, yaw_rad, heading_rad)]
        if valid:
            messages.insert(0, self._range_message(boot_ms, range_m, outlier))
        errors = range_m - sight.slant_range_m, bearing_error_rad, elevation_error_rad
        return Measurement(messages, valid, valid and outlier, range_m if valid else None, *errors)

    def _next_dropout(self, after_s: float) -> tuple[float, float]:
        fraction = self._settings.dropout_fraction
        length_s = float(self._dropout_rng.uniform(*_DROPOUT_S))
        if fraction <= 0.0:
            return math.inf, math.inf
        mean_gap_s = 0.5 * sum(_DROPOUT_S) * (1.0 - fraction) / fraction
        begin_s = after_s + float(self._dropout_rng.exponential(mean_gap_s))
        return begin_s, begin_s + length_s

    def _range_message(self, boot_ms: int, range_m: float, outlier: bool) -> Any:
        if self._settings.range_message == RangeMessage.RANGEFINDER:
            return mavlink.MAVLink_rangefinder_message(range_m, 0.0)
        counts_cm = (round(length_m * 100.0) for length_m in (_RANGE_MIN_M, _RANGE_MAX_M, range_m))
        kind = mavlink.MAV_DISTANCE_SENSOR_LASER, _SENSOR_ID, mavlink.MAV_SENSOR_ROTATION_CUSTOM
        quality = _OUTLIER_QUALITY if outlier else _GOOD_QUALITY
        return mavlink.MAVLink_distance_sensor_message(
            boot_ms, *counts_cm, *kind, 255, 0.02, 0.02, [1.0, 0.0, 0.0, 0.0], quality
        )

    def _gimbal_message(self, boot_ms: int, pitch_rad: float, yaw_rad: float, heading_rad: float) -> Any:
        settings = self._settings
        if settings.gimbal_frame != GimbalFrame.EARTH:
            yaw_rad -= heading_rad
        pointing = list(quaternion(0.0, pitch_rad, yaw_rad))
        return mavlink.MAVLink_gimbal_device_attitude_status_message(
            0, 0, boot_ms, _FLAGS[settings.gimbal_frame], pointing, *(math.nan,) * 3, 0
        )

    @staticmethod
    def heartbeat() -> Any:
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GIMBAL, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )
