"""Extended Kalman filter of a target that holds its velocity; the update is filterpy's."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from sidelong.estimators.filters import imm_kernel as kernel
from sidelong.estimators.filters.imm import TargetImm, seen
from sidelong.estimators.filters.imm_kernel import EAST, HEIGHT, NORTH, Densities, errors_of
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
        kf, noise = ExtendedKalmanFilter(dim_x=n, dim_z=3), np.diag(sighting.variances)

        def take_in(inflation: float) -> None:
            kf.x, kf.P = mean, self.state[0, 1 + n :].reshape(n, n)
            # The residual is taken where bearings wrap; filterpy gets it as the measurement, with zero expected.
            kf.update(residual, lambda _: jacobian, lambda _: 0.0, R=inflation * noise)

        take_in(1.0)
        nis = float(kf.y @ kf.SI @ kf.y)
        if nis > gate_nis:
            return nis
        if nis > self._soft_nis:  # Huber: the pull on the estimate no longer grows with the distance
            take_in(math.sqrt(nis / self._soft_nis))
        self.state = np.concatenate(([1.0], kf.x, kf.P.ravel()))[None]
        return nis
