"""The measurement and motion models of the filters in plain numpy, to compare the compiled ones with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sidelong.estimators.filters.imm_kernel import (
    CRUISING,
    EAST,
    GENERATOR,
    HEIGHT,
    HEIGHT_DENSITY_M2_S,
    MANOEUVRING,
    MODELS,
    NORTH,
    SHUFFLE_SIGMA_M_S,
    STANDING,
    TURN_DRIFT_RAD2_S3,
    TURN_SIGMA_RAD_S,
    TURNING,
    VELOCITY_E,
    VELOCITY_N,
    Densities,
    FloatArray,
)
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.sensing.sighting import Sighting

TURN = -1  # the turn rate is the last of the state
POSITION = [EAST, NORTH, HEIGHT]


def measured(sighting: Sighting, east_m: float, north_m: float, height_m: float) -> tuple[FloatArray, FloatArray]:
    """Return measured minus expected (3,) of a target at a position, and the derivative (3, 3) by the position."""
    east, north = east_m - sighting.aircraft_east_m, north_m - sighting.aircraft_north_m
    drop, horizontal = sighting.aircraft_height_m - height_m, math.hypot(east, north)
    residual = np.array(
        [
            sighting.slant_range_m - math.hypot(horizontal, drop),
            wrap_rad(sighting.bearing_rad - math.atan2(east, north)),
            sighting.depression_rad - math.atan2(drop, horizontal),
        ]
    )
    slant = math.hypot(horizontal, drop)
    steepening = drop / horizontal / slant**2
    jacobian = np.array(
        [
            [east / slant, north / slant, -drop / slant],
            [north / horizontal**2, -east / horizontal**2, 0.0],
            [-east * steepening, -north * steepening, -horizontal / slant**2],
        ]
    )
    return residual, jacobian


def cruise(size: int, step_s: float) -> FloatArray:
    """Return the transition (n, n) of a target that holds its velocity."""
    transition = np.eye(size)
    transition[EAST, VELOCITY_E] = transition[NORTH, VELOCITY_N] = step_s
    return transition


def cruise_noise(size: int, step_s: float, density_m2_s3: float, bias_drift: tuple[float, ...] = ()) -> FloatArray:
    """Return the process noise (n, n) of white acceleration, uneven ground and drifting biases after the height."""
    noise = np.zeros((size, size))
    add_white_acceleration(noise, density_m2_s3, step_s)
    noise[HEIGHT, HEIGHT] = HEIGHT_DENSITY_M2_S * step_s
    for i, drift in enumerate(bias_drift, start=HEIGHT + 1):
        noise[i, i] = drift * step_s
    return noise


def add_white_acceleration(noise: FloatArray, density_m2_s3: float, step_s: float) -> None:
    """Add the effect of acceleration of this density in a step to a process noise (n, n)."""
    for position, velocity in ((EAST, VELOCITY_E), (NORTH, VELOCITY_N)):
        noise[position, position] += density_m2_s3 * step_s**3 / 3
        noise[position, velocity] += density_m2_s3 * step_s**2 / 2
        noise[velocity, position] += density_m2_s3 * step_s**2 / 2
        noise[velocity, velocity] += density_m2_s3 * step_s


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
