"""Where the circle next to the target lies. Source: Liao et al., Defence Technology 16(4), 2020, equations 17-22."""

from __future__ import annotations

import math

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.requirement import Aircraft, Requirement


def stand_off_m(aircraft: Aircraft, requirement: Requirement) -> float:
    """Return D = Dmin + R, the distance from the target to the circle's centre: the circle just touches Dmin."""
    return requirement.range_min_m + aircraft.radius_m


def circle_next_to(
    target_east_m: float, target_north_m: float, course_rad: float, aircraft: Aircraft, requirement: Requirement
) -> Circle:
    """Return the circle on the required side of a target that moves on ``course_rad`` (20-21).

    Args:
        target_east_m: East of the target, m.
        target_north_m: North of the target, m.
        course_rad: Course of the target, rad.
        aircraft: Limits of the aircraft.
        requirement: Required band and side.
    """
    outward_rad, distance_m = course_rad + requirement.side.normal_turn_rad, stand_off_m(aircraft, requirement)
    return Circle(
        target_east_m + distance_m * math.sin(outward_rad),
        target_north_m + distance_m * math.cos(outward_rad),
        aircraft.radius_m,
        requirement.side.clockwise,
    )


def shifted(circle: Circle, east_m: float, north_m: float) -> Circle:
    """Return the circle after the regular step O2 = O1 + e (17).

    Args:
        circle: The circle.
        east_m: Displacement to the east, m.
        north_m: Displacement to the north, m.
    """
    return Circle(circle.east_m + east_m, circle.north_m + north_m, circle.radius_m, circle.clockwise)
