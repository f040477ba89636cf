"""Extended Kalman filter of a target that holds its velocity.

Source: Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001, section 10.3;
Huber, "Robust estimation of a location parameter", Annals of Mathematical Statistics 35(1), 1964.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from sidelong.estimators.filters import imm_kernel as kernel
from sidelong.estimators.filters.imm import TargetImm, seen
from sidelong.estimators.filters.imm_kernel import EAST, HEIGHT, NORTH, Densities, errors_of
from sidelong.estimators.filters.measurement_kernel import FloatArray
from sidelong.estimators.sensing.sighting import AnySighting
from sidelong.estimators.settings import TrackerSettings


class TargetEkf(TargetImm):
    """The cruising model alone, for one payload: it lags where the target turns or stops."""

    models: ClassVar[int] = 1

    @staticmethod
    def _densities_of(settings: TrackerSettings) -> Densities:
        density = settings.acceleration_density_m2_s3
        return Densities(density, density, 0.0)

    def update(self, sighting: AnySighting, gate_nis: float) -> float:
        """See :meth:`sidelong.estimators.filters.imm.TargetImm.update`."""
        mean, residual, by_columns = kernel.innovation(self.state, 0, seen(sighting))
        n, first = len(mean), errors_of(0, len(mean))[0]
        jacobian = np.zeros((3, n))
        jacobian[:, [EAST, NORTH, HEIGHT, first, first + 1, first + 2]] = by_columns[:, :6]
        before, noise = self.state[0, 1 + n :].reshape(n, n), np.diag(sighting.variances)
        across = before @ jacobian.T

        def weighted(noise: FloatArray) -> tuple[FloatArray, FloatArray, float]:
            inverse = np.linalg.inv(jacobian @ across + noise)
            gain = across @ inverse
            kept = np.eye(n) - gain @ jacobian  # Joseph's form stays symmetric
            nis = float(residual @ inverse @ residual)
            return mean + gain @ residual, kept @ before @ kept.T + gain @ noise @ gain.T, nis

        updated, covariance, nis = weighted(noise)
        if nis > gate_nis:
            return nis
        if nis > self._soft_nis:  # Huber: the pull on the estimate no longer grows with the distance
            updated, covariance, _ = weighted(math.sqrt(nis / self._soft_nis) * noise)
        self.state = np.concatenate(([1.0], updated, covariance.ravel()))[None]
        return nis
