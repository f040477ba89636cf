"""Extended Kalman filter of a target that holds its velocity, on filterpy."""

from __future__ import annotations

import copy
from typing import Self

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.filters.comparison import Comparison, compare, huber_inflation
from sidelong.estimators.filters.motion import cruise, cruise_noise
from sidelong.estimators.filters.target_filter import (
    BIASES,
    EAST,
    HEIGHT,
    NORTH,
    FloatArray,
    bias_drift,
    measured_linearly,
    starting_state,
)
from sidelong.estimators.sensing.sighting import AnySighting
from sidelong.estimators.settings import TrackerSettings


class TargetEkf:
    """One constant-velocity model: cheap, and lags where the target turns or stops."""

    def __init__(self, settings: TrackerSettings, sighting: AnySighting, biases: Biases) -> None:
        self.time_s = sighting.time_s
        self._density_m2_s3 = settings.acceleration_density_m2_s3
        self._soft_nis = settings.soft_nis
        self._prior = biases
        self._estimated = biases.estimated
        self._drift = tuple(bias_drift(self._estimated).tolist())
        mean, covariance = starting_state(settings, sighting, biases)
        self._kf = ExtendedKalmanFilter(dim_x=len(mean), dim_z=3)
        self._kf.x, self._kf.P = mean, covariance

    def predict(self, time_s: float) -> None:
        """Carry the state on to ``time_s``; see :class:`sidelong.estimators.filters.target_filter.TargetFilter`."""
        step_s = round(time_s - self.time_s, 6)
        self.time_s = time_s
        if step_s > 0.0:
            self._kf.F = cruise(self._kf.dim_x, step_s)
            self._kf.Q = cruise_noise(self._kf.dim_x, step_s, self._density_m2_s3, self._drift)
            self._kf.predict()

    def update(self, sighting: AnySighting, gate_nis: float) -> float:
        """Take a sighting in unless it lies beyond the gate; return its normalised innovation squared."""
        kf = self._kf
        mean, covariance = kf.x, kf.P
        place_variance_m2 = float(covariance[EAST, EAST] + covariance[NORTH, NORTH])
        comparison = compare(sighting, mean, place_variance_m2, self._prior, kf.dim_x)
        noise = np.diag(sighting.variances)
        self._take_in(comparison, noise)
        nis = float(kf.y @ kf.SI @ kf.y)
        if nis > self._soft_nis:
            kf.x, kf.P = mean, covariance
            if nis <= gate_nis:
                self._take_in(comparison, huber_inflation(nis, self._soft_nis) * noise)
        return nis

    def _take_in(self, comparison: Comparison, noise: FloatArray) -> None:
        # The residual is taken where bearings wrap; the filter is given it as the measurement, with zero expected.
        self._kf.update(comparison.residual, lambda _: comparison.jacobian, lambda _: 0.0, R=noise)

    @property
    def size(self) -> int:
        """How many numbers the state has."""
        return int(self._kf.x.size)

    @property
    def height_m(self) -> float:
        """The height of the target's ground."""
        return float(self._kf.x[HEIGHT])

    def carry(self, transition: FloatArray, shift: FloatArray, height_variance_m2: float) -> None:
        """Turn the state linearly; see :class:`sidelong.estimators.filters.target_filter.TargetFilter`."""
        covariance = transition @ self._kf.P @ transition.T
        covariance[HEIGHT, HEIGHT] += height_variance_m2
        self._kf.x, self._kf.P = transition @ self._kf.x + shift, 0.5 * (covariance + covariance.T)

    def measure(self, row: FloatArray, residual: float, variance: float) -> None:
        """Take in one number; see :class:`sidelong.estimators.filters.target_filter.TargetFilter`."""
        self._kf.x, self._kf.P = measured_linearly(self._kf.x, self._kf.P, row, residual, variance)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return mean (4,) and covariance (4, 4) of (east, north, velocity east, velocity north)."""
        return self._kf.x[:4], self._kf.P[:4, :4]

    def biases(self) -> Biases:
        """Return the sensor biases with their covariance."""
        return self._prior.updated(self._kf.x[BIASES:], self._kf.P[BIASES:, BIASES:])

    def copy(self) -> Self:
        """Return an independent filter with the same state."""
        other = copy.copy(self)
        # filterpy replaces its arrays and never writes into them.
        other._kf = copy.copy(self._kf)
        return other
