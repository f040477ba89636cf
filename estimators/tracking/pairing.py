"""Ranges, lines of sight and poses of different times become sightings.

Readings are kept with their stamps; they were made by a delay earlier. A range waits until gimbal and aircraft are
known on both sides of its time, and takes what lies between. It gives up after ``_WAIT_S``. Over known ground, while
the laser is silent, a line of sight alone becomes a sighting.

Source: docs/explanation/filter.md#measurement.
"""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Callable
from operator import attrgetter
from typing import TYPE_CHECKING

from sidelong.estimators.filters.biases import Delays
from sidelong.estimators.rotations import from_roll_pitch_yaw, interpolated
from sidelong.estimators.sensing.line_of_sight import lever_arm_plane_m, line_of_sight
from sidelong.estimators.sensing.pose import PoseHistory, ReadingHistory
from sidelong.estimators.sensing.readings import IMAGE_TRACKER, GimbalReading, RangeReading
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.settings import TrackerSettings

if TYPE_CHECKING:
    from sidelong.estimators.terrain.ground import Ground

_SPAN_S = 12.0
_WAIT_S = 1.5
_GIMBAL_GAP_MAX_S = 1.0
_WAITING_MAX = 32  # so that what has waited is never long to take in
# Timeout of the laser. After it one line of sight per interval is used, with an uninformative range.
_BEGINNING_S = 3.0
_SILENT_S, _ALONE_EVERY_S = 1.0, 0.2
_UNKNOWN_M, _REACH_M = 2e3, 5_000.0
_time_s = attrgetter("time_s")


class Pairing:
    """Collects what belongs together."""

    def __init__(self, settings: TrackerSettings, poses: PoseHistory) -> None:
        self._settings = settings
        self._poses = poses
        self.gimbal_delay_s, self.range_delay_s = settings.latencies_s
        self.range_factor = 1.0
        self._gimbals: ReadingHistory[GimbalReading] = ReadingHistory(_SPAN_S)
        self._ranges: ReadingHistory[RangeReading] = ReadingHistory(_SPAN_S)
        self._has_arm = any(settings.lever_arm_body_m)
        self.parent_from_mount = from_roll_pitch_yaw(*settings.mount_roll_pitch_yaw_rad)
        self._paired_s, self._begun_s = -math.inf, math.inf
        self._has_image = False  # a camera's tracker reports the target's place in the image
        self._alone: list[float] = []  # times of lines of sight that go without a range
        self.ground: Ground | None = None
        self.waiting: list[RangeReading] = []

    def add_gimbal(self, gimbal: GimbalReading) -> bool:
        """Store a line of sight; return whether it is new and its quaternion is a rotation."""
        w, x, y, z = gimbal.quaternion_wxyz
        if abs(w * w + x * x + y * y + z * z - 1.0) >= 0.1 or not self._gimbals.add(gimbal):
            return False
        by_image = gimbal.source.message == IMAGE_TRACKER
        self._has_image |= by_image
        if self.ground is None or (self._has_image and not by_image):  # nothing keeps the axis on the target
            return True
        # A camera's tracker, or the laser, may begin a little later than the gimbal.
        self._begun_s = min(self._begun_s, gimbal.time_s)
        if gimbal.time_s - self._begun_s < _BEGINNING_S:
            return True
        last_s = self._alone[-1] if self._alone else self._paired_s
        if gimbal.time_s - self._ranges.newest_s > _SILENT_S and gimbal.time_s - last_s >= _ALONE_EVERY_S:
            self._alone.append(gimbal.time_s)
            del self._alone[:-_WAITING_MAX]
        return True

    def change_gimbals(self, changed: Callable[[GimbalReading], GimbalReading]) -> None:
        """Change the stored lines of sight."""
        before, self._gimbals = self._gimbals, ReadingHistory(_SPAN_S)
        for gimbal in before.since(-math.inf):
            self._gimbals.add(changed(gimbal))

    def add_range(self, reading: RangeReading) -> None:
        """Store a range until it can be paired."""
        if self._ranges.add(reading):
            insort(self.waiting, reading, key=_time_s)
            if len(self.waiting) > _WAITING_MAX:
                del self.waiting[0]

    def completed(self) -> list[Sighting]:
        """Return the sightings that can be made now, oldest first."""
        made: list[Sighting] = []
        newest_s = max(self._poses.positions.newest_s, self._gimbals.newest_s, self._ranges.newest_s)
        known_s = min(self._poses.positions.newest_s, self._gimbals.newest_s - self.gimbal_delay_s)
        if self._needs_attitude:
            known_s = min(known_s, self._poses.attitudes.newest_s)
        # A gimbal that is later than the laser is waited for.
        known_s += self.range_delay_s
        wait_s = _WAIT_S + max(0.0, self.gimbal_delay_s - self.range_delay_s)
        while self.waiting and (known_s >= self.waiting[0].time_s or newest_s - self.waiting[0].time_s > wait_s):
            reading = self.waiting.pop(0)
            sighting = self._sighting(reading.time_s - self.range_delay_s, reading)
            if sighting is not None:
                made.append(sighting)
        known_s += self.gimbal_delay_s - self.range_delay_s
        while self._alone and known_s >= self._alone[0]:
            sighting = self._sighting(self._alone.pop(0) - self.gimbal_delay_s)
            if sighting is not None:
                made.append(sighting)
        return made

    def set_delays(self, delays: Delays | None) -> None:
        """Use other delays from now on, rounded to whole milliseconds so that a replay computes the same values.

        Args:
            delays: Delays of laser and gimbal; None: the configured ones.
        """
        used_s, self.range_factor = self._settings.latencies_s, 1.0
        if delays is not None:
            used_s = round(delays.gimbal_s, 3), round(delays.range_s, 3)
            self.range_factor = round(delays.range_factor, 3)
        self.gimbal_delay_s, self.range_delay_s = used_s

    def repeated(self, since_s: float) -> list[Sighting]:
        """Return the paired sightings since a time, computed again with the present delays."""
        self._paired_s = -math.inf
        waiting = {reading.time_s for reading in self.waiting}
        readings = [reading for reading in self._ranges.since(since_s) if reading.time_s not in waiting]
        made = (self._sighting(reading.time_s - self.range_delay_s, reading) for reading in readings)
        return [sighting for sighting in made if sighting is not None]

    @property
    def due(self) -> bool:
        """Whether anything waits to be completed."""
        return bool(self.waiting or self._alone)

    @property
    def _needs_attitude(self) -> bool:
        newest = self._gimbals.newest()
        return self._has_arm or (newest is not None and newest.frame != "earth")

    def _sighting(self, time_s: float, reading: RangeReading | None = None) -> Sighting | None:
        """Return the sighting at a time, with a range or where the line of sight meets the ground."""
        settings = self._settings
        position = self._poses.position_at(time_s)
        found = self._gimbal_at(time_s)
        if position is None or found is None:
            return None
        gimbal, gap_s = found
        needs_attitude = self._needs_attitude or gimbal.frame != "earth"  # the newest may be of another frame
        attitude = self._poses.attitude_at(time_s) if needs_attitude else None
        if attitude is None and needs_attitude:
            return None
        sight = line_of_sight(gimbal, attitude, self.parent_from_mount)
        arm_m = (0.0, 0.0, 0.0) if attitude is None else lever_arm_plane_m(settings.lever_arm_body_m, attitude)
        aircraft_m = position.east_m + arm_m[0], position.north_m + arm_m[1], position.height_m + arm_m[2]
        if reading is not None:
            range_m = self.range_factor * reading.slant_range_m
            range_sigma_m = reading.sigma_m or settings.range_sigma_m
        elif self.ground is not None:
            level_m = self.ground.cut_m(*aircraft_m, sight.bearing_rad, sight.depression_rad, _REACH_M)
            if level_m is None:
                return None
            range_m, range_sigma_m = level_m / math.cos(sight.depression_rad), _UNKNOWN_M
        else:
            return None
        attitude_sigma_rad = 0.0 if gimbal.frame == "earth" else settings.attitude_sigma_rad
        # Several ranges between two lines of sight share the noise of these: none may count it as its own.
        shared = math.sqrt(max(1.0, gap_s / max(abs(time_s - self._paired_s), 1e-3)))
        self._paired_s = max(self._paired_s, time_s)
        return Sighting(
            time_s=time_s,
            slant_range_m=range_m,
            bearing_rad=sight.bearing_rad,
            depression_rad=sight.depression_rad,
            # The same position error in all three axes adds to each measured number separately.
            range_sigma_m=math.hypot(range_sigma_m, settings.position_sigma_m),
            bearing_sigma_rad=math.hypot(
                shared * settings.yaw_sigma_rad,
                attitude_sigma_rad,
                settings.position_sigma_m / (range_m * max(math.cos(sight.depression_rad), 0.01)),
            ),
            depression_sigma_rad=math.hypot(
                shared * settings.pitch_sigma_rad, attitude_sigma_rad, settings.position_sigma_m / range_m
            ),
            aircraft_east_m=aircraft_m[0],
            aircraft_north_m=aircraft_m[1],
            aircraft_height_m=aircraft_m[2],
            quality=None if reading is None else reading.quality,
            has_range=reading is not None,
        )

    def _gimbal_at(self, time_s: float) -> tuple[GimbalReading, float] | None:
        """Return the gimbal's direction, and the gap between the readings that it is interpolated from."""
        time_s += self.gimbal_delay_s
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
