r"""A sighting: one laser range and one line of sight, made at one instant.

The target stands on ground of unknown height; the aircraft's altitude may be off by any constant::

    aircraft --- horizontal_m --->.
             \ depression         | drop: aircraft height - target height
              \                   v
               `--slant range--> target

Three numbers are measured (slant range, bearing, depression) and three are sought (east, north, height), so the
height is measured by the sightings themselves, and horizontal range is slant * cos(depression).

Source: docs/explanation/filter.md#measurement.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from sidelong.estimators.numbers import value_type
from sidelong.estimators.rotations import (
    Quaternion,
    Vector,
    from_roll_pitch_yaw,
    multiply,
    normalized,
    rotate,
    sight_direction,
)
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading

FloatArray = npt.NDArray[np.float64]


@value_type(frozen=True, slots=True)
class Sighting:
    """The target as seen from the aircraft at ``time_s``. Sigmas are those of the three measured numbers.

    The aircraft's height has an arbitrary zero, the same for all sightings. ``payload`` is the index of the payload
    in a filter of several. Without ``has_range`` the slant range only shows where to linearise.
    """

    time_s: float
    slant_range_m: float
    bearing_rad: float
    depression_rad: float
    range_sigma_m: float
    bearing_sigma_rad: float
    depression_sigma_rad: float
    aircraft_east_m: float
    aircraft_north_m: float
    aircraft_height_m: float = 0.0
    quality: float | None = None
    payload: int = 0
    has_range: bool = True

    @property
    def horizontal_range_m(self) -> float:
        """Range over the ground, m: the slant range times the cosine of the depression."""
        return self.slant_range_m * math.cos(self.depression_rad)

    @property
    def east_m(self) -> float:
        """East of the target by this sighting, m in the local plane."""
        return self.aircraft_east_m + self.horizontal_range_m * math.sin(self.bearing_rad)

    @property
    def north_m(self) -> float:
        """North of the target by this sighting, m in the local plane."""
        return self.aircraft_north_m + self.horizontal_range_m * math.cos(self.bearing_rad)

    @property
    def height_m(self) -> float:
        """Height of the target by this sighting, m above home."""
        return self.aircraft_height_m - self.slant_range_m * math.sin(self.depression_rad)

    @property
    def place_by_measurement(self) -> FloatArray:
        """Derivative (3, 3) of (east, north, height) by (slant range, bearing, depression)."""
        sin_b, cos_b = math.sin(self.bearing_rad), math.cos(self.bearing_rad)
        sin_d, cos_d = math.sin(self.depression_rad), math.cos(self.depression_rad)
        slant_m = self.slant_range_m
        return np.array(
            [
                [cos_d * sin_b, slant_m * cos_d * cos_b, -slant_m * sin_d * sin_b],
                [cos_d * cos_b, -slant_m * cos_d * sin_b, -slant_m * sin_d * cos_b],
                [-sin_d, 0.0, -slant_m * cos_d],
            ]
        )

    @property
    def variances(self) -> tuple[float, float, float]:
        """Variances of slant range, m^2, bearing and depression, rad^2."""
        return self.range_sigma_m**2, self.bearing_sigma_rad**2, self.depression_sigma_rad**2

    @property
    def covariance(self) -> FloatArray:
        """Covariance (2, 2) of (east, north), m^2, to first order: at 0.35 degrees and 300 m the rest is 6 mm."""
        jacobian = self.place_by_measurement[:2]
        covariance: FloatArray = (jacobian * np.array(self.variances)) @ jacobian.T
        return covariance

    def without(self, yaw_rad: float, pitch_rad: float, range_m: float) -> Sighting:
        """Return what a payload without these errors would have measured."""
        return replace(
            self,
            slant_range_m=self.slant_range_m - range_m,
            bearing_rad=self.bearing_rad - yaw_rad,
            depression_rad=self.depression_rad + pitch_rad,
        )


@value_type(frozen=True, slots=True)
class Fix:
    """The target's place as a camera's own tracker gives it, uncalibrated. Its third number measures nothing."""

    time_s: float
    east_m: float
    north_m: float
    sigma_m: float
    height_m: float = 0.0
    quality: float | None = None
    payload: int = 0
    has_range: ClassVar[bool] = True

    @property
    def place_by_measurement(self) -> FloatArray:
        """Derivative (3, 3) of (east, north, height): the height is anything within 100 m."""
        return np.diag((1.0, 1.0, 100.0))

    @property
    def variances(self) -> tuple[float, float, float]:
        """Variances of east and north, m^2; a fix has no third measurement: its variance is 1."""
        return self.sigma_m**2, self.sigma_m**2, 1.0

    @property
    def covariance(self) -> FloatArray:
        """Covariance (2, 2) of (east, north), m^2."""
        return np.eye(2) * self.sigma_m**2

    def without(self, yaw_rad: float, pitch_rad: float, range_m: float) -> Fix:
        """Return itself: it has none of these errors."""
        return self


AnySighting = Sighting | Fix


def measurement_by_biases(sighting: AnySighting) -> FloatArray:
    """Return the derivative (3, 3) of a measurement by the (yaw, pitch, range) errors; read only."""
    return _BY_BIASES if isinstance(sighting, Sighting) else _BY_NO_BIASES


# A positive pitch error looks too high, so the measured depression is too small.
_BY_BIASES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_BY_NO_BIASES = np.zeros((3, 3))
_BY_BIASES.setflags(write=False)
_BY_NO_BIASES.setflags(write=False)


@value_type(frozen=True, slots=True)
class SightingOutcome:
    """What became of a sighting. nis is its normalised innovation squared, NaN where it was not compared."""

    sighting: AnySighting
    accepted: bool
    nis: float
    reason: str = ""


_CORRELATION_S = 30.0
_MIN_STEP_S = 0.01


class BeaconErrors:
    """Returns the sigma with which each fix can be treated as an independent measurement.

    Fixes within the correlation time of the error count together as one: averaging them does not improve them. For
    errors that fade as exp(-t / tau), variances are multiplied by 2 tau / step, the growth of their mean's variance.
    """

    def __init__(self) -> None:
        self._last_s = -math.inf

    def sigma_m(self, time_s: float, sigma_m: float) -> float:
        """Return the standard deviation to use for a fix, from that which the beacon reports or is configured."""
        step_s = max(abs(time_s - self._last_s), _MIN_STEP_S)
        self._last_s = max(self._last_s, time_s)
        return sigma_m * math.sqrt(max(2.0 * _CORRELATION_S / step_s, 1.0))


@value_type(frozen=True, slots=True)
class LineOfSight:
    """bearing_rad is a compass angle, depression_rad positive below the horizon."""

    bearing_rad: float
    depression_rad: float


def ned_from_body(attitude: AttitudeReading) -> Quaternion:
    """Return the aircraft's attitude as a rotation from body (forward, right, down) to north-east-down."""
    return from_roll_pitch_yaw(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)


def parent_of_gimbal(gimbal: GimbalReading, attitude: AttitudeReading | None, mount: Quaternion) -> Quaternion:
    """Return the rotation from what a gimbal's attitude is relative to, through its mount, to north-east-down."""
    if gimbal.frame == "earth":
        return 1.0, 0.0, 0.0, 0.0
    if attitude is None:
        raise ValueError(f"a {gimbal.frame}-frame gimbal points nowhere without the aircraft's attitude")
    level = gimbal.frame == "vehicle"
    return multiply(from_roll_pitch_yaw(0.0, 0.0, attitude.yaw_rad) if level else ned_from_body(attitude), mount)


def line_of_sight(
    gimbal: GimbalReading, attitude: AttitudeReading | None, parent_from_mount: Quaternion
) -> LineOfSight:
    """Return the direction in which the gimbal points; the attitude may be None for an earth-frame gimbal only.

    Straight down the bearing is 0: a line of sight within a degree of it has no usable bearing.
    """
    direction = sight_direction(normalized(gimbal.quaternion_wxyz))
    if gimbal.frame != "earth":
        direction = rotate(parent_of_gimbal(gimbal, attitude, parent_from_mount), direction)
    north, east, down = direction
    return LineOfSight(math.atan2(east, north), math.atan2(down, math.hypot(north, east)))


def lever_arm_plane_m(lever_arm_body_m: Vector, attitude: AttitudeReading) -> Vector:
    """Return the gimbal's position from the aircraft's (east, north, up), given in (forward, right, down)."""
    north, east, down = rotate(ned_from_body(attitude), lever_arm_body_m)
    return east, north, -down
