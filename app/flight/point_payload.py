"""Points the gimbal at the estimate by the payload's own protocol."""

from __future__ import annotations

import math
from collections.abc import Callable

from sidelong.estimators.estimate import TrackQuality
from sidelong.estimators.rotations import rotate
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.control.snapshot import Snapshot

_EVERY_S = 0.2  # of the vehicle's time: in that time a circling aircraft turns by 4 degrees


class PayloadPointer:
    """An ``Observer`` that commands the gimbal's angles five times a second at most.

    Nothing is commanded while the track is lost, before the mission or after a yield.

    Args:
        point: takes pitch and yaw of the gimbal in its mount, level and relative to the aircraft's heading, rad.
        heading_rad: returns the aircraft's heading, None while it is not known.
        tracker: knows the mount and the gimbal's yaw error.
        target_height_m: returns the target's height above home at a place (east, north), m.
    """

    def __init__(
        self,
        point: Callable[[float, float], object],
        heading_rad: Callable[[], float | None],
        tracker: Tracker,
        target_height_m: Callable[[float, float], float],
    ) -> None:
        self._point, self._heading_rad = point, heading_rad
        self._tracker, self._target_height_m = tracker, target_height_m
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
        down_m = snapshot.sensor_status.height_m - self._target_height_m(target_east_m, target_north_m)
        if not math.isfinite(down_m):
            return
        # The gimbal reports its yaw with the error, and so turns too far by it.
        yaw_rad = math.atan2(east_m, north_m) - heading_rad + self._tracker.calibration.yaw_bias_rad
        level_m = math.hypot(east_m, north_m)
        w, x, y, z = self._tracker.parent_from_mount
        forward_m, right_m, down_m = rotate(
            (w, -x, -y, -z), (level_m * math.cos(yaw_rad), level_m * math.sin(yaw_rad), down_m)
        )
        self._point(-math.atan2(down_m, math.hypot(forward_m, right_m)), math.atan2(right_m, forward_m))
