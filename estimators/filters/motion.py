"""How a target may go on: how much noise the motions of each kind of target have, and what a single model does.

The densities are measured: of several, those with which the filter's 95 % ellipse held recorded movers of that kind
as often as it says, at the least error (``tests/bench/test_real_targets.py``).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sidelong.estimators.filters.mixture_kernel import HEIGHT_DENSITY_M2_S, Densities
from sidelong.estimators.filters.target_filter import BIASES, EAST, HEIGHT, NORTH, VELOCITY_E, VELOCITY_N, FloatArray
from sidelong.estimators.settings import TargetKind

# Nobody stands still for long: a target that does not move on still wanders, by a metre in 10 s. As less of it was
# allowed for, what a resting or creeping target did was taken for an error of the gimbal, and believed.
_SHUFFLE_M2_S = 0.1

DENSITIES: dict[TargetKind, Densities] = {
    "unknown": Densities(0.025, 1.0, _SHUFFLE_M2_S),
    "walker": Densities(0.02, 0.5, _SHUFFLE_M2_S),
    "cyclist": Densities(0.025, 1.5, _SHUFFLE_M2_S),
    "car": Densities(0.02, 0.5, _SHUFFLE_M2_S),
    "boat": Densities(0.02, 1.0, _SHUFFLE_M2_S),
    "animal": Densities(0.02, 0.5, _SHUFFLE_M2_S),
}


@lru_cache(maxsize=256)
def cruise(size: int, step_s: float) -> FloatArray:
    """Return the transition (n, n) of a target that holds its velocity; read only."""
    transition = np.eye(size)
    transition[EAST, VELOCITY_E] = transition[NORTH, VELOCITY_N] = step_s
    transition.setflags(write=False)
    return transition


@lru_cache(maxsize=256)
def cruise_noise(size: int, step_s: float, density_m2_s3: float, bias_drift: tuple[float, ...]) -> FloatArray:
    """Return the process noise (n, n) of white acceleration, uneven ground and drifting biases; read only."""
    noise = np.zeros((size, size))
    add_white_acceleration(noise, density_m2_s3, step_s)
    noise[HEIGHT, HEIGHT] = HEIGHT_DENSITY_M2_S * step_s
    for i, drift in enumerate(bias_drift, start=BIASES):
        noise[i, i] = drift * step_s
    noise.setflags(write=False)
    return noise


def add_white_acceleration(noise: FloatArray, density_m2_s3: float, step_s: float) -> None:
    """Add to a process noise (n, n) what acceleration of this density does in a step."""
    for place, velocity in ((EAST, VELOCITY_E), (NORTH, VELOCITY_N)):
        noise[place, place] += density_m2_s3 * step_s**3 / 3
        noise[place, velocity] += density_m2_s3 * step_s**2 / 2
        noise[velocity, place] += density_m2_s3 * step_s**2 / 2
        noise[velocity, velocity] += density_m2_s3 * step_s
