"""Ranges, lines of sight and poses of different times become sightings.

A range waits until gimbal and aircraft are known on both sides of its time, and takes what lies between. It gives
up after ``_WAIT_S``.
"""

from __future__ import annotations

import math
from bisect import insort
from operator import attrgetter

from estimators.line_of_sight import lever_arm_plane_m, line_of_sight
from estimators.pose import History, PoseHistory
from estimators.readings import GimbalReading, RangeReading
from estimators.rotations import from_roll_pitch_yaw, interpolated
from estimators.settings import TrackerSettings
from estimators.sighting import Sighting

_SPAN_S = 12.0
_WAIT_S = 1.5
_GIMBAL_GAP_MAX_S = 1.0
_WAITING_MAX = 32  # so that what has waited is never long to take in
_time_s = attrgetter("time_s")


class Pairing:
    """Collects what belongs together."""

    def __init__(self, settings: TrackerSettings, poses: PoseHistory) -> None:
        self._settings = settings
        self._poses = poses
        self._gimbals: History[GimbalReading] = History(_SPAN_S)
        self._ranges: History[RangeReading] = History(_SPAN_S)
        self._parent_from_mount = from_roll_pitch_yaw(*settings.mount_roll_pitch_yaw_rad)
        self._paired_s = -math.inf
        self.waiting: list[RangeReading] = []
        self.unpaired = 0

    def add_gimbal(self, gimbal: GimbalReading) -> None:
        """Keep a line of sight; one whose quaternion is no rotation is dropped."""
        length_2 = sum(part * part for part in gimbal.quaternion_wxyz)
        if abs(length_2 - 1.0) < 0.1:
            self._gimbals.add(gimbal)

    def add_range(self, reading: RangeReading) -> None:
        """Keep a range until it can be paired."""
        if self._ranges.add(reading):
            insort(self.waiting, reading, key=_time_s)
            if len(self.waiting) > _WAITING_MAX:
                del self.waiting[0]
                self.unpaired += 1

    def completed(self) -> list[Sighting]:
        """Return the sightings that can be made now, oldest first."""
        made: list[Sighting] = []
        newest_s = max(self._poses.positions.newest_s, self._gimbals.newest_s, self._ranges.newest_s)
        known_s = min(self._poses.positions.newest_s, self._gimbals.newest_s)
        if self._needs_attitude:
            known_s = min(known_s, self._poses.attitudes.newest_s)
        while self.waiting and (known_s >= self.waiting[0].time_s or newest_s - self.waiting[0].time_s > _WAIT_S):
            sighting = self._sighting(self.waiting.pop(0))
            if sighting is None:
                self.unpaired += 1
            else:
                made.append(sighting)
        return made

    @property
    def _needs_attitude(self) -> bool:
        newest = self._gimbals.newest()
        return any(self._settings.lever_arm_body_m) or (newest is not None and newest.frame != "earth")

    def _sighting(self, reading: RangeReading) -> Sighting | None:
        settings = self._settings
        time_s, range_m = reading.time_s, reading.slant_range_m
        position = self._poses.position_at(time_s)
        attitude = self._poses.attitude_at(time_s) if self._needs_attitude else None
        found = self._gimbal_at(time_s)
        if position is None or found is None or (attitude is None and self._needs_attitude):
            return None
        gimbal, gap_s = found
        sight = line_of_sight(gimbal, attitude, self._parent_from_mount)
        arm_m = (0.0, 0.0, 0.0) if attitude is None else lever_arm_plane_m(settings.lever_arm_body_m, attitude)
        attitude_sigma_rad = 0.0 if gimbal.frame == "earth" else settings.attitude_sigma_rad
        # Several ranges between two lines of sight share the noise of these: none may count it as its own.
        shared = math.sqrt(max(1.0, gap_s / max(abs(time_s - self._paired_s), 1e-3)))
        self._paired_s = max(self._paired_s, time_s)
        return Sighting(
            time_s=time_s,
            slant_range_m=range_m,
            bearing_rad=sight.bearing_rad,
            depression_rad=sight.depression_rad,
            # The same position error in all three axes adds to each measured number by itself.
            range_sigma_m=math.hypot(reading.sigma_m or settings.range_sigma_m, settings.position_sigma_m),
            bearing_sigma_rad=math.hypot(
                shared * settings.yaw_sigma_rad,
                attitude_sigma_rad,
                settings.position_sigma_m / (range_m * max(math.cos(sight.depression_rad), 0.01)),
            ),
            depression_sigma_rad=math.hypot(
                shared * settings.pitch_sigma_rad, attitude_sigma_rad, settings.position_sigma_m / range_m
            ),
            aircraft_east_m=position.east_m + arm_m[0],
            aircraft_north_m=position.north_m + arm_m[1],
            aircraft_height_m=position.height_m + arm_m[2],
            quality=reading.quality,
        )

    def _gimbal_at(self, time_s: float) -> tuple[GimbalReading, float] | None:
        """Return where the gimbal pointed, and the gap between the readings that tell it."""
        pair = self._gimbals.around(time_s)
        if pair is None:
            return None
        a, b = pair
        gap_s = b.time_s - a.time_s
        if gap_s == 0.0:
            return a, 0.0
        if gap_s > _GIMBAL_GAP_MAX_S or a.source != b.source or a.frame != b.frame:
            return None
        quaternion = interpolated(a.quaternion_wxyz, b.quaternion_wxyz, (time_s - a.time_s) / gap_s)
        return GimbalReading(time_s, quaternion, a.frame, a.source), gap_s
