"""Flat ground at the height of home, used without elevation data. Source: docs/explanation/limits.md."""

from __future__ import annotations

import numpy as np

from sidelong.estimators.terrain.ground import Ground

_REACH_M, _STEP_M = 40_000.0, 400.0


def flat_ground(sigma_m: float) -> Ground:
    """Return flat ground for 40 km around the origin of the plane.

    Args:
        sigma_m: standard deviation of the target's height against home's, m.
    """
    posts = round(2.0 * _REACH_M / _STEP_M) + 1
    return Ground(np.zeros((posts, posts), np.float32), -_REACH_M, -_REACH_M, _STEP_M, _STEP_M, sigma_m)
