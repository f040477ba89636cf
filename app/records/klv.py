"""A flight as MISB ST 0601 metadata (KLV): where the aircraft was, where its sensor looked, where the target was.

One UAS Datalink Local Set for each position of the aircraft, one after another, as they stand in the metadata
stream of a video; the time stamps join them to one. Heights are above sea level.
"""

from __future__ import annotations

import math
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from sidelong.app.errors import missing_package
from sidelong.app.records.sensing import Sensing
from sidelong.estimators.estimate import TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.rotations import from_roll_pitch_yaw, rotate
from sidelong.estimators.sensing.readings import AttitudeReading, PositionReading
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.core.events import Event, StepOutput

_EVERY_S = 0.2
_SEEN_FOR_S = 1.0  # how long a sighting is the sensor's present line of sight
_VERSION = 19
_LASER_ON, _SLANT_RANGE_MEASURED = 1, 16  # of Generic Flag Data
_CE90 = 0.9
# The standard's clock counts leap seconds; most readers take its stamps for UTC. With none declared, both are right.
_LEAP_SECONDS = 0


class KlvLog:
    """Takes a flight's events in order and replaces ``path``.

    booted is when the vehicle's clock was zero; home_altitude_m is above sea level. Raises InputError when the
    package stanag4609 is not installed, OSError when the file cannot be written.
    """

    def __init__(
        self, path: Path, name: str, plane: LocalPlane, tracker: Tracker, booted: datetime, home_altitude_m: float
    ) -> None:
        try:
            from stanag4609.st0601 import encode_uas_local_set, utc_to_misp_timestamp  # noqa: PLC0415  # an extra
        except ImportError as error:
            raise missing_package("KLV", "stanag4609") from error
        self._encode, self._stamp = encode_uas_local_set, utc_to_misp_timestamp
        self._file = path.open("wb")
        self._name, self._plane, self._sensing = name, plane, Sensing(tracker)
        self._booted, self._home_altitude_m = booted, home_altitude_m
        self._seen: Sighting | None = None
        self._next_s = -math.inf

    def event(self, event: Event) -> None:
        admitted, outcomes = self._sensing.take(event)
        for outcome in outcomes:
            if outcome.accepted and isinstance(outcome.sighting, Sighting):
                self._seen = outcome.sighting
        if isinstance(admitted, PositionReading) and admitted.time_s >= self._next_s:
            self._next_s = admitted.time_s + _EVERY_S
            self._file.write(self._encode(self._values(admitted)))

    def command(self, command: StepOutput) -> None:
        """Take a command: the metadata has none."""

    def close(self) -> None:
        self._file.close()

    def _values(self, p: PositionReading) -> dict[int, Any]:
        """Return the values by their tags in ST 0601."""
        values: dict[int, Any] = {
            2: self._stamp(self._booted + timedelta(seconds=p.time_s), leap_seconds=_LEAP_SECONDS),
            3: self._name,
            10: "sidelong",
            12: "Geodetic WGS84",
            **self._place((13, 14, 15), p.east_m, p.north_m, p.height_m),
            56: min(round(math.hypot(p.velocity_east_m_s, p.velocity_north_m_s)), 255),
            65: _VERSION,
            136: _LEAP_SECONDS,
        }
        attitude = self._sensing.attitude
        if attitude is not None:
            values[5] = math.degrees(attitude.yaw_rad) % 360.0
            values[90], values[91] = math.degrees(attitude.pitch_rad), math.degrees(attitude.roll_rad)
        seen = self._seen
        if seen is not None and p.time_s - seen.time_s <= _SEEN_FOR_S:
            values |= self._place((23, 24, 25), seen.east_m, seen.north_m, seen.height_m)
            values[21] = seen.slant_range_m
            values[47] = _LASER_ON | _SLANT_RANGE_MEASURED
            if attitude is not None:
                values[18], values[19] = _relative_deg(seen, attitude)
                values[20] = 0.0
        estimate = self._sensing.tracker.estimate(p.time_s)
        if estimate is not None and estimate.quality is not TrackQuality.LOST:
            height_m = seen.height_m if seen is not None else 0.0
            values |= self._place((40, 41, 42), estimate.east_m, estimate.north_m, height_m)
            # CE90: the radius in which a circular error of the same mean variance stays at 90 %.
            values[45] = math.sqrt(-math.log(1.0 - _CE90) * float(np.trace(estimate.covariance[:2, :2])))
        return values

    def _place(self, tags: tuple[int, int, int], east_m: float, north_m: float, height_m: float) -> dict[int, float]:
        latitude_deg, longitude_deg = self._plane.latitude_longitude_deg(east_m, north_m)
        return dict(zip(tags, (latitude_deg, longitude_deg, self._home_altitude_m + height_m), strict=True))


def _relative_deg(seen: Sighting, attitude: AttitudeReading) -> tuple[float, float]:
    """Return azimuth and elevation of the line of sight against the airframe."""
    cos_d = math.cos(seen.depression_rad)
    north, east = cos_d * math.cos(seen.bearing_rad), cos_d * math.sin(seen.bearing_rad)
    w, x, y, z = from_roll_pitch_yaw(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)
    forward, right, down = rotate((w, -x, -y, -z), (north, east, math.sin(seen.depression_rad)))
    return math.degrees(math.atan2(right, forward)) % 360.0, -math.degrees(math.asin(min(max(down, -1.0), 1.0)))
