"""A target that stands on the ground, as far as the ground is known.

The state's height is that of the target's ground. Off the elevation data it is by an offset: the data's own error,
and what they do not resolve. Along the target's way the offset is a Gauss-Markov process of the data's standard
deviation: sightings with a range tell it, and after a kilometre little of that is left. From one
sighting to the next the offset stays while the height follows the ground; with the laser out the line of sight alone
then tells the place.

The filter's own arithmetic is left as it is: its Gaussians are turned into offset and back around each prediction.
"""

from __future__ import annotations

import copy
from typing import Self

import numpy as np

from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.filters.target_filter import (
    EAST,
    HEIGHT,
    NORTH,
    FloatArray,
    TargetFilter,
)
from sidelong.estimators.sensing.sighting import AnySighting
from sidelong.estimators.terrain.ground import Ground, GroundPatch
from sidelong.estimators.terrain.standing_kernel import kept_offset


class GroundedFilter:
    """A target filter whose target stands on a ground; where that is void it is the filter as it was."""

    def __init__(self, inner: TargetFilter, ground: Ground) -> None:
        self._inner, self._ground = inner, ground
        self.time_s = inner.time_s
        patch = self._patch()
        if patch is not None:
            row = np.zeros(inner.size)
            row[EAST], row[NORTH], row[HEIGHT] = -patch.slope_east, -patch.slope_north, 1.0
            inner.measure(row, patch.height_m - inner.height_m, patch.sigma_m**2)

    @classmethod
    def resumed(cls, inner: TargetFilter, ground: Ground) -> Self:
        """Return a filter that goes on from one that stands on the ground already."""
        filtered = cls.__new__(cls)
        filtered._inner, filtered._ground, filtered.time_s = inner, ground, inner.time_s
        return filtered

    @property
    def inner(self) -> TargetFilter:
        """The filter without the ground."""
        return self._inner

    @property
    def size(self) -> int:
        """How many numbers the state has."""
        return self._inner.size

    def carry(self, transition: FloatArray, shift: FloatArray, height_variance_m2: float) -> None:
        """Turn the state linearly; see :class:`sidelong.estimators.filters.target_filter.TargetFilter`."""
        self._inner.carry(transition, shift, height_variance_m2)

    def measure(self, row: FloatArray, residual: float, variance: float) -> None:
        """Take in one number; see :class:`sidelong.estimators.filters.target_filter.TargetFilter`."""
        self._inner.measure(row, residual, variance)

    @property
    def height_m(self) -> float:
        """The height of the target's ground."""
        return self._inner.height_m

    def predict(self, time_s: float) -> None:
        """Carry the state on to ``time_s``, its height along the ground."""
        inner = self._inner
        before, step_s = self._patch(), time_s - self.time_s
        self.time_s = time_s
        if before is None or step_s <= 0.0:
            inner.predict(time_s)
            return
        mean, covariance = inner.moments()
        size = inner.size
        inner.carry(*_offset(before, size), 0.0)
        inner.predict(time_s)
        after = self._patch() or before
        kept = kept_offset(mean, covariance, step_s)
        inner.carry(*_height(after, size, kept), (1.0 - kept**2) * after.sigma_m**2)

    def _patch(self) -> GroundPatch | None:
        mean, _ = self._inner.moments()
        return self._ground.patch(float(mean[EAST]), float(mean[NORTH]))

    def update(self, sighting: AnySighting, gate_nis: float) -> float:
        """Take a sighting in unless it lies beyond the gate; return its normalised innovation squared."""
        return self._inner.update(sighting, gate_nis)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return mean (4,) and covariance (4, 4) of (east, north, velocity east, velocity north)."""
        return self._inner.moments()

    def biases(self) -> Biases:
        """Return the sensor biases with their covariance."""
        return self._inner.biases()

    def copy(self) -> Self:
        """Return an independent filter with the same state."""
        other = copy.copy(self)
        other._inner = self._inner.copy()
        return other


def _offset(patch: GroundPatch, size: int) -> tuple[FloatArray, FloatArray]:
    """Return transition (n, n) and shift (n,) from the height to its offset from the ground."""
    transition, shift = np.eye(size), np.zeros(size)
    transition[HEIGHT, EAST], transition[HEIGHT, NORTH] = -patch.slope_east, -patch.slope_north
    shift[HEIGHT] = patch.slope_east * patch.east_m + patch.slope_north * patch.north_m - patch.height_m
    return transition, shift


def _height(patch: GroundPatch, size: int, kept: float) -> tuple[FloatArray, FloatArray]:
    """Return transition (n, n) and shift (n,) from an offset, of which a part is kept, to the height."""
    transition, shift = _offset(patch, size)
    transition[HEIGHT, EAST], transition[HEIGHT, NORTH] = patch.slope_east, patch.slope_north
    transition[HEIGHT, HEIGHT] = kept
    return transition, -shift
