"""Figures of eight, for a gimbal that cannot pan all around.

On a circle the heading turns through all directions, and a target outside it is beyond the gimbal's limits for a part
of each lap. An aircraft that flies past the target and turns towards it at both ends always has it within about 120
degrees of the nose: that is a figure of eight with its long axis across the line of sight. Its legs are bent around
the target: on a straight one the target falls back. A move is a half of it: a leg away from the circle, a turn
the other way round, and a leg back onto a circle.
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
    Trapezoid,
    laid_out,
    moved_m,
    trapezoid,
    turned_rad,
)
from sidelong.mission.predictive.rollout_kernel import Air, Lines, times_s

# The length of the legs, in radii of the circle; their curvature towards the target, as a share of the circle's; and
# the turn between them, in radians.
OUTWARD, BACK, BEND = np.array([1.5, 3.5, 5.5, 7.5]), np.array([1.5, 3.5, 5.5, 7.5]), np.array([0.13, 0.27])
TURNED = np.array([2.2, 2.7, 3.2])
EIGHTS = OUTWARD.size * BACK.size * BEND.size * TURNED.size


@compiled
def shapes_of(
    start_per_m: float, eight: int, signed_radius_m: float, ramp: float
) -> tuple[Trapezoid, Trapezoid, Trapezoid]:
    """Return leg, turn and leg of an eight; the radius is positive for one that ends on a clockwise circle."""
    turned, rest = TURNED[eight % TURNED.size], eight // TURNED.size
    bend, rest = BEND[rest % BEND.size], rest // BEND.size
    back, outward = BACK[rest % BACK.size], OUTWARD[rest // BACK.size]
    radius_m, circle_per_m = abs(signed_radius_m), 1.0 / signed_radius_m
    return (
        trapezoid(start_per_m, -bend * circle_per_m, outward * radius_m, -circle_per_m, ramp),
        trapezoid(-circle_per_m, -circle_per_m, turned * radius_m, -circle_per_m, ramp),
        trapezoid(-circle_per_m, bend * circle_per_m, back * radius_m, circle_per_m, ramp),
    )


@compiled
def eight_line(start: LinePoint, eight: int, signed_radius_m: float, ramp: float) -> FloatArray:
    """Return the line (5, n) of an eight."""
    leg, turn, leg_back = shapes_of(start.curvature_per_m, eight, signed_radius_m, ramp)
    line = laid_out(leg, start.east_m, start.north_m, start.course_rad)
    for shape in (turn, leg_back):
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
    own_first, end_m = np.ones(EIGHTS + 1, np.int64), np.empty(EIGHTS)
    for i in range(EIGHTS):
        leg, turn, leg_back = shapes_of(start_per_m, i, radius_m, ramp)
        end_m[i] = leg[5] + turn[5] + leg_back[5]
        own_first[i + 1] = own_first[i] + math.ceil((end_m[i] + beyond_m) / step_m)
    samples = own_first[EIGHTS]
    x, y, turned, time, weight = (
        np.zeros(samples),
        np.zeros(samples),
        np.zeros(samples),
        np.zeros(samples),
        np.ones(samples),
    )
    for i in range(EIGHTS):
        shapes = shapes_of(start_per_m, i, radius_m, ramp)
        first, last, part = own_first[i], own_first[i + 1] - 1, 0
        x_m, y_m, arc_m, begun_m, begun_rad = 0.0, 0.0, 0.0, 0.0, 0.0
        arc, course = np.zeros(last - first + 2), np.full(last - first + 2, heading_rad)
        for s in range(first, last + 1):
            to_m = end_m[i] + beyond_m if s == last else arc_m + step_m
            while True:
                until_m = to_m if part == 2 else min(to_m, begun_m + shapes[part][5])
                across_m, along_m = moved_m(shapes[part], begun_rad, arc_m - begun_m, until_m - begun_m)
                x_m, y_m, arc_m = x_m + across_m, y_m + along_m, until_m
                if until_m == to_m:
                    break
                begun_rad += turned_rad(shapes[part], shapes[part][5])
                begun_m, part = until_m, part + 1
            x[s], y[s], turned[s] = x_m, y_m, begun_rad + turned_rad(shapes[part], arc_m - begun_m)
            arc[s - first + 1], course[s - first + 1] = arc_m, heading_rad + turned[s]
        time[first : last + 1] = times_s(course, arc, air)[1:]
        weight[first : last + 1] = np.exp(-rate_per_s * time[first : last + 1])
    trunk = np.zeros(EIGHTS, np.int64)
    return Lines(x, y, turned, time, weight, np.array([0, 1]), own_first, trunk, trunk + 1, end_m)
