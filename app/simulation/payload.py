"""The simulated payload: readings of laser and gimbal with noise, outliers and dropouts, as MAVLink messages."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

import numpy as np

from sidelong.app.link.message import DISTANCE_SENSOR_MAX_CM, Message
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.rotations import from_roll_pitch_yaw

PAYLOAD_COMPONENT = 154  # MAV_COMP_ID_GIMBAL
_LOCKED_IN_EARTH_FRAME = 4 | 8 | 16 | 64  # roll, pitch and yaw lock; yaw counts from north
_DISTANCE_MIN_CM = 100
_REMEMBERED = 128  # lines of sight that a late reading may be made of
_ORIENTATION_CUSTOM, _COVARIANCE_UNKNOWN, _GOOD_QUALITY = 100, 255, 90


@dataclass(frozen=True, slots=True)
class PayloadErrors:
    """Errors of the readings.

    Attributes:
        range_sigma_m: one standard deviation of the slant range.
        angle_sigma_rad: one standard deviation of yaw and pitch of the line of sight.
        yaw_bias_rad: constant error of the yaw.
        outliers: share of the ranges that are wrong by up to ``outlier_max_m``.
        outlier_max_m: greatest error of those.
        dropouts_per_s: how often the laser begins to miss.
        dropout_s: for how long it misses.
        gimbal_delay_s: how much earlier than its stamp a line of sight was measured.
        range_delay_s: the same of a range.
        has_laser: whether there is a laser.
        view_deg: field of view of a camera that tracks the target, 0 for none. Its gimbal points off the target by up
            to ``off_axis`` of the view.
        pan_limit_rad: how far the gimbal pans to each side of the nose. A target beyond is not seen.
    """

    range_sigma_m: float = 0.8
    angle_sigma_rad: float = math.radians(0.35)
    yaw_bias_rad: float = math.radians(0.4)
    outliers: float = 0.0
    outlier_max_m: float = 90.0
    dropouts_per_s: float = 0.0
    dropout_s: float = 3.0
    gimbal_delay_s: float = 0.0
    range_delay_s: float = 0.0
    has_laser: bool = True
    view_deg: float = 0.0
    off_axis: float = 0.15
    pan_limit_rad: float = math.pi


class Payload:
    """Laser and gimbal of the vehicle ``system_id``, both looking at the target."""

    def __init__(self, errors: PayloadErrors, rng: np.random.Generator, system_id: int = 1) -> None:
        self._errors, self._rng, self._system_id = errors, rng, system_id
        self._dropout_s = (0.0, 0.0)  # begin and end
        self._lines: deque[tuple[float, float, float, float]] = deque(maxlen=_REMEMBERED)

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
        errors = self._errors
        self._lines.append((time_s, east_m, north_m, up_m))
        east_m, north_m, up_m = self._line_at(time_s - errors.gimbal_delay_s)
        level_m = math.hypot(east_m, north_m)
        range_noise, yaw_noise, pitch_noise = self._rng.standard_normal(3).tolist()
        yaw_rad = math.atan2(east_m, north_m) + errors.yaw_bias_rad + errors.angle_sigma_rad * yaw_noise
        pitch_rad = math.atan2(up_m, level_m) + errors.angle_sigma_rad * pitch_noise
        pan_rad = wrap_rad(yaw_rad - heading_rad)
        if abs(pan_rad) > errors.pan_limit_rad:  # the gimbal waits at its stop
            return [self._gimbal(boot_ms, heading_rad + math.copysign(errors.pan_limit_rad, pan_rad), pitch_rad)]
        if errors.view_deg:
            return self._tracked(time_s, boot_ms, yaw_rad, pitch_rad)
        gimbal = self._gimbal(boot_ms, yaw_rad, pitch_rad)
        range_m = math.hypot(*self._line_at(time_s - errors.range_delay_s)) + errors.range_sigma_m * range_noise
        if errors.outliers and self._rng.random() < errors.outliers:
            range_m += self._rng.uniform(-errors.outlier_max_m, errors.outlier_max_m)
        range_cm = round(100.0 * range_m)
        is_in_reach = _DISTANCE_MIN_CM <= range_cm <= DISTANCE_SENSOR_MAX_CM
        if not (with_range and errors.has_laser) or self._is_dropped(time_s) or not is_in_reach:
            return [gimbal]
        laser = self._message(
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

    def _tracked(self, time_s: float, boot_ms: int, yaw_rad: float, pitch_rad: float) -> list[Message]:
        """Return a gimbal that follows the target loosely, and where the target is in its image."""
        view_deg, off = self._errors.view_deg, self._errors.off_axis
        right, down = 2.0 * off * math.sin(0.7 * time_s), 2.0 * off * math.cos(0.31 * time_s)  # of half the image
        half = math.tan(math.radians(0.5 * view_deg))
        across, below = right * half, down * half
        # Yaw and pitch whose image has the target there: the rotation of (1, across, below) into its direction.
        sine = math.hypot(1.0, across, below) / math.hypot(1.0, below) * math.sin(pitch_rad)
        own_pitch_rad = math.atan(below) + math.asin(max(-1.0, min(1.0, sine)))
        ahead = math.cos(own_pitch_rad) + below * math.sin(own_pitch_rad)
        own_yaw_rad = yaw_rad - math.atan2(across, ahead)
        view = self._message("CAMERA_FOV_STATUS", time_boot_ms=boot_ms, hfov=view_deg, vfov=view_deg)
        target = self._message(
            "CAMERA_TRACKING_IMAGE_STATUS",
            tracking_status=1,
            tracking_mode=1,
            point_x=0.5 + 0.5 * right,
            point_y=0.5 + 0.5 * down,
        )
        return [self._gimbal(boot_ms, own_yaw_rad, own_pitch_rad), view, target]

    def _gimbal(self, boot_ms: int, yaw_rad: float, pitch_rad: float) -> Message:
        return self._message(
            "GIMBAL_DEVICE_ATTITUDE_STATUS",
            time_boot_ms=boot_ms,
            q=list(from_roll_pitch_yaw(0.0, pitch_rad, yaw_rad)),
            flags=_LOCKED_IN_EARTH_FRAME,
            gimbal_device_id=0,
        )

    def _line_at(self, time_s: float) -> tuple[float, float, float]:
        """Return the way to the target (east, north, up) at a time of the last seconds."""
        if time_s >= self._lines[-1][0] - 1e-6:
            return self._lines[-1][1:]
        k = bisect_right(self._lines, (time_s + 1e-6, math.inf))
        if k == 0:
            return self._lines[0][1:]
        (before_s, *before), (after_s, *after) = self._lines[k - 1], self._lines[k]
        share = (time_s - before_s) / (after_s - before_s)
        east_m, north_m, up_m = (a + share * (b - a) for a, b in zip(before, after, strict=True))
        return east_m, north_m, up_m

    def _is_dropped(self, time_s: float) -> bool:
        rate_per_s = self._errors.dropouts_per_s
        while rate_per_s and time_s >= self._dropout_s[1]:
            begin_s = self._dropout_s[1] + float(self._rng.exponential(1.0 / rate_per_s))
            self._dropout_s = begin_s, begin_s + self._errors.dropout_s
        return self._dropout_s[0] <= time_s < self._dropout_s[1]

    def _message(self, name: str, **fields: object) -> Message:
        return Message(name, self._system_id, PAYLOAD_COMPONENT, fields, 0.0)
