"""What the vehicle and its payload report, as plain values: the inputs of the estimation.

Every reading carries the time it was *measured*, on the vehicle's clock. Values are finite; a reader that
meets NaN drops the reading.
"""

from __future__ import annotations

from typing import Literal

from sidelong.estimators.numbers import value_type

IMAGE_TRACKER = "CAMERA_TRACKING_IMAGE_STATUS"  # of a camera that tracks the target off its gimbal's axis
BEACON_MESSAGES = (
    *("FOLLOW_TARGET", "COT", "TARGET_ABSOLUTE", "ADSB_VEHICLE", "AIS_VESSEL"),
    *("GLOBAL_POSITION_INT", "NMEA"),
)


@value_type(frozen=True, slots=True)
class Source:
    """Which device spoke: the MAVLink message, its component, and the device's own id and orientation."""

    message: str
    component_id: int
    sensor_id: int = 0
    orientation: int = 0  # MAV_SENSOR_ORIENTATION; 25 looks down, 100 is a custom quaternion


@value_type(frozen=True, slots=True)
class PositionReading:
    """The aircraft's position and ground velocity; its height is above the autopilot's present home."""

    time_s: float
    east_m: float
    north_m: float
    height_m: float
    velocity_east_m_s: float
    velocity_north_m_s: float
    velocity_up_m_s: float
    home_altitude_m: float | None = None  # above the sea; None: not reported


@value_type(frozen=True, slots=True)
class AttitudeReading:
    """The aircraft's attitude: ned_from_body as roll, pitch, yaw (aerospace order)."""

    time_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float


@value_type(frozen=True, slots=True)
class RangeReading:
    """A slant range along the line of sight."""

    time_s: float
    slant_range_m: float
    source: Source
    sigma_m: float | None = None
    quality: float | None = None  # 0..1; None where the sensor does not report it
    min_range_m: float = 0.0
    max_range_m: float = float("inf")
    sensor_quaternion_wxyz: tuple[float, float, float, float] | None = None  # mounting of a custom orientation


@value_type(frozen=True, slots=True)
class GimbalReading:
    """The line of sight: sight frame relative to ``frame``.

    ``earth``: yaw is relative to north (ned_from_sight). ``vehicle``: yaw is relative to the aircraft's heading
    while roll and pitch stay relative to the horizon, as GIMBAL_DEVICE_ATTITUDE_STATUS defines it for
    GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME. ``body``: relative to the airframe in all axes (no roll or pitch lock).
    """

    time_s: float
    quaternion_wxyz: tuple[float, float, float, float]
    frame: Literal["earth", "vehicle", "body"]
    source: Source


@value_type(frozen=True, slots=True)
class TargetFixReading:
    """A target position in the plane: from a camera's own tracker (CAMERA_TRACKING_GEO_STATUS), or from a beacon.

    A beacon is a receiver that the target carries; its source's message is one of ``BEACON_MESSAGES``.
    """

    time_s: float
    east_m: float
    north_m: float
    sigma_m: float
    source: Source


Reading = PositionReading | AttitudeReading | RangeReading | GimbalReading | TargetFixReading
