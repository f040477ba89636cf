"""Interacting multiple model filter: a target that stands, cruises, turns or manoeuvres.

Blom and Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching coefficients",
IEEE Transactions on Automatic Control 33(8), 1988.

standing      velocity is zero but for a shuffle, the position stays
cruising      velocity holds, with a little white acceleration
turning       velocity turns at an unknown rate, otherwise as cruising
manoeuvring   much white acceleration: braking, gathering way, swerving

All models share the derivative of the measurement, taken at their common mean: they lie within metres of one another
and some hundred metres from the aircraft.
"""

from __future__ import annotations

from typing import Self

import numpy as np

from sidelong.estimators.filters import imm_kernel as kernel
from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.filters.imm_kernel import COVARIANCE, MEAN, PROBABILITY, RANGE, TURN, YAW, N, Seen
from sidelong.estimators.filters.mixture_kernel import MODELS, TURN_SIGMA_RAD_S, combine
from sidelong.estimators.filters.motion import DENSITIES
from sidelong.estimators.filters.target_filter import (
    BIASES,
    HEIGHT,
    FloatArray,
    bias_drift,
    measured_linearly,
    starting_state,
)
from sidelong.estimators.sensing.sighting import AnySighting, Fix
from sidelong.estimators.settings import TrackerSettings


class TargetImm:
    """state: see :mod:`sidelong.estimators.filters.mixture_kernel`; never changed in place: copies share it."""

    def __init__(self, settings: TrackerSettings, sighting: AnySighting, biases: Biases) -> None:
        self._set_up(settings, biases)
        self.time_s = sighting.time_s
        self.state = starting_models(settings, sighting, biases)

    @classmethod
    def resumed(cls, settings: TrackerSettings, biases: Biases, time_s: float, state: FloatArray) -> Self:
        """Return a filter in a known ``state``; biases are what was known of them before."""
        filtered = cls.__new__(cls)
        filtered._set_up(settings, biases)
        filtered.time_s, filtered.state = time_s, state
        return filtered

    def _set_up(self, settings: TrackerSettings, biases: Biases) -> None:
        self._densities = DENSITIES[settings.target_kind]
        self._soft_nis = settings.soft_nis
        self._prior = biases
        self._drift_per_s = drift_per_s(biases)

    def predict(self, time_s: float) -> None:
        """Carry the state on to ``time_s``; see :class:`sidelong.estimators.filters.target_filter.TargetFilter`."""
        step_s = round(time_s - self.time_s, 6)
        self.time_s = time_s
        if step_s > 0.0:
            ahead = np.empty_like(self.state)
            kernel.predict(self.state, step_s, self._densities, self._drift_per_s, ahead)
            self.state = ahead

    def update(self, sighting: AnySighting, gate_nis: float) -> float:
        """Take a sighting in unless it lies beyond the gate; return its normalised innovation squared."""
        state = self.state.copy()
        nis = kernel.update(state, seen(sighting), gate_nis, self._soft_nis)
        if nis <= gate_nis:
            self.state = state
        return nis

    @property
    def size(self) -> int:
        """How many numbers the state has."""
        return N

    @property
    def height_m(self) -> float:
        """The height of the target's ground."""
        return float(self.state[:, PROBABILITY] @ self.state[:, MEAN + HEIGHT])

    def carry(self, transition: FloatArray, shift: FloatArray, height_variance_m2: float) -> None:
        """Turn the state linearly; see :class:`sidelong.estimators.filters.target_filter.TargetFilter`."""
        state = self.state.copy()
        for model in state:
            covariance = model[COVARIANCE:].reshape(N, N)
            model[MEAN:COVARIANCE] = transition @ model[MEAN:COVARIANCE] + shift
            covariance[:] = transition @ covariance @ transition.T
            covariance[HEIGHT, HEIGHT] += height_variance_m2
        self.state = state

    def measure(self, row: FloatArray, residual: float, variance: float) -> None:
        """Take in one number; see :class:`sidelong.estimators.filters.target_filter.TargetFilter`."""
        state = self.state.copy()
        for model in state:
            covariance = model[COVARIANCE:].reshape(N, N)
            model[MEAN:COVARIANCE], covariance[:] = measured_linearly(
                model[MEAN:COVARIANCE], covariance, row, residual, variance
            )
        self.state = state

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return mean (4,) and covariance (4, 4) of (east, north, velocity east, velocity north)."""
        return self._combined(4)

    def biases(self) -> Biases:
        """Return the sensor biases with their covariance."""
        mean, covariance = self._combined(N)
        estimated = YAW + self._prior.estimated
        return self._prior.updated(mean[estimated], covariance[np.ix_(estimated, estimated)])

    def _combined(self, size: int) -> tuple[FloatArray, FloatArray]:
        mean, covariance = np.empty(size), np.empty((size, size))
        combine(self.state, mean, covariance)
        return mean, covariance

    @property
    def mode_probabilities(self) -> FloatArray:
        """How likely each motion is: standing, cruising, turning, manoeuvring."""
        return self.state[:, PROBABILITY]

    def copy(self) -> Self:
        """Return an independent filter with the same state."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        return other


def starting_models(settings: TrackerSettings, sighting: AnySighting, biases: Biases) -> FloatArray:
    """Return the state of the filter of a target first seen here: all models know the same."""
    estimated = [*range(BIASES), *(YAW + biases.estimated).tolist()]
    mean, covariance = np.zeros(N), np.zeros((N, N))
    mean[YAW : RANGE + 1] = biases.mean
    mean[estimated], covariance[np.ix_(estimated, estimated)] = starting_state(settings, sighting, biases)
    covariance[TURN, TURN] = TURN_SIGMA_RAD_S**2
    state = np.empty((len(MODELS), kernel.SIZE))
    state[:, PROBABILITY] = 1.0 / len(MODELS)
    state[:, MEAN:COVARIANCE], state[:, COVARIANCE:] = mean, covariance.ravel()
    return state


def drift_per_s(biases: Biases) -> tuple[float, float, float]:
    """Return the variance that each bias gains each second: none where it is not estimated."""
    drift = np.zeros(3)
    drift[biases.estimated] = bias_drift(biases.estimated)
    yaw, pitch, offset = drift.tolist()
    return yaw, pitch, offset


def seen(sighting: AnySighting) -> Seen:
    """Return a sighting as the loops see it."""
    if isinstance(sighting, Fix):
        return Seen(True, sighting.east_m, sighting.north_m, 0.0, *sighting.variances, 0.0, 0.0, 0.0)
    return Seen(
        False,
        sighting.slant_range_m,
        sighting.bearing_rad,
        sighting.depression_rad,
        *sighting.variances,
        sighting.aircraft_east_m,
        sighting.aircraft_north_m,
        sighting.aircraft_height_m,
    )
