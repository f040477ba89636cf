"""Unscented Kalman filter of a target that holds its velocity, on filterpy."""

from __future__ import annotations

import copy
from typing import Self

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.filters.comparison import huber_inflation
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
from sidelong.estimators.sensing.sighting import AnySighting, measurement_by_biases
from sidelong.estimators.settings import TrackerSettings


class TargetUkf:
    """As the extended filter, but carries a cloud of states through the measurement instead of its derivative."""

    def __init__(self, settings: TrackerSettings, sighting: AnySighting, biases: Biases) -> None:
        self.time_s = sighting.time_s
        self._density_m2_s3 = settings.acceleration_density_m2_s3
        self._soft_nis = settings.soft_nis
        self._prior = biases
        self._estimated = biases.estimated
        self._drift = tuple(bias_drift(self._estimated).tolist())
        mean, covariance = starting_state(settings, sighting, biases)
        size = len(mean)
        self._kf = UnscentedKalmanFilter(
            dim_x=size,
            dim_z=3,
            dt=0.0,
            hx=self._expected,
            fx=lambda state, step_s: cruise(size, step_s) @ state,
            points=MerweScaledSigmaPoints(size, alpha=0.5, beta=2.0, kappa=0.0),
        )
        self._kf.x, self._kf.P = mean, covariance

    def predict(self, time_s: float) -> None:
        """Carry the state on to ``time_s``; see :class:`sidelong.estimators.filters.target_filter.TargetFilter`."""
        step_s = max(round(time_s - self.time_s, 6), 0.0)
        self.time_s = time_s
        self._kf.Q = cruise_noise(self._kf.x.size, step_s, self._density_m2_s3, self._drift)
        self._kf.predict(dt=step_s)

    def update(self, sighting: AnySighting, gate_nis: float) -> float:
        """Take a sighting in unless it lies beyond the gate; return its normalised innovation squared."""
        kf = self._kf
        mean, covariance = kf.x, kf.P
        # Everything is measured against the sighting, so that no bearing wraps within the cloud.
        noise = np.diag(sighting.variances)
        kf.update(np.zeros(3), R=noise, sighting=sighting)
        nis = float(kf.y @ kf.SI @ kf.y)
        if nis > self._soft_nis:
            kf.x, kf.P = mean, covariance
            if nis <= gate_nis:
                kf.update(np.zeros(3), R=huber_inflation(nis, self._soft_nis) * noise, sighting=sighting)
        return nis

    def _expected(self, state: FloatArray, sighting: AnySighting) -> FloatArray:
        """Return expected minus measured (slant range, bearing, depression), (3,)."""
        place = (float(state[EAST]), float(state[NORTH]), float(state[HEIGHT]))
        biases = self._prior.mean.copy()
        biases[self._estimated] = state[BIASES:]
        expected: FloatArray = measurement_by_biases(sighting) @ biases - sighting.residual(*place)
        return expected

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
        self._become(transition @ self._kf.x + shift, 0.5 * (covariance + covariance.T))

    def measure(self, row: FloatArray, residual: float, variance: float) -> None:
        """Take in one number; see :class:`sidelong.estimators.filters.target_filter.TargetFilter`."""
        self._become(*measured_linearly(self._kf.x, self._kf.P, row, residual, variance))

    def _become(self, mean: FloatArray, covariance: FloatArray) -> None:
        kf = self._kf
        kf.x, kf.P = mean, covariance
        kf.sigmas_f = kf.points_fn.sigma_points(mean, covariance)  # those of the last prediction are not its own

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return mean (4,) and covariance (4, 4) of (east, north, velocity east, velocity north)."""
        return self._kf.x[:4], self._kf.P[:4, :4]

    def biases(self) -> Biases:
        """Return the sensor biases with their covariance."""
        return self._prior.updated(self._kf.x[BIASES:], self._kf.P[BIASES:, BIASES:])

    def copy(self) -> Self:
        """Return an independent filter with the same state."""
        other = copy.copy(self)
        other._kf = copy.copy(self._kf)
        other._kf.hx = other._expected
        # The one array that filterpy writes into.
        other._kf.sigmas_f = self._kf.sigmas_f.copy()
        return other
