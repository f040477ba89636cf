r"""Curvature trapezoids: the transition that can begin anywhere, at any moment, and ends on a circle.

::

    curvature
      start ----.                      .---- final: the circle
                 \                    /
                  '---- hold --------'
              ramp      hold_length    ramp          arc length ->

Curvature is continuous and its rate along the line never exceeds ``sharpness_per_m2``; where start, hold and final
are within a limit, so is every point between. A transition under way is retargeted by starting another trapezoid from
the curvature it has there. Course is a piecewise quadratic of arc length (exact); position is its Gauss quadrature.

Source: docs/explanation/planners.md#transitions; Fraichard and Scheuer, "From Reeds and Shepp's to
continuous-curvature paths", IEEE Transactions on Robotics 20(6), 2004.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray, Path
from sidelong.mission.core.requirement import Aircraft
from sidelong.mission.geometry import line_kernel


def turn_radius_m(aircraft: Aircraft, ground_speed_m_s: float, turn_share: float) -> float:
    """Return the tightest radius of a transition: turn_share of the circle's, with 30 degrees of bank at most.

    Args:
        turn_share: Tightest turn, in radii of the aircraft's circle.
    """
    craft = line_kernel.craft_of(aircraft, turn_share)
    return line_kernel.turn_radius_m(aircraft.radius_m, ground_speed_m_s, craft)


def sharpness_per_m2(aircraft: Aircraft, ground_speed_m_s: float, turn_share: float = 1.0) -> float:
    """Return the change of curvature per metre of a transition that keeps the roll rate within its share.

    tan(bank) = v^2 curvature / g, so the roll rate is greatest at wings level: v^3 ramp / g.

    Args:
        turn_share: Tightest turn, in radii of the aircraft's circle.
    """
    return line_kernel.sharpness_per_m2(ground_speed_m_s, line_kernel.craft_of(aircraft, turn_share))


@dataclass(frozen=True, slots=True, eq=False)
class Trapezoids:
    """n trapezoids: shapes (n, 6), rows as :mod:`sidelong.mission.geometry.line_kernel` has them."""

    shapes: FloatArray

    @staticmethod
    def between(
        start_per_m: float,
        hold_per_m: npt.ArrayLike,
        hold_length_m: npt.ArrayLike,
        final_per_m: npt.ArrayLike,
        ramp: float,
    ) -> Trapezoids:
        """Build one trapezoid for each element; hold, hold length and final broadcast against each other.

        Args:
            start_per_m: Curvature at the start, 1/m; positive to the right.
            ramp: Change of curvature per metre, 1/m^2.
        """
        each = np.broadcast(np.asarray(hold_per_m), np.asarray(hold_length_m), np.asarray(final_per_m))
        shapes = [
            line_kernel.trapezoid(start_per_m, float(hold), float(length), float(final), ramp)
            for hold, length, final in each
        ]
        return Trapezoids(np.array(shapes))

    @property
    def end_m(self) -> FloatArray:
        """Where each circle begins, (n,)."""
        return self.shapes[:, 5]

    def displaced_m(self, arc_m: FloatArray, course_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (east, north, turned rad) since the start at ascending arcs (n, k), for steps up to about 10 m.

        Args:
            arc_m: Ascending arcs (n, k), m.
        """
        found = np.empty((3, *arc_m.shape))
        line_kernel.displaced_m(self.shapes, np.ascontiguousarray(arc_m), course_rad, found)
        return found[0], found[1], found[2]

    def path(self, index: int, east_m: float, north_m: float, course_rad: float) -> Path:
        """Return trapezoid ``index`` from that place, densely sampled, with samples at every corner of curvature.

        It ends where the circle begins; a trapezoid of no length gets one fine step of its circle.
        """
        a, b, c, d, e, f = self.shapes[index].tolist()
        return Path(*line_kernel.laid_out((a, b, c, d, e, f), east_m, north_m, course_rad))


def end_circle(path: Path, radius_m: float) -> Circle:
    """Return the circle that continues a trapezoid's path with the sign of its last curvature."""
    return Circle.tangent_to(
        float(path.east_m[-1]),
        float(path.north_m[-1]),
        float(path.course_rad[-1]),
        radius_m,
        clockwise=bool(path.curvature_per_m[-1] > 0.0),
    )
