"""Figures of eight, for a gimbal that cannot pan all around.

On a circle the heading turns through all directions, and a target outside it is beyond the gimbal's limits for a part
of each lap. An aircraft that flies past the target on straights, and turns towards it at both ends, always has it
within about 120 degrees of the nose: that is a figure of eight with its long axis across the line of sight. A move is
a half of it: a straight away from the circle, a turn the other way round, and a straight back onto a circle.
"""

from __future__ import annotations

import math

import numpy as np

from sidelong.estimators.compiled import compiled
from sidelong.mission.core.path import FloatArray
from sidelong.mission.geometry.line_kernel import (
    ARC,
    COURSE,
    EAST,
    NORTH,
    LinePoint,
    circle_after,
    laid_out,
    line_at,
    trapezoid,
)
from sidelong.mission.predictive.rollout_kernel import Air, Lines, times_s

# The straights, in radii of the circle, and the turn between them, in radians.
OUTWARD, TURNED, BACK = np.array([1.0, 2.0, 3.0, 4.5]), np.array([2.6, 3.2, 3.8, 4.4]), np.array([1.0, 2.5, 4.0])
EIGHTS = OUTWARD.size * TURNED.size * BACK.size


@compiled
def eight_line(start: LinePoint, eight: int, signed_radius_m: float, ramp: float) -> FloatArray:
    """Return the line (5, n) of an eight; the radius is positive for one that ends on a clockwise circle."""
    out = OUTWARD[eight // (TURNED.size * BACK.size)]
    turn = TURNED[eight // BACK.size % TURNED.size]
    back = BACK[eight % BACK.size]
    radius_m, circle_per_m = abs(signed_radius_m), 1.0 / signed_radius_m
    first = trapezoid(start.curvature_per_m, 0.0, out * radius_m, 0.0, ramp)
    line = laid_out(first, start.east_m, start.north_m, start.course_rad)
    for shape in (
        trapezoid(0.0, -circle_per_m, turn * radius_m, 0.0, ramp),
        trapezoid(0.0, 0.0, back * radius_m, circle_per_m, ramp),
    ):
        part = laid_out(shape, line[EAST, -1], line[NORTH, -1], line[COURSE, -1])
        part[ARC] += line[ARC, -1]
        line = np.concatenate((line, part[:, 1:]), axis=1)
    return line


@compiled
def eights_from(
    start_per_m: float,
    radius_m: float,
    ramp: float,
    step_m: float,
    beyond_m: float,
    heading_rad: float,
    air: Air,
    rate_per_s: float,
) -> Lines:
    """Return the lines of all eights: see :func:`sidelong.mission.predictive.rollout_kernel.spread`."""
    start = LinePoint(0.0, 0.0, 0.0, start_per_m)
    lines = [eight_line(start, eight, radius_m, ramp) for eight in range(EIGHTS)]
    own_first, end_m = np.ones(EIGHTS + 1, np.int64), np.empty(EIGHTS)
    for i in range(EIGHTS):
        end_m[i] = lines[i][ARC, -1]
        own_first[i + 1] = own_first[i] + math.ceil((end_m[i] + beyond_m) / step_m)
    places, time, weight = np.zeros((3, own_first[EIGHTS])), np.zeros(own_first[EIGHTS]), np.ones(own_first[EIGHTS])
    for i in range(EIGHTS):
        first, count = own_first[i], own_first[i + 1] - own_first[i]
        arc = np.empty(count + 1)
        for k in range(count):
            arc[k] = step_m * k
        arc[count] = end_m[i] + beyond_m
        found = np.empty((3, count + 1))
        line_at(lines[i], circle_after(lines[i], radius_m), arc, 0.0, 0.0, found)
        since_s = times_s(heading_rad + found[2], arc, air)
        for k in range(count):
            places[:, first + k] = found[:, k + 1]
            time[first + k] = since_s[k + 1]
            weight[first + k] = math.exp(-rate_per_s * since_s[k + 1])
    trunk = np.zeros(EIGHTS, np.int64)
    return Lines(places[0], places[1], places[2], time, weight, np.array([0, 1]), own_first, trunk, trunk + 1, end_m)
