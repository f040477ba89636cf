"""A sighting held against what a filter expects: residual, and its derivative by the state."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.filters.target_filter import BIASES, EAST, HEIGHT, NORTH, PLACE, FloatArray
from sidelong.estimators.sensing.sighting import AnySighting, Sighting, measurement_by_biases

# Where the place is known worse than this part of the range, a bearing's curvature shows: 0.3 m at three sigma.
_CURVED_BEYOND = 0.015


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """residual (3,) is measured minus expected, jacobian (3, n) the derivative of what is expected by the state."""

    residual: FloatArray
    jacobian: FloatArray


def compare(
    sighting: AnySighting, mean: FloatArray, place_variance_m2: float, prior: Biases, size: int
) -> Comparison:
    """Hold a sighting against the state ``mean`` (BIASES + k or longer), for a filter of ``size`` numbers.

    place_variance_m2 is that of east plus that of north. The derivative is taken where the filter expects the
    target, because taken at the noisy measurement it would correlate with the noise and pull the biases away; but
    where the filter knows far less than the sighting, it is taken where the sighting puts the target.
    """
    estimated = prior.estimated
    biases = prior.mean.copy()
    biases[estimated] = mean[BIASES : BIASES + len(estimated)]
    place = [float(mean[EAST]), float(mean[NORTH]), float(mean[HEIGHT])]
    jacobian_wrt_position = np.array(sighting.measurement_by_place(*place))
    jacobian_wrt_bias = measurement_by_biases(sighting)
    if isinstance(sighting, Sighting) and place_variance_m2 > (_CURVED_BEYOND * sighting.slant_range_m) ** 2:
        seen = np.array((sighting.east_m, sighting.north_m, sighting.height_m))
        seen -= sighting.place_by_measurement @ jacobian_wrt_bias @ biases
        jacobian_wrt_position = np.array(sighting.measurement_by_place(*seen))
        residual = sighting.residual(*seen) + jacobian_wrt_position @ (seen - place)
    else:
        residual = np.array(sighting.residual(*place))
    jacobian = np.zeros((3, size))
    jacobian[:, PLACE] = jacobian_wrt_position
    jacobian[:, BIASES : BIASES + len(estimated)] = jacobian_wrt_bias[:, estimated]
    return Comparison(residual - jacobian_wrt_bias @ biases, jacobian)


def huber_inflation(nis: float, soft_nis: float) -> float:
    """Return by what to multiply the noise of a sighting that lies between ``soft_nis`` and the gate.

    Huber's weight: beyond the threshold the pull on the estimate no longer grows with the distance.
    """
    return max(1.0, math.sqrt(nis / soft_nis))
