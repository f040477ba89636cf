"""What a filter of the target does for its track, whichever way it does it.

State of every filter, mean (n,) and covariance (n, n):

    [POSITION] east, north, m
    [VELOCITY] east, north, m/s
    ...        what the filter's own motion models need
    [-k:]      the k calibrated errors of the payload, those of (yaw rad, pitch rad, range m) with a prior sigma > 0
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
import numpy.typing as npt

from estimators.settings import TrackerSettings
from estimators.sighting import Sighting

FloatArray = npt.NDArray[np.float64]

POSITION = slice(0, 2)
VELOCITY = slice(2, 4)


@dataclass(frozen=True, slots=True, eq=False)
class Biases:
    """What is known of the payload's constant errors (yaw rad, pitch rad, range m): mean (3,), covariance (3, 3)."""

    mean: FloatArray
    covariance: FloatArray

    @staticmethod
    def prior(settings: TrackerSettings) -> Biases:
        sigmas = (settings.yaw_bias_sigma_rad, settings.pitch_bias_sigma_rad, settings.range_bias_sigma_m)
        return Biases(np.zeros(3), np.diag(np.square(sigmas)))


class TargetFilter(Protocol):
    """A filter that has been started at a sighting.

    ``predict``, then ``nis``, then perhaps ``update`` with the same sighting. Sightings come in the order of time.
    """

    time_s: float

    def predict(self, time_s: float) -> None:
        """Move on to ``time_s``, no earlier than the filter's own time."""
        ...

    def nis(self, sighting: Sighting) -> float:
        """Return the normalised innovation squared of a sighting made at the filter's time."""
        ...

    def update(self, sighting: Sighting, noise_scale: float = 1.0) -> None:
        """Take the sighting in; ``noise_scale`` multiplies its covariance."""
        ...

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return mean (4,) and covariance (4, 4) of position and velocity."""
        ...

    def biases(self) -> Biases:
        """Return what has been learnt of the payload's errors."""
        ...

    def copy(self) -> Self:
        """Return a filter that goes its own way from here."""
        ...
