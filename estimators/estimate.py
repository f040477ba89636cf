"""The target estimate: the only value about the target that planning reads; the ellipse that holds the target.

Source: docs/explanation/filter.md#motion; Johnson and Wichern, *Applied Multivariate Statistical Analysis*, 4.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from sidelong.estimators.numbers import convert_to_floats, value_type


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


class TrackQuality(StrEnum):
    """How far the estimate can be trusted."""

    GOOD = "good"  # fed by fresh, consistent sightings
    COASTING = "coasting"  # predicted through a drop-out
    LOST = "lost"  # too old or too uncertain to plan by


@value_type(frozen=True, slots=True, eq=False)
class TargetEstimate:
    """The target's state at ``time_s``: state = (east, north, velocity east, velocity north), m and m/s.

    covariance is (4, 4) in the same order. reason: why the quality is not good, in words.
    as_seen: that of the last sighting, where the payload reports it so late that this one is mostly predicted.
    """

    time_s: float
    east_m: float
    north_m: float
    velocity_east_m_s: float
    velocity_north_m_s: float
    covariance: npt.NDArray[np.float64]
    quality: TrackQuality
    last_sighting_s: float
    reason: str = ""
    as_seen: TargetEstimate | None = None

    def __post_init__(self) -> None:
        place = "time_s", "east_m", "north_m"
        convert_to_floats(self, *place, "velocity_east_m_s", "velocity_north_m_s", "last_sighting_s")

    @property
    def speed_m_s(self) -> float:
        """Speed over the ground, m/s."""
        return math.hypot(self.velocity_east_m_s, self.velocity_north_m_s)

    def position_m(self, time_s: float) -> tuple[float, float]:
        """Return the position (east, north) predicted at the estimated velocity; at ``time_s`` for earlier times."""
        ahead_s = max(time_s - self.time_s, 0.0)
        return self.east_m + ahead_s * self.velocity_east_m_s, self.north_m + ahead_s * self.velocity_north_m_s

    @property
    def ellipse_95(self) -> Ellipse:
        """The ellipse about the position that holds the target with 95 % probability."""
        return confidence_ellipse(self.covariance[:2, :2])

    @property
    def course_rad(self) -> float:
        """Course of the estimated velocity, rad clockwise from north; meaningless for a target that stands."""
        return math.atan2(self.velocity_east_m_s, self.velocity_north_m_s)
