from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.planners.value_cache import value_table
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind
from sidelong.mission.core.sight import NOTHING_HIDDEN
from sidelong.mission.predictive.planner import PredictivePlanner, table_configuration
from sidelong.mission.predictive.rollout_kernel import Pose, WatchFrame, add_sight, hidden_rate, single_line
from sidelong.mission.terrain.heights import SightField

HEIGHT_M = 100.0


def walled() -> Ground:
    """Flat, but for a wall 150 m high that runs north to south 100 m west of the origin, from 60 m south on."""
    heights = np.zeros((161, 161), np.float32)
    heights[:, 75] = 150.0
    heights[:77, 75] = 0.0
    return Ground(heights, -1600.0, -1600.0, 20.0, 20.0, 4.0)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("course_deg", [0.0, 140.0, -75.0])
def test_the_cost_of_a_place_is_what_the_line_of_sight_reports(
    ground: Ground, course_deg: float, mirror: float
) -> None:
    """Over real hills, in any frame: clear by more than the doubt costs nothing, hidden by more costs the whole."""
    rng = np.random.default_rng(7)
    field, course_rad = SightField(ground, 700.0), math.radians(course_deg)
    agreed = total = 0
    for east_m, north_m in 15.0 * rng.integers(-600, 600, (25, 2)):
        height_m = ground.height_m(east_m, north_m) + 60.0
        sight = field.sight(east_m, north_m, 0.0, 0.0, height_m)
        view = WatchFrame(course_rad, mirror, 0.0, 0.0)
        for _ in range(30):
            azimuth_rad, range_m = rng.uniform(-math.pi, math.pi), rng.uniform(150.0, 600.0)
            off = range_m * math.sin(azimuth_rad), range_m * math.cos(azimuth_rad)
            sin_c, cos_c = math.sin(course_rad), math.cos(course_rad)
            x_m, y_m = mirror * (off[0] * cos_c - off[1] * sin_c), off[0] * sin_c + off[1] * cos_c
            cost = hidden_rate(sight, view, x_m, y_m, 0.0)
            if 0.0 < cost < sight.weight:
                continue
            target_m = (east_m, north_m, height_m - 59.0)
            total += 1
            agreed += ground.sees((east_m + off[0], north_m + off[1], height_m), target_m) is (cost == 0.0)
    assert total > 400
    assert agreed / total > 0.95  # rays of 5 degrees


def test_what_will_be_hidden_counts_where_the_target_will_be() -> None:
    """The target walks north, behind the wall: a place in the west sees it now and will not in 30 s."""
    field = SightField(walled(), 700.0)
    sight = field.sight(0.0, -300.0, 0.0, 10.0, HEIGHT_M)
    view = WatchFrame(0.0, 1.0, 0.0, 10.0)
    assert hidden_rate(sight, view, -300.0, 0.0, 0.0) == 0.0
    assert hidden_rate(sight, view, -300.0, 400.0, 40.0) == sight.weight


def test_over_unknown_ground_nothing_is_hidden() -> None:
    field = SightField(walled(), 700.0)
    assert field.sight(5000.0, 0.0, 0.0, 0.0, HEIGHT_M) is NOTHING_HIDDEN
    line = np.zeros(3), np.array([0.0, 10.0, 20.0]), np.zeros(3), np.arange(3.0)
    view = WatchFrame(0.0, 1.0, 0.0, 0.0)
    lines, costs = single_line(*line, 0.01), np.zeros(1)
    add_sight(lines, Pose(0.0, 0.0, 0.0), NOTHING_HIDDEN, view, 50.0, 30.0, 0.01, costs)
    assert costs[0] == 0.0


def test_over_ground_that_stays_below_the_lines_of_sight_nothing_is_hidden() -> None:
    """So that elevation data of a plain change no decision: the planner looks two moves deep."""
    low = replace(walled(), heights_m=0.05 * walled().heights_m)
    assert SightField(low, 700.0).sight(0.0, 0.0, 0.0, 0.0, HEIGHT_M) is NOTHING_HIDDEN
    assert SightField(low, 700.0).sight(0.0, 0.0, 0.0, 0.0, 50.0) is not NOTHING_HIDDEN


def test_rasters_are_kept_while_the_target_is_near() -> None:
    field = SightField(walled(), 700.0)
    first = field.sight(0.0, 0.0, 0.0, 0.0, HEIGHT_M)
    assert field.sight(3.0, -4.0, 0.0, 0.0, HEIGHT_M).needed_m is not first.needed_m
    assert field._needed_m.cache_info().currsize == 1
    for k in range(200):
        field.sight(20.0 * (k % 60) - 600.0, 0.0, 0.0, 0.0, HEIGHT_M)
    assert field._needed_m.cache_info().currsize <= 64


def test_the_planner_moves_to_where_it_sees() -> None:
    """A target standing still behind a wall, seen from the south-west: it goes there, and without the wall stays."""
    aircraft, requirement = Aircraft(15.0, 50.0), Requirement(100.0, 500.0, Side.LEFT, 3.0)
    planner = PredictivePlanner(aircraft, requirement, value_table(table_configuration(aircraft, requirement)))
    ground = walled()
    field = SightField(ground, 700.0)
    circle = Circle(-300.0, 0.0, 50.0, clockwise=True)
    estimate = TargetEstimate(0.0, 0.0, 0.0, 0.0, 0.6, np.diag((1.0, 1.0, 0.04, 0.04)), TrackQuality.GOOD, 0.0)

    def watched(sees: bool) -> float:
        """The share of ten minutes with the target in sight."""
        planner._sight = (lambda *target: field.sight(*target, HEIGHT_M)) if sees else (lambda *_: NOTHING_HIDDEN)
        plan, seen, time_s = Plan(circle), 0, 0.0
        east_m, north_m = circle.position_at_course(0.0)
        course_rad, arc_m, line = 0.0, 0.0, plan.transition
        for _ in range(300):
            state = AircraftState(time_s, east_m, north_m, course_rad, 15.0, plan.circle.curvature_per_m)
            estimate_now = TargetEstimate(time_s, 0.0, 0.0, 0.0, 0.6, estimate.covariance, TrackQuality.GOOD, time_s)
            if line is None:
                decided = planner.decide(state, estimate_now, plan, Wind(), 0.0).plan
                if decided is not None:
                    plan, line, arc_m = decided, decided.transition, 0.0
            time_s += 2.0
            if line is not None and arc_m + 30.0 < line.length_m:
                arc_m += 30.0
                east_m, north_m, course_rad = (
                    float(np.interp(arc_m, line.arc_m, column))
                    for column in (line.east_m, line.north_m, line.course_rad)
                )
            else:
                line = None
                course_rad = plan.circle.course_at(east_m, north_m) + 30.0 * plan.circle.curvature_per_m
                east_m, north_m = plan.circle.position_at_course(course_rad)
            seen += ground.sees((east_m, north_m, HEIGHT_M), (0.0, 0.0, 1.0))
        return seen / 300

    assert watched(sees=True) > watched(sees=False) + 0.4
