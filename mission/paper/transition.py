"""The paper's transition ABCD from one circle to the next, and the stretched lap that is flown where it has no room.

Local frame, for clockwise flight; counter-clockwise is its mirror image in the line O1 O2::

      y          B ---------- C
      |     .                      .
      |   A                          D        A leaves the circle about O1, D enters the one about O2,
      +---O1------------------------O2--> x   both heading psi_c away from x

AB is the answer of the heading channel, psi = pi/2 - psi_c exp(-mu t). With mu = v / (R psi_c) its curvature begins
as the circle's, and its shape depends on R and psi_c alone: psi = pi/2 - psi_c exp(-s / (R psi_c)) after s metres.
CD is its mirror image. The paper ends AB at t = 3T and calls BC straight, which leaves a corner of psi_c exp(-3)
(4.5 degrees for psi_c = pi/2) at B and at C. Here BC is the arc that takes both out, and AB ends where that arc has
AB's own curvature, so that the curvature is continuous from circle to circle. A, D and the shortest move are the
paper's.

Source: Liao et al., Defence Technology 16(4), 2020, equations 23-42.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray, Path

_SETTLING = 3.0  # AB lasts 3 T
_SETTLED = 30.0  # the turn that remains after 30 T is lost in rounding


def _integrals(angle_rad: Any) -> Any:
    from scipy.special import sici  # noqa: PLC0415  # a tenth of a second, for the paper's planner alone

    return sici(angle_rad)


def root(function: Callable[[float], float], low: float, high: float, tolerance: float = 2e-12) -> float:
    """Return where ``function`` is zero between ``low`` and ``high``.

    Raises:
        ValueError: It has the same sign at both ends.
    """
    from scipy.optimize import brentq  # noqa: PLC0415  # a third of a second

    return float(brentq(function, low, high, xtol=tolerance))


class TransitionError(ValueError):
    """There is no transition between these circles."""


def departure_course_rad(move_bearing_rad: float, psi_c_rad: float, clockwise: bool) -> float:
    """Return the switching heading: the course at A, where a move in that direction leaves the circle (9-11)."""
    return move_bearing_rad - psi_c_rad if clockwise else move_bearing_rad + psi_c_rad


def transition_length_m(radius_m: float, psi_c_rad: float) -> float:
    """Return x_tr, the length of AB along x, by the paper's series, within 0.1 % of the exact one."""
    return radius_m * psi_c_rad * (_SETTLING - psi_c_rad**2 / 4.0 + psi_c_rad**4 / 96.0)


def min_move_m(radius_m: float, psi_c_rad: float) -> float:
    """Return the shortest distance between centres for which ABCD exists (42)."""
    return 2.0 * transition_length_m(radius_m, psi_c_rad) - 2.0 * radius_m * math.sin(psi_c_rad)


def abcd(present: Circle, new: Circle, psi_c_rad: float = math.pi / 2, step_m: float = 2.0) -> Path:
    """Return the transition from A on ``present`` to D on ``new``, sampled at most ``step_m`` apart.

    Raises:
        TransitionError: The circles differ in kind, psi_c is not in (0, pi/2], or the move is below ``min_move_m``.
    """
    if present.clockwise != new.clockwise or not math.isclose(present.radius_m, new.radius_m):
        raise TransitionError("ABCD joins circles of one radius and one direction")
    if not 0.0 < psi_c_rad <= math.pi / 2:
        raise TransitionError(f"psi_c_rad must be in (0, pi/2], not {psi_c_rad:.3f}")
    radius_m = present.radius_m
    move_east_m, move_north_m = new.east_m - present.east_m, new.north_m - present.north_m
    move_m = math.hypot(move_east_m, move_north_m)
    min_m = min_move_m(radius_m, psi_c_rad)
    if move_m < min_m:
        raise TransitionError(f"a move of {move_m:.1f} m is shorter than the transition needs, {min_m:.1f} m")
    half_m = move_m / 2.0 + radius_m * math.sin(psi_c_rad)
    arc_m, x_m, y_m, lean_rad, curvature_per_m = _first_half(half_m, radius_m, psi_c_rad, step_m)

    # The second half is the first one seen in the mirror that stands half way between the circles.
    arc_m = np.concatenate((arc_m, 2.0 * arc_m[-1] - arc_m[-2::-1]))
    x_m = np.concatenate((x_m, 2.0 * half_m - x_m[-2::-1])) - radius_m * math.sin(psi_c_rad)
    y_m = np.concatenate((y_m, y_m[-2::-1])) + radius_m * math.cos(psi_c_rad)
    lean_rad = np.concatenate((lean_rad, -lean_rad[-2::-1]))
    curvature_per_m = np.concatenate((curvature_per_m, curvature_per_m[-2::-1]))

    left = 1.0 if present.clockwise else -1.0  # where y points, seen along x
    move_rad = math.atan2(move_east_m, move_north_m)
    start_rad = departure_course_rad(move_rad, psi_c_rad, present.clockwise)
    return Path(
        arc_m,
        present.east_m + x_m * math.sin(move_rad) - left * y_m * math.cos(move_rad),
        present.north_m + x_m * math.cos(move_rad) + left * y_m * math.sin(move_rad),
        start_rad + left * (psi_c_rad - lean_rad),
        left * curvature_per_m,
    )


def _first_half(
    half_m: float, radius_m: float, psi_c_rad: float, step_m: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return arc, x and y from A, lean (course left of x) and curvature, from A to half way along BC."""
    scale_m = radius_m * psi_c_rad  # v / mu

    def reach_m(settled: float) -> float:
        """Return how far along x the middle of BC is when AB ends after ``settled`` T and BC has its curvature."""
        lean_rad = psi_c_rad * math.exp(-settled)
        along_m = scale_m * float(_integrals(psi_c_rad)[1] - _integrals(lean_rad)[1])
        return along_m + radius_m * math.exp(settled) * math.sin(lean_rad)

    settled = _SETTLED
    if reach_m(_SETTLED) > half_m:
        settled = root(lambda s: reach_m(s) - half_m, 0.0, _SETTLED, 1e-13)

    ab_m = np.linspace(0.0, scale_m * settled, max(2, math.ceil(scale_m * settled / step_m) + 1))
    lean_rad = psi_c_rad * np.exp(-ab_m / scale_m)
    si, ci = _integrals(lean_rad)
    x_m, y_m = scale_m * (ci[0] - ci), scale_m * (si[0] - si)
    curvature_per_m = np.exp(-ab_m / scale_m) / radius_m

    end_lean_rad, chord_m = float(lean_rad[-1]), half_m - float(x_m[-1])
    bc_curvature_per_m = math.sin(end_lean_rad) / chord_m
    bc_m = end_lean_rad / bc_curvature_per_m
    on_bc_m = np.linspace(0.0, bc_m, max(2, math.ceil(bc_m / step_m) + 1))[1:]
    bc_lean_rad = end_lean_rad - bc_curvature_per_m * on_bc_m
    bc_lean_rad[-1] = 0.0
    return (
        np.concatenate((ab_m, ab_m[-1] + on_bc_m)),
        np.concatenate((x_m, x_m[-1] + (math.sin(end_lean_rad) - np.sin(bc_lean_rad)) / bc_curvature_per_m)),
        np.concatenate((y_m, y_m[-1] + (np.cos(bc_lean_rad) - math.cos(end_lean_rad)) / bc_curvature_per_m)),
        np.concatenate((lean_rad, bc_lean_rad)),
        np.concatenate((curvature_per_m, np.full(on_bc_m.shape, bc_curvature_per_m))),
    )


def stretched_lap(
    present: Circle, new: Circle, half_width_rad: float = math.radians(60.0), step_m: float = 2.0
) -> Path:
    """Return the stretched part of the lap, from ``half_width_rad`` before the move's bearing to as much after it.

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
