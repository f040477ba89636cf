"""A flown line over the ground, sampled densely. Source: docs/explanation/how-it-works.md#frames-and-units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Samples along a line, all arrays of shape (n,), n >= 2.

    arc_m: length flown since the start, strictly increasing from 0. course_rad is continuous (not wrapped).
    curvature_per_m: positive turns right.
    """

    arc_m: FloatArray
    east_m: FloatArray
    north_m: FloatArray
    course_rad: FloatArray
    curvature_per_m: FloatArray

    @property
    def length_m(self) -> float:
        """Length of the whole path, m."""
        return float(self.arc_m[-1])
