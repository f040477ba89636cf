"""The inner loops of :mod:`mission.geometry.separation`."""

from __future__ import annotations

import math

import numpy as np

from estimators.compiled import compiled
from mission.core.path import FloatArray
from mission.geometry._line_kernel import Circling, ground_speed_m_s, nearest_arc_m, point_at


@compiled
def flown_places(
    now_s: float,
    east_m: float,
    north_m: float,
    course_rad: float,
    present: FloatArray,
    present_circle: Circling,
    coming: FloatArray,
    coming_circle: Circling,
    departure_s: float,
    airspeed_m_s: float,
    wind_east_m_s: float,
    wind_north_m_s: float,
    step_s: float,
    found: FloatArray,
) -> None:
    """Fill in (east, north) (2, n) every step_s from now on: along the present line, from the departure the other.

    departure_s is inf where nothing else is coming. Speed over the ground follows the wind.
    """
    arc_m = nearest_arc_m(present, present_circle, east_m, north_m, course_rad)
    line, circle, departed = present, present_circle, False
    for k in range(found.shape[1]):
        if not departed and now_s + k * step_s >= departure_s:
            line, circle, arc_m, departed = coming, coming_circle, 0.0, True
        point = point_at(line, circle, arc_m, east_m, north_m)
        found[0, k], found[1, k] = point.east_m, point.north_m
        arc_m += step_s * ground_speed_m_s(point.course_rad, airspeed_m_s, wind_east_m_s, wind_north_m_s)


@compiled
def min_distance_m(a: FloatArray, b: FloatArray, step_s: float, vertical_m: float, growth_m_s: float) -> float:
    """Return the least distance of places (2, n) of the same times, less what grows with time: nobody keeps time.

    vertical_m: between their heights.
    """
    least_m = np.inf
    for k in range(a.shape[1]):
        flat_m = math.hypot(a[0, k] - b[0, k], a[1, k] - b[1, k]) - growth_m_s * step_s * k
        least_m = min(least_m, math.hypot(max(flat_m, 0.0), vertical_m))
    return least_m
