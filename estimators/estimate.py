"""The target estimate: the only value about the target that planning reads.

Source: docs/explanation/filter.md#motion.
"""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from sidelong.estimators.ellipse import Ellipse, confidence_ellipse
from sidelong.estimators.numbers import convert_to_floats, value_type


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
        convert_to_floats(
            self, "time_s", "east_m", "north_m", "velocity_east_m_s", "velocity_north_m_s", "last_sighting_s"
        )

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
