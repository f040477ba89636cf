"""Extended Kalman filter of a target that holds its velocity, on filterpy's.

Source: Labbe, filterpy, :class:`filterpy.kalman.ExtendedKalmanFilter`; Bar-Shalom, Li, Kirubarajan, *Estimation with
Applications to Tracking and Navigation*, 2001, section 10.3; Huber, "Robust estimation of a location parameter",
Annals of Mathematical Statistics 35(1), 1964.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from sidelong.estimators.filters import imm_kernel as kernel
from sidelong.estimators.filters.biases import FloatArray
from sidelong.estimators.filters.imm import TargetImm, seen
from sidelong.estimators.filters.imm_kernel import EAST, HEIGHT, NORTH, TARGET, TURN, VELOCITY_E, VELOCITY_N
from sidelong.estimators.sensing.sighting import AnySighting
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.terrain.ground_kernel import height_and_slope, height_sigma_m

_MEASURED = [EAST, NORTH, HEIGHT, TARGET, TARGET + 1, TARGET + 2]


class TargetEkf(TargetImm):
    """The cruising model alone, for one payload: it lags where the target turns or stops."""

    models: ClassVar[int] = 1

    @staticmethod
    def _densities_of(settings: TrackerSettings) -> kernel.Densities:
        density = settings.acceleration_density_m2_s3
        return kernel.Densities(density, density, 0.0)

    def _filterpy(self) -> ExtendedKalmanFilter:
        n = kernel.numbers_of(self.state)
        ekf = ExtendedKalmanFilter(dim_x=n, dim_z=3)
        ekf.x, ekf.P, ekf.B = self.state[0, 1 : 1 + n], self.state[0, 1 + n :].reshape(n, n), 1.0
        return ekf

    def _take(self, ekf: ExtendedKalmanFilter) -> None:
        self.state = np.concatenate(([1.0], ekf.x, (0.5 * (ekf.P + ekf.P.T)).ravel()))[None]

    def _move(self, step_s: float, densities: kernel.Densities) -> None:
        ekf, ground = self._filterpy(), self._ground
        place = None if ground is None else _surface(ground, ekf.x)
        if ground is None or place is None:
            _cruise(ekf, step_s, densities)
        else:
            moments = ekf.x[:4], ekf.P[:4, :4]
            _lean(ekf, -place[1], -place[2], -place[0], 1.0, 0.0)
            _cruise(ekf, step_s, densities._replace(height_m2_s=0.0))
            kept = kernel.kept_offset(np.ascontiguousarray(moments[0]), np.ascontiguousarray(moments[1]), step_s)
            level_m, east, north = _surface(ground, ekf.x) or place
            sigma_m = height_sigma_m(ground.sigma_m, min(ground.grid[3], ground.grid[4]), east, north)
            _lean(ekf, east, north, level_m, kept, (1.0 - kept * kept) * sigma_m * sigma_m)
        self._take(ekf)

    def update(self, sighting: AnySighting, gate_nis: float) -> float:
        """See :meth:`sidelong.estimators.filters.imm.TargetImm.update`."""
        ekf, noise = self._filterpy(), np.diag(sighting.variances)
        before, covariance = ekf.x, ekf.P
        mean, residual, by_columns = kernel.innovation(self.state, 0, seen(sighting))
        jacobian = np.zeros((3, len(mean)))
        jacobian[:, _MEASURED] = by_columns[:, :6]

        def take_in(inflation: float) -> float:
            ekf.x, ekf.P = before, covariance
            # The residual is taken where bearings wrap; filterpy gets it as the measurement, with zero expected.
            ekf.update(residual, lambda _: jacobian, lambda _: 0.0, R=inflation * noise)
            return float(ekf.y @ ekf.SI @ ekf.y)

        nis = take_in(1.0)
        if nis > gate_nis:
            return nis
        if nis > self._soft_nis:  # Huber: the pull on the estimate no longer grows with the distance
            take_in(math.sqrt(nis / self._soft_nis))
        self._take(ekf)
        return nis


def _cruise(ekf: ExtendedKalmanFilter, step_s: float, densities: kernel.Densities) -> None:
    """Predict a target that holds its velocity; its turn rate is not used."""
    n = len(ekf.x)
    ekf.F, ekf.Q = np.eye(n), np.zeros((n, n))
    ekf.F[TURN, TURN], ekf.Q[TURN, TURN] = 0.0, kernel.TURN_SIGMA_RAD_S**2
    density = densities.cruise_m2_s3
    for place, velocity in ((EAST, VELOCITY_E), (NORTH, VELOCITY_N)):
        ekf.F[place, velocity] = step_s
        ekf.Q[place, place] = density * step_s**3 / 3.0
        ekf.Q[place, velocity] = ekf.Q[velocity, place] = density * step_s**2 / 2.0
        ekf.Q[velocity, velocity] = density * step_s
    ekf.Q[HEIGHT, HEIGHT] = densities.height_m2_s * step_s
    for error, drift_per_s in enumerate(kernel.ERROR_DRIFT_PER_S, TARGET):
        if ekf.P[error, error] > 0.0:
            ekf.Q[error, error] = drift_per_s * step_s
    ekf.predict()


def _surface(ground: Ground, mean: FloatArray) -> tuple[float, float, float] | None:
    """Return the plane that touches the ground below a mean: height at the origin, m, and slopes east and north."""
    east_m, north_m = float(mean[EAST]), float(mean[NORTH])
    height_m, east, north = height_and_slope(ground.grid, east_m, north_m)
    return None if math.isnan(height_m) else (height_m - east * east_m - north * north_m, east, north)


def _lean(
    ekf: ExtendedKalmanFilter, east: float, north: float, shift_m: float, kept: float, variance_m2: float
) -> None:
    """Turn the height h into kept h + slopes times the place + shift, with a variance added."""
    n = len(ekf.x)
    ekf.F, ekf.Q, shift = np.eye(n), np.zeros((n, n)), np.zeros(n)
    ekf.F[HEIGHT, [EAST, NORTH, HEIGHT]] = east, north, kept
    ekf.Q[HEIGHT, HEIGHT], shift[HEIGHT] = variance_m2, shift_m
    ekf.predict(shift)
