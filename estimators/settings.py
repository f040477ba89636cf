"""Settings of the estimation. Source: docs/how-to/troubleshooting.md."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from sidelong.estimators.sensing.readings import Source

TargetKind = Literal["unknown", "walker", "cyclist", "car", "boat", "animal"]


@dataclass(frozen=True, slots=True)
class SourceChoice:
    """Which device to listen to; None matches any."""

    message: str | None = None
    component_id: int | None = None
    sensor_id: int | None = None
    orientation: int | None = None

    def matches(self, source: Source) -> bool:
        """Return whether a source matches the selection; None matches any."""
        names = "message", "component_id", "sensor_id", "orientation"
        return all(getattr(self, name) in (None, getattr(source, name)) for name in names)


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Sigmas are one standard deviation. A calibration sigma of 0 switches its estimation off."""

    filter: Literal["imm", "ekf"] = "imm"
    target_kind: TargetKind = "unknown"  # what moves: how much its motions are let wander

    range_sigma_m: float = 0.8  # slant range error, used if the sensor reports no sigma
    yaw_sigma_rad: float = math.radians(0.35)  # of the line of sight
    pitch_sigma_rad: float = math.radians(0.35)
    attitude_sigma_rad: float = math.radians(0.3)  # adds where the gimbal is measured against the aircraft
    position_sigma_m: float = 0.3  # each axis: what changes between sightings, not the common offset

    # How much earlier than their stamps line of sight and range were measured, as far as it is known.
    gimbal_latency_s: float = 0.0
    range_latency_s: float = 0.0
    latency_sigma_s: float = 0.7  # how well both are known; a further delay of each is estimated within it
    range_source: SourceChoice | None = None
    gimbal_source: SourceChoice | None = None
    # What the gimbal's angles are relative to, where its frame flags are wrong; None: as flagged.
    gimbal_frame: Literal["earth", "vehicle", "body"] | None = None
    fix_source: SourceChoice | None = None  # None: a camera's fixes are used only while no laser is received
    lever_arm_body_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # to the gimbal: forward, right, down
    # How the gimbal's base is turned against the airframe; of no effect on an earth-frame gimbal.
    mount_roll_pitch_yaw_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)

    quality_min: float = 0.5  # ranges of a lower signal quality (0..1) are rejected
    gate_nis: float = 20.0  # a larger normalised innovation squared is rejected: 0.02 % of the good sightings
    soft_nis: float = 11.3  # from here to the gate a sighting weighs less the farther it lies: 1 % of the good ones
    reacquire_after: int = 6  # consecutive rejected detections, consistent with one another, restart the track
    coasting_after_s: float = 1.0
    lost_after_s: float = 60.0
    lost_sigma_m: float = 100.0  # a track is lost after this time without a detection, or at this position sigma

    # Prior of the constant errors of gimbal and laser.
    yaw_bias_sigma_rad: float = math.radians(1.0)
    pitch_bias_sigma_rad: float = math.radians(0.5)
    range_bias_sigma_m: float = 0.3

    target_speed_sigma_m_s: float = 5.0  # each axis, before the first sightings
    acceleration_density_m2_s3: float = 0.03  # white acceleration of a target in the filters of a single motion

    @property
    def latencies_s(self) -> tuple[float, float]:
        """Delays of gimbal and laser, s."""
        return self.gimbal_latency_s, self.range_latency_s
