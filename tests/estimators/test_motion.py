import math

import numpy as np
import pytest

from sidelong.estimators.filters.imm import DENSITIES
from tests.estimators.plain_motion import (
    MODELS,
    TURN,
    TURNING,
    cruise_noise,
    model_noises,
    model_transitions,
    switch_probabilities,
    turn,
)


def test_a_quarter_turn_to_the_right_from_north_ends_eastward():
    # 5 m/s at 9 degrees a second: a radius of 31.83 m, once ahead and once aside after 90 degrees.
    rate_rad_s = math.radians(9)
    moved = turn(rate_rad_s, 0.0, 5.0, 10.0).transition @ np.array([0.0, 0.0, 0.0, 5.0])
    assert moved == pytest.approx([31.831, 31.831, 5.0, 0.0], abs=1e-3)


def test_a_turn_of_no_rate_goes_straight():
    assert turn(0.0, 1.0, 2.0, 0.5).transition @ np.array([0.0, 0.0, 1.0, 2.0]) == pytest.approx([0.5, 1.0, 1.0, 2.0])


def test_the_derivative_by_the_rate_is_that_of_the_turn():
    state, rate, step = np.array([0.0, 0.0, 3.0, 4.0]), 0.15, 0.1
    difference = (turn(rate + 1e-6, 3, 4, step).transition - turn(rate - 1e-6, 3, 4, step).transition) @ state / 2e-6
    assert turn(rate, 3, 4, step).by_rate == pytest.approx(difference, abs=1e-3)


def test_a_standing_target_forgets_its_speed_and_a_cruising_one_its_turn():
    transitions, _ = model_transitions(6, 0.1, 0.2, 3.0, 4.0)
    standing, cruising, turning, _ = transitions @ np.array([0.0, 0.0, 3.0, 4.0, 0.0, 0.2])
    assert standing == pytest.approx([0, 0, 0, 0, 0, 0])
    assert cruising == pytest.approx([0.3, 0.4, 3, 4, 0, 0])
    assert turning[TURN] == 0.2
    assert math.hypot(turning[2], turning[3]) == pytest.approx(5.0)


@pytest.mark.parametrize("step_s", [0.05, 0.1, 1.0])
def test_chances_stay_chances(step_s):
    switch = switch_probabilities(step_s)
    assert switch.sum(axis=1) == pytest.approx(np.ones(len(MODELS)))
    assert (switch >= 0).all()
    assert (np.diag(switch) > 0.7).all()


def test_two_small_steps_spread_as_one_large():
    transition = np.eye(5)
    transition[0, 2] = transition[1, 3] = 0.5
    half, whole = cruise_noise(5, 0.5, 0.03, ()), cruise_noise(5, 1.0, 0.03, ())
    assert transition @ half @ transition.T + half == pytest.approx(whole, abs=1e-12)


def test_noises_are_covariances():
    for noise in model_noises(9, 0.1, DENSITIES["unknown"], (1e-10, 1e-10, 1e-7)):
        assert noise == pytest.approx(noise.T)
        assert np.linalg.eigvalsh(noise).min() >= -1e-15
    assert model_noises(9, 0.1, DENSITIES["unknown"], (1e-10, 1e-10, 1e-7))[TURNING, TURN, TURN] > 0
