r"""Curvature trapezoids: the transition that can begin anywhere, at any moment, and ends on a circle.

::

    curvature
      start ----.                      .---- final: the circle
                 \                    /
                  '---- hold --------'
              ramp      hold_length    ramp          arc length ->

Curvature is continuous and its rate along the line never exceeds ``sharpness_per_m2``; where start, hold and final
are within +-1/R, so is every point between. A transition under way is retargeted by starting another trapezoid from
the curvature it has there. Course is a piecewise quadratic of arc length (exact); position is its Gauss quadrature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from mission.core.circle import Circle
from mission.core.path import FloatArray, Path
from mission.core.requirement import GRAVITY_M_S2, Aircraft

# Planned lines roll from one turn into the opposite one in this time, with at least and at most these shares of the
# aircraft's roll rate: the rest is left to the autopilot for gusts and corrections.
_REVERSAL_S = 5.0
_MIN_SHARE, _MAX_SHARE = 1.0 / 6.0, 1.0 / 2.0
_FINE_STEP_M = 2.0
# Gauss-Legendre on [0, 1]: three nodes make steps of 2 m exact to 1e-12 m, two make steps of 10 m exact to 1 mm.
_NODES_3, _WEIGHTS_3 = np.array([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)]), np.array([5.0, 8.0, 5.0]) / 18.0
_NODES_2, _WEIGHTS_2 = 0.5 + np.array([-0.5, 0.5]) / math.sqrt(3.0), np.array([0.5, 0.5])


def sharpnesses_per_m2(aircraft: Aircraft, ground_speed_m_s: FloatArray) -> FloatArray:
    """Return the change of curvature per metre that keeps the roll rate within its share at each ground speed.

    tan(bank) = v^2 curvature / g, so the roll rate is greatest at wings level: v^3 ramp / g.
    """
    bank_rad = np.arctan(ground_speed_m_s**2 / (GRAVITY_M_S2 * aircraft.radius_m))
    max_rad_s = aircraft.roll_rate_max_rad_s
    roll_rad_s = np.clip(2.0 * bank_rad / _REVERSAL_S, _MIN_SHARE * max_rad_s, _MAX_SHARE * max_rad_s)
    ramps: FloatArray = roll_rad_s * GRAVITY_M_S2 / ground_speed_m_s**3
    return ramps


def sharpness_per_m2(aircraft: Aircraft, ground_speed_m_s: float) -> float:
    """Return one of :func:`sharpnesses_per_m2`."""
    return float(sharpnesses_per_m2(aircraft, np.asarray(ground_speed_m_s)))


@dataclass(frozen=True, slots=True, eq=False)
class Trapezoids:
    """n trapezoids, arrays of shape (n,): curvature(s) = start + first ramp + last ramp."""

    start_per_m: float
    first_rate_per_m2: FloatArray
    first_end_m: FloatArray  # where the first ramp ends
    last_rate_per_m2: FloatArray
    last_start_m: FloatArray
    last_end_m: FloatArray  # where the circle begins

    @staticmethod
    def between(
        start_per_m: float,
        hold_per_m: npt.ArrayLike,
        hold_length_m: npt.ArrayLike,
        final_per_m: npt.ArrayLike,
        ramp: float,
    ) -> Trapezoids:
        """Build one trapezoid for each element; hold, hold length and final broadcast against each other."""
        hold, length, final = (
            np.asarray(a, dtype=np.float64) for a in np.broadcast_arrays(hold_per_m, hold_length_m, final_per_m)
        )
        first_end = np.abs(hold - start_per_m) / ramp
        last_start = first_end + length
        return Trapezoids(
            start_per_m,
            np.sign(hold - start_per_m) * ramp,
            first_end,
            np.sign(final - hold) * ramp,
            last_start,
            last_start + np.abs(final - hold) / ramp,
        )

    def curvature_per_m(self, arc_m: FloatArray) -> FloatArray:
        """Return the curvature at arc lengths of shape (n, k)."""
        return (
            self.start_per_m
            + self.first_rate_per_m2[:, None] * np.minimum(arc_m, self.first_end_m[:, None])
            + self.last_rate_per_m2[:, None] * self._into_last_m(arc_m)
        )

    def turned_rad(self, arc_m: FloatArray) -> FloatArray:
        """Return the change of course since the start, exactly, at arc lengths of shape (n, k)."""
        first = np.minimum(arc_m, self.first_end_m[:, None])
        last = self._into_last_m(arc_m)
        after = np.maximum(arc_m - self.last_end_m[:, None], 0.0)
        last_length = (self.last_end_m - self.last_start_m)[:, None]
        return (
            self.start_per_m * arc_m
            + self.first_rate_per_m2[:, None] * first * (arc_m - 0.5 * first)
            + self.last_rate_per_m2[:, None] * (0.5 * last * last + last_length * after)
        )

    def _into_last_m(self, arc_m: FloatArray) -> FloatArray:
        return np.clip(arc_m - self.last_start_m[:, None], 0.0, (self.last_end_m - self.last_start_m)[:, None])

    def coarse_arcs_m(self, step_m: float, beyond_m: float = 0.0) -> FloatArray:
        """Return arc lengths (n, k) at ``step_m``, each row repeating its end once it is reached.

        beyond_m: how far each row follows its circle.
        """
        ends_m = self.last_end_m + beyond_m
        steps = math.ceil(float(ends_m.max()) / step_m) + 1
        arcs: FloatArray = np.minimum(step_m * np.arange(steps + 1), ends_m[:, None])
        return arcs

    def displaced_m(self, arc_m: FloatArray, course_rad: float) -> tuple[FloatArray, FloatArray]:
        """Return (east, north) from the start at ascending arcs (n, k), for steps of up to about 10 m."""
        return _integrate(self, arc_m, course_rad, _NODES_2, _WEIGHTS_2)

    def path(self, index: int, east_m: float, north_m: float, course_rad: float) -> Path:
        """Return trapezoid ``index`` from that place, densely sampled, with samples at every corner of curvature.

        It ends where the circle begins; a trapezoid of no length gets one fine step of its circle.
        """
        one = self.subset(slice(index, index + 1))
        corners = [0.0, float(one.first_end_m[0]), float(one.last_start_m[0]), float(one.last_end_m[0])]
        if corners[-1] < 1e-6:
            corners.append(_FINE_STEP_M)
        pieces = [
            np.linspace(a, b, max(1, math.ceil((b - a) / _FINE_STEP_M)), endpoint=False)
            for a, b in pairwise(corners)
            if b - a > 1e-9
        ]
        arc = np.append(np.concatenate(pieces), corners[-1])[None, :]
        east, north = _integrate(one, arc, course_rad, _NODES_3, _WEIGHTS_3)
        return Path(
            arc[0],
            east_m + east[0],
            north_m + north[0],
            course_rad + one.turned_rad(arc)[0],
            one.curvature_per_m(arc)[0],
        )

    def subset(self, chosen: slice) -> Trapezoids:
        """Return some of the trapezoids."""
        return Trapezoids(
            self.start_per_m,
            self.first_rate_per_m2[chosen],
            self.first_end_m[chosen],
            self.last_rate_per_m2[chosen],
            self.last_start_m[chosen],
            self.last_end_m[chosen],
        )

    def with_last_ramps(self, sharpnesses_per_m2: FloatArray) -> Trapezoids:
        """Return the trapezoids with other last ramps (n,): those begin where they did."""
        change_per_m = np.abs(self.last_rate_per_m2) * (self.last_end_m - self.last_start_m)
        return Trapezoids(
            self.start_per_m,
            self.first_rate_per_m2,
            self.first_end_m,
            np.sign(self.last_rate_per_m2) * sharpnesses_per_m2,
            self.last_start_m,
            self.last_start_m + change_per_m / sharpnesses_per_m2,
        )

    def mirrored(self) -> Trapezoids:
        """Return the trapezoids with left and right swapped."""
        return Trapezoids(
            -self.start_per_m,
            -self.first_rate_per_m2,
            self.first_end_m,
            -self.last_rate_per_m2,
            self.last_start_m,
            self.last_end_m,
        )


def _integrate(
    trapezoids: Trapezoids, arc_m: FloatArray, course_rad: float, nodes: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    step = np.diff(arc_m, axis=1)
    east, north = np.zeros_like(arc_m), np.zeros_like(arc_m)
    for node, weight in zip(nodes, weights, strict=True):
        course = course_rad + trapezoids.turned_rad(arc_m[:, :-1] + node * step)
        east[:, 1:] += weight * step * np.sin(course)
        north[:, 1:] += weight * step * np.cos(course)
    return np.cumsum(east, axis=1), np.cumsum(north, axis=1)


def end_circle(path: Path, radius_m: float) -> Circle:
    """Return the circle that continues a trapezoid's path with the sign of its last curvature."""
    return Circle.tangent_to(
        float(path.east_m[-1]),
        float(path.north_m[-1]),
        float(path.course_rad[-1]),
        radius_m,
        clockwise=bool(path.curvature_per_m[-1] > 0.0),
    )
