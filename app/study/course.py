"""The course that a target made good: what tells its sides where it winds."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

# The truth's courses: made good over so many seconds, held where that way is no longer than so many metres.
LONG, SHORT = (30.0, 10.0), (5.0, 2.5)


def course_made_good_rad(
    east_m: FloatArray, north_m: FloatArray, step_s: float, window_s: float, min_way_m: float
) -> FloatArray:
    """Return the course (n,) from where the target was window_s before, or at its start, to where it is.

    Where the way is no longer than min_way_m the last course is held; before the first that counts, this first one;
    0 if there is none.
    """
    k = np.arange(east_m.size)
    before = np.maximum(k - round(window_s / step_s), 0)
    way_east_m, way_north_m = east_m - east_m[before], north_m - north_m[before]
    counts = np.hypot(way_east_m, way_north_m) > min_way_m
    if not counts.any():
        return np.zeros(east_m.size)
    held = np.maximum.accumulate(np.where(counts, k, int(np.argmax(counts))))
    return np.asarray(np.arctan2(way_east_m, way_north_m)[held])
