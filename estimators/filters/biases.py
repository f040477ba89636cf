"""The payload's constant errors, which a circling aircraft can separate from the target's motion.

Seen from one side all the time, a yaw error looks like a shifted target. From a circle the line of sight swings to
and fro, the shift turns with it, and a target cannot be in several places at once.

Source: docs/explanation/filter.md#measurement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sidelong.estimators.settings import TrackerSettings

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Calibration:
    """What is known of the payload's errors, measured minus true, each with its standard deviation."""

    yaw_bias_rad: float
    pitch_bias_rad: float
    range_bias_m: float
    yaw_sigma_rad: float
    pitch_sigma_rad: float
    range_sigma_m: float


@dataclass(frozen=True, slots=True)
class Delays:
    """How much earlier than their stamps the readings were made, s, and the errors that were found with that."""

    gimbal_s: float
    range_s: float
    gimbal_sigma_s: float
    range_sigma_s: float
    yaw_bias_rad: float
    yaw_sigma_rad: float
    range_bias_m: float  # after the factor
    range_bias_sigma_m: float
    range_factor: float = 1.0  # by what the ranges have to be multiplied

    def __str__(self) -> str:
        return (
            f"gimbal {self.gimbal_s:.2f} +- {self.gimbal_sigma_s:.2f} s, "
            f"laser {self.range_s:.2f} +- {self.range_sigma_s:.2f} s"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Biases:
    """Constant errors (yaw rad, pitch rad, range m) of one payload; with several payloads, (..., clock s) of each.

    mean (k,), covariance (k, k). A variance of 0 is not estimated.
    """

    mean: FloatArray
    covariance: FloatArray

    @staticmethod
    def prior(settings: TrackerSettings) -> Biases:
        """Return the errors before the first measurement: zero, with the configured standard deviations."""
        return Biases(np.zeros(3), np.diag(np.square(prior_sigmas(settings))))

    @property
    def calibration(self) -> Calibration:
        """Each error with its standard deviation, rad and m."""
        return Calibration(*self.mean.tolist(), *np.sqrt(self.covariance.diagonal()).tolist())


def prior_sigmas(settings: TrackerSettings) -> tuple[float, float, float]:
    """Return the standard deviations of yaw error, pitch error and range error before the first measurement."""
    return settings.yaw_bias_sigma_rad, settings.pitch_bias_sigma_rad, settings.range_bias_sigma_m
