"""From what the gimbal reports to a direction over the ground.

earth     ned_from_sight = q
vehicle   ned_from_sight = ned_from_heading @ heading_from_mount @ q
body      ned_from_sight = ned_from_body @ body_from_mount @ q
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
    """Return the rotation of the aircraft's attitude, body (FRD) to north-east-down."""
    return from_roll_pitch_yaw(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)


def line_of_sight(
    gimbal: GimbalReading, attitude: AttitudeReading | None, parent_from_mount: Quaternion
) -> LineOfSight:
    """Return where the gimbal points. Only an earth-frame gimbal does without the aircraft's attitude.

    Straight down the bearing is 0: a sight within a degree of it has no bearing to speak of.
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
    """Return (east, north, up) from the aircraft's position to its gimbal."""
    north, east, down = rotate(ned_from_body(attitude), lever_arm_body_m)
    return east, north, -down
