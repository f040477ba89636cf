"""The inner loops of :mod:`sidelong.mission.geometry.separation`."""

from __future__ import annotations

import math

import numpy as np

from sidelong.estimators.compiled import compiled
from sidelong.mission.core.path import FloatArray
from sidelong.mission.geometry.line_kernel import Circling, ground_speed_m_s, nearest_arc_m, point_at


@compiled
def flown_places(
    state: tuple[float, float, float, float],
    present: FloatArray,
    present_circle: Circling,
    coming: FloatArray,
    coming_circle: Circling,
    departure_s: float,
    wind: tuple[float, float, float],
    step_s: float,
    found: FloatArray,
) -> None:
    """Fill in (east, north, course) (3, n) every step_s: along the present line, from the departure on the other.

    state: time, east, north and course from which on; departure_s is inf where nothing else is coming. wind: airspeed
    and wind (east, north), after which goes the speed over the ground.
    """
    now_s, east_m, north_m, course_rad = state
    airspeed_m_s, wind_east_m_s, wind_north_m_s = wind
    arc_m = nearest_arc_m(present, present_circle, east_m, north_m, course_rad)
    line, circle, departed = present, present_circle, False
    for k in range(found.shape[1]):
        if not departed and now_s + k * step_s >= departure_s:
            line, circle, arc_m, departed = coming, coming_circle, 0.0, True
        point = point_at(line, circle, arc_m, east_m, north_m)
        found[0, k], found[1, k], found[2, k] = point.east_m, point.north_m, point.course_rad
        arc_m += step_s * ground_speed_m_s(point.course_rad, airspeed_m_s, wind_east_m_s, wind_north_m_s)


@compiled
def min_distance_m(a: FloatArray, b: FloatArray, step_s: float, vertical_m: float, growth_m_s: float) -> float:
    """Return the least distance of places of the same times, less an allowance that grows with time.

    a, b: (east, north) and more (2 or 3, n). vertical_m: between their heights.
    """
    least_m = np.inf
    for k in range(a.shape[1]):
        flat_m = math.hypot(a[0, k] - b[0, k], a[1, k] - b[1, k]) - growth_m_s * step_s * k
        least_m = min(least_m, math.hypot(max(flat_m, 0.0), vertical_m))
    return least_m
