"""The inner loops of :mod:`sidelong.estimators.filters.imm`, and how a sighting is held against a target.

The state is that of :mod:`sidelong.estimators.filters.mixture_kernel`. N holds all three biases: one that is not
estimated has no variance, and keeps its value.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sidelong.estimators.compiled import compiled
from sidelong.estimators.filters.mixture_kernel import (
    EAST,
    HEIGHT,
    NORTH,
    Densities,
    FloatArray,
    middle_of,
    mix,
    move,
    take_in,
)

YAW, PITCH, RANGE, TURN = range(5, 9)
N = 9
PROBABILITY, MEAN, COVARIANCE, SIZE = 0, 1, 1 + N, 1 + N + N * N

# Where the place is known worse than this part of the range, a bearing's curvature shows: 0.3 m at three sigma.
_CURVED_BEYOND = 0.015
_TWO_PI = 2.0 * math.pi
# The state's numbers that a sighting measures.
_SEEN = (EAST, NORTH, HEIGHT, YAW, PITCH, RANGE)


class Seen(NamedTuple):
    """A sighting, its three numbers with their variances; of a fix the first two are (east, north)."""

    is_fix: bool
    slant_range_m: float
    bearing_rad: float
    depression_rad: float
    range_variance_m2: float
    bearing_variance_rad2: float
    depression_variance_rad2: float
    aircraft_east_m: float
    aircraft_north_m: float
    aircraft_height_m: float


@compiled
def predict(
    state: FloatArray,
    step_s: float,
    densities: Densities,
    drift_per_s: tuple[float, float, float],
    found: FloatArray,
) -> None:
    """Fill in the state ``step_s`` later. drift_per_s: what the variances of the biases gain."""
    mix(state, N, step_s, found)
    for model in range(len(found)):
        p = found[model, COVARIANCE:].reshape(N, N)
        move(model, found[model, MEAN:COVARIANCE], p, TURN, step_s, densities)
        for bias in range(3):
            p[YAW + bias, YAW + bias] += drift_per_s[bias] * step_s


@compiled
def _compared(
    seen: Seen, east_m: float, north_m: float, height_m: float, residual: FloatArray, jacobian: FloatArray
) -> None:
    """Fill in measured minus expected (3,) of a target at a place, and the derivative (3, 6) by it."""
    jacobian[:] = 0.0
    if seen.is_fix:
        residual[0], residual[1], residual[2] = seen.slant_range_m - east_m, seen.bearing_rad - north_m, 0.0
        jacobian[0, 0] = jacobian[1, 1] = 1.0
        return
    east, north = east_m - seen.aircraft_east_m, north_m - seen.aircraft_north_m
    drop = seen.aircraft_height_m - height_m
    horizontal = math.sqrt(east * east + north * north)
    residual[0] = seen.slant_range_m - math.sqrt(horizontal * horizontal + drop * drop)
    off_rad = seen.bearing_rad - math.atan2(east, north)
    residual[1] = off_rad - _TWO_PI * math.floor((off_rad + math.pi) / _TWO_PI)
    residual[2] = seen.depression_rad - math.atan2(drop, horizontal)
    # Within a metre of straight below the aircraft, where the bearing turns over, it is that of one metre off.
    horizontal = max(horizontal, 1.0)
    slant2 = horizontal * horizontal + drop * drop
    slant = math.sqrt(slant2)
    per_horizontal2 = 1.0 / (horizontal * horizontal)
    steepening = drop / horizontal / slant2
    jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = east / slant, north / slant, -drop / slant
    jacobian[1, 0], jacobian[1, 1] = north * per_horizontal2, -east * per_horizontal2
    jacobian[2, 0], jacobian[2, 1] = -east * steepening, -north * steepening
    jacobian[2, 2] = -horizontal / slant2
    jacobian[0, 5] = jacobian[1, 3] = 1.0
    jacobian[2, 4] = -1.0  # a positive pitch error looks too high, so the measured depression is too small


@compiled
def linearized(
    seen: Seen, middle: FloatArray, place_variance_m2: float, residual: FloatArray, jacobian: FloatArray
) -> None:
    """Hold a sighting against the common mean (N,): fill in residual (3,) and derivative (3, 6).

    The derivative is taken where the filter expects the target, because taken at the noisy measurement it would
    correlate with the noise and pull the biases away; but where the filter knows far less than the sighting, it is
    taken where the sighting puts the target.
    """
    yaw, pitch, offset = middle[YAW], middle[PITCH], middle[RANGE]
    curved_m = _CURVED_BEYOND * seen.slant_range_m
    if not seen.is_fix and place_variance_m2 > curved_m * curved_m:
        sin_b, cos_b = math.sin(seen.bearing_rad), math.cos(seen.bearing_rad)
        sin_d, cos_d = math.sin(seen.depression_rad), math.cos(seen.depression_rad)
        slant = seen.slant_range_m
        across, down = slant * cos_d * yaw, slant * sin_d * pitch
        east = seen.aircraft_east_m + (slant - offset) * cos_d * sin_b - across * cos_b - down * sin_b
        north = seen.aircraft_north_m + (slant - offset) * cos_d * cos_b + across * sin_b - down * cos_b
        height = seen.aircraft_height_m - (slant - offset) * sin_d - slant * cos_d * pitch
        _compared(seen, east, north, height, residual, jacobian)
        for i in range(3):
            residual[i] += (
                jacobian[i, 0] * (east - middle[EAST])
                + jacobian[i, 1] * (north - middle[NORTH])
                + jacobian[i, 2] * (height - middle[HEIGHT])
            )
    else:
        _compared(seen, middle[EAST], middle[NORTH], middle[HEIGHT], residual, jacobian)
    if not seen.is_fix:
        residual[0] -= offset
        residual[1] -= yaw
        residual[2] += pitch


@compiled
def update(state: FloatArray, seen: Seen, gate_nis: float, soft_nis: float) -> float:
    """Take a sighting into the state unless it lies beyond the gate; see :func:`take_in`. Return its NIS."""
    middle, place_variance_m2 = middle_of(state, N)
    residual, jacobian = np.empty(3), np.empty((3, 6))
    linearized(seen, middle, place_variance_m2, residual, jacobian)
    noise = (seen.range_variance_m2, seen.bearing_variance_rad2, seen.depression_variance_rad2)
    return take_in(state, middle, residual, jacobian, _SEEN, noise, gate_nis, soft_nis)
