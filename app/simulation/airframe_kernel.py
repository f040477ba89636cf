"""The inner loop of :mod:`sidelong.app.simulation.airframe`."""

from __future__ import annotations

import math
from typing import NamedTuple

from sidelong.estimators.compiled import compiled
from sidelong.mission.core.requirement import GRAVITY_M_S2
from sidelong.mission.geometry.line_kernel import ground_speed_m_s, remainder


class Airframe(NamedTuple):
    """answer: the share of the way to its command that the bank goes in a step, within the roll rate."""

    airspeed_m_s: float
    bank_max_rad: float
    roll_rate_max_rad_s: float
    answer: float
    wind_east_m_s: float
    wind_north_m_s: float


class Body(NamedTuple):
    """Where an aircraft is, and how it flies."""

    time_s: float
    east_m: float
    north_m: float
    course_rad: float
    speed_m_s: float
    curvature_per_m: float
    bank_rad: float


@compiled
def stepped(body: Body, frame: Airframe, curvature_per_m: float, step_s: float) -> Body:
    """Roll towards the commanded curvature and fly on for a step."""
    speed_m_s = body.speed_m_s
    wanted_rad = math.atan(speed_m_s * speed_m_s * curvature_per_m / GRAVITY_M_S2)
    wanted_rad = min(max(wanted_rad, -frame.bank_max_rad), frame.bank_max_rad)
    reach_rad = frame.roll_rate_max_rad_s * step_s
    bank_rad = body.bank_rad + min(max(frame.answer * (wanted_rad - body.bank_rad), -reach_rad), reach_rad)
    flown_per_m = GRAVITY_M_S2 * math.tan(bank_rad) / (speed_m_s * speed_m_s)
    turned_rad = flown_per_m * speed_m_s * step_s
    middle_rad = body.course_rad + 0.5 * turned_rad
    course_rad = remainder(body.course_rad + turned_rad)
    windy = frame.wind_east_m_s != 0.0 or frame.wind_north_m_s != 0.0
    return Body(
        body.time_s + step_s,
        body.east_m + speed_m_s * step_s * math.sin(middle_rad),
        body.north_m + speed_m_s * step_s * math.cos(middle_rad),
        course_rad,
        ground_speed_m_s(course_rad, frame.airspeed_m_s, frame.wind_east_m_s, frame.wind_north_m_s)
        if windy
        else frame.airspeed_m_s,
        flown_per_m,
        bank_rad,
    )
