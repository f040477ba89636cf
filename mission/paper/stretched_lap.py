"""A lap whose radius swells and shrinks again, so that it ends on a circle shifted by any distance.

The radius of curvature depends on the course: rho = R + A w(u), w = cos^2(pi u / 2 W), u = course - psi_0, |u| <= W.
Around a whole lap that shifts the circle by A I along psi_0 and not across. It is continuous in curvature, never
tighter than R, and exists for every distance, also those too short for ABCD.

Source: docs/explanation/planners.md#transitions.
"""

from __future__ import annotations

import math

import numpy as np

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray, Path
from sidelong.mission.geometry.switching import departure_course_rad
from sidelong.mission.geometry.transition import TransitionError


def stretched_lap(
    present: Circle, new: Circle, half_width_rad: float = math.radians(60.0), step_m: float = 2.0
) -> Path:
    """Return the stretched part of the lap, from ``half_width_rad`` before the move's bearing to as much after it.

    Args:
        present: The circle that is flown.
        new: The circle to fly next.
        half_width_rad: Half of the stretched turn W, rad.
        step_m: Greatest distance between samples, m.

    Raises:
        TransitionError: The circles differ in radius or direction, or W is not in (0, pi).
    """
    if present.clockwise != new.clockwise or not math.isclose(present.radius_m, new.radius_m):
        raise TransitionError("a stretched lap joins circles of one radius and one direction")
    if not 0.0 < half_width_rad < math.pi:
        raise TransitionError(f"half_width_rad must be in (0, pi), not {half_width_rad:.3f}")
    radius_m, width_rad = present.radius_m, half_width_rad
    move_east_m, move_north_m = new.east_m - present.east_m, new.north_m - present.north_m
    move_rad = math.atan2(move_east_m, move_north_m)
    swell_m = math.hypot(move_east_m, move_north_m) / float(_along(np.asarray(width_rad), width_rad))

    length_m = 2.0 * width_rad * radius_m + swell_m * width_rad
    turn_rad = _turns_rad(radius_m, swell_m, width_rad, max(3, math.ceil(length_m / step_m) + 1))
    # Along the move and to its right, from the point of the circle that is flown on the move's bearing.
    along_m = radius_m * np.sin(turn_rad) + swell_m * _along(turn_rad, width_rad)
    inward_m = radius_m * (1.0 - np.cos(turn_rad)) + swell_m * _inward(turn_rad, width_rad)
    right = 1.0 if present.clockwise else -1.0
    top_east_m, top_north_m = present.position_at_course(move_rad)
    start_rad = departure_course_rad(move_rad, width_rad, present.clockwise)
    return Path(
        _arc_m(turn_rad, radius_m, swell_m, width_rad),
        top_east_m + along_m * math.sin(move_rad) + right * inward_m * math.cos(move_rad),
        top_north_m + along_m * math.cos(move_rad) - right * inward_m * math.sin(move_rad),
        start_rad + right * (turn_rad + width_rad),
        right / (radius_m + swell_m * np.cos(math.pi * turn_rad / (2.0 * width_rad)) ** 2),
    )


def _arc_m(turn_rad: FloatArray, radius_m: float, swell_m: float, width_rad: float) -> FloatArray:
    a = math.pi / width_rad
    within_rad = turn_rad + width_rad
    return radius_m * within_rad + swell_m * 0.5 * (within_rad + np.sin(a * turn_rad) / a)


def _turns_rad(radius_m: float, swell_m: float, width_rad: float, count: int) -> FloatArray:
    """Return courses (relative to the move) whose points on the line lie about equally far apart."""
    even_rad = np.linspace(-width_rad, width_rad, 8 * count)
    arc_m = _arc_m(even_rad, radius_m, swell_m, width_rad)
    turns_rad = np.interp(np.linspace(0.0, arc_m[-1], count), arc_m, even_rad)
    turns_rad[0], turns_rad[-1] = -width_rad, width_rad
    return turns_rad


def _along(turn_rad: FloatArray, width_rad: float) -> FloatArray:
    """Return the integral of w(u) cos u from -W; at W it is I of the closed form."""
    a = math.pi / width_rad

    def antiderivative(u: FloatArray) -> FloatArray:
        # sin(b u) / b = u sinc(b u) holds for b = 0, that is W = pi, too.
        return 0.5 * np.sin(u) + 0.25 * u * (np.sinc((1 + a) * u / math.pi) + np.sinc((1 - a) * u / math.pi))

    total: FloatArray = antiderivative(turn_rad) - antiderivative(np.asarray(-width_rad))
    return total


def _inward(turn_rad: FloatArray, width_rad: float) -> FloatArray:
    """Return the integral of w(u) sin u from -W; it is zero again at W."""
    a = math.pi / width_rad

    def antiderivative(u: FloatArray) -> FloatArray:
        # (1 - cos b u) / b = b u^2 / 2 sinc^2(b u / 2)
        halves = (b * np.square(u) / 2.0 * np.square(np.sinc(b * u / (2.0 * math.pi))) for b in (1 + a, 1 - a))
        return 0.5 * (1.0 - np.cos(u)) + 0.25 * sum(halves)

    total: FloatArray = antiderivative(turn_rad) - antiderivative(np.asarray(-width_rad))
    return total
