"""The courses of a target as it is judged and shown: the one it made good, whose sides count, and its present one."""

from __future__ import annotations

import math
from collections import deque

Pair = tuple[float, float]

_MIN_WAY_M = 10.0  # within it the target keeps the course that it made good


class TargetCourse:
    """Both courses, None until they are known. Slower than standing_m_s, the target keeps its present one."""

    def __init__(self, standing_m_s: float) -> None:
        self._standing_m_s = standing_m_s
        self.made_good_rad: float | None = None
        self.present_rad: float | None = None
        self._been: deque[tuple[float, Pair]] = deque()  # time, place

    def take(self, time_s: float, place_m: Pair, velocity_m_s: Pair, horizon_s: float) -> None:
        """Take the target at a time, in order, each as (east, north). horizon_s 0: the present course counts."""
        if math.hypot(*velocity_m_s) >= self._standing_m_s:
            self.present_rad = math.atan2(*velocity_m_s)
        if horizon_s == 0.0:
            self.made_good_rad = self.present_rad
            return
        self._been.append((time_s, place_m))
        while len(self._been) > 1 and self._been[1][0] <= time_s - horizon_s:
            self._been.popleft()
        _, before_m = self._been[0]
        east_m, north_m = place_m[0] - before_m[0], place_m[1] - before_m[1]
        if math.hypot(east_m, north_m) > _MIN_WAY_M:
            self.made_good_rad = math.atan2(east_m, north_m)
