"""The random target of the studies: straight legs, sudden turns, stops."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sidelong.mission.core.path import FloatArray

STEP_S = 0.1
"""Of the guidance and of the airframe."""

# The heading change at each new leg, and its chance.
_TURNS_DEG = (-90.0, -45.0, -20.0, 0.0, 20.0, 45.0, 90.0, 180.0)
_CHANCES = (0.12, 0.15, 0.15, 0.10, 0.15, 0.15, 0.12, 0.06)
_MIN_SPEED_M_S = 1.0
# Below this the last course goes on to count.
_COURSE_SPEED_M_S = 0.3


@dataclass(frozen=True, slots=True)
class TargetTruth:
    """The target at a moment. course_rad is its last course while it stands."""

    east_m: float
    north_m: float
    velocity_east_m_s: float
    velocity_north_m_s: float
    course_rad: float


class Target(Protocol):
    """A target with precomputed motion."""

    def at(self, time_s: float) -> TargetTruth:
        """Return the truth at a time from 0 to the end of the motion."""


class RandomTarget:
    """Legs of random length; at each one speed 0, uniform or greatest, with equal chances, and a random turn.

    It starts at the origin.
    """

    def __init__(
        self, rng: np.random.Generator, duration_s: float, speed_max_m_s: float, legs_s: tuple[float, float]
    ) -> None:
        legs = []
        start_s, east_m, north_m = 0.0, 0.0, 0.0
        heading_rad = course_rad = float(rng.uniform(-math.pi, math.pi))
        while start_s < duration_s:
            length_s = float(rng.uniform(*legs_s))
            speed_m_s = float(
                rng.choice([0.0, rng.uniform(min(_MIN_SPEED_M_S, speed_max_m_s), speed_max_m_s), speed_max_m_s])
            )
            if speed_m_s >= _COURSE_SPEED_M_S:
                course_rad = heading_rad
            velocity_m_s = speed_m_s * math.sin(heading_rad), speed_m_s * math.cos(heading_rad)
            legs.append((start_s, east_m, north_m, *velocity_m_s, course_rad))
            start_s += length_s
            east_m += length_s * speed_m_s * math.sin(heading_rad)
            north_m += length_s * speed_m_s * math.cos(heading_rad)
            heading_rad += math.radians(float(rng.choice(_TURNS_DEG, p=_CHANCES)))
        self._legs = np.array(legs)

    def sampled(self, time_s: FloatArray) -> FloatArray:
        """Return (n, 5) at times (n,): east, north, velocity east, velocity north, course."""
        legs = self._legs[np.maximum(np.searchsorted(self._legs[:, 0], time_s, side="right") - 1, 0)]
        gone_s = time_s - legs[:, 0]
        return np.stack([legs[:, 1] + legs[:, 3] * gone_s, legs[:, 2] + legs[:, 4] * gone_s, *legs[:, 3:].T], axis=1)

    def at(self, time_s: float) -> TargetTruth:
        """See :class:`Target`."""
        return TargetTruth(*self.sampled(np.array([time_s]))[0].tolist())
