"""The moves a planner chooses among: 70 trapezoids, and going back to the circle at once.

Their holds and lengths stand in :mod:`sidelong.mission.predictive.moves_kernel`.

Source: docs/explanation/planners.md#transitions.
"""

from __future__ import annotations

import numpy as np

from sidelong.mission.geometry.trapezoid import Trapezoids
from sidelong.mission.predictive.moves_kernel import MOVES, STAY_LENGTHS, move_from


def moves_from(start_per_m: float, radius_m: float, turn_radius_m: float, sharpness_per_m2: float) -> Trapezoids:
    """Return all moves from a curvature, ending on the clockwise circle; the last one ramps back at once.

    Args:
        start_per_m: Curvature at the start, 1/m; positive to the right.
        radius_m: Radius of the circle, m.
        turn_radius_m: Tightest radius of a transition, m.
        sharpness_per_m2: Change of curvature per metre, 1/m^2.
    """
    shapes = [move_from(start_per_m, move, radius_m, turn_radius_m, sharpness_per_m2) for move in range(MOVES)]
    return Trapezoids(np.array(shapes))


def staying_on(curvature_per_m: float, radius_m: float, sharpness_per_m2: float) -> Trapezoids:
    """Return stretches of a present circle, in the form of moves: each ends on the clockwise circle.

    They are plain arcs where the present circle is that circle; from another one they ramp over at their end.

    Args:
        curvature_per_m: Curvature of the circle, 1/m.
        radius_m: Radius of the circle, m.
        sharpness_per_m2: Change of curvature per metre, 1/m^2.
    """
    return Trapezoids.between(
        curvature_per_m, curvature_per_m, STAY_LENGTHS * radius_m, 1.0 / radius_m, sharpness_per_m2
    )
