"""The inner loops of :mod:`sidelong.mission.upload.line_tracking`: steering along waypoints, and flights of them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled, inner
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import GRAVITY_M_S2
from sidelong.mission.geometry.line_kernel import Air, Circling, LinePoint, remainder

IntArray = npt.NDArray[np.int64]
Place = tuple[float, float]  # east, north

_STEP_S = 0.25
_LINE_INTERCEPT = math.sin(math.pi / 4)  # a line is met at 45 degrees at most


class Guidance(NamedTuple):
    """The guidance law: gain_per_s / v is g, look_ahead_s * v is l, at a ground speed v; the aircraft, and its air.

    A leg ends switch_m before its waypoint. first_is_line: whether the first leg is a line.
    """

    gain_per_s: float
    look_ahead_s: float
    switch_m: float
    first_is_line: bool
    roll_lag_s: float
    bank_max_rad: float
    roll_rate_max_rad_s: float
    air: Air


@inner
def is_done(at_m: Place, begin_m: Place, end_m: Place, switch_m: float) -> bool:
    """Return whether a leg ends here: near its waypoint, or abreast of it. begin_m is NaN on a first leg."""
    past_east_m, past_north_m = at_m[0] - end_m[0], at_m[1] - end_m[1]
    if math.hypot(past_east_m, past_north_m) <= switch_m:
        return True
    return (end_m[0] - begin_m[0]) * past_east_m + (end_m[1] - begin_m[1]) * past_north_m >= 0.0


@inner
def _pursue(error_rad: float, speed_m_s: float, law: Guidance) -> float:
    error_rad = remainder(error_rad)
    return law.gain_per_s / speed_m_s * math.sin(max(-0.5 * math.pi, min(0.5 * math.pi, error_rad)))


@inner
def to_line_per_m(
    at_m: Place, course_rad: float, speed_m_s: float, begin_m: Place, end_m: Place, law: Guidance
) -> float:
    """Return the curvature that leads to the line between waypoints, or, with a first one of NaN, to the second."""
    if math.isnan(begin_m[0]):
        return _pursue(math.atan2(end_m[0] - at_m[0], end_m[1] - at_m[1]) - course_rad, speed_m_s, law)
    line_rad = math.atan2(end_m[0] - begin_m[0], end_m[1] - begin_m[1])
    right_m = (at_m[0] - end_m[0]) * math.cos(line_rad) - (at_m[1] - end_m[1]) * math.sin(line_rad)
    offset = max(-_LINE_INTERCEPT, min(_LINE_INTERCEPT, right_m / (law.look_ahead_s * speed_m_s)))
    return _pursue(line_rad - math.asin(offset) - course_rad, speed_m_s, law)


@inner
def to_circle_per_m(at_m: Place, course_rad: float, speed_m_s: float, circle: Circling, law: Guidance) -> float:
    """Return the curvature that leads onto a circle."""
    east_m, north_m = at_m[0] - circle.east_m, at_m[1] - circle.north_m
    distance_m, radius_m = math.hypot(east_m, north_m), abs(circle.radius_m)
    turn = 1.0 if circle.radius_m > 0.0 else -1.0
    outside_m = distance_m - radius_m
    error_rad = remainder(math.atan2(east_m, north_m) + turn * 0.5 * math.pi - course_rad)
    gain_per_m, look_ahead_m = law.gain_per_s / speed_m_s, law.look_ahead_s * speed_m_s
    hold_per_m = turn * math.cos(error_rad) ** 2 / max(radius_m / 2.0, distance_m) + gain_per_m * (
        math.sin(error_rad) + turn * outside_m / look_ahead_m
    )
    if outside_m <= 0.0:
        return hold_per_m
    # Far outside, the law for the circle would turn too early: steer for its centre until it turns less.
    centre_per_m = _pursue(math.atan2(-east_m, -north_m) - course_rad, speed_m_s, law)
    return centre_per_m if turn * centre_per_m < turn * hold_per_m else hold_per_m


@inner
def _ground_speed_m_s(course_rad: float, air: Air) -> float:
    sine, cosine = math.sin(course_rad), math.cos(course_rad)
    along_m_s = air.wind_x_m_s * sine + air.wind_y_m_s * cosine
    across_m_s = air.wind_x_m_s * cosine - air.wind_y_m_s * sine
    air_m_s2 = air.airspeed_m_s * air.airspeed_m_s - across_m_s * across_m_s
    return max(along_m_s + math.sqrt(max(air_m_s2, 0.0)), 1.0)


@compiled
def flown(start: LinePoint, waypoints: FloatArray, circle: Circling, law: Guidance, duration_s: float) -> FloatArray:
    """Return rows of (time s, east m, north m) (n, 3) of a flight of waypoints (k, 2) to a circle."""
    east_m, north_m, course_rad, curvature_per_m = start
    begin_m = (east_m, north_m) if law.first_is_line else (np.nan, np.nan)
    rows, leg = np.empty((math.ceil(duration_s / _STEP_S) + 1, 3)), 0
    lagged = 1.0 - math.exp(-_STEP_S / law.roll_lag_s)
    for step in range(len(rows)):
        at_m = (east_m, north_m)
        rows[step, 0], rows[step, 1], rows[step, 2] = step * _STEP_S, east_m, north_m
        speed_m_s = _ground_speed_m_s(course_rad, law.air)
        while leg < len(waypoints) and is_done(at_m, begin_m, (waypoints[leg, 0], waypoints[leg, 1]), law.switch_m):
            begin_m, leg = (waypoints[leg, 0], waypoints[leg, 1]), leg + 1
        if leg == len(waypoints):
            wanted_per_m = to_circle_per_m(at_m, course_rad, speed_m_s, circle, law)
        else:
            end_m = (waypoints[leg, 0], waypoints[leg, 1])
            wanted_per_m = to_line_per_m(at_m, course_rad, speed_m_s, begin_m, end_m, law)
        tightest_per_m = GRAVITY_M_S2 * math.tan(law.bank_max_rad) / speed_m_s**2
        wanted_per_m = max(-tightest_per_m, min(tightest_per_m, wanted_per_m))
        ramp_per_m = GRAVITY_M_S2 * law.roll_rate_max_rad_s / speed_m_s**2 * _STEP_S
        change_per_m = max(-ramp_per_m, min(ramp_per_m, (wanted_per_m - curvature_per_m) * lagged))
        way_m = speed_m_s * _STEP_S
        turned_rad = (curvature_per_m + change_per_m / 2.0) * way_m
        middle_rad = course_rad + turned_rad / 2.0
        east_m, north_m = east_m + way_m * math.sin(middle_rad), north_m + way_m * math.cos(middle_rad)
        course_rad += turned_rad
        curvature_per_m += change_per_m
    return rows


@compiled
def nearest_on(
    rows: FloatArray,
    planned_m: FloatArray,
    arc_m: FloatArray,
    line_east_m: FloatArray,
    line_north_m: FloatArray,
    window_m: float,
) -> tuple[IntArray, FloatArray]:
    """Return the index of the nearest point of a line for each row of a flight, and the distance there, (n,) each.

    arc_m, line_east_m, line_north_m (k,): the line. planned_m (n,), rising: where along it each row should be. The
    nearest point is looked for within the window about that; the distance is infinite where none is.
    """
    nearest, apart_m = np.zeros(len(rows), np.int64), np.full(len(rows), np.inf)
    first = 0
    for k in range(len(rows)):
        while first < len(arc_m) and arc_m[first] < planned_m[k] - window_m:
            first += 1
        i = first
        while i < len(arc_m) and arc_m[i] <= planned_m[k] + window_m:
            here_m = math.hypot(rows[k, 1] - line_east_m[i], rows[k, 2] - line_north_m[i])
            if here_m < apart_m[k]:
                nearest[k], apart_m[k] = i, here_m
            i += 1
    return nearest, apart_m
