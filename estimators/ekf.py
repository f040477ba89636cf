"""Extended Kalman filter of one constant-velocity target, on filterpy."""

from __future__ import annotations

import copy
from typing import Self

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from estimators.settings import TrackerSettings
from estimators.sighting import Sighting
from estimators.target_filter import Biases, FloatArray

_UNKNOWN_PLACE_M = 1e4
_BIAS_DRIFT_RAD2_S = 1e-11  # 0.006 degrees in 1,000 s: keeps the calibration from closing for good


class TargetEkf:
    """State: position, velocity, then the calibrated biases.

    The sighting, corrected by the biases known so far, is compared with the position: linear in the position, so
    that a bad first guess does no harm, and linearised in the biases alone.
    """

    def __init__(self, settings: TrackerSettings, sighting: Sighting, biases: Biases) -> None:
        self.time_s = sighting.time_s
        self._density = settings.acceleration_density_m2_s3
        self._calibrated = np.flatnonzero(np.diag(biases.covariance) > 0.0)
        self._known = biases.mean.copy()
        size = 4 + len(self._calibrated)
        self._kf = ExtendedKalmanFilter(dim_x=size, dim_z=2)
        self._kf.x = np.concatenate(((sighting.east_m, sighting.north_m, 0.0, 0.0), biases.mean[self._calibrated]))
        self._kf.P = np.zeros((size, size))
        self._kf.P[(0, 1), (0, 1)] = _UNKNOWN_PLACE_M**2
        self._kf.P[(2, 3), (2, 3)] = settings.target_speed_sigma_m_s**2
        self._kf.P[4:, 4:] = biases.covariance[np.ix_(self._calibrated, self._calibrated)]
        self._kf.Q = np.zeros((size, size))
        self._kf.F = np.eye(size)
        self.update(sighting)

    def predict(self, time_s: float) -> None:
        step_s = time_s - self.time_s
        if step_s <= 0.0:
            return
        f, q = self._kf.F, self._kf.Q
        f[0, 2] = f[1, 3] = step_s
        q[0, 0] = q[1, 1] = self._density * step_s**3 / 3
        q[0, 2] = q[1, 3] = q[2, 0] = q[3, 1] = self._density * step_s**2 / 2
        q[2, 2] = q[3, 3] = self._density * step_s
        for i in range(4, len(f)):
            q[i, i] = _BIAS_DRIFT_RAD2_S * step_s
        self._kf.predict()
        self.time_s = time_s

    def nis(self, sighting: Sighting) -> float:
        residual, h = self._residual(sighting)
        s = h @ self._kf.P @ h.T + sighting.covariance
        return float(residual @ np.linalg.solve(s, residual))

    def update(self, sighting: Sighting, noise_scale: float = 1.0) -> None:
        residual, h = self._residual(sighting)
        self._kf.update(residual, lambda _x: h, lambda _x: 0.0, R=noise_scale * sighting.covariance)

    def _residual(self, sighting: Sighting) -> tuple[FloatArray, FloatArray]:
        bias = self._known
        bias[self._calibrated] = self._kf.x[4:]
        east_m, north_m, jacobian = sighting.corrected(*bias)
        h = np.hstack((np.eye(2, 4), jacobian[:, self._calibrated]))
        return np.array((east_m - self._kf.x[0], north_m - self._kf.x[1])), h

    def moments(self) -> tuple[FloatArray, FloatArray]:
        return self._kf.x[:4], self._kf.P[:4, :4]

    def biases(self) -> Biases:
        mean, covariance = self._known.copy(), np.zeros((3, 3))
        mean[self._calibrated] = self._kf.x[4:]
        covariance[np.ix_(self._calibrated, self._calibrated)] = self._kf.P[4:, 4:]
        return Biases(mean, covariance)

    def copy(self) -> Self:
        other = copy.copy(self)
        # filterpy puts new arrays in place of x and P, and never writes into the old ones.
        other._kf = copy.copy(self._kf)
        other._kf.F, other._kf.Q = self._kf.F.copy(), self._kf.Q.copy()
        other._known = self._known.copy()
        return other
