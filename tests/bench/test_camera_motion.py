"""A camera without a laser: how often does its 95 % ellipse contain the target?

``python -m pytest tests/bench/test_camera_motion.py -s``, for recorded targets and for targets that move as the
filter's motion models do. The errors of the gimbal's yaw and pitch and of the ground's height have the standard
deviations of the settings. They are constant during a flight, so this bench flies more flights than
``test_camera_flights.py`` does in the closed loop.

SIDELONG_TARGETS: a folder of recorded targets; without it those of the benchmark are used.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sidelong.app.study.benchmark import TRACKS
from sidelong.app.study.recorded import recorded_targets
from sidelong.estimators.filters.imm import DENSITIES
from sidelong.estimators.filters.imm_kernel import (
    GENERATOR,
    MODELS,
    SHUFFLE_SIGMA_M_S,
    STANDING,
    TURN_SIGMA_RAD_S,
    TURNING,
    Densities,
)
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.terrain.ground import flat_ground
from sidelong.estimators.tracking.track import Track
from tests.bench.size import size
from tests.estimators.conftest import HEIGHT_M, STEP_S, Scene

FLIGHTS, DURATION_S = size(200, 2), float(size(300, 30))
_SPEED_SIGMA_M_S, _TRACK_SPEED_MAX_M_S = 1.0, 3.5
_GROUND_SIGMA_M, _UNKNOWN_M = 2.0, 2e3
_SKIPPED_S = 5.0
_CHI2_95 = 5.991


def own_motion(rng: np.random.Generator, steps: int, own: Densities) -> np.ndarray:
    """Return (steps, 4), position and velocity, of a target that changes between the filter's motion models."""
    rates = -np.diag(GENERATOR)
    model, position, turn_rad_s = int(rng.integers(len(MODELS))), np.zeros(2), 0.0
    velocity = _SPEED_SIGMA_M_S * rng.standard_normal(2)
    densities = [0.0, own.cruise_m2_s3, own.cruise_m2_s3, own.manoeuvre_m2_s3]
    rows = []
    for _ in range(steps):
        if rng.random() < rates[model] * STEP_S:
            chances = np.maximum(GENERATOR[model], 0.0)
            model = int(rng.choice(len(MODELS), p=chances / chances.sum()))
            turn_rad_s = TURN_SIGMA_RAD_S * rng.standard_normal()
        if model == STANDING:
            velocity = SHUFFLE_SIGMA_M_S * rng.standard_normal(2)
            position = position + math.sqrt(own.shuffle_m2_s * STEP_S) * rng.standard_normal(2)
        else:
            if model == TURNING:
                sin, cos = math.sin(turn_rad_s * STEP_S), math.cos(turn_rad_s * STEP_S)
                velocity = np.array(((cos, sin), (-sin, cos))) @ velocity
            velocity = velocity + math.sqrt(densities[model] * STEP_S) * rng.standard_normal(2)
            position = position + STEP_S * velocity
        rows.append((*position, *velocity))
    return np.array(rows)


def circling(target: np.ndarray) -> np.ndarray:
    """Return (n, 4) of an aircraft at 12 m/s on a circle of 40 m whose centre stays 150 m south of the target."""
    angle = 12.0 / 40.0 * STEP_S * np.arange(len(target))
    places = target[:, :2] + 40.0 * np.stack((np.sin(angle), np.cos(angle)), axis=1) + (0.0, -150.0)
    return np.hstack((places, np.gradient(places, STEP_S, axis=0)))


def recorded_motion() -> list[np.ndarray]:
    """Return (steps, 4), position and velocity, of each recorded target that lasts as long as a flight."""
    folder = Path(os.environ.get("SIDELONG_TARGETS", TRACKS))
    times_s = STEP_S * np.arange(round(DURATION_S / STEP_S))
    flown = recorded_targets([folder], _TRACK_SPEED_MAX_M_S).flown
    return [one.sampled(times_s)[:, :4] for one in flown if one.duration_s >= DURATION_S]


def held_and_nees(target: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """Return the share of a flight in which the ellipse contains the target, and the mean of the NEES."""
    settings = TrackerSettings()
    sigmas = settings.yaw_bias_sigma_rad, settings.pitch_bias_sigma_rad, _GROUND_SIGMA_M
    yaw_rad, pitch_rad, off_m = sigmas * rng.standard_normal(3)
    track, nees = Track(settings), []
    track.stand_on(flat_ground(_GROUND_SIGMA_M))
    scene = Scene(target, circling(target))
    for one, truth in zip(scene.sightings(rng, yaw_rad=yaw_rad, pitch_rad=pitch_rad), target, strict=True):
        track.add(replace(one, range_sigma_m=_UNKNOWN_M, has_range=False, aircraft_height_m=HEIGHT_M + off_m))
        if one.time_s > _SKIPPED_S:
            estimate = track.estimate(one.time_s)
            off = np.array([estimate.east_m, estimate.north_m]) - truth[:2]
            nees.append(off @ np.linalg.solve(estimate.covariance[:2, :2], off))
    return float(np.mean(np.array(nees) <= _CHI2_95)), float(np.mean(nees))


@pytest.mark.parametrize("motion", ["recorded", "of the models"])
def test_ellipse_of_a_camera_contains_the_target(motion):
    recorded, flown = recorded_motion(), []
    for k in range(FLIGHTS):
        rng = np.random.default_rng((k, 2))
        own = own_motion(rng, round(DURATION_S / STEP_S), DENSITIES["unknown"])
        flown.append(held_and_nees(recorded[k % len(recorded)] if motion == "recorded" else own, rng))
    held, nees = np.array(flown).T
    print(
        f"\n{FLIGHTS} flights, motion {motion}: in the 95 % ellipse {100 * held.mean():.1f} "
        f"+- {100 * held.std() / math.sqrt(FLIGHTS):.1f} %, NEES {nees.mean():.2f}"
    )
    assert 0.92 <= held.mean() <= 0.98
