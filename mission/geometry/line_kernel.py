r"""The inner loops of flown lines: trapezoids, where an aircraft is along its plan, and how it is steered back to it.

A transition is a curvature trapezoid, which can begin anywhere, at any moment, and ends on a circle::

    curvature
      start ----.                      .---- final: the circle
                 \                    /
                  '---- hold --------'
              ramp      hold length    ramp          arc length ->

Curvature is continuous, and its rate along the line never exceeds the sharpness. Where start, hold and final are
within a limit, so is every point between. A transition under way is retargeted by a trapezoid from the curvature
there. Course is a piecewise quadratic of arc length (exact); position is its Gauss quadrature.

A line is an array (5, n) with the rows ARC .. CURVATURE, n = 0 for a plan that is only its circle. The radius of
a circle is signed, positive for a clockwise one.

Source: docs/explanation/planners.md#transitions; Fraichard and Scheuer, "From Reeds and Shepp's to
continuous-curvature paths", IEEE Transactions on Robotics 20(6), 2004.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sidelong.estimators.compiled import compiled, inlined, inner, inner_inlined
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import GRAVITY_M_S2, Aircraft

ARC, EAST, NORTH, COURSE, CURVATURE = range(5)
# Metres that count as much as one radian of course when the fitting point of a line that crosses itself is sought.
_COURSE_WEIGHT_M = 50.0
FINE_STEP_M = 2.0
# Gauss-Legendre on [0, 1]: three nodes make steps of 2 m exact to 1e-12 m, two make steps of 10 m exact to 1 mm.
_NODE_3 = math.sqrt(0.15)
_NODE_2 = 0.5 / math.sqrt(3.0)

# Planned lines roll from one turn into the opposite one in this time, with at least and at most these shares of the
# aircraft's roll rate: the rest is left to the autopilot for gusts and corrections.
_REVERSAL_S = 3.0
_MIN_SHARE, _MAX_SHARE = 1.0 / 6.0, 1.0 / 2.0

# Turns of a transition that are tighter than the circle bank no more than this.
_TURN_BANK_RAD = math.radians(30.0)

# Further off its line than this, or on another course, an aircraft is not following its plan.
OFF_TRACK_M, OFF_TRACK_RAD = 40.0, math.radians(40.0)


class Trapezoid(NamedTuple):
    """A line that ramps from one curvature to another, holds that, and ramps on to the one of its circle.

    first_per_m2, last_per_m2: rates of the ramps, which end and begin at these arcs; end_m: where the circle begins.
    """

    start_per_m: float
    first_per_m2: float
    first_end_m: float
    last_per_m2: float
    last_start_m: float
    end_m: float


class Craft(NamedTuple):
    """The aircraft: see :class:`sidelong.mission.core.requirement.Aircraft`.

    turn_share: the tightest turn of a transition, in radii of the circle, if the bank allows.
    """

    airspeed_m_s: float
    radius_m: float
    bank_max_rad: float
    roll_rate_max_rad_s: float
    turn_share: float


def craft_of(aircraft: Aircraft, turn_share: float = 1.0) -> Craft:
    """Return the aircraft as the loops see it."""
    limits = aircraft.bank_max_rad, aircraft.roll_rate_max_rad_s
    return Craft(aircraft.airspeed_m_s, aircraft.radius_m, *limits, turn_share)


class Air(NamedTuple):
    """Airspeed, and the wind in the frame of the courses."""

    airspeed_m_s: float
    wind_x_m_s: float
    wind_y_m_s: float


class LinePoint(NamedTuple):
    """A point of a flown line: place, course and curvature there."""

    east_m: float
    north_m: float
    course_rad: float
    curvature_per_m: float


class Circling(NamedTuple):
    """A circle as the loops see it: radius_m is negative for a counter-clockwise one."""

    east_m: float
    north_m: float
    radius_m: float


@compiled
def remainder(angle_rad: float) -> float:
    """Return the same angle within half a turn of zero."""
    return angle_rad - math.tau * round(angle_rad / math.tau)


@inner
def speed_m_s(course_rad: float, air: Air) -> float:
    """Return the speed over the ground on a course: the long side of the wind triangle; NaN if it cannot be held."""
    if air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0:
        return air.airspeed_m_s
    sin_c, cos_c = math.sin(course_rad), math.cos(course_rad)
    along_m_s = air.wind_x_m_s * sin_c + air.wind_y_m_s * cos_c
    across_m_s = air.wind_x_m_s * cos_c - air.wind_y_m_s * sin_c
    return along_m_s + math.sqrt(air.airspeed_m_s * air.airspeed_m_s - across_m_s * across_m_s)


@inner
def nose_rad(course_rad: float, air: Air) -> float:
    """Return where the nose points on a course over the ground."""
    across_m_s = air.wind_x_m_s * math.cos(course_rad) - air.wind_y_m_s * math.sin(course_rad)
    return course_rad - math.asin(across_m_s / air.airspeed_m_s)


@compiled
def speeds_m_s(course_rad: FloatArray, air: Air, found: FloatArray) -> None:
    """Fill in :func:`speed_m_s` on many courses (n,)."""
    for i in range(len(course_rad)):
        found[i] = speed_m_s(course_rad[i], air)


@compiled
def turn_radius_m(radius_m: float, speed_m_s: float, craft: Craft) -> float:
    """Return the radius of the tightest turn on the way to a circle: its share, with 30 degrees of bank at most."""
    banked_m = speed_m_s * speed_m_s / (GRAVITY_M_S2 * math.tan(min(_TURN_BANK_RAD, craft.bank_max_rad)))
    return min(radius_m, max(craft.turn_share * radius_m, banked_m))


@compiled
def sharpness_per_m2(speed_m_s: float, craft: Craft) -> float:
    """Return the change of curvature per metre of a transition that keeps the roll rate within its share.

    tan(bank) = v^2 curvature / g, so the roll rate is greatest at wings level: v^3 ramp / g.
    """
    bank_rad = math.atan(speed_m_s * speed_m_s / (GRAVITY_M_S2 * turn_radius_m(craft.radius_m, speed_m_s, craft)))
    max_rad_s = craft.roll_rate_max_rad_s
    roll_rad_s = min(max(2.0 * bank_rad / _REVERSAL_S, _MIN_SHARE * max_rad_s), _MAX_SHARE * max_rad_s)
    return roll_rad_s * GRAVITY_M_S2 / (speed_m_s * speed_m_s * speed_m_s)


@compiled
def trapezoid(
    start_per_m: float, hold_per_m: float, length_m: float, final_per_m: float, ramp_per_m2: float
) -> Trapezoid:
    """Return the trapezoid that ramps from start to hold, holds that for a length, and ramps on to final."""
    first_end_m = abs(hold_per_m - start_per_m) / ramp_per_m2
    last_start_m = first_end_m + length_m
    return Trapezoid(
        start_per_m,
        math.copysign(ramp_per_m2, hold_per_m - start_per_m),
        first_end_m,
        math.copysign(ramp_per_m2, final_per_m - hold_per_m),
        last_start_m,
        last_start_m + abs(final_per_m - hold_per_m) / ramp_per_m2,
    )


@inner
def with_last_ramp(shape: Trapezoid, ramp_per_m2: float) -> Trapezoid:
    """Return the trapezoid with another last ramp that begins where the old one did."""
    start_per_m, first_per_m2, first_end_m, last_per_m2, last_start_m, end_m = shape
    change_per_m = abs(last_per_m2) * (end_m - last_start_m)
    last_per_m2, end_m = math.copysign(ramp_per_m2, last_per_m2), last_start_m + change_per_m / ramp_per_m2
    return Trapezoid(start_per_m, first_per_m2, first_end_m, last_per_m2, last_start_m, end_m)


@inner
def turned_rad(shape: Trapezoid, arc_m: float) -> float:
    """Return the change of course since the start, exactly."""
    first = min(arc_m, shape.first_end_m)
    last_length = shape.end_m - shape.last_start_m
    last = min(max(arc_m - shape.last_start_m, 0.0), last_length)
    after = max(arc_m - shape.end_m, 0.0)
    return (
        shape.start_per_m * arc_m
        + shape.first_per_m2 * first * (arc_m - 0.5 * first)
        + shape.last_per_m2 * (0.5 * last * last + last_length * after)
    )


@compiled
def curvature_per_m(shape: Trapezoid, arc_m: float) -> float:
    """Return the curvature at an arc."""
    last_m = min(max(arc_m - shape.last_start_m, 0.0), shape.end_m - shape.last_start_m)
    return shape.start_per_m + shape.first_per_m2 * min(arc_m, shape.first_end_m) + shape.last_per_m2 * last_m


@inner
def moved_m(shape: Trapezoid, course_rad: float, from_m: float, to_m: float) -> tuple[float, float]:
    """Return (east, north) from one arc to another, up to about 10 m on."""
    step = to_m - from_m
    a = course_rad + turned_rad(shape, from_m + (0.5 - _NODE_2) * step)
    b = course_rad + turned_rad(shape, from_m + (0.5 + _NODE_2) * step)
    return 0.5 * step * (math.sin(a) + math.sin(b)), 0.5 * step * (math.cos(a) + math.cos(b))


@compiled
def displaced_m(shape: Trapezoid, arc_m: FloatArray) -> FloatArray:
    """Return (east, north, turned) (3, k) since the start, on course 0, at ascending arcs (k,) up to 10 m apart."""
    places = np.zeros((3, len(arc_m)))
    for k in range(len(arc_m)):
        places[2, k] = turned_rad(shape, arc_m[k])
        if k > 0:
            east_m, north_m = moved_m(shape, 0.0, arc_m[k - 1], arc_m[k])
            places[0, k], places[1, k] = places[0, k - 1] + east_m, places[1, k - 1] + north_m
    return places


@compiled
def laid_out(shape: Trapezoid, east_m: float, north_m: float, course_rad: float) -> FloatArray:
    """Return the line (5, n) of a trapezoid from that place, with samples at every corner of curvature.

    It ends where the circle begins; a trapezoid of no length gets one fine step of its circle.
    """
    end_m = shape.end_m if shape.end_m >= 1e-6 else FINE_STEP_M
    corners = (0.0, shape.first_end_m, shape.last_start_m, end_m)
    steps = [0, 0, 0]
    for k in range(3):
        length_m = corners[k + 1] - corners[k]
        if length_m > 1e-9:
            steps[k] = max(1, math.ceil(length_m / FINE_STEP_M))
    line = np.empty((5, steps[0] + steps[1] + steps[2] + 1))
    i = 0
    for k in range(3):
        for step in range(steps[k]):
            line[ARC, i] = corners[k] + step * ((corners[k + 1] - corners[k]) / steps[k])
            i += 1
    line[ARC, i] = end_m
    line[EAST, 0], line[NORTH, 0] = east_m, north_m
    for i in range(line.shape[1]):
        arc_m = line[ARC, i]
        line[COURSE, i] = course_rad + turned_rad(shape, arc_m)
        line[CURVATURE, i] = curvature_per_m(shape, arc_m)
        if i > 0:
            before_m, step_m = line[ARC, i - 1], arc_m - line[ARC, i - 1]
            a = course_rad + turned_rad(shape, before_m + (0.5 - _NODE_3) * step_m)
            b = course_rad + turned_rad(shape, before_m + 0.5 * step_m)
            c = course_rad + turned_rad(shape, before_m + (0.5 + _NODE_3) * step_m)
            sines, cosines = 5.0 * math.sin(a) + 8.0 * math.sin(b), 5.0 * math.cos(a) + 8.0 * math.cos(b)
            line[EAST, i] = line[EAST, i - 1] + step_m / 18.0 * (sines + 5.0 * math.sin(c))
            line[NORTH, i] = line[NORTH, i - 1] + step_m / 18.0 * (cosines + 5.0 * math.cos(c))
    return line


@inner
def circle_touching(east_m: float, north_m: float, course_rad: float, signed_m: float) -> Circling:
    """Return the circle of a signed radius that touches a ray at its origin."""
    return Circling(east_m + signed_m * math.cos(course_rad), north_m - signed_m * math.sin(course_rad), signed_m)


@compiled
def circle_after(line: FloatArray, radius_m: float) -> Circling:
    """Return the circle that continues a line with the sign of its last curvature."""
    signed_m = radius_m if line[CURVATURE, -1] > 0.0 else -radius_m
    return circle_touching(line[EAST, -1], line[NORTH, -1], line[COURSE, -1], signed_m)


@inner
def course_on_circle(circle: Circling, east_m: float, north_m: float) -> float:
    """Return the course flown at the point of the circle nearest to a place."""
    outward_rad = math.atan2(east_m - circle.east_m, north_m - circle.north_m)
    return outward_rad + math.copysign(0.5 * math.pi, circle.radius_m)


@compiled
def nearest_arc_m(line: FloatArray, circle: Circling, east_m: float, north_m: float, course_rad: float) -> float:
    """See :func:`sidelong.mission.geometry.progress.nearest_arc_m`."""
    n = line.shape[1]
    if n == 0:
        return 0.0
    # A coarse pass first: what it finds lets the full one pass over most samples by their distance alone.
    best, misfit_m = 0, np.inf
    for stride in (16, 1):
        for i in range(0, n, stride):
            off_east_m, off_north_m = line[EAST, i] - east_m, line[NORTH, i] - north_m
            off_m2 = off_east_m * off_east_m + off_north_m * off_north_m
            if off_m2 < misfit_m * misfit_m:
                here_m = math.sqrt(off_m2) + _COURSE_WEIGHT_M * abs(remainder(line[COURSE, i] - course_rad))
                if here_m < misfit_m:
                    best, misfit_m = i, here_m
    lap_rad = course_on_circle(circle, east_m, north_m)
    off_circle_m = math.hypot(east_m - circle.east_m, north_m - circle.north_m) - abs(circle.radius_m)
    off_circle_rad = remainder(lap_rad - course_rad)
    length_m = line[ARC, n - 1]
    if best == n - 1 or abs(off_circle_m) + _COURSE_WEIGHT_M * abs(off_circle_rad) < misfit_m:
        past_rad = math.copysign(1.0, circle.radius_m) * (lap_rad - line[COURSE, n - 1])
        past_rad -= math.tau * math.floor(past_rad / math.tau)
        return float(length_m + abs(circle.radius_m) * past_rad)
    line_rad = line[COURSE, best]
    ahead_m = (east_m - line[EAST, best]) * math.sin(line_rad) + (north_m - line[NORTH, best]) * math.cos(line_rad)
    return float(min(max(line[ARC, best] + ahead_m, 0.0), length_m))


@inner
def arc_point(start: LinePoint, sharpness_per_m2: float, flown_m: float) -> LinePoint:
    """Return the point further on where curvature changes linearly: exact in course, Simpson's rule in place."""
    middle_rad = start.course_rad + (start.curvature_per_m + 0.25 * sharpness_per_m2 * flown_m) * 0.5 * flown_m
    end_rad = start.course_rad + (start.curvature_per_m + 0.5 * sharpness_per_m2 * flown_m) * flown_m
    sixth_m = flown_m / 6.0
    return LinePoint(
        start.east_m + sixth_m * (math.sin(start.course_rad) + 4.0 * math.sin(middle_rad) + math.sin(end_rad)),
        start.north_m + sixth_m * (math.cos(start.course_rad) + 4.0 * math.cos(middle_rad) + math.cos(end_rad)),
        end_rad,
        start.curvature_per_m + sharpness_per_m2 * flown_m,
    )


@inner_inlined
def _before(line: FloatArray, arc_m: float) -> int:
    """Return the last sample at or before an arc, of those that have one after them."""
    low, high = 0, line.shape[1] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if line[ARC, middle] <= arc_m:
            low = middle
        else:
            high = middle
    return low


@inlined
def point_at(line: FloatArray, circle: Circling, arc_m: float, east_m: float, north_m: float) -> LinePoint:
    """See :func:`sidelong.mission.geometry.progress.point_at`: the aircraft is at (east, north)."""
    n = line.shape[1]
    if n > 0 and arc_m <= line[ARC, n - 1]:
        i = _before(line, arc_m)
        start = LinePoint(line[EAST, i], line[NORTH, i], line[COURSE, i], line[CURVATURE, i])
        sharpness_per_m2 = (line[CURVATURE, i + 1] - line[CURVATURE, i]) / (line[ARC, i + 1] - line[ARC, i])
        return arc_point(start, sharpness_per_m2, arc_m - line[ARC, i])
    if n == 0:
        start_rad, flown_m = course_on_circle(circle, east_m, north_m), arc_m
    else:
        start_rad, flown_m = line[COURSE, n - 1], arc_m - line[ARC, n - 1]
    course_rad = start_rad + flown_m / circle.radius_m
    return LinePoint(
        circle.east_m - circle.radius_m * math.cos(course_rad),
        circle.north_m + circle.radius_m * math.sin(course_rad),
        course_rad,
        1.0 / circle.radius_m,
    )


@compiled
def line_at(
    line: FloatArray, circle: Circling, arc_m: FloatArray, east_m: float, north_m: float, found: FloatArray
) -> None:
    """Fill in (east, north, course) (3, k) at many arcs (k,): :func:`point_at` to some centimetres."""
    n = line.shape[1]
    start_rad, length_m = (
        (course_on_circle(circle, east_m, north_m), 0.0) if n == 0 else (line[COURSE, n - 1], line[ARC, n - 1])
    )
    for k in range(len(arc_m)):
        if n > 0 and arc_m[k] < length_m:
            i = _before(line, arc_m[k])
            share = (arc_m[k] - line[ARC, i]) / (line[ARC, i + 1] - line[ARC, i])
            for row in range(3):
                found[row, k] = line[EAST + row, i] + share * (line[EAST + row, i + 1] - line[EAST + row, i])
        else:
            course_rad = start_rad + (arc_m[k] - length_m) / circle.radius_m
            found[0, k] = circle.east_m - circle.radius_m * math.cos(course_rad)
            found[1, k] = circle.north_m + circle.radius_m * math.sin(course_rad)
            found[2, k] = course_rad


@compiled
def flown_places(
    state: tuple[float, float, float, float],
    present: FloatArray,
    present_circle: Circling,
    coming: FloatArray,
    coming_circle: Circling,
    departure_s: float,
    air: Air,
    step_s: float,
    found: FloatArray,
) -> None:
    """Fill in (east, north, course) (3, n) every step_s: along the present line, from the departure on the other.

    state: time, east, north and course from which on; departure_s is inf where nothing else is coming.
    """
    now_s, east_m, north_m, course_rad = state
    arc_m = nearest_arc_m(present, present_circle, east_m, north_m, course_rad)
    line, circle, departed = present, present_circle, False
    for k in range(found.shape[1]):
        if not departed and now_s + k * step_s >= departure_s:
            line, circle, arc_m, departed = coming, coming_circle, 0.0, True
        point = point_at(line, circle, arc_m, east_m, north_m)
        found[0, k], found[1, k], found[2, k] = point.east_m, point.north_m, point.course_rad
        arc_m += step_s * speed_m_s(point.course_rad, air)


@compiled
def min_distance_m(a: FloatArray, b: FloatArray, step_s: float, vertical_m: float, growth_m_s: float) -> float:
    """Return the least distance of two aircraft, m, less an allowance that grows with time.

    a, b: (east, north) and more (2 or 3, n) every step_s. vertical_m: between their heights.
    """
    least_m = np.inf
    for k in range(a.shape[1]):
        flat_m = math.hypot(a[0, k] - b[0, k], a[1, k] - b[1, k]) - growth_m_s * step_s * k
        least_m = min(least_m, math.hypot(max(flat_m, 0.0), vertical_m))
    return least_m
