"""The route, the target's progress along it, and planning by it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.mission.route.progress_kernel import forecast, fresh_progress, update_progress
from sidelong.mission.route.route import Direction, Route, RouteProgress, describe, progress_of, route_of, way_of
from sidelong.mission.viewpoint.viewpoint_kernel import TargetState

_COVARIANCE = np.diag([4.0, 4.0, 0.09, 0.09])


def _follow(
    route: Route, path: list[tuple[float, float, float, float]], seed: int = 3, sigma_m_s: float = 0.3
) -> list[RouteProgress]:
    """Return the progress after each second of a noisy path of (east, north, velocity east, north)."""
    rng, memory, found = np.random.default_rng(seed), fresh_progress(route.east_m.size), []
    for k, state in enumerate(path):
        east, north, ve, vn = np.array(state) + rng.normal(0.0, [2.0, 2.0, sigma_m_s, sigma_m_s])
        update_progress(way_of(route), TargetState(float(k), east, north, ve, vn, _COVARIANCE), memory)
        progress = progress_of(route, memory)
        assert progress is not None
        found.append(progress)
    return found


def _corner() -> Route:
    return route_of(np.array([0.0, 0.0, 400.0]), np.array([0.0, 300.0, 300.0]))


def _along_corner(speed_m_s: float, aside_m: float, seconds: int) -> list[tuple[float, float, float, float]]:
    path = []
    for k in range(seconds):
        gone = k * speed_m_s
        if gone < 300.0:
            path.append((aside_m, gone, 0.0, speed_m_s))
        else:
            path.append((gone - 300.0, 300.0 - aside_m, speed_m_s, 0.0))
    return path


def test_target_next_to_its_route_is_followed_round_the_corner() -> None:
    found = _follow(_corner(), _along_corner(4.0, 6.0, 120))
    assert all(one.on_route for one in found[15:])
    assert found[110].along_m == pytest.approx(440.0, abs=15.0)
    assert found[110].speed_m_s == pytest.approx(4.0, abs=0.5)
    assert found[110].to_end_s == pytest.approx(65.0, abs=8.0)
    assert "along the route" in describe(found[110])


def test_corner_of_a_displaced_route_is_expected_where_the_target_turns() -> None:
    # The target's way is 12 m east and 9 m south of the route, which the first leg shows east and the second north.
    corners = np.array([(0.0, 0.0), (0.0, 300.0), (400.0, 300.0), (400.0, 600.0), (700.0, 600.0)])
    route = route_of(*corners.T)
    path = _along(corners + np.array([12.0, -9.0]), 4.0)
    memory, ahead, rng = fresh_progress(route.east_m.size), np.empty((31, 2)), np.random.default_rng(4)
    k = 235  # 300 + 400 + 240 m: the last turn is 60 m ahead
    for at, state in enumerate(path[: k + 1]):
        known = np.array(state) + rng.normal(0.0, [1.0, 1.0, 0.2, 0.2])
        update_progress(way_of(route), TargetState(float(at), *known, _COVARIANCE), memory)
    forecast(way_of(route), memory.state[0], float(k), ahead)
    predicted = ahead[-1] - ahead[0]
    assert predicted == pytest.approx(np.array(path[k + 30][:2]) - np.array(path[k][:2]), abs=6.0)


def test_target_that_stops_aside_of_the_route_stays_on_it() -> None:
    forward = _along_corner(3.0, 17.0, 60)
    found = _follow(_corner(), forward + [(*forward[-1][:2], 0.0, 0.0)] * 300, sigma_m_s=0.1)
    assert all(one.on_route for one in found[40:])


def test_target_that_speeds_up_is_not_predicted_to_slow_down() -> None:
    route = route_of(np.zeros(2), np.array([0.0, 600.0]))
    speed_m_s = np.append(np.full(40, 3.0), np.linspace(3.0, 12.0, 9))
    north_m = np.cumsum(speed_m_s)
    memory, ahead = fresh_progress(route.east_m.size), np.empty((7, 2))
    for k, (north, speed) in enumerate(zip(north_m, speed_m_s, strict=True)):
        update_progress(way_of(route), TargetState(float(k), 0.0, north, 0.0, speed, _COVARIANCE), memory)
    forecast(way_of(route), memory.state[0], float(len(speed_m_s) - 1), ahead)
    assert ahead[6, 1] - ahead[0, 1] > 6.0 * 10.5


def test_target_that_leaves_the_route_is_reported_within_15_s_of_20_m() -> None:
    straight_on = [(6.0, 4.0 * k, 0.0, 4.0) for k in range(130)]  # the route turns at 300 m, after 75 s
    found = _follow(_corner(), straight_on)
    assert found[70].on_route
    assert not found[80 + 15].on_route
    assert describe(found[-1]) == "off route"


def test_stop_keeps_the_target_on_the_route_and_turning_back_is_followed() -> None:
    forward = _along_corner(3.0, 3.0, 40)
    stand = [(*forward[-1][:2], 0.0, 0.0)] * 60
    back = [(3.0, forward[-1][1] - 3.0 * k, 0.0, -3.0) for k in range(30)]
    found = _follow(_corner(), forward + stand + back)
    assert found[95].on_route
    assert found[-1].on_route
    assert found[-1].speed_m_s == pytest.approx(-3.0, abs=0.7)
    # With a direction given, the target is off the route when it goes the other way.
    one_way = route_of(np.array([0.0, 0.0, 400.0]), np.array([0.0, 300.0, 300.0]), direction=Direction.FORWARD)
    assert not _follow(one_way, forward + stand + back)[-1].on_route


def _rows(rows: int, length_m: float, apart_m: float) -> np.ndarray:
    """Return the corners (n, 2) of a path up and down the rows of a field."""
    corners = [(apart_m * row, length_m * ((row + end) % 2)) for row in range(rows) for end in range(2)]
    return np.array(corners)


def _along(corners: np.ndarray, speed_m_s: float) -> list[tuple[float, float, float, float]]:
    leg_m = np.hypot(*np.diff(corners, axis=0).T)
    arc_m = np.append(0.0, np.cumsum(leg_m))
    gone_m = np.arange(0.0, arc_m[-1], speed_m_s)
    place = np.stack([np.interp(gone_m, arc_m, one) for one in corners.T])
    return list(zip(*place, *np.gradient(place, axis=1), strict=True))


def test_progress_keeps_to_the_order_of_rows_that_lie_close_together() -> None:
    corners, apart_m, speed_m_s = _rows(8, 160.0, 6.0), 6.0, 2.0
    # The recorded route is a row's distance aside: by its position alone the target is always on the next row.
    route = route_of(corners[:, 0] + apart_m, corners[:, 1])
    found = _follow(route, _along(corners, speed_m_s))
    for k, one in enumerate(found[20:], 20):
        assert one.on_route
        assert one.speed_m_s >= 0.0
        assert one.along_m == pytest.approx(k * speed_m_s, abs=30.0)


def test_route_whose_rows_are_taken_in_another_order_is_of_no_use() -> None:
    path, speed_m_s = _rows(12, 160.0, 60.0), 4.0
    own = _follow(route_of(*path.T), _along(path, speed_m_s))
    assert all(one.of_use for one in own)
    shifted = _follow(route_of(path[:, 0] + 60.0, path[:, 1]), _along(path, speed_m_s))
    wrong = [one for one in shifted[len(shifted) // 2 :] if one.on_route]
    assert len(wrong) > 60  # s; on each row it is taken for the row of the route
    assert not any(one.of_use for one in wrong)
    assert "not used" in describe(wrong[-1])


def test_parallel_route_60_m_aside_is_not_followed() -> None:
    found = _follow(_corner(), _along_corner(4.0, 60.0, 120))
    assert not any(one.on_route for one in found[10:70])


def test_lap_continues_at_its_first_point() -> None:
    corners = np.array([[0.0, 0.0], [0.0, 100.0], [100.0, 100.0], [100.0, 0.0]])
    square = route_of(corners[:, 0], corners[:, 1], lap=True)
    assert square.length_m == pytest.approx(400.0)
    path = []
    for k in range(260):
        gone = 3.0 * k % 400.0
        leg, past = int(gone // 100.0), gone % 100.0
        (e, n), (e2, n2) = corners[leg], corners[(leg + 1) % 4]
        ve, vn = (e2 - e) / 100.0, (n2 - n) / 100.0
        path.append((e + ve * past, n + vn * past, 3.0 * ve, 3.0 * vn))
    found = _follow(square, path)
    assert all(one.on_route for one in found[15:])
    assert found[-1].along_m == pytest.approx(3.0 * 259 % 400.0, abs=15.0)
    assert math.isnan(found[-1].to_end_s)


def test_route_needs_two_different_finite_points() -> None:
    with pytest.raises(ValueError, match="two different points"):
        route_of(np.zeros(3), np.zeros(3))
    for east_m in (math.nan, math.inf, 1e308):
        with pytest.raises(ValueError, match="finite"):
            route_of(np.array([0.0, east_m]), np.zeros(2))


def test_route_recorded_by_the_centimetre_keeps_its_length() -> None:
    route = route_of(np.arange(0.0, 100.0, 0.01), np.zeros(10_000))
    assert route.length_m == pytest.approx(100.0, abs=0.1)
    assert route_of(np.array([0.0, 0.01, 0.02, 50.0]), np.zeros(4)).length_m == pytest.approx(50.0)
