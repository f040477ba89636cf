"""When another circle has to be flown. Source: Liao et al., Defence Technology 16(4), 2020, equations 9-16."""

from __future__ import annotations

import math

from sidelong.mission.core.requirement import Requirement


def departure_course_rad(move_bearing_rad: float, psi_c_rad: float, clockwise: bool) -> float:
    """Return the switching heading: the course at A, where a move in that direction leaves the circle (9-11)."""
    return move_bearing_rad - psi_c_rad if clockwise else move_bearing_rad + psi_c_rad


def turn_to_go_rad(course_rad: float, wanted_course_rad: float, clockwise: bool) -> float:
    """Return the turn, in [0, 2 pi), that remains on the circle until it is flown on ``wanted_course_rad``."""
    turn_rad = wanted_course_rad - course_rad if clockwise else course_rad - wanted_course_rad
    return turn_rad % (2.0 * math.pi)


def range_after_lap_m(
    aircraft_m: tuple[float, float],
    target_m: tuple[float, float],
    target_velocity_m_s: tuple[float, float],
    lap_s: float,
) -> float:
    """Return the predicted range l_pre, one lap later and at the same point of the circle (12-15).

    Args:
        aircraft_m: East and north of the aircraft, m.
        target_m: East and north of the target, m.
        target_velocity_m_s: East and north velocity of the target, m/s.
    """
    return math.hypot(
        target_m[0] + target_velocity_m_s[0] * lap_s - aircraft_m[0],
        target_m[1] + target_velocity_m_s[1] * lap_s - aircraft_m[1],
    )


def must_move(range_after_lap_m: float, requirement: Requirement) -> bool:
    """Return whether another lap would end outside [Dmin, C Dmax] (16)."""
    return not requirement.range_min_m <= range_after_lap_m <= requirement.threshold * requirement.range_max_m
