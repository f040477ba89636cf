"""From what the gimbal reports to a direction over the ground.

earth     ned_from_sight = q
vehicle   ned_from_sight = ned_from_heading @ heading_from_mount @ q
body      ned_from_sight = ned_from_body @ body_from_mount @ q

Source: MAVLink gimbal protocol v2, <https://mavlink.io/en/services/gimbal_v2.html>.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.estimators.rotations import (
    Quaternion,
    Vector,
    from_roll_pitch_yaw,
    multiply,
    normalized,
    rotate,
    sight_direction,
)
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading


@dataclass(frozen=True, slots=True)
class LineOfSight:
    """bearing_rad is a compass angle, depression_rad positive below the horizon."""

    bearing_rad: float
    depression_rad: float


def ned_from_body(attitude: AttitudeReading) -> Quaternion:
    """Return the aircraft's attitude as a rotation from body (forward, right, down) to north-east-down."""
    return from_roll_pitch_yaw(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)


def line_of_sight(
    gimbal: GimbalReading, attitude: AttitudeReading | None, parent_from_mount: Quaternion
) -> LineOfSight:
    """Return the direction in which the gimbal points.

    Straight down the bearing is 0: a line of sight within a degree of it has no usable bearing.

    Args:
        gimbal: The gimbal's orientation and its frame.
        attitude: Attitude of the aircraft; None is accepted for an earth-frame gimbal only.
        parent_from_mount: Rotation from the gimbal's mount to its parent frame.
    """
    direction = sight_direction(normalized(gimbal.quaternion_wxyz))
    if gimbal.frame != "earth":
        if attitude is None:
            raise ValueError(f"a {gimbal.frame}-frame gimbal points nowhere without the aircraft's attitude")
        aircraft = (
            from_roll_pitch_yaw(0.0, 0.0, attitude.yaw_rad) if gimbal.frame == "vehicle" else ned_from_body(attitude)
        )
        direction = rotate(multiply(aircraft, parent_from_mount), direction)
    north, east, down = direction
    return LineOfSight(math.atan2(east, north), math.atan2(down, math.hypot(north, east)))


def lever_arm_plane_m(lever_arm_body_m: Vector, attitude: AttitudeReading) -> Vector:
    """Return the gimbal's position relative to the aircraft's position.

    Args:
        lever_arm_body_m: The same in body axes (forward, right, down), m.
        attitude: Attitude of the aircraft.

    Returns:
        (east, north, up), m.
    """
    north, east, down = rotate(ned_from_body(attitude), lever_arm_body_m)
    return east, north, -down
