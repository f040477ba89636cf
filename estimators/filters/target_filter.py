"""What a filter of the target does for its track, and the state that all of them share.

State, mean (n,) and covariance (n, n):

    [EAST, NORTH]       place in the plane, m
    [VELOCITY_E, _N]    m/s
    [HEIGHT]            of the ground under the target, above the zero of the aircraft's height, m
    [BIASES:BIASES+k]   those of the payload's errors that are estimated
    [-1]                turn rate, rad/s, clockwise: only in the filter that has motion models
"""

from __future__ import annotations

from typing import Protocol, Self

import numpy as np
import numpy.typing as npt

from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.sensing.sighting import AnySighting, measurement_by_biases
from sidelong.estimators.settings import TrackerSettings

FloatArray = npt.NDArray[np.float64]

EAST, NORTH, VELOCITY_E, VELOCITY_N, HEIGHT, BIASES = range(6)
PLACE = [EAST, NORTH, HEIGHT]
VELOCITY = [VELOCITY_E, VELOCITY_N]

# A calibration that is let drift never closes for good. What a mover does that no model knows is taken for an error
# of the payload, mostly of its yaw: without a drift of 0.25 degrees in 1,000 s the calibration would be sure of that.
_BIAS_DRIFT_PER_S = np.array([2e-8, 1e-10, 1e-7])


class TargetFilter(Protocol):
    """A filter that has been started at a sighting. Sightings come in the order of time."""

    time_s: float

    def predict(self, time_s: float) -> None:
        """Move on to ``time_s``, no earlier than the filter's own time."""
        ...

    def update(self, sighting: AnySighting, gate_nis: float) -> float:
        """Take in a sighting made at the filter's time; leave the filter alone if it lies beyond the gate.

        Returns the normalised innovation squared: chi-square with three degrees of freedom for laser and gimbal.
        """
        ...

    @property
    def size(self) -> int:
        """How many numbers the state has."""
        ...

    @property
    def height_m(self) -> float:
        """The height of the target's ground."""
        ...

    def carry(self, transition: FloatArray, shift: FloatArray, height_variance_m2: float) -> None:
        """Turn the state x into ``transition @ x + shift``, (n, n) and (n,), with a variance added to its height."""
        ...

    def measure(self, row: FloatArray, residual: float, variance: float) -> None:
        """Take in one number that depends on the state by ``row`` (n,); residual is measured minus expected."""
        ...

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return mean (4,) and covariance (4, 4) of position and velocity."""
        ...

    def biases(self) -> Biases:
        """Return what is known of the payload's errors."""
        ...

    def copy(self) -> Self:
        """Return a filter that goes its own way from here."""
        ...


def measured_linearly(
    mean: FloatArray, covariance: FloatArray, row: FloatArray, residual: float, variance: float
) -> tuple[FloatArray, FloatArray]:
    """Return mean (n,) and covariance (n, n) after one number was measured, with what it depends on, (n,)."""
    cross = covariance @ row
    expected = float(row @ cross) + variance
    updated = covariance - np.outer(cross, cross) / expected
    return mean + cross * (residual / expected), 0.5 * (updated + updated.T)


def starting_state(settings: TrackerSettings, sighting: AnySighting, biases: Biases) -> tuple[FloatArray, FloatArray]:
    """Return mean (n,) and covariance (n, n) of a target first seen here: place, biases, an unknown velocity."""
    estimated = biases.estimated
    size = BIASES + len(estimated)
    mean, covariance = np.zeros(size), np.zeros((size, size))
    to_place = sighting.place_by_measurement
    place = (sighting.east_m, sighting.north_m, sighting.height_m)
    # What a bias adds to the measurement it adds to the place, and is to be taken off it.
    shift = -to_place @ measurement_by_biases(sighting)
    mean[PLACE] = place + shift @ biases.mean
    mean[BIASES:] = biases.mean[estimated]
    covariance[np.ix_(PLACE, PLACE)] = (to_place * np.array(sighting.variances)) @ to_place.T
    covariance[np.ix_(PLACE, PLACE)] += shift @ biases.covariance @ shift.T
    covariance[np.ix_(PLACE, range(BIASES, size))] = (shift @ biases.covariance)[:, estimated]
    covariance[BIASES:, :BIASES] = covariance[:BIASES, BIASES:].T
    covariance[VELOCITY, VELOCITY] = settings.target_speed_sigma_m_s**2
    covariance[BIASES:, BIASES:] = biases.covariance[np.ix_(estimated, estimated)]
    return mean, covariance


def bias_drift(estimated: npt.NDArray[np.intp]) -> FloatArray:
    """Return the variance (k,) that the estimated biases gain each second."""
    return _BIAS_DRIFT_PER_S[estimated]
