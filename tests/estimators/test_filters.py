"""Every filter through the same scenes: what it reports of its own error must be true."""

import math
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, IMMEstimator
from scipy.stats import chi2

from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.filters.ekf import TargetEkf
from sidelong.estimators.filters.imm import DENSITIES, TargetImm, starting_moments
from sidelong.estimators.filters.imm_kernel import TARGET
from sidelong.estimators.settings import TrackerSettings
from tests.estimators.plain_motion import (
    CRUISING,
    MODELS,
    POSITION,
    STANDING,
    TURNING,
    cruise,
    cruise_noise,
    measured,
    model_noises,
    model_transitions,
    switch_probabilities,
)

FILTERS = {"ekf": TargetEkf, "imm": TargetImm}
SETTINGS = TrackerSettings()
NO_BIAS = TrackerSettings(yaw_bias_sigma_rad=0.0, pitch_bias_sigma_rad=0.0, range_bias_sigma_m=0.0)


def run(kind, sightings, settings=SETTINGS, gate_nis=math.inf):
    """Yield the filter after each sighting, and the sighting's NIS."""
    target = FILTERS[kind](settings, sightings[0], Biases.prior(settings))
    for sighting in sightings[1:]:
        target.predict(sighting.time_s)
        yield target, target.update(sighting, gate_nis)


def wandering(rng, density_m2_s3=0.03):
    """A velocity that wanders as the cruising model reports."""
    velocity, last_s = 3.0 * rng.standard_normal(2), 0.0

    def at(time_s):
        nonlocal velocity, last_s
        velocity = velocity + math.sqrt(density_m2_s3 * (time_s - last_s)) * rng.standard_normal(2)
        last_s = time_s
        return tuple(velocity)

    return at


@pytest.mark.parametrize("kind", FILTERS)
def test_errors_are_as_large_as_the_filter_reports(kind, scene):
    """NEES of position and of the biases, and NIS, averaged over seeds, lie where chi-square puts them."""
    seeds = 12
    nees, nis, bias_nees = [], [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        flown = scene.of(wandering(rng), 60.0, phase_rad=seed)
        prior = Biases.prior(SETTINGS)
        biases = np.sqrt(np.diag(prior.covariance)) * rng.standard_normal(3)
        sightings = flown.sightings(rng, yaw_rad=biases[0], pitch_rad=biases[1], range_m=biases[2])
        for k, (target, one_nis) in enumerate(run(kind, sightings), start=1):
            nis.append(one_nis)
            if k % 100 == 0:
                mean, covariance = target.moments()
                error = mean[:2] - flown.target[k, :2]
                nees.append(error @ np.linalg.solve(covariance[:2, :2], error))
        known = target.biases()
        error = known.mean - biases
        bias_nees.append(error @ np.linalg.solve(known.covariance, error))
    # A flight's errors, being mostly its biases, count once: two degrees of freedom for each seed.
    assert chi2.ppf(0.005, 2 * seeds) / seeds < np.mean(nees) < chi2.ppf(0.995, 2 * seeds) / seeds
    assert chi2.ppf(0.005, 3 * seeds) / seeds < np.mean(bias_nees) < chi2.ppf(0.995, 3 * seeds) / seeds
    assert np.mean(nis) == pytest.approx(3.0, abs=0.12)


@pytest.mark.parametrize("kind", FILTERS)
def test_a_bias_of_yaw_is_learnt_with_the_precision_that_is_claimed(kind, scene):
    """Half a degree, five laps next to a standing target; a moving target needs far longer."""
    sightings = scene.of(lambda _: (0.0, 0.0), 170.0).sightings(np.random.default_rng(5), yaw_rad=math.radians(0.5))
    *_, (target, _) = run(kind, sightings)
    calibration = target.biases().calibration
    assert abs(calibration.yaw_bias_rad - math.radians(0.5)) < 3 * calibration.yaw_sigma_rad
    assert calibration.yaw_sigma_rad < 0.3 * SETTINGS.yaw_bias_sigma_rad


def test_a_single_model_predicts_as_the_cruising_matrices_do():
    """The extended filter: nothing but the cruising model, and the drift of the errors that are estimated."""
    rng, n = np.random.default_rng(1), TARGET + 3
    settings = TrackerSettings(filter="ekf", acceleration_density_m2_s3=0.03)
    root = rng.normal(size=(n, n))
    mean, covariance = rng.normal(size=n), root @ root.T
    mean[5] = covariance[5, :] = covariance[:, 5] = 0.0
    target = TargetEkf.resumed(settings, 0.0, np.concatenate(([1.0], mean, covariance.ravel()))[None])
    target.predict(0.4)
    transition, noise = cruise(n, 0.4), cruise_noise(n, 0.4, 0.03)
    noise[5, 5] = 0.25**2  # of the turn rate, which it does not use
    noise[6:, 6:] = 0.4 * np.diag([2e-8, 1e-10, 1e-7])
    found = target.state[0]
    assert found[1 : 1 + n] == pytest.approx(transition @ mean)
    assert found[1 + n :].reshape(n, n) == pytest.approx(transition @ covariance @ transition.T + noise)


class Reference(ExtendedKalmanFilter):
    """One motion of the IMM on filterpy's own filter: takes sightings for measurements, at the steps of the scene."""

    def __init__(self, model, mean, covariance):
        super().__init__(dim_x=len(mean), dim_z=3)
        self.model = model
        self.x, self.P = mean, covariance

    def predict(self, u=None):
        transitions, by_rate = model_transitions(self.dim_x, 0.1, *map(float, self.x[[-1, 2, 3]]))
        self.x = transitions[self.model] @ self.x
        if self.model == TURNING:
            transitions[TURNING, :4, -1] = by_rate
        self.F = transitions[self.model]
        self.P = self.F @ self.P @ self.F.T + model_noises(self.dim_x, 0.1, DENSITIES["unknown"], ())[self.model]

    def update(self, sighting):
        residual, by_position = measured(sighting, *map(float, self.x[POSITION]))
        jacobian = np.zeros((3, self.dim_x))
        jacobian[:, POSITION] = by_position
        super().update(residual, lambda _: jacobian, lambda _: 0.0, R=np.diag(sighting.variances))


def test_the_stacked_filter_is_the_interacting_multiple_model_filter_of_filterpy(scene):
    """The same but for where the measurement is linearised: at the common mean here, at each model's own there."""

    def velocity(time_s):
        if time_s < 20:
            return (4.0, 0.0) if time_s < 10 else (0.0, 0.0)
        return 4 * math.sin(time_s / 8), 4 * math.cos(time_s / 8)

    settings = TrackerSettings(
        yaw_bias_sigma_rad=0.0, pitch_bias_sigma_rad=0.0, range_bias_sigma_m=0.0, soft_nis=math.inf
    )
    sightings = scene.of(velocity, 40.0).sightings(np.random.default_rng(3))
    start, start_covariance = starting_moments(settings, sightings[0], Biases.prior(settings))
    mean, covariance = start[:TARGET], start_covariance[:TARGET, :TARGET]
    models = [Reference(model, mean.copy(), covariance.copy()) for model in MODELS]
    reference = IMMEstimator(models, np.full(len(MODELS), 0.25), switch_probabilities(0.1))
    for (target, _), sighting in zip(run("imm", sightings, settings), sightings[1:], strict=True):
        reference.predict()
        reference.update(sighting)
        ours, covariance = target.moments()
        assert ours == pytest.approx(reference.x[:4], abs=0.02)
        assert np.sqrt(np.diag(covariance)) == pytest.approx(np.sqrt(np.diag(reference.P))[:4], rel=0.02)
        assert target.state[:, 0] == pytest.approx(reference.mu, abs=0.02)


def test_a_standing_target_is_known_to_stand(scene):
    sightings = scene.of(lambda _: (0.0, 0.0), 40.0).sightings(np.random.default_rng(4))
    *_, (target, _) = run("imm", sightings, NO_BIAS)
    mean, _ = target.moments()
    assert math.hypot(mean[2], mean[3]) < 0.1
    assert target.state[STANDING, 0] > 0.8


def test_a_target_that_brakes_is_caught_within_seconds(scene):
    """From 5 m/s at 2.5 m/s^2, as a car does, and at once, as nothing does: standing for the filter within 5 s."""
    for braking_s in (0.0, 2.0):
        took_s = []
        for seed in range(10):

            def velocity(time_s, braking_s=braking_s):
                left = 1.0 if time_s < 20 else max(0.0, 1.0 - (time_s - 20) / braking_s) if braking_s else 0.0
                return 5.0 * left, 0.0

            sightings = scene.of(velocity, 40.0, phase_rad=seed).sightings(np.random.default_rng(seed))
            speeds = [math.hypot(*target.moments()[0][2:]) for target, _ in run("imm", sightings)]
            stop = round((20 + braking_s) / 0.1)
            took_s.append(next(k for k in range(300) if speeds[stop + k] < 0.5) * 0.1)
        assert np.median(took_s) <= 5.0


def test_in_a_turn_the_models_follow_where_one_model_lags(scene):
    turning = scene.of(lambda t: (5 * math.sin(t / 6), 5 * math.cos(t / 6)), 60.0)
    sightings = turning.sightings(np.random.default_rng(6))
    error = {}
    for kind in ("ekf", "imm"):
        places = np.array([target.moments()[0][:2] for target, _ in run(kind, sightings, NO_BIAS)])
        error[kind] = np.sqrt(((places - turning.target[1:, :2]) ** 2).sum(axis=1).mean())
    assert error["imm"] < 1.0
    assert error["imm"] < 0.6 * error["ekf"]


@pytest.mark.parametrize("kind", FILTERS)
def test_a_sighting_beyond_the_gate_leaves_the_filter_as_it_was(kind, scene, moved):
    sightings = scene.of(lambda _: (2.0, 0.0), 10.0).sightings(np.random.default_rng(7))
    *_, (target, _) = run(kind, sightings)
    target.predict(10.0)
    before, spread = (array.copy() for array in target.moments())
    assert target.update(moved(sightings[-1], slant_range_m=60.0, time_s=0.1), 20.0) > 20.0
    after, after_spread = target.moments()
    assert after.tolist() == before.tolist()
    assert after_spread.tolist() == spread.tolist()


@pytest.mark.parametrize("kind", FILTERS)
def test_a_copy_goes_its_own_way(kind, scene):
    sightings = scene.of(lambda _: (2.0, 1.0), 8.0).sightings(np.random.default_rng(8))
    *_, (target, _) = run(kind, sightings[:40])
    copy = target.copy()
    for sighting in sightings[40:]:
        copy.predict(sighting.time_s)
        copy.update(sighting, math.inf)
    again, straight = list(run(kind, sightings[:40]))[-1][0], list(run(kind, sightings))[-1][0]
    assert target.moments()[0].tolist() == again.moments()[0].tolist()
    assert copy.moments()[0].tolist() == straight.moments()[0].tolist()


@pytest.mark.parametrize("kind", FILTERS)
def test_a_far_wrong_prediction_does_not_bend_the_next_sighting(kind, scene, moved):
    """After a minute unseen the target is 150 m from where it was expected: two sightings later it is found."""
    sightings = scene.of(lambda _: (2.0, 0.0), 65.0).sightings(np.random.default_rng(9))
    *_, (target, _) = run(kind, sightings[:50])
    for step in range(60):
        target.predict(5.0 + step)
    for sighting in sightings[640:645]:
        target.predict(sighting.time_s)
        target.update(moved(sighting, aircraft_north_m=-80.0), math.inf)
    mean, covariance = target.moments()
    error = math.hypot(mean[0] - 2.0 * 64.4, mean[1] + 80.0)
    assert error < 6 * math.sqrt(covariance[:2, :2].trace())
    assert error < 20.0


def test_cruising_is_taken_for_cruising(scene):
    *_, (target, _) = run("imm", scene.of(lambda _: (3.0, 3.0), 60.0).sightings(np.random.default_rng(10)), NO_BIAS)
    assert int(np.argmax(target.state[:, 0])) == CRUISING


def test_a_resting_target_that_creeps_is_not_taken_for_an_error_of_the_gimbal(scene):
    """By 0.2 m/s, elsewhere every 12 s, as a resting hiker does: what is accepted of the yaw error must be true."""
    nees = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        velocities = rng.normal(0.0, 0.2, (20, 2))
        flown = scene.of(lambda time_s, v=velocities: v[int(time_s / 12.0)], 240.0, phase_rad=seed)
        *_, (target, _) = run("imm", flown.sightings(rng))
        calibration = target.biases().calibration
        nees.append((calibration.yaw_bias_rad / calibration.yaw_sigma_rad) ** 2)
    assert np.mean(nees) < chi2.ppf(0.99, 6) / 6


@pytest.mark.parametrize(("dropout_s", "steadier"), [(0.0, False), (2.0, False), (5.0, True)])
def test_motion_counts_as_steadier_only_while_ranges_are_missing(dropout_s, steadier, scene):
    """After a few seconds without ranges the velocity is predicted with less noise; without sightings it is not."""
    sightings = scene.of(lambda _: (3.0, 0.0), 20.0).sightings(np.random.default_rng(1))
    ranged_s = sightings[-1].time_s - dropout_s
    flown = [one if one.time_s <= ranged_s else replace(one, range_sigma_m=2e3, has_range=False) for one in sightings]
    *_, (target, _) = run("imm", flown)
    usual = TargetImm.resumed(SETTINGS, target.time_s, target.state)
    target.predict(target.time_s + 10.0)
    usual.predict(usual.time_s + 10.0)
    variances, usual_variances = (np.diag(one.moments()[1])[2:] for one in (target, usual))
    assert (variances < usual_variances).all() == steadier
    assert (variances == usual_variances).all() != steadier


def test_density_of_the_ekf_is_the_configured_one_without_ranges_too(scene):
    """Its first sighting has no range, as where the laser is silent at first."""
    sightings = scene.of(lambda _: (3.0, 0.0), 20.0).sightings(np.random.default_rng(1))
    first = replace(sightings[0], range_sigma_m=2e3, has_range=False)
    *_, (target, _) = run("ekf", [first, *sightings[1:]])
    usual = TargetEkf.resumed(SETTINGS, target.time_s, target.state)
    target.predict(target.time_s + 10.0)
    usual.predict(usual.time_s + 10.0)
    assert (target.moments()[1] == usual.moments()[1]).all()
