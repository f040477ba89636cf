"""A flight as MISB ST 0601 metadata (KLV): where the aircraft was, where its sensor looked, where the target was.

Each UAS Datalink Local Set has the minimum of ST 0902: a file has one after another, for each position of the
aircraft, and a video one for each picture. The time stamps join them to one. Heights are above sea level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import NAMESPACE_URL, uuid5

import numpy as np

from sidelong.app.errors import missing_package
from sidelong.app.records.sensing import Sensing
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.rotations import (
    Quaternion,
    from_roll_pitch_yaw,
    multiply,
    normalized,
    rotate,
    sight_direction,
)
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading
from sidelong.estimators.sensing.sighting import Sighting, parent_of_gimbal
from sidelong.estimators.tracking.sources import SourceSelector, axis_rank
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.core.events import Event, StepOutput

_EVERY_S = 0.2
_SEEN_FOR_S = 1.0  # how long a sighting, or an attitude of the gimbal, is the sensor's present line of sight
_VERSION, _VMTI_VERSION, _SECURITY_VERSION = 19, 6, 12
_LASER_ON, _SLANT_RANGE_MEASURED = 1, 16  # of Generic Flag Data
_CE90, _CE90_MAX_M = 0.9, 4095.0
_GATE_MAX_PX = 510.0
_ACTIVE, _COASTING = 1, 4  # of detectionStatus
_DEPRESSION_MIN_RAD = math.radians(1.0)  # a line of sight nearer to the horizon meets the ground nowhere
# The standard's clock counts leap seconds; most readers take its stamps for UTC. With none declared, both are right.
_LEAP_SECONDS = 0
_UNCLASSIFIED, _GENC_THREE_LETTER, _NO_COUNTRY = 1, 14, "XXX"


@dataclass(frozen=True, slots=True)
class Sensor:
    """What a sensor saw at one moment."""

    ned_from_sight: Quaternion  # of the optical axis: x along it, y to the right, z down
    ground_m: float  # height above home of the ground where it looks
    range_m: float | None = None  # measured slant range; None: where the axis meets the ground


@dataclass(frozen=True, slots=True)
class Marked:
    """The tracked object in a picture, where it is expected while it is hidden."""

    size_px: tuple[int, int]  # width and height of the picture
    edges_px: tuple[float, float, float, float]  # left, top, right and bottom edge of the object
    confidence: float  # 0 to 1; 0 while it is hidden


class UasMetadata:
    """Encodes UAS Datalink Local Sets of a mission. Raises InputError without the package stanag4609.

    booted: when the vehicle's clock was zero. view_rad: horizontal and vertical field of view.
    """

    def __init__(
        self, name: str, plane: LocalPlane, booted: datetime, home_altitude_m: float, view_rad: tuple[float, float]
    ) -> None:
        try:
            import stanag4609  # noqa: PLC0415  # an extra
        except ImportError as error:
            raise missing_package("KLV", "stanag4609") from error
        self._package, self._name, self._plane = stanag4609, name, plane
        self._booted, self._home_altitude_m, self._view_rad = booted, home_altitude_m, view_rad
        security = {1: _UNCLASSIFIED, 2: _GENC_THREE_LETTER, 3: f"//{_NO_COUNTRY}", 12: _GENC_THREE_LETTER}
        security |= {13: _NO_COUNTRY, 22: _SECURITY_VERSION}
        encoded = stanag4609.encode_security_local_set(security)
        self._security = stanag4609.decode_security_local_set(encoded, standalone=False)
        self._identifier = stanag4609.MIISCoreIdentifier(1, minor_id=uuid5(NAMESPACE_URL, f"{name} {booted}"))

    def stamp_us(self, time_s: float) -> int:
        """Return the precision time stamp of a time on the vehicle's clock."""
        at = self._booted + timedelta(seconds=time_s)
        return int(self._package.utc_to_misp_timestamp(at, leap_seconds=_LEAP_SECONDS))

    def packet(
        self,
        time_s: float,
        p: PositionReading,
        attitude: AttitudeReading | None,
        sensor: Sensor | None,
        estimate: TargetEstimate | None,
        marked: Marked | None = None,
    ) -> bytes:
        """Return the set of a moment; what is None is left out."""
        values: dict[int, Any] = {
            2: self.stamp_us(time_s),
            3: self._name,
            10: "sidelong",
            11: "EO",
            12: "Geodetic WGS84",
            **self._place((13, 14, 15), p.east_m, p.north_m, p.height_m),
            16: math.degrees(self._view_rad[0]),
            17: math.degrees(self._view_rad[1]),
            48: self._security,
            56: min(round(math.hypot(p.velocity_east_m_s, p.velocity_north_m_s)), 255),
            65: _VERSION,
            94: self._identifier,
            136: _LEAP_SECONDS,
        }
        if attitude is not None:
            values[5] = math.degrees(attitude.yaw_rad) % 360.0
            values[90], values[91] = math.degrees(attitude.pitch_rad), math.degrees(attitude.roll_rad)
        if sensor is not None:
            values |= self._looked(p, attitude, sensor)
        if estimate is not None and estimate.quality is not TrackQuality.LOST:
            ground_m = 0.0 if sensor is None else sensor.ground_m
            values |= self._place((40, 41, 42), *estimate.position_m(time_s), ground_m)
            # CE90: the radius in which a circular error of the same mean variance stays at 90 %.
            variance_m2 = float(np.trace(estimate.covariance[:2, :2]))
            values[45] = min(math.sqrt(-math.log(1.0 - _CE90) * variance_m2), _CE90_MAX_M)
        if marked is not None:
            values |= self._tracked(values[2], marked)
        return bytes(self._package.encode_uas_local_set(values))

    def _looked(self, p: PositionReading, attitude: AttitudeReading | None, sensor: Sensor) -> dict[int, Any]:
        """Return where the sensor looked: against the airframe, and on the ground."""
        values: dict[int, Any] = {}
        if attitude is not None:
            body = from_roll_pitch_yaw(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)
            w, x, y, z = q = multiply((body[0], -body[1], -body[2], -body[3]), sensor.ned_from_sight)
            forward, right, down = sight_direction(q)
            values[18] = math.degrees(math.atan2(right, forward)) % 360.0
            values[19] = -math.degrees(math.asin(min(max(down, -1.0), 1.0)))
            values[20] = math.degrees(math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))) % 360.0
        north, east, down = rotate(sensor.ned_from_sight, (1.0, 0.0, 0.0))
        range_m = sensor.range_m
        if range_m is not None:
            values[47] = _LASER_ON | _SLANT_RANGE_MEASURED
        elif down > math.sin(_DEPRESSION_MIN_RAD) and p.height_m > sensor.ground_m:
            range_m = (p.height_m - sensor.ground_m) / down
        if range_m is not None:
            values[21], values[22] = range_m, min(2.0 * range_m * math.tan(0.5 * self._view_rad[0]), 10_000.0)
            middle_m = p.east_m + range_m * east, p.north_m + range_m * north, p.height_m - range_m * down
            values |= self._place((23, 24, 25), *middle_m)
        return values

    def _tracked(self, stamp_us: int, marked: Marked) -> dict[int, Any]:
        """Return the track gate, and the ST 0903 set of the object; its pixels count from 1, along the rows."""
        (width, height), (left, top, right, bottom) = marked.size_px, marked.edges_px

        def number(x_px: float, y_px: float) -> int:
            return min(max(int(y_px), 0), height - 1) * width + min(max(int(x_px), 0), width - 1) + 1

        target = {
            1: number(0.5 * (left + right), 0.5 * (top + bottom)),
            2: number(left, top),
            3: number(right, bottom),
        }
        target[5] = round(100.0 * min(max(marked.confidence, 0.0), 1.0))
        target[23] = _ACTIVE if marked.confidence else _COASTING
        package = self._package
        fields = {2: stamp_us, 4: _VMTI_VERSION, 5: 1, 6: 1, 8: width, 9: height}
        encoded = package.encode_vmti_local_set(fields, targets=[package.VTargetData(1, target)])
        gate = {43: min(right - left, _GATE_MAX_PX), 44: min(bottom - top, _GATE_MAX_PX)}
        return {**gate, 74: package.decode_vmti_local_set(encoded, standalone=False)}

    def _place(self, tags: tuple[int, int, int], east_m: float, north_m: float, height_m: float) -> dict[int, float]:
        latitude_deg, longitude_deg = self._plane.latitude_longitude_deg(east_m, north_m)
        return dict(zip(tags, (latitude_deg, longitude_deg, self._home_altitude_m + height_m), strict=True))


class KlvLog:
    """Takes a flight's events in order and replaces ``path``. Raises OSError when it cannot be written."""

    def __init__(self, path: Path, metadata: UasMetadata, tracker: Tracker) -> None:
        self._metadata, self._sensing = metadata, Sensing(tracker)
        self._file = path.open("wb")
        self._seen: Sighting | None = None
        self._gimbal: GimbalReading | None = None
        self._axis_source = SourceSelector(axis_rank)
        self._next_s = -math.inf

    def event(self, event: Event) -> None:
        """Feed an event; each second of positions writes a packet."""
        admitted, outcomes = self._sensing.take(event)
        for outcome in outcomes:
            if outcome.accepted and isinstance(outcome.sighting, Sighting):
                self._seen = outcome.sighting
        if isinstance(admitted, GimbalReading) and self._axis_source.accepts(admitted.source, admitted.time_s):
            self._gimbal = admitted
        if isinstance(admitted, PositionReading) and admitted.time_s >= self._next_s:
            self._next_s = admitted.time_s + _EVERY_S
            sensing, time_s = self._sensing, admitted.time_s
            estimate = sensing.tracker.estimate(time_s)
            self._file.write(
                self._metadata.packet(time_s, admitted, sensing.attitude, self._sensor(time_s), estimate)
            )

    def command(self, command: StepOutput) -> None:
        """Take a command: the metadata has none."""

    def close(self) -> None:
        self._file.close()

    def _sensor(self, time_s: float) -> Sensor | None:
        gimbal, seen, attitude = self._gimbal, self._seen, self._sensing.attitude
        if gimbal is None or time_s - gimbal.time_s > _SEEN_FOR_S or (attitude is None and gimbal.frame != "earth"):
            return None
        parent = parent_of_gimbal(gimbal, attitude, self._sensing.tracker.parent_from_mount)
        is_ranged = seen is not None and seen.has_range and time_s - seen.time_s <= _SEEN_FOR_S
        return Sensor(
            multiply(parent, normalized(gimbal.quaternion_wxyz)),
            0.0 if seen is None else seen.height_m,
            seen.slant_range_m if seen is not None and is_ranged else None,
        )
