from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.filters.ekf import TargetEkf
from sidelong.estimators.filters.imm import TargetImm, drift_per_s
from sidelong.estimators.filters.imm_kernel import COVARIANCE, MEAN
from sidelong.estimators.filters.motion import DENSITIES
from sidelong.estimators.filters.target_filter import EAST, HEIGHT, NORTH
from sidelong.estimators.filters.ukf import TargetUkf
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.terrain.standing import GroundedFilter
from sidelong.estimators.terrain.standing_kernel import predict_standing
from sidelong.estimators.tracking.tracker import Tracker

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


@pytest.mark.parametrize("kind", [TargetImm, TargetEkf, TargetUkf])
def test_the_height_follows_the_ground_between_sightings(kind) -> None:
    """A target goes uphill at 3 m/s: ten seconds after the last sighting its height has grown by the slope."""
    settings = TrackerSettings()
    inner = kind(settings, seen(0.0, (0.0, 0.0, 0.0), 0.8), Biases.prior(settings))
    on_ground = GroundedFilter(inner, TILTED)
    for k in range(1, 201):
        time_s = 0.1 * k
        on_ground.predict(time_s)
        on_ground.update(seen(time_s, (3.0 * time_s, 0.0, 0.3 * time_s), 0.8), math.inf)
    on_ground.predict(30.0)
    state = inner.state[1, MEAN:COVARIANCE] if kind is TargetImm else inner._kf.x
    assert state[EAST] == pytest.approx(90.0, abs=8.0)
    assert state[HEIGHT] == pytest.approx(0.1 * state[EAST] - 0.05 * state[NORTH], abs=1.0)


def test_the_compiled_step_is_the_filters(ground: Ground) -> None:
    """Of targets anywhere over the hills, and beyond them, through steps of any length."""
    settings, rng = TrackerSettings(), np.random.default_rng(5)
    on_known_ground = 0
    for _ in range(30):
        at_m = rng.uniform(-18_000.0, 18_000.0, 2).tolist()
        inner = TargetImm(settings, seen(0.0, (0.0, 0.0, 20.0), 0.8), Biases.prior(settings))
        state = inner.state.copy()
        state[:, MEAN + EAST] += at_m[0]
        state[:, MEAN + NORTH] += at_m[1]
        state[:, MEAN + 2 : MEAN + 4] = rng.normal(0.0, 3.0, 2)
        inner = TargetImm.resumed(settings, Biases.prior(settings), 0.0, state.copy())
        on_ground, step_s = GroundedFilter.resumed(inner, ground), float(rng.uniform(0.05, 1.0))
        on_ground.predict(step_s)
        found, drift = np.empty_like(state), drift_per_s(Biases.prior(settings))
        densities = DENSITIES[settings.target_kind]
        predict_standing(state, round(step_s, 6), densities, drift, ground.grid, ground.sigma_m, found)
        np.testing.assert_allclose(found, inner.state, rtol=1e-9, atol=1e-6)
        on_known_ground += not math.isnan(ground.height_m(*at_m))
    assert 10 < on_known_ground < 30


def test_a_line_of_sight_alone_places_a_standing_target(ground: Ground) -> None:
    """Without one range ever: the ray is cut with the ground, and its covariance is the slope's."""
    settings = TrackerSettings(pitch_bias_sigma_rad=0.0, yaw_bias_sigma_rad=0.0, range_bias_sigma_m=0.0)
    place = (200.0, 50.0, 0.1 * 200.0 - 0.05 * 50.0)
    first = seen(0.0, place, 2e3)
    grounded = GroundedFilter(TargetEkf(settings, first, Biases.prior(settings)), TILTED)
    mean, covariance = grounded.moments()
    assert mean[:2] == pytest.approx(place[:2], abs=0.5)
    along = np.array((500.0, 50.0)) / math.hypot(500.0, 50.0)
    slope = 0.1 * along[0] - 0.05 * along[1]
    fall = (100.0 - place[2]) / math.hypot(500.0, 50.0)
    patch = TILTED.patch(*place[:2])
    assert patch is not None
    level_m = math.hypot(500.0, 50.0)
    told_m = math.hypot(patch.sigma_m, 0.006 * level_m * (1.0 + fall**2))
    assert math.sqrt(along @ covariance[:2, :2] @ along) == pytest.approx(told_m / (fall + slope), rel=0.05)


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
