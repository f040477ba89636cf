"""Interacting multiple model filter: a target that stands, cruises, turns or manoeuvres.

Blom and Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching coefficients",
IEEE Transactions on Automatic Control 33(8), 1988; with the motions of :mod:`estimators.motion`.

All models go through each step together, as one stack (models, n, n). They share the derivative of the measurement,
taken at their common mean: they lie within metres of one another and some hundred metres from the aircraft.
"""

from __future__ import annotations

import copy
from typing import Self

import numpy as np

from estimators.biases import Biases
from estimators.comparison import compare, huber_inflation
from estimators.motion import (
    MODELS,
    TURN,
    TURN_SIGMA_RAD_S,
    TURNING,
    model_noises,
    model_transitions,
    switch_probabilities,
)
from estimators.settings import TrackerSettings
from estimators.sighting import AnySighting
from estimators.target_filter import (
    BIASES,
    EAST,
    NORTH,
    VELOCITY_E,
    VELOCITY_N,
    FloatArray,
    bias_drift,
    starting_state,
)

_START = np.full(len(MODELS), 1.0 / len(MODELS))


class TargetImm:
    """means (models, n), covariances (models, n, n), chances (models,).

    None of them is ever changed in place, so that copies may share them.
    """

    def __init__(self, settings: TrackerSettings, sighting: AnySighting, biases: Biases) -> None:
        self.time_s = sighting.time_s
        self._density_m2_s3 = settings.acceleration_density_m2_s3
        self._soft_nis = settings.soft_nis
        self._prior = biases
        self._estimated = biases.estimated
        self._drift = tuple(bias_drift(self._estimated).tolist())
        start_mean, start_covariance = starting_state(settings, sighting, biases)
        mean = np.append(start_mean, 0.0)
        covariance = np.zeros((len(mean), len(mean)))
        covariance[:TURN, :TURN] = start_covariance
        covariance[TURN, TURN] = TURN_SIGMA_RAD_S**2
        self._means = np.stack([mean] * len(MODELS))
        self._covariances = np.stack([covariance] * len(MODELS))
        self._mode_probabilities = _START

    def predict(self, time_s: float) -> None:
        """Carry the state on to ``time_s``; see :class:`estimators.target_filter.TargetFilter`."""
        step_s = round(time_s - self.time_s, 6)
        self.time_s = time_s
        if step_s <= 0.0:
            return
        means, covariances = self._mixed(step_s)
        size = means.shape[1]
        turning = means[TURNING]
        transitions, by_rate = model_transitions(
            size, step_s, float(turning[TURN]), float(turning[VELOCITY_E]), float(turning[VELOCITY_N])
        )
        self._means = (transitions @ means[:, :, None])[:, :, 0]
        transitions[TURNING, :4, TURN] = by_rate
        self._covariances = transitions @ covariances @ transitions.transpose(0, 2, 1)
        self._covariances += model_noises(size, step_s, self._density_m2_s3, self._drift)

    def _mixed(self, step_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the means and covariances that each model starts the step from, and move the chances on."""
        switch = switch_probabilities(step_s)
        mode_probabilities = self._mode_probabilities @ switch
        weights = switch * self._mode_probabilities[:, None] / mode_probabilities  # (from, to)
        size = self._means.shape[1]
        means = weights.T @ self._means
        apart = (self._means[:, None] - means) * np.sqrt(weights)[:, :, None]  # (from, to, n)
        covariances = (weights.T @ self._covariances.reshape(len(MODELS), -1)).reshape(-1, size, size)
        covariances += apart.transpose(1, 2, 0) @ apart.transpose(1, 0, 2)
        self._mode_probabilities = mode_probabilities
        return means, covariances

    def update(self, sighting: AnySighting, gate_nis: float) -> float:
        """Take a sighting in unless it lies beyond the gate; return its normalised innovation squared."""
        means, covariances, mode_probabilities = self._means, self._covariances, self._mode_probabilities
        middle = mode_probabilities @ means
        place_variance_m2 = float(mode_probabilities @ (covariances[:, EAST, EAST] + covariances[:, NORTH, NORTH]))
        comparison = compare(sighting, middle, place_variance_m2, self._prior, len(middle))
        residual, jacobian = comparison.residual, comparison.jacobian

        residuals = residual - (means - middle) @ jacobian.T  # (models, 3)
        cross = covariances @ jacobian.T  # (models, n, 3)
        expected = jacobian @ cross
        noise = np.diag(sighting.variances)
        apart = residuals - residual
        spread = (
            (mode_probabilities @ expected.reshape(len(MODELS), 9)).reshape(3, 3)
            + (apart.T * mode_probabilities) @ apart
            + noise
        )
        nis = float(residual @ np.linalg.solve(spread, residual))
        if nis > gate_nis:
            return nis

        inverses = np.linalg.inv(expected + huber_inflation(nis, self._soft_nis) * noise)
        gains = cross @ inverses
        self._means = means + (gains @ residuals[:, :, None])[:, :, 0]
        updated = covariances - gains @ cross.transpose(0, 2, 1)
        self._covariances = 0.5 * (updated + updated.transpose(0, 2, 1))
        distances = (residuals[:, None, :] @ inverses @ residuals[:, :, None])[:, 0, 0]
        likelihoods = np.exp(-0.5 * (distances - distances.min())) * np.sqrt(np.linalg.det(inverses))
        mode_probabilities = mode_probabilities * likelihoods
        self._mode_probabilities = mode_probabilities / mode_probabilities.sum()
        return nis

    def _combined(self) -> tuple[FloatArray, FloatArray]:
        mean = self._mode_probabilities @ self._means
        apart = self._means - mean
        return mean, np.tensordot(self._mode_probabilities, self._covariances, 1) + (
            apart.T * self._mode_probabilities
        ) @ apart

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return mean (4,) and covariance (4, 4) of (east, north, velocity east, velocity north)."""
        mean, covariance = self._combined()
        return mean[:4], covariance[:4, :4]

    def biases(self) -> Biases:
        """Return the sensor biases with their covariance."""
        mean, covariance = self._combined()
        return self._prior.updated(mean[BIASES:TURN], covariance[BIASES:TURN, BIASES:TURN])

    @property
    def mode_probabilities(self) -> FloatArray:
        """How likely each motion is: standing, cruising, turning, manoeuvring."""
        return self._mode_probabilities

    def copy(self) -> Self:
        """Return a filter that goes on by itself from the same state."""
        return copy.copy(self)
