"""Extended Kalman filter of a target that holds its velocity, on filterpy."""

from __future__ import annotations

import copy
from typing import Self

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from estimators.biases import Biases, measurement_by_biases
from estimators.motion import HEIGHT_DENSITY_M2_S, add_white_acceleration, cruise
from estimators.settings import TrackerSettings
from estimators.sighting import AnySighting
from estimators.target_filter import (
    BIASES,
    EAST,
    HEIGHT,
    NORTH,
    PLACE,
    VELOCITY_E,
    VELOCITY_N,
    FloatArray,
    bias_drift,
    starting_state,
)


class TargetEkf:
    """One constant-velocity model: cheap, and lags where the target turns or stops."""

    def __init__(self, settings: TrackerSettings, sighting: AnySighting, biases: Biases) -> None:
        self.time_s = sighting.time_s
        self._density_m2_s3 = settings.acceleration_density_m2_s3
        self._prior = biases
        self._estimated = biases.estimated
        self._drift = bias_drift(self._estimated)
        mean, covariance = starting_state(settings, sighting, biases)
        self._kf = ExtendedKalmanFilter(dim_x=len(mean), dim_z=3)
        self._kf.x, self._kf.P = mean, covariance

    def predict(self, time_s: float) -> None:
        step_s = time_s - self.time_s
        self.time_s = time_s
        if step_s <= 0.0:
            return
        kf = self._kf
        kf.F = cruise(kf.dim_x, step_s)
        kf.Q = np.zeros((kf.dim_x, kf.dim_x))
        add_white_acceleration(kf.Q, self._density_m2_s3, step_s)
        kf.Q[HEIGHT, HEIGHT] = HEIGHT_DENSITY_M2_S * step_s
        for i, drift in enumerate(self._drift, start=BIASES):
            kf.Q[i, i] = drift * step_s
        kf.predict()

    def update(self, sighting: AnySighting, gate_nis: float) -> float:
        kf = self._kf
        east_m, north_m, height_m = float(kf.x[EAST]), float(kf.x[NORTH]), float(kf.x[HEIGHT])
        by_place = np.array(sighting.measurement_by_place(east_m, north_m, height_m))
        by_bias = measurement_by_biases(sighting, by_place, float(kf.x[VELOCITY_E]), float(kf.x[VELOCITY_N]))
        jacobian = np.zeros((3, kf.dim_x))
        jacobian[:, PLACE] = by_place
        jacobian[:, BIASES:] = by_bias[:, self._estimated]
        bias_mean = self._prior.mean.copy()
        bias_mean[self._estimated] = kf.x[BIASES:]
        # The residual is taken here, where bearings wrap; the filter is given it as a measurement of zero.
        residual = np.array(sighting.residual(east_m, north_m, height_m)) - by_bias @ bias_mean
        noise = np.diag(sighting.variances)
        spread = jacobian @ kf.P @ jacobian.T + noise
        nis = float(residual @ np.linalg.solve(spread, residual))
        if nis <= gate_nis:
            kf.update(residual, lambda _: jacobian, lambda _: 0.0, R=noise)
        return nis

    def moments(self) -> tuple[FloatArray, FloatArray]:
        return self._kf.x[:4], self._kf.P[:4, :4]

    def biases(self) -> Biases:
        return self._prior.updated(self._kf.x[BIASES:], self._kf.P[BIASES:, BIASES:])

    def copy(self) -> Self:
        other = copy.copy(self)
        # filterpy replaces its arrays and never writes into them.
        other._kf = copy.copy(self._kf)
        return other
