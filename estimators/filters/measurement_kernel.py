"""The measurement model: what a sighting of a target at a given position is expected to measure."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled

FloatArray = npt.NDArray[np.float64]

# Where the position is known worse than this part of the range, a bearing's curvature shows: 0.3 m at three sigma.
_CURVED_BEYOND = 0.015


class Seen(NamedTuple):
    """A sighting: its three numbers with their variances. The first two numbers of a fix are (east, north)."""

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
def compared(
    seen: Seen, east_m: float, north_m: float, height_m: float, residual: FloatArray, jacobian: FloatArray
) -> None:
    """Fill in measured minus expected of a target at a position, and the derivative of the expected numbers.

    Args:
        seen: the sighting.
        east_m: position of the target in the local plane, m.
        north_m: likewise.
        height_m: height of the target, m, in the frame of the aircraft's height.
        residual: (3,), filled in: slant range in m, bearing and depression in rad.
        jacobian: (3, 6), filled in: derivative by (east, north, height, yaw error, pitch error, range error).
    """
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
    residual[1] = off_rad - math.tau * math.floor((off_rad + math.pi) / math.tau)
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
    seen: Seen,
    position: tuple[float, float, float],
    errors: tuple[float, float, float],
    position_variance_m2: float,
    residual: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Fill in residual (3,) and derivative (3, 6), see :func:`compared`, for a filter's mean.

    The derivative is taken where the filter expects the target. Taken at the noisy measurement it would correlate
    with the noise and pull the estimated errors away. Only where the filter knows far less than the sighting, it is
    taken where the sighting puts the target.

    Args:
        seen: the sighting.
        position: expected (east, north, height) of the target, m.
        errors: expected constant errors of the payload: yaw and pitch in rad, range in m.
        position_variance_m2: variance of east plus that of north.
        residual: filled in.
        jacobian: filled in.
    """
    yaw, pitch, offset = errors
    curved_m = _CURVED_BEYOND * seen.slant_range_m
    if not seen.is_fix and position_variance_m2 > max(curved_m * curved_m, seen.range_variance_m2):
        bearing, depression, slant = seen.bearing_rad - yaw, seen.depression_rad + pitch, seen.slant_range_m - offset
        east = seen.aircraft_east_m + slant * math.cos(depression) * math.sin(bearing)
        north = seen.aircraft_north_m + slant * math.cos(depression) * math.cos(bearing)
        height = seen.aircraft_height_m - slant * math.sin(depression)
        compared(seen, east, north, height, residual, jacobian)
        for i in range(3):
            residual[i] += (
                jacobian[i, 0] * (east - position[0])
                + jacobian[i, 1] * (north - position[1])
                + jacobian[i, 2] * (height - position[2])
            )
    else:
        compared(seen, position[0], position[1], position[2], residual, jacobian)
    if not seen.is_fix:
        residual[0] -= offset
        residual[1] -= yaw
        residual[2] += pitch
