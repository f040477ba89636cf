"""The random target of the studies (straight legs, sudden turns, stops), and the noisy payload that looks at one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.sensing.readings import GimbalReading, RangeReading, Reading, Source
from sidelong.mission.core.path import FloatArray

STEP_S = 0.1  # of the guidance and of the airframe

# The heading change at each new leg, and its chance.
_TURNS_DEG = (-90.0, -45.0, -20.0, 0.0, 20.0, 45.0, 90.0, 180.0)
_CHANCES = (0.12, 0.15, 0.15, 0.10, 0.15, 0.15, 0.12, 0.06)
_MIN_SPEED_M_S = 1.0
# Below this the last course goes on to count.
_COURSE_SPEED_M_S = 0.3


@dataclass(frozen=True, slots=True)
class TargetTruth:
    """The target at a moment. course_rad is its last course while it stands."""

    east_m: float
    north_m: float
    velocity_east_m_s: float
    velocity_north_m_s: float
    course_rad: float


class Target(Protocol):
    def at(self, time_s: float) -> TargetTruth: ...  # at a time from 0 to the end of the motion


class RandomTarget:
    """Legs of random length; at each one speed 0, uniform or greatest, with equal chances, and a random turn."""

    def __init__(
        self, rng: np.random.Generator, duration_s: float, speed_max_m_s: float, legs_s: tuple[float, float]
    ) -> None:
        legs = []
        start_s, east_m, north_m = 0.0, 0.0, 0.0
        heading_rad = course_rad = float(rng.uniform(-math.pi, math.pi))
        while start_s < duration_s:
            length_s = float(rng.uniform(*legs_s))
            speed_m_s = float(
                rng.choice([0.0, rng.uniform(min(_MIN_SPEED_M_S, speed_max_m_s), speed_max_m_s), speed_max_m_s])
            )
            if speed_m_s >= _COURSE_SPEED_M_S:
                course_rad = heading_rad
            velocity_m_s = speed_m_s * math.sin(heading_rad), speed_m_s * math.cos(heading_rad)
            legs.append((start_s, east_m, north_m, *velocity_m_s, course_rad))
            start_s += length_s
            east_m += length_s * speed_m_s * math.sin(heading_rad)
            north_m += length_s * speed_m_s * math.cos(heading_rad)
            heading_rad += math.radians(float(rng.choice(_TURNS_DEG, p=_CHANCES)))
        self._legs = np.array(legs)

    def sampled(self, time_s: FloatArray) -> FloatArray:
        """Return (n, 5) at times (n,): east, north, velocity east, velocity north, course."""
        legs = self._legs[np.maximum(np.searchsorted(self._legs[:, 0], time_s, side="right") - 1, 0)]
        gone_s = time_s - legs[:, 0]
        return np.stack([legs[:, 1] + legs[:, 3] * gone_s, legs[:, 2] + legs[:, 4] * gone_s, *legs[:, 3:].T], axis=1)

    def at(self, time_s: float) -> TargetTruth:
        """Return the truth at a time from 0 to the end of the motion."""
        return TargetTruth(*self.sampled(np.array([time_s]))[0].tolist())


PAYLOAD_COMPONENT = 154  # MAV_COMP_ID_GIMBAL
RANGE_MIN_M, RANGE_MAX_M = 1.0, 655.35  # as a DISTANCE_SENSOR of one metre and more states them
GIMBAL = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", PAYLOAD_COMPONENT)
LASER = Source("DISTANCE_SENSOR", PAYLOAD_COMPONENT, 1, 100)  # of custom orientation
_QUALITY = 0.9


@dataclass(frozen=True, slots=True)
class PayloadErrors:
    """Sigmas of slant range, and of yaw and pitch; a constant yaw error; how far the gimbal pans from the nose."""

    range_sigma_m: float = 0.8
    angle_sigma_rad: float = math.radians(0.35)
    yaw_bias_rad: float = math.radians(0.4)
    pan_limit_rad: float = math.pi


class Payload:
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
        """Return the readings of one moment, of a target that far from the aircraft (up_m: negative below)."""
        errors, level_m = self._errors, math.hypot(east_m, north_m)
        range_noise, yaw_noise, pitch_noise = self._rng.standard_normal(3).tolist()
        yaw_rad = math.atan2(east_m, north_m) + errors.yaw_bias_rad + errors.angle_sigma_rad * yaw_noise
        pitch_rad = math.atan2(up_m, level_m) + errors.angle_sigma_rad * pitch_noise
        if errors.pan_limit_rad < math.pi:
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
        return [gimbal, RangeReading(stamp_s, range_m, LASER, None, _QUALITY, RANGE_MIN_M, RANGE_MAX_M, level)]

    def gimbal(self, boot_ms: int, yaw_rad: float, pitch_rad: float) -> Reading:
        """Return a gimbal reading; yaw from north, pitch positive up."""
        # A rotation without roll, at half the cost of any.
        cp, sp, cy, sy = (
            math.cos(pitch_rad / 2),
            math.sin(pitch_rad / 2),
            math.cos(yaw_rad / 2),
            math.sin(yaw_rad / 2),
        )
        return GimbalReading(boot_ms * 1e-3, (cp * cy, -sp * sy, sp * cy, cp * sy), "earth", GIMBAL)
