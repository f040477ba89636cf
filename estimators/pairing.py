"""Ranges, lines of sight and poses of different times become sightings.

A range waits until gimbal and aircraft are known on both sides of its time, and takes what lies between. It gives
up after ``_WAIT_S``.
"""

from __future__ import annotations

import math
from bisect import insort
from operator import attrgetter

from estimators.line_of_sight import LineOfSight, lever_arm_plane_m, line_of_sight
from estimators.pose import History, PoseHistory
from estimators.readings import AttitudeReading, GimbalReading, RangeReading
from estimators.rotations import from_roll_pitch_yaw, interpolated
from estimators.settings import TrackerSettings
from estimators.sighting import Sighting

_WAIT_S = 1.5
_GIMBAL_GAP_MAX_S = 1.0
_time_s = attrgetter("time_s")


class Pairing:
    """Collects what belongs together."""

    def __init__(self, settings: TrackerSettings, poses: PoseHistory) -> None:
        self._settings = settings
        self._poses = poses
        self._gimbals: History[GimbalReading] = History(12.0)
        self._ranges: History[RangeReading] = History(12.0)
        self._parent_from_mount = from_roll_pitch_yaw(*settings.mount_roll_pitch_yaw_rad)
        self.waiting: list[RangeReading] = []
        self.unpaired = 0

    def add_gimbal(self, gimbal: GimbalReading) -> None:
        self._gimbals.add(gimbal)

    def add_range(self, reading: RangeReading) -> None:
        if self._ranges.add(reading):
            insort(self.waiting, reading, key=_time_s)

    def completed(self) -> list[Sighting]:
        """Return the sightings that can be made now, oldest first."""
        made: list[Sighting] = []
        newest_s = max(self._poses.positions.newest_s, self._gimbals.newest_s, self._ranges.newest_s)
        while self.waiting:
            reading = self.waiting[0]
            bracketed = min(self._poses.positions.newest_s, self._gimbals.newest_s) >= reading.time_s
            if not bracketed and newest_s - reading.time_s < _WAIT_S:
                break
            del self.waiting[0]
            sighting = self._sighting(reading)
            if sighting is None:
                self.unpaired += 1
            else:
                made.append(sighting)
        return made

    def _sighting(self, reading: RangeReading) -> Sighting | None:
        settings = self._settings
        position = self._poses.position_at(reading.time_s)
        attitude = self._poses.attitude_at(reading.time_s)
        sight = self._sight_at(reading.time_s, attitude)
        if position is None or sight is None:
            return None
        east_m, north_m, height_m = position.east_m, position.north_m, position.height_m
        if attitude is not None and any(settings.lever_arm_body_m):
            arm_east_m, arm_north_m, arm_up_m = lever_arm_plane_m(settings.lever_arm_body_m, attitude)
            east_m, north_m, height_m = east_m + arm_east_m, north_m + arm_north_m, height_m + arm_up_m
        range_m = reading.slant_range_m
        return Sighting(
            time_s=reading.time_s,
            slant_range_m=range_m,
            bearing_rad=sight.bearing_rad,
            depression_rad=sight.depression_rad,
            # The same position error in all three axes adds to each measured number by itself.
            range_sigma_m=math.hypot(reading.sigma_m or settings.range_sigma_m, settings.position_sigma_m),
            bearing_sigma_rad=math.hypot(
                settings.yaw_sigma_rad, settings.position_sigma_m / (range_m * math.cos(sight.depression_rad))
            ),
            depression_sigma_rad=math.hypot(settings.pitch_sigma_rad, settings.position_sigma_m / range_m),
            aircraft_east_m=east_m,
            aircraft_north_m=north_m,
            aircraft_height_m=height_m,
            aircraft_velocity_east_m_s=position.velocity_east_m_s,
            aircraft_velocity_north_m_s=position.velocity_north_m_s,
            quality=reading.quality,
        )

    def _sight_at(self, time_s: float, attitude: AttitudeReading | None) -> LineOfSight | None:
        pair = self._gimbals.around(time_s)
        if pair is None:
            return None
        a, b = pair
        gap_s = b.time_s - a.time_s
        if gap_s > _GIMBAL_GAP_MAX_S:
            return None
        quaternion = a.quaternion_wxyz
        if gap_s > 0.0:
            quaternion = interpolated(quaternion, b.quaternion_wxyz, (time_s - a.time_s) / gap_s)
        return line_of_sight(GimbalReading(time_s, quaternion, a.frame, a.source), attitude, self._parent_from_mount)
