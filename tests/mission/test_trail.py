"""A target that repeats an earlier part of its path is expected to continue as it did then."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.estimators.compiled import new_record
from sidelong.mission.viewpoint.viewpoint_kernel import PATH_HISTORY, predict_along, remember, repeated_part

SPEED_M_S, PREDICTED_S = 2.0, 60


def rows(apart_m: float, length_m: float = 150.0, count: int = 6) -> np.ndarray:
    """Rows of a field, or with 0 m between them a target that paces: corners (n, 2)."""
    return np.array([(apart_m * row, length_m * ((row + end) % 2)) for row in range(count) for end in (0, 1)])


def laps(apart_m: float) -> np.ndarray:
    """Laps about a field, each inside the one before."""
    lap = [(1.0, 1.0), (1.0, 150.0), (240.0, 150.0), (240.0, 1.0)]
    inwards = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])
    return np.concatenate([np.array(lap) + inwards * apart_m * k for k in range(3)])


def walked(corners: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return the places (n, 2) of each second, known to half a metre, of a target that goes from corner to corner."""
    way_m = np.concatenate([[0.0], np.hypot(*np.diff(corners, axis=0).T).cumsum()])
    at_m = np.arange(0.0, way_m[-1], SPEED_M_S)
    places = np.stack([np.interp(at_m, way_m, corners[:, i]) for i in (0, 1)], axis=1)
    return places + np.random.default_rng(seed).normal(0.0, 0.5, places.shape)


def remembered(places: np.ndarray) -> np.record:
    trail = new_record(PATH_HISTORY)[0]
    for east_m, north_m in places:
        remember(trail, east_m, north_m)
    return trail


def predicted(places: np.ndarray, now_s: int) -> tuple[float, np.ndarray]:
    """Return the probability that an earlier part is repeated, and the places (n, 2) along it."""
    trail = remembered(places[: now_s + 1])
    part = repeated_part(trail, *places[now_s], SPEED_M_S)
    east_m, north_m = np.empty(PREDICTED_S), np.empty(PREDICTED_S)
    if part.chance > 0.0:
        predict_along(trail, part, *places[now_s], SPEED_M_S, east_m, north_m)
    return part.chance, np.stack([east_m, north_m], axis=1)


def corner_s(places: np.ndarray) -> int:
    """Return when a way of six seconds is first half a right angle off that at the start."""
    courses = [math.atan2(*(places[k + 6] - places[k])) for k in range(len(places) - 6)]
    return next(k + 3 for k, one in enumerate(courses) if math.cos(one - courses[0]) < math.cos(math.pi / 4))


@pytest.mark.parametrize("corners", [rows(8.0), rows(0.0), laps(9.0)], ids=["rows", "pacing", "laps"])
@pytest.mark.parametrize("ahead_s", [15, 30])
def test_a_corner_is_predicted_from_the_last_one_there(corners, ahead_s):
    places = walked(corners)
    leg_m = np.hypot(*np.diff(corners, axis=0).T)
    # The corner at the end of the leg that is the first one of the last row, or lap.
    last = {12: 8}.get(len(corners), 10)
    now_s = round(leg_m[:last].sum() / SPEED_M_S) - ahead_s
    chance, found = predicted(places, now_s)
    assert chance >= 0.7
    assert corner_s(found) == pytest.approx(corner_s(places[now_s:]), abs=8.0)


def test_a_path_that_was_never_taken_before_predicts_nothing():
    rng = np.random.default_rng(2)
    corners = np.cumsum(rng.uniform(30.0, 90.0, (12, 2)), axis=0)
    places = walked(corners)
    assert all(predicted(places, now_s)[0] == 0.0 for now_s in range(40, len(places), 10))


def test_one_who_paces_over_a_few_metres_predicts_nothing():
    places = walked(rows(1.0, 24.0, 30), seed=3)
    assert all(predicted(places, now_s)[0] == 0.0 for now_s in range(40, len(places), 5))


def test_the_trail_goes_straight_on_where_it_ends():
    places = np.stack([np.zeros(201), 2.0 * np.abs(np.arange(201) - 100.0)], axis=1)  # there and back
    trail = remembered(places[:166])
    part = repeated_part(trail, *places[165], SPEED_M_S)
    assert part.ahead == -1
    east_m, north_m = np.empty(60), np.empty(60)
    predict_along(trail, part, *places[165], SPEED_M_S, east_m, north_m)
    np.testing.assert_allclose(np.diff(north_m), 2.0, atol=1e-6)


def test_a_part_is_held_on_to_in_a_bend_that_is_another_one_now_and_left_by_one_who_goes_straight_on():
    corners = rows(8.0)
    places = walked(corners)
    corner = round(np.hypot(*np.diff(corners[:10], axis=0).T).sum() / SPEED_M_S)  # the end of the fifth row
    beyond = places[corner] + np.outer(np.arange(1, 31) * SPEED_M_S, (0.0, 1.0 if corners[9, 1] > 0.0 else -1.0))
    for then, ahead in ((places[corner + 1 :], -1), (beyond, 0)):
        trail = new_record(PATH_HISTORY)[0]
        for east_m, north_m in np.concatenate([places[: corner + 1], then[:10]]):
            remember(trail, east_m, north_m)
            part = repeated_part(trail, east_m, north_m, SPEED_M_S)
        assert part.ahead == ahead


def test_a_long_trail_forgets_its_older_half():
    trail = remembered(np.stack([np.zeros(5000), 4.0 * np.arange(5000.0)], axis=1))
    kept = trail.points[: trail.count]
    assert 2048 <= trail.count <= 4096
    np.testing.assert_allclose(kept[-1], (0.0, 19_996.0, 19_996.0))
    np.testing.assert_allclose(np.diff(kept[:, 2]), 4.0)
