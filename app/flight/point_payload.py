"""Points the gimbal at the estimate by the payload's own protocol."""

from __future__ import annotations

import math
from collections.abc import Callable

from sidelong.estimators.estimate import TrackQuality
from sidelong.estimators.frames import wrap_rad
from sidelong.mission.control.snapshot import Snapshot

_EVERY_S = 0.2  # of the vehicle's time: in that time a circling aircraft turns by 4 degrees


class PayloadPointer:
    """An ``Observer`` that commands the gimbal's angles five times a second at most.

    Nothing is commanded while the track is lost, before the mission or after a yield.

    Args:
        point: takes pitch and yaw relative to the aircraft's heading, rad.
        heading_rad: returns the aircraft's heading, None while it is not known.
    """

    def __init__(self, point: Callable[[float, float], object], heading_rad: Callable[[], float | None]) -> None:
        self._point, self._heading_rad = point, heading_rad
        self._next_s = -math.inf

    def show(self, snapshot: Snapshot) -> None:
        """Command the angles if it is time to."""
        estimate, aircraft, heading_rad = snapshot.estimate, snapshot.aircraft, self._heading_rad()
        if not snapshot.phase.in_control or estimate is None or aircraft is None or heading_rad is None:
            return
        if estimate.quality is TrackQuality.LOST or snapshot.time_s < self._next_s:
            return
        self._next_s = snapshot.time_s + _EVERY_S
        target_east_m, target_north_m = estimate.position_m(snapshot.time_s)
        east_m, north_m = target_east_m - aircraft.east_m, target_north_m - aircraft.north_m
        height_m = snapshot.sensor_status.height_m  # above home, as the ground below the target is taken to be
        if not math.isfinite(height_m):
            return
        pitch_rad = -math.atan2(height_m, math.hypot(east_m, north_m))
        self._point(pitch_rad, wrap_rad(math.atan2(east_m, north_m) - heading_rad))
