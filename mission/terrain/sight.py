"""From where a target that moves over the ground is seen, and will be.

The planner uses it one move deep. Two moves deep it saw 21 targets among hills for 99.91 % of the time instead of
99.93 %, was on side for 96.1 % instead of 96.3 %, and took twice as long to decide.

Source: docs/how-to/hills.md.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.core.sight import NOTHING_HIDDEN, Sight

_AZIMUTHS, _RING_M = 72, 20.0
_TARGETS, _STEP_S = 5, 10.0
_APART_M = 15.0  # places nearer to one another share their raster
_KEPT = 64
_TARGET_M = 1.0  # of it stands above the ground
# Elevation data miss the last metres of a crest, and trees: lower than this above the horizon counts more and more.
_SOFT_M = 10.0
_WEIGHT = 3.0  # seconds off side for a second hidden


class SightField:
    """Rasters about where the target is and will be, kept while it stays near. reach_m: the farthest asked for."""

    def __init__(self, ground: Ground, reach_m: float) -> None:
        self._ground = ground
        self._rings = math.ceil(reach_m / _RING_M)
        self._needed_m = lru_cache(_KEPT)(self._compute_needed_m)

    def sight(
        self, east_m: float, north_m: float, velocity_east_m_s: float, velocity_north_m_s: float, height_m: float
    ) -> Sight:
        """Return from where a target is visible.

        Everything is visible if the ground at the target is unknown, and if no ground around it reaches a line of
        sight: the planner then looks as deep as over a plain.

        Args:
            height_m: Height of the aircraft above home, m.
        """
        if math.isnan(self._ground.height_m(east_m, north_m)):
            return NOTHING_HIDDEN
        needed_m = np.stack(
            [
                self._needed_m(
                    round((east_m + velocity_east_m_s * time_s) / _APART_M),
                    round((north_m + velocity_north_m_s * time_s) / _APART_M),
                )
                for time_s in np.arange(_TARGETS) * _STEP_S
            ]
        )
        if needed_m.max() + _SOFT_M <= height_m:
            return NOTHING_HIDDEN
        return Sight(needed_m, _RING_M, _STEP_S, height_m, _SOFT_M, _WEIGHT)

    def _compute_needed_m(self, column: int, row: int) -> npt.NDArray[np.float32]:
        place_m = column * _APART_M, row * _APART_M
        height_m = self._ground.height_m(*place_m) + _TARGET_M
        found = self._ground.horizon_m(*place_m, height_m, _AZIMUTHS, self._rings, _RING_M)
        if math.isnan(height_m):
            found[:] = -math.inf
        return found
