"""A simulated payload with faults: outliers, dropouts, delays, and a camera in place of the laser."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

import numpy as np

from sidelong.app.link.message import DISTANCE_SENSOR_MAX_CM, Message
from sidelong.app.simulation.target import PAYLOAD_COMPONENT, Payload, PayloadErrors
from sidelong.estimators.rotations import from_roll_pitch_yaw

_SYSTEM = 1
_LOCKED_IN_EARTH_FRAME = 4 | 8 | 16 | 64  # roll, pitch and yaw lock; yaw counts from north
_DISTANCE_MIN_CM = 100
_ORIENTATION_CUSTOM, _COVARIANCE_UNKNOWN, _GOOD_QUALITY = 100, 255, 90
_REMEMBERED = 128  # lines of sight that a late reading may be made of


@dataclass(frozen=True, slots=True)
class PayloadFaults(PayloadErrors):
    """Errors of the readings, and what else is wrong with them.

    Attributes:
        outliers: share of the ranges that are wrong by up to ``outlier_max_m``.
        outlier_max_m: greatest error of those.
        dropouts_per_s: how often the laser begins to miss.
        dropout_s: for how long it misses.
        gimbal_delay_s: how much earlier than its stamp a line of sight was measured.
        range_delay_s: the same of a range.
        has_laser: whether there is a laser.
        view_deg: field of view of a camera that tracks the target, 0 for none. Its gimbal points off the target by up
            to ``off_axis`` of the view.
    """

    outliers: float = 0.0
    outlier_max_m: float = 90.0
    dropouts_per_s: float = 0.0
    dropout_s: float = 3.0
    gimbal_delay_s: float = 0.0
    range_delay_s: float = 0.0
    has_laser: bool = True
    view_deg: float = 0.0
    off_axis: float = 0.15


class FaultyPayload(Payload):
    """Laser and gimbal, or a camera, both looking at the target; what they measure comes as MAVLink messages."""

    def __init__(self, faults: PayloadFaults, rng: np.random.Generator) -> None:
        super().__init__(faults, rng)
        self._faults = faults
        self._dropout_s = (0.0, 0.0)  # begin and end
        self._lines: deque[tuple[float, float, float, float]] = deque(maxlen=_REMEMBERED)

    def measure(self, time_s, boot_ms, east_m, north_m, up_m, **how):
        self._lines.append((time_s, east_m, north_m, up_m))
        return super().measure(time_s, boot_ms, *self._line_at(time_s - self._faults.gimbal_delay_s), **how)

    def readings(self, time_s, boot_ms, yaw_rad, pitch_rad, range_m):
        faults, wrong_m = self._faults, 0.0
        if faults.view_deg:
            return self._tracked(time_s, boot_ms, yaw_rad, pitch_rad)
        if faults.range_delay_s != faults.gimbal_delay_s:
            lines_m = (self._line_at(time_s - delay_s) for delay_s in (faults.range_delay_s, faults.gimbal_delay_s))
            late_m, measured_m = (math.hypot(*line_m) for line_m in lines_m)
            wrong_m += late_m - measured_m
        if faults.outliers and self._rng.random() < faults.outliers:
            wrong_m += self._rng.uniform(-faults.outlier_max_m, faults.outlier_max_m)
        if range_m is None or not faults.has_laser or self._is_dropped(time_s):
            return [self.gimbal(boot_ms, yaw_rad, pitch_rad)]
        range_cm = round(100.0 * (range_m + wrong_m))
        if not _DISTANCE_MIN_CM <= range_cm <= DISTANCE_SENSOR_MAX_CM:
            return [self.gimbal(boot_ms, yaw_rad, pitch_rad)]
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
        return [self.gimbal(boot_ms, yaw_rad, pitch_rad), laser]

    def gimbal(self, boot_ms, yaw_rad, pitch_rad):
        return self.message(
            "GIMBAL_DEVICE_ATTITUDE_STATUS",
            time_boot_ms=boot_ms,
            q=list(from_roll_pitch_yaw(0.0, pitch_rad, yaw_rad)),
            flags=_LOCKED_IN_EARTH_FRAME,
            gimbal_device_id=0,
        )

    def message(self, name: str, **fields: object) -> Message:
        return Message(name, _SYSTEM, PAYLOAD_COMPONENT, fields, 0.0)

    def _tracked(self, time_s: float, boot_ms: int, yaw_rad: float, pitch_rad: float) -> list[Message]:
        """Return a gimbal that follows the target loosely, and where the target is in its image."""
        view_deg, off = self._faults.view_deg, self._faults.off_axis
        right, down = 2.0 * off * math.sin(0.7 * time_s), 2.0 * off * math.cos(0.31 * time_s)  # of half the image
        half = math.tan(math.radians(0.5 * view_deg))
        across, below = right * half, down * half
        # Yaw and pitch whose image has the target there: the rotation of (1, across, below) into its direction.
        sine = math.hypot(1.0, across, below) / math.hypot(1.0, below) * math.sin(pitch_rad)
        own_pitch_rad = math.atan(below) + math.asin(max(-1.0, min(1.0, sine)))
        ahead = math.cos(own_pitch_rad) + below * math.sin(own_pitch_rad)
        own_yaw_rad = yaw_rad - math.atan2(across, ahead)
        view = self.message("CAMERA_FOV_STATUS", time_boot_ms=boot_ms, hfov=view_deg, vfov=view_deg)
        target = self.message(
            "CAMERA_TRACKING_IMAGE_STATUS",
            tracking_status=1,
            tracking_mode=1,
            point_x=0.5 + 0.5 * right,
            point_y=0.5 + 0.5 * down,
        )
        return [self.gimbal(boot_ms, own_yaw_rad, own_pitch_rad), view, target]

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
        rate_per_s = self._faults.dropouts_per_s
        while rate_per_s and time_s >= self._dropout_s[1]:
            begin_s = self._dropout_s[1] + float(self._rng.exponential(1.0 / rate_per_s))
            self._dropout_s = begin_s, begin_s + self._faults.dropout_s
        return self._dropout_s[0] <= time_s < self._dropout_s[1]
