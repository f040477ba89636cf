"""The ellipse that holds the truth with a stated probability.

Source: Johnson and Wichern, *Applied Multivariate Statistical Analysis*, section 4.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True)
class Ellipse:
    """semi_major_m points along the compass angle ``orientation_rad``, in [0, pi)."""

    semi_major_m: float
    semi_minor_m: float
    orientation_rad: float

    def outline(self, corners: int) -> list[tuple[float, float]]:
        """Return points (east, north) of the ellipse from its centre, m; the first one is repeated at the end."""
        sin, cos = math.sin(self.orientation_rad), math.cos(self.orientation_rad)
        points = []
        for corner in range(corners):
            angle_rad = math.tau * corner / corners
            along_m, across_m = self.semi_major_m * math.cos(angle_rad), self.semi_minor_m * math.sin(angle_rad)
            points.append((along_m * sin + across_m * cos, along_m * cos - across_m * sin))
        return [*points, points[0]]


def confidence_ellipse(covariance: npt.NDArray[np.float64], probability: float = 0.95) -> Ellipse:
    """Return the confidence ellipse of a position with a covariance (2, 2) of (east, north), m^2.

    Two Gaussian coordinates lie within k sigma with probability 1 - exp(-k^2 / 2).
    """
    k = math.sqrt(-2.0 * math.log(1.0 - probability))
    variance_e, variance_n, cross = float(covariance[0, 0]), float(covariance[1, 1]), float(covariance[0, 1])
    middle = (variance_e + variance_n) / 2
    half_spread = math.hypot((variance_e - variance_n) / 2, cross)
    orientation_rad = math.atan2(2 * cross, variance_n - variance_e) / 2
    return Ellipse(
        k * math.sqrt(middle + half_spread), k * math.sqrt(max(middle - half_spread, 0.0)), orientation_rad % math.pi
    )
