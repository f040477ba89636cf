"""Figures of eight: what is flown, what it costs, and what it is for."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.planners.value_cache import value_table
from sidelong.app.study.benchmark import TRACKS
from sidelong.app.study.closed_loop import run
from sidelong.app.study.recorded import own_route, recorded_targets
from sidelong.app.study.settings import (
    PREDICTIVE,
    StudySettings,
    studied,
)
from sidelong.app.study.study import table_of
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.frames import wrap_rad
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind
from sidelong.mission.fleet.team_planner import IN_TEAM
from sidelong.mission.geometry.line_kernel import (
    ARC,
    COURSE,
    CURVATURE,
    EAST,
    NORTH,
    Air,
    LinePoint,
    laid_out,
    trapezoid,
)
from sidelong.mission.geometry.progress import ground_speed_m_s, nearest_arc_m, point_at
from sidelong.mission.predictive.decision_kernel import commitment
from sidelong.mission.predictive.moves_kernel import BACK, BEND, EIGHTS, OUTWARD, TURNED, eight_line, eights_from
from sidelong.mission.predictive.planner import (
    USUAL,
    PredictivePlanner,
    foreseen,
    price_s,
    scene_at,
    table_configuration,
)
from sidelong.mission.predictive.rollout_kernel import Sampling, blind_rate
from sidelong.mission.predictive.value_table import WatchCost

RADIUS_M, RAMP, AIRSPEED_M_S = 50.0, 0.0008, 10.0
LIMITED = Aircraft(AIRSPEED_M_S, RADIUS_M, pan_limit_rad=math.radians(120.0))
BAND = Requirement(100.0, 500.0, Side.LEFT, 3.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_line_of_every_eight_is_flyable_and_ends_on_its_circle(sign):
    start = LinePoint(30.0, -20.0, 0.7, sign / RADIUS_M)
    for eight in range(EIGHTS):
        line = eight_line(start, eight, sign * RADIUS_M, RAMP)
        arc, curvature = line[ARC], line[CURVATURE]
        assert tuple(line[[EAST, NORTH, COURSE, CURVATURE], 0]) == tuple(start)
        assert np.diff(arc).min() > 0.0
        assert np.abs(curvature).max() <= 1.0 / RADIUS_M + 1e-9
        assert np.abs(np.diff(curvature) / np.diff(arc)).max() <= RAMP + 1e-9
        assert curvature[-1] == pytest.approx(sign / RADIUS_M)
        assert (sign * curvature).min() == pytest.approx(-1.0 / RADIUS_M)
        # Course and place follow from the curvature.
        course = start.course_rad + np.append(0.0, np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * np.diff(arc)))
        np.testing.assert_allclose(line[COURSE], course, atol=1e-9)
        middle = 0.5 * (course[1:] + course[:-1])
        np.testing.assert_allclose(np.diff(line[EAST]), np.diff(arc) * np.sin(middle), atol=1e-3)
        np.testing.assert_allclose(np.diff(line[NORTH]), np.diff(arc) * np.cos(middle), atol=1e-3)


def test_an_eight_is_a_leg_a_turn_the_other_way_round_and_a_leg():
    eight = ((2 * BACK.size + 1) * BEND.size + 1) * TURNED.size + 1
    line = eight_line(LinePoint(0.0, 0.0, 0.0, 1.0 / RADIUS_M), eight, RADIUS_M, RAMP)
    step = np.diff(line[ARC])

    def held_m(share):
        return step[np.abs(line[CURVATURE, 1:] - share / RADIUS_M) < 1e-9].sum()

    assert held_m(-BEND[1]) == pytest.approx(OUTWARD[2] * RADIUS_M, abs=5.0)
    assert held_m(-1.0) == pytest.approx(TURNED[1] * RADIUS_M, abs=5.0)
    assert held_m(BEND[1]) == pytest.approx(BACK[1] * RADIUS_M, abs=5.0)


@pytest.mark.parametrize("wind", [(0.0, 0.0), (2.0, -1.0)])
def test_what_is_rolled_out_is_what_is_flown(wind):
    air, step_m, beyond_m = Air(AIRSPEED_M_S, *wind), 10.0, 40.0
    lines = eights_from(1.0 / RADIUS_M, RADIUS_M, RAMP, Sampling(beyond_m, 0.4, air, 0.01))
    for eight in (0, 17, EIGHTS - 1):
        line = eight_line(LinePoint(0.0, 0.0, 0.0, 1.0 / RADIUS_M), eight, RADIUS_M, RAMP)
        first, last = lines.own_first[eight], lines.own_first[eight + 1] - 1
        assert lines.end_m[eight] == pytest.approx(line[ARC, -1])
        on_it = np.arange(1, int(line[ARC, -1] / step_m))
        for found, row in ((lines.x_m, EAST), (lines.y_m, NORTH), (lines.turned_rad, COURSE)):
            wanted = np.interp(step_m * on_it, line[ARC], line[row])
            np.testing.assert_allclose(found[first + on_it - 1], wanted, atol=0.02)
        # It is followed onto its circle.
        on_circle_rad = beyond_m / RADIUS_M
        assert lines.turned_rad[last] == pytest.approx(line[COURSE, -1] + on_circle_rad)
        speeds = np.array([ground_speed_m_s(0.4 + rad, AIRSPEED_M_S, Wind(*wind)) for rad in line[COURSE]])
        time_s = np.sum(np.diff(line[ARC]) * 0.5 * (1.0 / speeds[1:] + 1.0 / speeds[:-1]))
        end = first + int(line[ARC, -1] / step_m) - 1
        assert lines.time_s[end] == pytest.approx(time_s, abs=1.1 * step_m / speeds.min())
        np.testing.assert_allclose(lines.weight[first : last + 1], np.exp(-0.01 * lines.time_s[first : last + 1]))


def test_it_costs_where_the_gimbal_cannot_look_and_more_far_beyond():
    terms = WatchCost(115.0, 485.0, pan_limit_rad=math.radians(120.0), lost=20.0).terms
    shares = ((0.0, 0.0, 0.0), (100.0, 0.0, 0.0), (120.0, 0.5, 0.0), (130.0, 1.0, 0.4744), (150.0, 1.0, 1.0))
    for pan_deg, blind, lost in (*shares, (180.0, 1.0, 1.0)):
        for side in (1.0, -1.0):
            bearing_rad = 0.3
            place = -300.0 * math.sin(bearing_rad), -300.0 * math.cos(bearing_rad)
            nose_rad = bearing_rad - side * math.radians(pan_deg)
            expected = blind * terms.blind + lost * terms.lost
            assert blind_rate(*place, nose_rad, terms) == pytest.approx(expected, abs=0.02)
    assert WatchCost(115.0, 485.0).terms.blind == 0.0


def test_aircraft_of_a_fleet_plan_for_no_pan_limit():
    def planned_rad(settings):
        return table_configuration(LIMITED, BAND, 0.0, settings).cost.pan_limit_rad

    assert planned_rad(USUAL) == LIMITED.pan_limit_rad - math.radians(2.0)
    assert planned_rad(IN_TEAM) == math.pi


def test_a_figure_of_eight_has_the_price_of_a_narrow_circle_whatever_its_width():
    narrow, wide = Aircraft(AIRSPEED_M_S, RADIUS_M), Aircraft(20.0, 70.0)
    limited = replace(wide, pan_limit_rad=LIMITED.pan_limit_rad)
    assert price_s(limited, BAND) == price_s(narrow, BAND) < price_s(wide, BAND)
    assert price_s(limited, BAND, IN_TEAM) == price_s(wide, BAND, IN_TEAM)


@pytest.fixture(scope="module")
def table():
    return value_table(table_configuration(LIMITED, BAND))


@pytest.mark.parametrize(("leg_m", "given_up"), [(10.0, True), (300.0, False)])
def test_a_young_plan_is_given_up_where_it_leads_beyond_the_pan_limits(table, leg_m, given_up):
    """It is a leg past the target, and then the circle on which the nose turns away from it."""
    planner = PredictivePlanner(LIMITED, BAND, table)
    per_m = 1.0 / RADIUS_M
    path = Path(*laid_out(trapezoid(per_m, 0.0, leg_m, per_m, RAMP), -300.0, 100.0, math.pi))
    plan = Plan(Circle(-350.0, 100.0 - leg_m, RADIUS_M, clockwise=True), path, -2.0)
    state = AircraftState(0.0, -300.0, 100.0, math.pi, AIRSPEED_M_S, 0.0)
    target = TargetEstimate(0.0, 0.0, 0.0, 0.0, 2.0, np.diag([1.0, 1.0, 0.04, 0.04]), TrackQuality.GOOD, 0.0)
    question = planner.questions[0]
    scene = scene_at(state, target, plan, Wind(), 0.5, question)
    futures, answered_by = foreseen(scene, question)
    context = question.context
    anywhere = answered_by._replace(context=context._replace(terms=context.terms._replace(blind=0.0)))
    assert commitment(scene, futures, anywhere) == question.prices.commit > 0.0
    assert commitment(scene, futures, answered_by) == (0.0 if given_up else question.prices.commit)


def flown(planner, corners, speed_m_s):
    """Return the shares of time beyond the pan limits, off the side and outside the band, next to a known target."""
    (east_m, north_m), steps = np.array(corners).T, range(500)
    gone_m = np.append(0.0, np.cumsum(np.hypot(np.diff(east_m), np.diff(north_m))))
    times_s = gone_m / speed_m_s
    places = np.array([[np.interp(k, times_s, axis) for axis in (east_m, north_m)] for k in range(len(steps) + 1)])
    plan, found = Plan(Circle(-250.0, 0.0, RADIUS_M, clockwise=True)), []
    state = AircraftState(0.0, *plan.circle.position_at_course(0.0), 0.0, AIRSPEED_M_S, 1.0 / RADIUS_M)
    for k in steps:
        covariance, velocity_m_s = np.diag([1.0, 1.0, 0.04, 0.04]), places[k + 1] - places[k]
        target = TargetEstimate(k, *places[k], *velocity_m_s, covariance, TrackQuality.GOOD, k)
        chosen = planner.decide(state, target, plan, Wind(), 1.0).plan
        here = point_at(plan, nearest_arc_m(plan, state) + AIRSPEED_M_S, state)
        state = AircraftState(k + 1.0, *here[:3], AIRSPEED_M_S, here.curvature_per_m)
        plan = chosen or plan
        away = np.array([here.east_m, here.north_m]) - places[k + 1]
        pan_rad = wrap_rad(math.atan2(-away[0], -away[1]) - here.course_rad)
        off_side = away[0] * velocity_m_s[1] - away[1] * velocity_m_s[0] > 0.0
        range_m = math.hypot(*away)
        found.append((abs(pan_rad) > LIMITED.pan_limit_rad, off_side, not 100.0 <= range_m <= 500.0))
    return np.mean(found, axis=0)


def test_figures_of_eight_keep_a_known_target_within_the_pan_limits(table):
    """Circles would have it outside the limits for a third of the time."""
    outside, _, beyond_band = flown(PredictivePlanner(LIMITED, BAND, table), [(0.0, 0.0), (0.0, 501.0)], 1.0)
    assert outside < 0.05
    assert beyond_band == 0.0


def test_figures_of_eight_are_planned_along_a_known_route():
    """Next to a boat they are on side for more of the time, and seldom beyond the limits."""
    tracks = recorded_targets([TRACKS / "boat_010.csv"], 5.0).flown
    limited = studied(airspeed_m_s=12.0, radius_m=40.0, target_speed_max_m_s=5.0, pan_limit_deg=120.0)
    unknown = StudySettings(runs=1, config=limited, tracks=tracks, duration_s=900.0)
    routed = tuple(replace(one, route=own_route(one, np.random.default_rng(1))) for one in tracks)
    known = replace(unknown, tracks=routed)
    of_class, off_side = table_of(unknown), []
    for settings, least in ((known, 0.98), (unknown, 0.97)):
        one = run(settings, PREDICTIVE, 0, of_class)
        assert one.time_within_pan_limits > least
        off_side.append(1.0 - one.time_on_side)
    assert off_side[0] < 0.7 * off_side[1]
