"""Plans away from a target that is not seen, and around where it can be, keep clear of wherever it can be."""

import math

import numpy as np
import pytest

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft
from sidelong.mission.geometry.approach import HOLD_S, LEAVE_S, Reach, orbits, retreats

AIRFRAME = Aircraft(15.0, 50.0)
KEEP_M = 100.0


@pytest.mark.parametrize("seed", range(8))
def test_no_target_that_walks_in_any_direction_comes_nearer_than_the_distance_to_keep(seed):
    rng = np.random.default_rng(seed)
    away_m, bearing_rad, course_rad = rng.uniform(170.0, 400.0), *rng.uniform(-math.pi, math.pi, 2)
    start = AircraftState(0.0, away_m * math.sin(bearing_rad), away_m * math.cos(bearing_rad), course_rad, 15.0, 0.0)
    reach = Reach(0.0, 0.0, 20.0, 3.0)
    plan = retreats(start, reach, True, AIRFRAME, KEEP_M)[0]
    path, circle = plan.transition, plan.circle
    for walk_rad in np.linspace(0.0, 2.0 * math.pi, 36):
        after_s = path.arc_m / AIRFRAME.airspeed_m_s
        gone_m = 20.0 + 3.0 * after_s
        off_m = np.hypot(path.east_m - gone_m * math.sin(walk_rad), path.north_m - gone_m * math.cos(walk_rad))
        assert off_m.min() >= KEEP_M - 1e-6
        gone_m = 20.0 + 3.0 * (after_s[-1] + HOLD_S)
        off = circle.east_m - gone_m * math.sin(walk_rad), circle.north_m - gone_m * math.cos(walk_rad)
        assert math.hypot(*off) - circle.radius_m >= KEEP_M - 1e-6


def test_path_already_flown_does_not_count():
    start = AircraftState(0.0, -60.0, 0.0, math.pi / 2, 15.0, 0.0)
    plan = retreats(start, Reach(0.0, 0.0, 0.0, 0.0), True, AIRFRAME, KEEP_M)[0]
    reach = Reach(-60.0, 0.0, 0.0, 0.0)
    assert reach.clearance_m(plan, 15.0) == pytest.approx(0.0, abs=1.0)
    clear_m = math.hypot(plan.circle.east_m + 60.0, plan.circle.north_m) - plan.circle.radius_m
    assert reach.clearance_m(plan, 15.0, from_m=plan.transition_m) == pytest.approx(clear_m)
    assert clear_m > 30.0


def test_disk_that_reaches_the_circle_has_no_clearance():
    plan = Plan(Circle(200.0, 0.0, 50.0, True))
    assert Reach(0.0, 0.0, 30.0, 0.0).clearance_m(plan, 15.0) == pytest.approx(120.0)
    assert Reach(0.0, 0.0, 30.0, 3.0).clearance_m(plan, 15.0, hold_s=40.0) == pytest.approx(0.0)


@pytest.mark.parametrize("seed", range(8))
def test_circle_around_a_growing_disk_that_moves_is_joined_from_within_and_from_outside(seed):
    rng = np.random.default_rng(seed)
    away_m, bearing_rad, course_rad = (190.0, 500.0)[seed % 2], *rng.uniform(-math.pi, math.pi, 2)
    per_m = rng.choice((-1.0, 1.0)) / AIRFRAME.radius_m
    start = AircraftState(
        0.0, away_m * math.sin(bearing_rad), away_m * math.cos(bearing_rad), course_rad, 15.0, per_m
    )
    for plan in orbits(start, Reach(0.0, 0.0, 60.0, 1.5, (1.0, 0.5)), AIRFRAME, KEEP_M):
        path, circle = plan.transition, plan.circle
        end_m = math.hypot(path.east_m[-1] - circle.east_m, path.north_m[-1] - circle.north_m)
        assert end_m == pytest.approx(circle.radius_m, abs=6.0)
        assert np.abs(path.curvature_per_m).max() <= 1.0 / AIRFRAME.radius_m + 1e-9
        for after_s in np.linspace(path.length_m / 15.0, path.length_m / 15.0 + LEAVE_S, 7):
            off_m = math.hypot(circle.east_m - after_s, circle.north_m - 0.5 * after_s)
            assert circle.radius_m - off_m >= KEEP_M + 60.0 + 1.5 * after_s - 1e-6
