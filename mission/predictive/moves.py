"""The moves a planner chooses among: 70 trapezoids, and going back to the circle at once.

All in units of the circle's radius, for a circle flown clockwise; mirrored for the other way round. Holds of
curvature -1 turn the other way: that is how the aircraft gets round a target that turned back.
"""

from __future__ import annotations

import numpy as np

from mission.geometry.trapezoid import Trapezoids

_HOLD_CURVATURES = np.array([-1.0, -0.5, 0.0, 0.33, 0.66])
_HOLD_LENGTHS = np.array([0.0, 0.2, 0.4, 0.6, 0.9, 1.2, 1.6, 2.1, 2.7, 3.4, 4.2, 5.2, 6.4, 8.0])
# How long the circle may be flown on before the next move.
_STAY_LENGTHS = np.array([0.2, 0.6, 1.2, 2.0, 3.2, 4.8, 2.0 * np.pi])


def moves_from(start_per_m: float, radius_m: float, sharpness_per_m2: float) -> Trapezoids:
    """Return all moves from a curvature, ending on the clockwise circle; the last one ramps back at once."""
    curvatures, lengths = np.meshgrid(_HOLD_CURVATURES / radius_m, _HOLD_LENGTHS * radius_m, indexing="ij")
    return Trapezoids.between(
        start_per_m,
        np.append(curvatures.ravel(), start_per_m),
        np.append(lengths.ravel(), 0.0),
        1.0 / radius_m,
        sharpness_per_m2,
    )


def staying_on(curvature_per_m: float, radius_m: float, sharpness_per_m2: float) -> Trapezoids:
    """Return stretches of a present circle, in the form of moves: each ends on the clockwise circle.

    They are plain arcs where the present circle is that circle; from another one they ramp over at their end.
    """
    return Trapezoids.between(
        curvature_per_m, curvature_per_m, _STAY_LENGTHS * radius_m, 1.0 / radius_m, sharpness_per_m2
    )
