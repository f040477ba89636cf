"""Interacting multiple models of one target that several payloads see, each with constant errors of its own.

Two aircraft see the target along two base lines: what one payload's yaw error shifts across its line of sight, the
other's range measures along it. So both calibrations become observable, which they hardly are for one alone.
The state is that of :mod:`sidelong.estimators.filters.joint_kernel`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from sidelong.estimators.filters import joint_kernel as kernel
from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.filters.imm import seen
from sidelong.estimators.filters.joint_kernel import BLOCK, NUMBERS, TURN
from sidelong.estimators.filters.mixture_kernel import HEIGHT, TURN_SIGMA_RAD_S, combine, numbers_of
from sidelong.estimators.filters.motion import DENSITIES
from sidelong.estimators.filters.target_filter import PLACE, VELOCITY, FloatArray, bias_drift
from sidelong.estimators.sensing.sighting import AnySighting, Fix, Sighting, measurement_by_biases
from sidelong.estimators.settings import TrackerSettings

_MODELS = 4


@dataclass(frozen=True, slots=True)
class PayloadSighting(Sighting):
    """A sighting of one of several payloads, the one of index ``payload``."""

    payload: int = 0


@dataclass(frozen=True, slots=True)
class PayloadFix(Fix):
    """A camera's fix of one of several payloads."""

    payload: int = 0


def prior_of(payloads: Sequence[TrackerSettings], clock_sigmas_s: Sequence[float]) -> Biases:
    """Return the prior of all payloads' errors: BLOCK numbers for each."""
    sigmas = [
        (one.yaw_bias_sigma_rad, one.pitch_bias_sigma_rad, one.range_bias_sigma_m, clock_s)
        for one, clock_s in zip(payloads, clock_sigmas_s, strict=True)
    ]
    return Biases(np.zeros(BLOCK * len(sigmas)), np.diag(np.square(sigmas).ravel()))


class JointImm:
    """Implements :class:`estimators.filters.target_filter.TargetFilter` for detections that name their payload."""

    def __init__(self, settings: TrackerSettings, sighting: AnySighting, biases: Biases) -> None:
        """biases: of all payloads, as :func:`prior_of` has them."""
        self._densities, self._soft_nis = DENSITIES[settings.target_kind], settings.soft_nis
        yaw, pitch, offset = bias_drift(np.arange(3)).tolist()
        self._drift_per_s = (yaw, pitch, offset)
        self.time_s = sighting.time_s
        self.state = starting_state(settings, sighting, biases)

    @property
    def size(self) -> int:
        """How many numbers the state has."""
        return numbers_of(self.state)

    @property
    def height_m(self) -> float:
        """The height of the target's ground."""
        return float(self._combined(HEIGHT + 1)[0][HEIGHT])

    def predict(self, time_s: float) -> None:
        """Carry the state on to ``time_s``."""
        step_s = round(time_s - self.time_s, 6)
        self.time_s = time_s
        if step_s > 0.0:
            ahead = np.empty_like(self.state)
            kernel.predict(self.state, step_s, self._densities, self._drift_per_s, ahead)
            self.state = ahead

    def update(self, sighting: AnySighting, gate_nis: float) -> float:
        """Take a sighting in unless it lies beyond the gate; return its normalised innovation squared."""
        state = self.state.copy()
        nis = kernel.update(state, _payload(sighting), seen(sighting), gate_nis, self._soft_nis)
        if nis <= gate_nis:
            self.state = state
        return nis

    def carry(self, transition: FloatArray, shift: FloatArray, height_variance_m2: float) -> None:
        """Not offered: several payloads are not yet joined over known ground."""
        raise NotImplementedError("a joint track does not stand on known ground")

    def measure(self, row: FloatArray, residual: float, variance: float) -> None:
        """Not offered; see ``carry``."""
        raise NotImplementedError("a joint track does not stand on known ground")

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return mean (4,) and covariance (4, 4) of (east, north, velocity east, velocity north)."""
        return self._combined(4)

    def biases(self) -> Biases:
        """Return all payloads' errors, (BLOCK * payloads,), with their covariance."""
        mean, covariance = self._combined(self.size)
        return Biases(mean[NUMBERS:], covariance[NUMBERS:, NUMBERS:])

    def widen_clock(self, payload: int, sigma_s: float) -> None:
        """Add this uncertainty of a payload's clock from now on, before its first detection."""
        n, at = self.size, NUMBERS + BLOCK * payload + 3
        self.state = self.state.copy()
        self.state[:, 1 + n + at * (n + 1)] = sigma_s**2

    def _combined(self, size: int) -> tuple[FloatArray, FloatArray]:
        mean, covariance = np.empty(size), np.empty((size, size))
        combine(self.state, mean, covariance)
        return mean, covariance

    def copy(self) -> Self:
        """Return an independent filter with the same state."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        return other


def _payload(sighting: AnySighting) -> int:
    assert isinstance(sighting, PayloadSighting | PayloadFix)
    return sighting.payload


def starting_state(settings: TrackerSettings, sighting: AnySighting, biases: Biases) -> FloatArray:
    """Return the state of a target first seen here, with all that is known of the payloads."""
    size = NUMBERS + biases.mean.size
    mean, covariance = np.zeros(size), np.zeros((size, size))
    first = BLOCK * _payload(sighting)
    own = slice(first, first + 3)
    to_place = sighting.place_by_measurement
    # What a bias adds to the measurement it adds to the place, and is to be taken off it.
    shift = -to_place @ measurement_by_biases(sighting)
    mean[PLACE] = np.array((sighting.east_m, sighting.north_m, sighting.height_m)) + shift @ biases.mean[own]
    mean[NUMBERS:] = biases.mean
    covariance[np.ix_(PLACE, PLACE)] = (to_place * np.array(sighting.variances)) @ to_place.T
    covariance[np.ix_(PLACE, PLACE)] += shift @ biases.covariance[own, own] @ shift.T
    covariance[PLACE, NUMBERS:] = shift @ biases.covariance[own]
    covariance[NUMBERS:, :NUMBERS] = covariance[:NUMBERS, NUMBERS:].T
    covariance[VELOCITY, VELOCITY] = settings.target_speed_sigma_m_s**2
    covariance[TURN, TURN] = TURN_SIGMA_RAD_S**2
    covariance[NUMBERS:, NUMBERS:] = biases.covariance
    state = np.empty((_MODELS, 1 + size + size * size))
    state[:, 0] = 1.0 / _MODELS
    state[:, 1 : 1 + size], state[:, 1 + size :] = mean, covariance.ravel()
    return state
