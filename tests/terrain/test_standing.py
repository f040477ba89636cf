from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.filters.ekf import TargetEkf
from sidelong.estimators.filters.imm import TargetImm
from sidelong.estimators.filters.imm_kernel import EAST, HEIGHT, NORTH
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.tracking.tracker import Tracker
from tests.terrain.patch import patch_of

EAST_M, NORTH_M = np.meshgrid(np.arange(81) * 50.0 - 2000.0, np.arange(81) * 50.0 - 2000.0)
TILTED = Ground((0.1 * EAST_M - 0.05 * NORTH_M).astype(np.float32), -2000.0, -2000.0, 50.0, 50.0, 4.0)


def seen(time_s: float, place: tuple[float, float, float], range_sigma_m: float) -> Sighting:
    """From 300 m west and 100 m above home, without noise."""
    east_m, north_m, drop_m = place[0] + 300.0, place[1], 100.0 - place[2]
    level_m = math.hypot(east_m, north_m)
    return Sighting(
        time_s,
        math.hypot(level_m, drop_m),
        math.atan2(east_m, north_m),
        math.atan2(drop_m, level_m),
        range_sigma_m,
        0.006,
        0.006,
        -300.0,
        0.0,
        100.0,
    )


@pytest.mark.parametrize("kind", [TargetImm, TargetEkf])
def test_the_height_follows_the_ground_between_sightings(kind) -> None:
    """A target goes uphill at 3 m/s: ten seconds after the last sighting its height has grown by the slope."""
    settings = TrackerSettings()
    on_ground = kind(settings, seen(0.0, (0.0, 0.0, 0.0), 0.8), Biases.prior(settings), TILTED)
    for k in range(1, 201):
        time_s = 0.1 * k
        on_ground.predict(time_s)
        on_ground.update(seen(time_s, (3.0 * time_s, 0.0, 0.3 * time_s), 0.8), math.inf)
    on_ground.predict(30.0)
    mean, _ = on_ground.moments()
    assert mean[EAST] == pytest.approx(90.0, abs=8.0)
    assert on_ground.height_m == pytest.approx(0.1 * mean[EAST] - 0.05 * mean[NORTH], abs=1.0)


def offset_from(patch, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return transition (n, n) and shift (n,) from the height to its offset from the ground."""
    transition, shift = np.eye(size), np.zeros(size)
    transition[HEIGHT, EAST], transition[HEIGHT, NORTH] = -patch.slope_east, -patch.slope_north
    shift[HEIGHT] = patch.slope_east * patch.east_m + patch.slope_north * patch.north_m - patch.height_m
    return transition, shift


def carried(state: np.ndarray, transition: np.ndarray, shift: np.ndarray, height_variance_m2: float) -> np.ndarray:
    """Return the state with each model's mean x turned into ``transition @ x + shift``."""
    size, found = len(shift), state.copy()
    for row in found:
        covariance = row[1 + size :].reshape(size, size)
        row[1 : 1 + size] = transition @ row[1 : 1 + size] + shift
        covariance[:] = transition @ covariance @ transition.T
        covariance[HEIGHT, HEIGHT] += height_variance_m2
    return found


@pytest.mark.parametrize("kind", [TargetImm, TargetEkf])
def test_a_prediction_over_ground_turns_the_height_into_its_offset_and_back(kind, ground: Ground) -> None:
    """Compared with matrices, for targets anywhere over the hills, and beyond them, through steps of any length."""
    settings, rng = TrackerSettings(), np.random.default_rng(5)
    on_known_ground = 0
    for _ in range(30):
        at_m = rng.uniform(-18_000.0, 18_000.0, 2).tolist()
        free = kind(settings, seen(0.0, (0.0, 0.0, 20.0), 0.8), Biases.prior(settings))
        state, step_s = free.state.copy(), round(float(rng.uniform(0.05, 1.0)), 6)
        state[:, 1 + EAST] += at_m[0]
        state[:, 1 + NORTH] += at_m[1]
        state[:, 3:5] = rng.normal(0.0, 3.0, 2)
        on_ground = kind.resumed(settings, 0.0, state, ground)
        mean, covariance = on_ground.moments()
        on_ground.predict(step_s)
        before = patch_of(ground, float(mean[EAST]), float(mean[NORTH]))
        if before is None:
            free = kind.resumed(settings, 0.0, state)
            free.predict(step_s)
        else:
            on_known_ground += 1
            free = kind.resumed(settings, 0.0, carried(state, *offset_from(before, 9), 0.0))
            free.densities = free.densities._replace(height_m2_s=0.0)  # the grid has the ground's changes
            free.predict(step_s)
            speed_m_s = math.sqrt(mean[2] ** 2 + mean[3] ** 2 + covariance[2, 2] + covariance[3, 3])
            kept = math.exp(-speed_m_s * step_s / 1000.0)
            mean, _ = free.moments()
            after = patch_of(ground, float(mean[EAST]), float(mean[NORTH])) or before
            to_offset, shift = offset_from(after, 9)
            to_height = 2.0 * np.eye(9) - to_offset
            to_height[HEIGHT, HEIGHT] = kept
            free.state = carried(free.state, to_height, -shift, (1.0 - kept**2) * after.sigma_m**2)
        np.testing.assert_allclose(on_ground.state, free.state, rtol=1e-9, atol=1e-6)
    assert 10 < on_known_ground < 30


def test_a_line_of_sight_alone_places_a_standing_target(ground: Ground) -> None:
    """Without one range ever: the ray is cut with the ground, and its covariance is the slope's."""
    settings = TrackerSettings(pitch_bias_sigma_rad=0.0, yaw_bias_sigma_rad=0.0, range_bias_sigma_m=0.0)
    place = (200.0, 50.0, 0.1 * 200.0 - 0.05 * 50.0)
    first = seen(0.0, place, 2e3)
    grounded = TargetEkf(settings, first, Biases.prior(settings), TILTED)
    mean, covariance = grounded.moments()
    assert mean[:2] == pytest.approx(place[:2], abs=0.5)
    along = np.array((500.0, 50.0)) / math.hypot(500.0, 50.0)
    slope = 0.1 * along[0] - 0.05 * along[1]
    fall = (100.0 - place[2]) / math.hypot(500.0, 50.0)
    patch = patch_of(TILTED, *place[:2])
    assert patch is not None
    level_m = math.hypot(500.0, 50.0)
    reported_m = math.hypot(patch.sigma_m, 0.006 * level_m * (1.0 + fall**2))
    assert math.sqrt(along @ covariance[:2, :2] @ along) == pytest.approx(reported_m / (fall + slope), rel=0.05)


def test_with_the_laser_out_for_a_minute_the_track_lives_on_angles(laser_out) -> None:
    flown = [laser_out.flown(seed) for seed in range(6)]
    assert np.median([rmse_m for rmse_m, _ in flown]) < 8.0
    assert np.mean([inside for _, inside in flown]) > 0.85
    coasted = [laser_out.flown(seed, grounded=False)[0] for seed in range(3)]
    assert np.median(coasted) > 2.0 * np.median([rmse_m for rmse_m, _ in flown[:3]])


def test_angles_do_not_count_where_the_gimbal_follows_the_estimate(laser_out) -> None:
    tracker = Tracker(TrackerSettings())
    tracker.stand_on(laser_out.true, angles_alone=False)
    assert tracker._pairing.ground is None
