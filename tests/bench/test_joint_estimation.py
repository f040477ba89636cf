"""The estimate of several aircraft against its limit: python -m pytest tests/bench/test_joint_estimation.py -s.

RUNS=100 for this many flights: all moments of one share its constant errors, so that few mean little.

Each aircraft circles (80 m, 15 m/s) at 300 m from a target that moves by an exactly known model, at an angle of its
own; laser and gimbal measure at 10 Hz with 0.8 m and 0.35 degrees, and have constant errors of 0.5 m and 0.5 degrees
(one sigma). The bound is the posterior Cramer-Rao bound, the errors being parts of the state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.joint_track import JointTrack
from tests.bench.size import size
from tests.bench.test_estimation import (
    CHI2_95,
    GROUND_DENSITY,
    SIGMAS,
    SPEED_SIGMA,
    STEP_S,
    Target,
    cruise_noise,
    measurement_derivative,
    sightings,
    turn_by,
    wandering,
)

BIASES = np.array([math.radians(0.5), math.radians(0.5), 0.5])
SETTINGS = TrackerSettings(yaw_bias_sigma_rad=BIASES[0], pitch_bias_sigma_rad=BIASES[1], range_bias_sigma_m=BIASES[2])
RUNS = size(48, 1, "RUNS")
RANGE_M, RADIUS_M, SPEED_M_S = 300.0, 80.0, 15.0


@dataclass(frozen=True)
class Flown:
    """errors_m (n,), inside the 95 % ellipse (n,), bound_m2 (n,)."""

    errors_m: np.ndarray
    inside: np.ndarray
    bound_m2: np.ndarray


def circling(target: Target, angle_rad: float, phase_rad: float) -> np.ndarray:
    """Places (n, 2) of an aircraft that circles next to the target, at an angle from north."""
    angle = phase_rad + np.arange(len(target.states)) * STEP_S * SPEED_M_S / RADIUS_M
    middle = RANGE_M * np.array([math.sin(angle_rad), math.cos(angle_rad)])
    return target.states[:, :2] + middle + RADIUS_M * np.stack((np.sin(angle), np.cos(angle)), axis=1)


def bound_m2(target: Target, aircraft: list[np.ndarray]) -> np.ndarray:
    """Variance of east plus that of north at each step. State: place, velocity, height, then biases of each."""
    n = 5 + 3 * len(aircraft)
    spread = np.diag([1e8, 1e8, SPEED_SIGMA**2, SPEED_SIGMA**2, 1e8, *np.tile(BIASES**2, len(aircraft))])
    by_bias = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    step, gained = np.eye(n), np.zeros((n, n))
    step[:4, :4], gained[:4, :4] = turn_by(0.0), cruise_noise()
    gained[4, 4] = GROUND_DENSITY * STEP_S
    found = np.zeros(len(target.states))
    for k, state in enumerate(target.states):
        if k > 0:
            spread = step @ spread @ step.T + gained
        for payload, places in enumerate(aircraft):
            jacobian = np.zeros((3, n))
            jacobian[:, [0, 1, 4]] = measurement_derivative(state[:2], places[k])
            jacobian[:, 5 + 3 * payload : 8 + 3 * payload] = by_bias
            gain = np.linalg.solve(jacobian @ spread @ jacobian.T + np.diag(SIGMAS**2), jacobian @ spread).T
            spread = spread - gain @ jacobian @ spread
            spread = (spread + spread.T) / 2.0
        found[k] = spread[0, 0] + spread[1, 1]
    return found


def fly(seed: int, angles_rad: tuple[float, ...], steps: int, ahead_s: float = 0.0) -> Flown:
    """Fly one target. ahead_s: of the last aircraft's clock, which the track is ordered to one sigma."""
    rng = np.random.default_rng(seed)
    target = wandering(rng, steps)
    aircraft = [circling(target, angle, rng.uniform(0, 2 * math.pi)) for angle in angles_rad]
    seen = [sightings(rng, target, places, tuple(BIASES * rng.standard_normal(3))) for places in aircraft]
    track = JointTrack({str(k): SETTINGS for k in range(len(aircraft))})
    errors, inside = [], []
    for k, true in enumerate(target.states):
        for payload, every in enumerate(seen):
            late = ahead_s if payload == len(seen) - 1 else 0.0
            sighting = replace(every[k], time_s=every[k].time_s + late)
            track.add(str(payload), sighting, late)
        estimate = track.estimate(k * STEP_S)
        assert estimate is not None
        moved = true[:2] + (estimate.time_s - k * STEP_S) * true[2:]
        error = np.array((estimate.east_m, estimate.north_m)) - moved
        errors.append(math.hypot(*error))
        inside.append(error @ np.linalg.solve(estimate.covariance[:2, :2], error) < CHI2_95)
    return Flown(np.array(errors), np.array(inside), bound_m2(target, aircraft))


def summed(flights: list[Flown], settled: slice) -> tuple[float, float, float]:
    """Return RMSE and bound, m, and the share of time in the 95 % ellipse."""
    rmse = math.sqrt(np.mean([(flown.errors_m[settled] ** 2).mean() for flown in flights]))
    bound = math.sqrt(np.mean([flown.bound_m2[settled].mean() for flown in flights]))
    return rmse, bound, float(np.mean([flown.inside[settled].mean() for flown in flights]))


def test_error_of_two_against_the_bound():
    """At whatever angle between them, the error is the same: two base lines report each payload's errors."""
    for apart_deg in (None, 30, 90, 150, 180):
        angles = (math.pi,) if apart_deg is None else (math.pi, math.pi + math.radians(apart_deg))
        rmse, bound, inside = summed([fly(seed, angles, 2000) for seed in range(RUNS)], slice(1000, None))
        who = "one aircraft" if apart_deg is None else f"two, {apart_deg} degrees apart"
        print(f"\n{who}: {rmse:.2f} m, bound {bound:.2f} ({rmse / bound:.2f} x), ellipse {100 * inside:.1f} %")
        if apart_deg is not None:
            assert rmse <= 1.25 * bound
            assert 0.92 <= inside <= 0.98


def test_a_clock_that_is_ahead_is_found_out():
    flights = [fly(seed, (math.pi, 1.5 * math.pi), 2000, ahead_s=0.3) for seed in range(size(8, 1))]
    rmse, bound, inside = summed(flights, slice(1000, None))
    print(f"\na clock 0.3 s ahead: {rmse:.3f} m, bound without {bound:.3f}, {100 * inside:.1f} %")
    assert rmse <= 1.5 * bound
