"""The motions of the IMM filter as matrices: what its compiled form is held to."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sidelong.estimators.filters.mixture_kernel import (
    CRUISING,
    GENERATOR,
    MANOEUVRING,
    MODELS,
    SHUFFLE_SIGMA_M_S,
    STANDING,
    TURN_DRIFT_RAD2_S3,
    TURN_SIGMA_RAD_S,
    TURNING,
    Densities,
)
from sidelong.estimators.filters.motion import add_white_acceleration, cruise, cruise_noise
from sidelong.estimators.filters.target_filter import EAST, NORTH, VELOCITY_E, VELOCITY_N, FloatArray

TURN = -1  # the turn rate is the last of the state


@lru_cache(maxsize=256)
def switch_probabilities(step_s: float) -> FloatArray:
    """Return the chance (models, models) of being in the column's motion ``step_s`` after the row's; step <= 1 s."""
    probabilities: FloatArray = np.eye(len(MODELS)) + GENERATOR * step_s + GENERATOR @ GENERATOR * (step_s**2 / 2)
    return probabilities


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """What a turn does to position and velocity: transition (4, 4), and derivative (4,) by the turn rate."""

    transition: FloatArray
    by_rate: FloatArray


def turn(rate_rad_s: float, velocity_east_m_s: float, velocity_north_m_s: float, step_s: float) -> Turn:
    """Return what a coordinated turn does to (east, north, velocity east, velocity north) in ``step_s``.

    The derivative is to first order in the angle turned.
    """
    angle = rate_rad_s * step_s
    sin_a, cos_a = math.sin(angle), math.cos(angle)
    if abs(angle) < 1e-4:
        ahead, aside = step_s, 0.5 * angle * step_s
    else:
        ahead, aside = sin_a / rate_rad_s, (1.0 - cos_a) / rate_rad_s
    east = cos_a * velocity_east_m_s + sin_a * velocity_north_m_s
    north = cos_a * velocity_north_m_s - sin_a * velocity_east_m_s
    half = 0.5 * step_s * step_s
    return Turn(
        np.array(
            [
                [1.0, 0.0, ahead, aside],
                [0.0, 1.0, -aside, ahead],
                [0.0, 0.0, cos_a, sin_a],
                [0.0, 0.0, -sin_a, cos_a],
            ]
        ),
        np.array([half * north, -half * east, step_s * north, -step_s * east]),
    )


@lru_cache(maxsize=256)
def model_noises(size: int, step_s: float, densities: Densities, bias_drift: tuple[float, ...]) -> FloatArray:
    """Return the process noise (models, n, n) of each motion; read only."""
    noises = np.stack([cruise_noise(size, step_s, 0.0, bias_drift)] * len(MODELS))
    for axis in (EAST, NORTH):
        noises[STANDING, axis, axis] = densities.shuffle_m2_s * step_s
    for axis in (VELOCITY_E, VELOCITY_N):
        noises[STANDING, axis, axis] = SHUFFLE_SIGMA_M_S**2
    add_white_acceleration(noises[CRUISING], densities.cruise_m2_s3, step_s)
    add_white_acceleration(noises[TURNING], densities.cruise_m2_s3, step_s)
    add_white_acceleration(noises[MANOEUVRING], densities.manoeuvre_m2_s3, step_s)
    # Who does not turn forgets the rate: a turn begins with nothing known of it.
    noises[:, TURN, TURN] = TURN_SIGMA_RAD_S**2
    noises[TURNING, TURN, TURN] = TURN_DRIFT_RAD2_S3 * step_s
    noises.setflags(write=False)
    return noises


def model_transitions(
    size: int, step_s: float, turn_rate_rad_s: float, velocity_east_m_s: float, velocity_north_m_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the transitions (models, n, n) of each motion, and the derivative of the turning one by its rate.

    Rate and velocity are those of the turning model. The transitions carry the mean; with the derivative in
    the last column of the turning one they carry the covariance.
    """
    transitions = np.array(_plain_transitions(size, step_s))
    turning = turn(turn_rate_rad_s, velocity_east_m_s, velocity_north_m_s, step_s)
    transitions[TURNING, :4, :4] = turning.transition
    return transitions, turning.by_rate


@lru_cache(maxsize=256)
def _plain_transitions(size: int, step_s: float) -> FloatArray:
    transitions = np.stack([cruise(size, step_s)] * len(MODELS))
    standing = transitions[STANDING]
    standing[EAST, VELOCITY_E] = standing[NORTH, VELOCITY_N] = 0.0
    standing[VELOCITY_E, VELOCITY_E] = standing[VELOCITY_N, VELOCITY_N] = 0.0
    transitions[(STANDING, CRUISING, MANOEUVRING), TURN, TURN] = 0.0
    transitions.setflags(write=False)
    return transitions
