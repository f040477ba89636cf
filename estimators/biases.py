"""The payload's constant errors, which a circling aircraft can tell apart from the target's motion.

Seen from one side all the time, a yaw error looks like a shifted target. From a circle the line of sight swings to
and fro, the shift turns with it, and a target cannot be in several places at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimators.settings import TrackerSettings
from estimators.sighting import AnySighting, Fix

FloatArray = npt.NDArray[np.float64]

# How (slant range, bearing, depression) as measured answer to (yaw, pitch, range) errors; latency depends on motion.
# A positive pitch error looks too high, so the measured depression is too small.
_MEASUREMENT_BY_BIAS = np.array(
    [
        [0.0, 0.0, 1.0, 0.0],
        [1.0, 0.0, 0.0, 0.0],
        [0.0, -1.0, 0.0, 0.0],
    ]
)
_LATENCY = 3


@dataclass(frozen=True, slots=True)
class Calibration:
    """What is known of the payload's errors, measured minus true, each with its standard deviation.

    latency_s is what remains beside the configured one.
    """

    yaw_bias_rad: float
    pitch_bias_rad: float
    range_bias_m: float
    latency_s: float
    yaw_sigma_rad: float
    pitch_sigma_rad: float
    range_sigma_m: float
    latency_sigma_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Biases:
    """(yaw rad, pitch rad, range m, latency s): mean (4,), covariance (4, 4). A variance of 0 is not estimated."""

    mean: FloatArray
    covariance: FloatArray

    @staticmethod
    def prior(settings: TrackerSettings) -> Biases:
        sigmas = (
            settings.yaw_bias_sigma_rad,
            settings.pitch_bias_sigma_rad,
            settings.range_bias_sigma_m,
            settings.latency_sigma_s,
        )
        return Biases(np.zeros(4), np.diag(np.square(sigmas)))

    @property
    def estimated(self) -> npt.NDArray[np.intp]:
        """Which of the four are."""
        return np.flatnonzero(np.diag(self.covariance) > 0.0)

    def updated(self, mean: FloatArray, covariance: FloatArray) -> Biases:
        """Return these with the estimated ones at a new mean (k,) and covariance (k, k)."""
        whole_mean, whole_covariance = self.mean.copy(), self.covariance.copy()
        whole_mean[self.estimated] = mean
        whole_covariance[np.ix_(self.estimated, self.estimated)] = covariance
        return Biases(whole_mean, whole_covariance)

    @property
    def calibration(self) -> Calibration:
        return Calibration(*self.mean.tolist(), *np.sqrt(np.diag(self.covariance)).tolist())


def measurement_by_biases(
    sighting: AnySighting,
    measurement_by_place: FloatArray,
    velocity_east_m_s: float,
    velocity_north_m_s: float,
) -> FloatArray:
    """Return the derivative (3, 4) of what a sighting measures by the payload's errors, the target moving so."""
    if isinstance(sighting, Fix):
        return np.zeros((3, 4))
    jacobian = _MEASUREMENT_BY_BIAS.copy()
    # Measured a little earlier than stamped: the target was back along its way, the aircraft along its own.
    closing = (
        sighting.aircraft_velocity_east_m_s - velocity_east_m_s,
        sighting.aircraft_velocity_north_m_s - velocity_north_m_s,
    )
    jacobian[:, _LATENCY] = measurement_by_place[:, :2] @ closing
    return jacobian
