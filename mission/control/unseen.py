"""Where a target that is not seen can be. Source: docs/health.md#the-target-is-not-seen."""

from __future__ import annotations

import math

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.geometry.retreat import Reach

_BLIND_S = 20.0  # longer than a laser or a beacon misses
_PROBATION_S = 8.0  # a payload that reports a wrong target is found out within this time


class UnseenTarget:
    """Follows the track of one flight."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._lost_s = -math.inf  # when the track was lost, last
        self._last: tuple[float, Reach] | None = None  # with the time that it holds for

    def reach(self, now_s: float, estimate: TargetEstimate, fault: bool, speed_max_m_s: float) -> Reach | None:
        """Return where the target can be, None while it is seen.

        A track that begins again may be a wrong one: it counts only some seconds later.

        Args:
            now_s: The vehicle's clock.
            estimate: Of the target.
            fault: Whether laser or gimbal have a fault: their silence then is no mere gap.
            speed_max_m_s: The target's highest speed.
        """
        unseen_s = now_s - estimate.last_sighting_s
        if estimate.quality is TrackQuality.LOST:
            self._lost_s = now_s
        if unseen_s <= _BLIND_S and not fault:
            if now_s - self._lost_s >= _PROBATION_S or self._last is None:
                self._last = None
                return None
            since_s, reach = self._last
            return reach.after(now_s - since_s)
        speed_m_s = max(speed_max_m_s, estimate.speed_m_s)
        seen = self._tracker.last_seen
        if seen is not None and seen.last_sighting_s == estimate.last_sighting_s:
            east_m, north_m = seen.east_m, seen.north_m
            sigma_m = math.sqrt(max(seen.covariance[0, 0], seen.covariance[1, 1]))
        else:  # the fleet's estimate
            east_m = estimate.east_m - unseen_s * estimate.velocity_east_m_s
            north_m = estimate.north_m - unseen_s * estimate.velocity_north_m_s
            sigma_m = 0.0
        reach = Reach(east_m, north_m, 2.0 * sigma_m + speed_m_s * unseen_s, speed_m_s)
        self._last = now_s, reach
        return reach
