import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.core.sight import NOTHING_HIDDEN
from sidelong.mission.geometry.line_kernel import (
    Air,
    Craft,
    LinePoint,
    circle_after,
    craft_of,
    line_at,
    sharpness_per_m2,
)
from sidelong.mission.geometry.progress import ground_speeds_m_s, line_of
from sidelong.mission.predictive import decision_kernel as kernel
from sidelong.mission.predictive.moves_kernel import (
    LEVELS,
    MOVE_BRANCHES,
    MOVES,
    SECOND_LENGTHS,
    SECONDS,
    STAY_BRANCHES,
    PlacedMoves,
    Second,
    deep_cost,
    lay,
    lay_out_second_moves,
    move_line,
    moving_ahead,
    new_line_cache,
    new_second_moves,
    scenario_rows,
    staying_ahead,
    stretch,
    workspace_for,
)
from sidelong.mission.predictive.planner import route_values, table_configuration
from sidelong.mission.predictive.rollout_kernel import Pose, Scenarios, lines_costs, single_line, times_s
from sidelong.mission.predictive.scene_kernel import FlownPlan, Turns, Watcher, first_of, in_frame, scene_of, winding
from sidelong.mission.predictive.value_table import completed
from sidelong.mission.route.progress_kernel import fresh_progress
from sidelong.mission.viewpoint.viewpoint_kernel import (
    Estimates,
    SideRule,
    TargetState,
    fresh_memory,
    remember_place,
)
from sidelong.mission.viewpoint.watch_course import watching_from
from tests.mission import plain_rollout
from tests.mission.plain_rollout import RollOut, moves_from, staying_on

CALM, RULE = Wind(), SideRule(False, 50.0, math.nan)
STRAIGHT, TURNING = Turns(np.zeros(1), 10.0, False), Turns(np.radians([0.0, -3.0, 3.0]), 10.0, False)
SHALLOW = kernel.LookaheadDepth(0, 15.0, np.zeros(1), 0.0, False)


def watching(rule, memory):
    """An aircraft that watches by a rule; nothing but that and the memory counts for the futures."""
    return Watcher(Craft(10.0, 50.0, 0.6, 0.5, 1.0), rule, 5.0, memory)


def prompt(*known):
    """What is known of a target that the payload reports at once."""
    return Estimates(TargetState(*known), TargetState(*known))


def a_table(aircraft, requirement, wind_m_s=0.0):
    """A table of random values: what is looked up has to be the right number, not a good one."""
    configuration = replace(table_configuration(aircraft, requirement, wind_m_s), cells=8)
    rng = np.random.default_rng(3)
    return completed(configuration, rng.uniform(0.0, 100.0, configuration.shape).astype(np.float32))


class Look:
    """One scene, seen by the compiled look-ahead and by the plain one."""

    def __init__(self, aircraft, table, wind=CALM, sigma_m=0.5, side=1.0, under_way=False, velocity=(1.5, 3.0)):
        self.aircraft, self.table, self.wind, self.side = aircraft, table, wind, side
        circle = Circle(-220.0 * side, 90.0, 60.0, clockwise=side > 0.0)
        present = Plan(circle)
        place = circle.position_at_course(0.9)
        self.state = AircraftState(0.0, *place, 0.9, 10.0, circle.curvature_per_m)
        target = prompt(-0.3, 10.0, -20.0, *velocity, np.diag([sigma_m**2, 0.1, 0.04, 0.03]))
        self.craft = craft_of(aircraft)
        scene = self._scene(target, present)
        if under_way:
            line = move_line(scene, self.craft, 33)
            circle = Circle(*circle_after(line, scene.radius_m)[:2], scene.radius_m, clockwise=side > 0.0)
            present = Plan(circle, Path(*line))
            here = 12
            self.state = AircraftState(0.0, *line[1:4, here].tolist(), 10.0, float(line[4, here]))
            scene = self._scene(target, present)
        self.scene, self.present, self.under_way = scene, present, under_way

    def _scene(self, target, present):
        s, wind = self.state, (self.wind.east_m_s, self.wind.north_m_s)
        here = s.time_s, LinePoint(s.east_m, s.north_m, s.course_rad, s.curvature_per_m), s.ground_speed_m_s
        watcher = Watcher(self.craft, RULE, 5.0, fresh_memory(self.side))
        return scene_of(*here, target, FlownPlan(*line_of(present), 0.0), wind, 0.4, watcher)

    def compiled(self, futures=None, kept=None):
        costs, motions, c = np.empty(MOVES), self.table.motions, self.table.configuration
        stay = kernel.look_ahead(
            self.scene,
            futures or going_straight(self.scene, motions),
            kernel.Question(
                kernel.PlannerContext(
                    Watcher(self.craft, RULE, 5.0, fresh_memory(self.side)),
                    *(
                        c.cost.terms,
                        motions,
                        STRAIGHT,
                        kept or new_line_cache(),
                        new_second_moves(),
                        route_values(None, self.table.arrays, c, fresh_progress(0)),
                    ),
                ),
                *(self.table.arrays, kernel.SwitchingCosts(0.5, 1.0), SHALLOW),
            ),
            NOTHING_HIDDEN,
            costs,
        )
        return costs, stay

    def plain(self):
        scene, radius_m = self.scene, self.scene.radius_m
        wind = Wind(scene.air.wind_x_m_s, scene.air.wind_y_m_s)
        other_wind = abs(wind.speed_m_s - self.table.configuration.wind_speed_m_s) > 1.5
        beyond_m = 2.0 * math.pi * radius_m if other_wind or scene.doubt.position_m > 10.0 else 0.0
        velocity = scene.velocity_x_m_s, scene.velocity_y_m_s
        roll_out = RollOut(self.table, velocity, wind, scene.doubt, self.aircraft.airspeed_m_s, beyond_m)
        x, y = in_frame(scene, scene.start.east_m, scene.start.north_m)
        heading = self.side * (scene.start.course_rad - scene.course_rad)

        def ramps(heading_rad):
            around = np.asarray(heading_rad)[:, None] + np.linspace(-0.5, 0.5, 5)
            fastest = ground_speeds_m_s(around, 10.0, wind).max(axis=1)
            return np.array([sharpness_per_m2(one, craft_of(self.aircraft)) for one in fastest])

        moves = moves_from(
            self.side * scene.start.curvature_per_m, radius_m, scene.turn_radius_m, ramps([heading])[0]
        )
        moves = moves.with_last_ramps(ramps(heading + moves.turned(moves.last_start[:, None])[:, 0]))
        costs = roll_out.costs(moves, x, y, heading)
        if not self.under_way:
            stays = staying_on(self.side * self.present.circle.curvature_per_m, radius_m, ramps([heading])[0])
            costs[moves.last_end < 0.4 * radius_m] = np.inf
            return costs + 0.5, roll_out.costs(stays, x, y, heading).min()
        length_m = self.present.transition.length_m - scene.arc_m + beyond_m
        arc = np.linspace(0.0, length_m, max(2, math.ceil(length_m / 10.0) + 1))
        east, north, course = found = np.empty((3, arc.size))
        line_at(*line_of(self.present), scene.arc_m + arc, self.state.east_m, self.state.north_m, found)
        seen = np.array([in_frame(scene, *place) for place in zip(east, north, strict=True)]).T
        stay = roll_out.costs_of(*seen[:, None], self.side * (course - scene.course_rad)[None], arc[None])
        return costs + 1.0, stay[0]


@pytest.mark.parametrize("under_way", [False, True])
@pytest.mark.parametrize(
    ("wind", "table_wind_m_s", "words", "doubt_m", "side"),
    [
        (CALM, 0.0, "left", 0.5, 1.0),
        (CALM, 0.0, "left", 25.0, -1.0),
        (Wind(3.0, -1.0), 0.0, "left", 0.5, 1.0),
        (Wind(-2.0, -1.5), 2.5, "left", 0.5, -1.0),
        (CALM, 0.0, "120-200", 0.5, 1.0),
    ],
)
def test_the_compiled_look_ahead_costs_what_the_plain_one_does(
    paper_aircraft, paper_requirement, wind, table_wind_m_s, words, doubt_m, side, under_way
):
    table = a_table(paper_aircraft, watching_from(paper_requirement, words), table_wind_m_s)
    for velocity in ((1.5, 3.0), (0.3, -0.2)):
        look = Look(paper_aircraft, table, wind, doubt_m, side, under_way, velocity)
        for compiled, plain in zip(look.compiled(), look.plain(), strict=True):
            np.testing.assert_allclose(compiled, plain, rtol=2e-5)


def test_lines_that_were_kept_cost_the_same(paper_aircraft, paper_requirement):
    table, kept = a_table(paper_aircraft, paper_requirement), new_line_cache()
    look = Look(paper_aircraft, table)
    first, again = look.compiled(kept=kept), look.compiled(kept=kept)
    np.testing.assert_array_equal(first[0], again[0])
    assert first[1] == again[1]


def going_straight(scene, motions):
    """One future of a steady velocity, its first sample alone: it goes on indefinitely."""
    every = winding(scene, motions, watching(RULE, fresh_memory(1.0)), STRAIGHT)
    return Scenarios(*every[:2], *(np.ascontiguousarray(a[:, :1]) for a in every[2:]))


def with_future(one, samples, weight=1.0):
    """The future of a steady velocity again, sampled this often."""
    k = np.arange(samples)[:, None]
    place = np.repeat(one.place[0], samples, axis=0)
    place[:, :2] += k * one.step_s * place[:, 2:]
    rest = (np.repeat(a, samples, axis=1) for a in one[3:])
    return Scenarios(np.array([weight]), one.step_s, place[None], *rest)


def test_a_future_may_be_sampled_and_futures_are_weighed(paper_aircraft, paper_requirement):
    table = a_table(paper_aircraft, paper_requirement)
    look = Look(paper_aircraft, table, under_way=True)
    straight = going_straight(look.scene, table.motions)
    costs, stay = look.compiled()
    sampled = look.compiled(with_future(straight, 40))
    np.testing.assert_allclose(sampled[0], costs, rtol=1e-9)
    assert sampled[1] == pytest.approx(stay, rel=1e-9)
    # Turned as a whole - target, watch course and the table's course - a scene costs what it did.
    sin_t, cos_t = math.sin(0.7), math.cos(0.7)
    both = Scenarios(np.array([0.25, 0.75]), 1.0, *(np.concatenate((a, a)) for a in straight[2:]))
    both.place[1, 0, 2:] = 4.0, -1.0
    other = Scenarios(np.ones(1), 1.0, *(a[1:] for a in both[2:]))
    np.testing.assert_allclose(look.compiled(both)[0], 0.25 * costs + 0.75 * look.compiled(other)[0], rtol=1e-9)
    x, y = np.linspace(-300.0, -200.0, 30), np.linspace(-50.0, 50.0, 30)
    heading, time_s = np.linspace(0.0, 1.0, 30), np.arange(30.0)
    terms, doubt = table.configuration.cost.terms, look.scene.doubt
    turned = Scenarios(*straight[:2], *(a.copy() for a in straight[2:]))
    vx, vy = straight.place[0, 0, 2:]
    turned.place[0, 0, 2:] = vx * cos_t + vy * sin_t, vy * cos_t - vx * sin_t
    turned.facing[0, 0, :2], turned.course[0, 0] = (sin_t, cos_t), (sin_t, cos_t, 0.7)
    cost, again, start = np.empty(1), np.empty(1), Pose(0.0, 0.0, 0.0)
    rest = doubt, terms, table.arrays, Air(10.0, 0.0, 0.0)
    lines_costs(single_line(x, y, heading, time_s, 0.02), start, straight, *rest, cost)
    other = x * cos_t + y * sin_t, y * cos_t - x * sin_t, heading + 0.7, time_s
    lines_costs(single_line(*other, 0.02), start, turned, *rest, again)
    np.testing.assert_allclose(again, cost, rtol=1e-9)


def test_wind_makes_a_line_faster_or_slower_only():
    heading, arc = np.full(11, 0.5 * math.pi), np.linspace(0.0, 100.0, 11)
    assert times_s(heading, arc, Air(10.0, 0.0, 0.0))[-1] == pytest.approx(10.0)
    assert times_s(heading, arc, Air(10.0, 3.0, 0.0))[-1] == pytest.approx(100.0 / 13.0)


def test_the_radius_grows_with_the_wind(paper_aircraft, paper_requirement):
    table = a_table(paper_aircraft, paper_requirement)
    steep = replace(paper_aircraft, radius_m=12.0)
    scene = Look(steep, table, Wind(4.0, 0.0)).scene
    assert scene.radius_m == pytest.approx(14.0**2 / (9.80665 * math.tan(steep.bank_max_rad)))
    assert scene.turn_radius_m == scene.radius_m
    assert sharpness_per_m2(10.0, craft_of(steep)) > sharpness_per_m2(10.0, craft_of(paper_aircraft))


def test_the_watch_course_turns_to_the_velocity_over_its_horizon(paper_aircraft, paper_requirement):
    """A target that drove north turned east: what is watched turns after it, the table is asked as it drives."""
    motions = a_table(paper_aircraft, paper_requirement).motions
    for side in (1.0, -1.0):
        memory, wish = fresh_memory(side), SideRule(False, 50.0, math.nan, 20.0)
        present = Plan(Circle(-220.0 * side, 90.0, 60.0, clockwise=side > 0.0))
        for time_s in range(61):
            velocity = (0.0, 4.0) if time_s < 60 else (4.0, 0.0)
            target = prompt(float(time_s), 0.0, 4.0 * time_s, *velocity, np.diag([0.25, 0.09, 0.04, 0.04]))
            here = LinePoint(-280.0 * side, 90.0, 0.0, side / 60.0)
            watcher = Watcher(craft_of(paper_aircraft), wish, 5.0, memory)
            flown = FlownPlan(*line_of(present), 0.0)
            scene = scene_of(float(time_s), here, 10.0, target, flown, (0.0, 0.0), 0.0, watcher)
        future = winding(scene, motions, watching(wish, memory), STRAIGHT)
        seen = scene.course_rad + side * np.arctan2(future.facing[0, :, 0], future.facing[0, :, 1])
        ahead_s = np.arange(seen.size)
        wanted = np.arctan2(4.0 * np.minimum(ahead_s, 20.0), 4.0 * np.maximum(20.0 - ahead_s, 0.0))
        np.testing.assert_allclose(seen, wanted, atol=1e-9)
        np.testing.assert_allclose(side * future.course[0, :, 2] + scene.course_rad, math.pi / 2)
        np.testing.assert_allclose(future.facing[0, 20, 2], math.hypot(0.5, 0.2 * 20.0) / 80.0)
        np.testing.assert_allclose(future.place[0, 10, :2], (side * 40.0, 0.0), atol=1e-9)


@pytest.mark.parametrize(("share", "given"), [(0.913, 0.92), (1.004, 1.0), (1.08, 1.08), (0.5, 0.84)])
@pytest.mark.parametrize("wind", [CALM, Wind(2.0, -1.0)])
def test_lines_are_predicted_at_the_airspeed_that_is_flown(paper_aircraft, share, given, wind):
    """10 m/s are wanted. Each second on circles it flies another airspeed: in steps of 2 %, within 16 %."""
    memory, craft, found = fresh_memory(1.0), craft_of(paper_aircraft), []
    present = Plan(Circle(-220.0, 90.0, 60.0, clockwise=True))
    target = prompt(0.0, 0.0, 0.0, 0.0, 3.0, np.eye(4))
    for time_s in range(300):
        course = 0.15 * time_s
        speed = float(ground_speeds_m_s(np.array([course]), 10.0 * share, wind)[0])
        here = LinePoint(*present.circle.position_at_course(course), course, 1.0 / 60.0)
        flown, watcher = FlownPlan(*line_of(present), 0.0), Watcher(craft, RULE, 5.0, memory)
        scene = scene_of(float(time_s), here, speed, target, flown, (wind.east_m_s, wind.north_m_s), 0.0, watcher)
        found.append(scene.air.airspeed_m_s)
    assert found[0] == 10.0
    assert found[-1] == pytest.approx(10.0 * given)


def test_a_turn_is_predicted_with_the_straight_way_first(paper_aircraft, paper_requirement):
    """Three futures of equal weight: straight on, and turns to either side that fade."""
    look = Look(paper_aircraft, a_table(paper_aircraft, paper_requirement))
    memory, turns = fresh_memory(1.0), TURNING
    memory[0].standing = False
    futures = winding(look.scene, look.table.motions, watching(RULE, memory), turns)
    np.testing.assert_allclose(futures.weight, 1.0 / 3.0)
    course = np.unwrap(np.arctan2(futures.place[:, :, 2], futures.place[:, :, 3]), axis=1)
    np.testing.assert_allclose(np.degrees(course[:, -1] - course[:, 0]), [0.0, -30.0, 30.0], atol=2.0)
    straight = first_of(futures, 1)
    assert straight.weight == [1.0]
    np.testing.assert_array_equal(straight.place[0], futures.place[0])


def test_a_target_that_stopped_stands_or_goes_on_as_estimated(paper_aircraft, paper_requirement):
    look, memory = Look(paper_aircraft, a_table(paper_aircraft, paper_requirement)), fresh_memory(1.0)
    for standing, stands, stays in ((1.0, True, True), (1.0, False, False), (0.0, True, False)):
        memory[0].standing = standing
        turns = TURNING._replace(stands=stands)
        place = winding(look.scene, look.table.motions, watching(RULE, memory), turns).place
        assert np.all(place == 0.0) == stays
    # A sector does not depend on whether the target stands: the memory holds its first value.
    sector = RULE._replace(fixed_course_rad=0.3)
    assert np.any(winding(look.scene, look.table.motions, watching(sector, fresh_memory(1.0)), turns).place != 0.0)


@pytest.mark.parametrize(("side", "under_way"), [(1.0, False), (-1.0, True)])
def test_the_look_two_moves_deep_costs_what_the_plain_one_does(paper_aircraft, paper_requirement, side, under_way):
    table = a_table(paper_aircraft, paper_requirement)
    look = Look(paper_aircraft, table, side=side, under_way=under_way)
    scene = look.scene
    memory, wish = fresh_memory(side), SideRule(False, 50.0, math.nan, 20.0)
    for time_s in range(30):
        remember_place(
            TargetState(time_s - 30.0, 0.0, 3.0 * time_s - 120.0, 0.0, 3.0, np.eye(4)), memory[0], math.inf
        )
    memory[0].standing = False
    futures = winding(scene, table.motions, watching(wish, memory), TURNING)
    assert np.ptp(futures.place[:, 20, 0]) > 10.0
    ahead, end = staying_ahead(scene, under_way)
    moved = moving_ahead(scene, look.craft, 20)
    assert (end > 0) is under_way
    ramp, seconds, terms = (
        sharpness_per_m2(10.0, craft_of(paper_aircraft)),
        new_second_moves(),
        table.configuration.cost.terms,
    )
    lay_out_second_moves(seconds, scene.radius_m, scene.turn_radius_m, ramp, 10.0)
    predicted = scenario_rows(futures, scene.doubt, table.arrays, table.values.min(axis=(1, 2, 3)).astype(float), 0.0)
    for (line, ends), branches in (((ahead, end), STAY_BRANCHES), (moved, MOVE_BRANCHES)):
        second = Second(predicted, terms, table.arrays, seconds, 3.0, 5.0, 15.0, workspace_for(futures, scene.air))
        found = deep_cost(line, ends, branches, scene, second, np.inf)
        assert deep_cost(line, ends, branches, scene, second, found + 0.1) == found
        assert found - 5.0 <= deep_cost(line, ends, branches, scene, second, found - 5.0) <= found
        plain = plain_rollout.deep_cost(
            *(table, futures, scene.doubt, line, ends, branches, 15, (3.0, 5.0)),
            *(scene.radius_m, scene.turn_radius_m, ramp, LEVELS, SECOND_LENGTHS),
        )
        assert found == pytest.approx(plain, rel=1e-4)


def test_second_moves_in_wind_are_flown_at_the_ground_speed(paper_aircraft, paper_requirement):
    """What is laid out for still air is stretched along itself: a second's way is that of the ground speed there."""
    seconds = new_second_moves()
    lay_out_second_moves(seconds, 60.0, 40.0, sharpness_per_m2(12.0, craft_of(paper_aircraft)), 10.0)
    calm, windy = np.empty((3, SECONDS, 64)), np.empty((3, SECONDS, 64))
    start, flown = Pose(5.0, -7.0, math.pi / 2), np.empty((64, SECONDS))
    speeds = ground_speeds_m_s(np.linspace(0.0, math.tau, 49), 10.0, Wind(2.0, 0.0)) / 10.0
    stretch(seconds, 4, start.heading_rad, speeds, 12, flown)
    for way, places in ((flown[:0], calm), (flown, windy)):
        fan = PlacedMoves(start, 1.0, 0.0, 4, way, places, np.zeros(SECONDS, np.bool_), np.full(SECONDS, 12))
        for j in range(SECONDS):
            lay(seconds, fan, j, 12)
    np.testing.assert_allclose(np.hypot(*(calm[:2, 0, 1] - (5.0, -7.0))), 10.0, atol=0.1)
    np.testing.assert_allclose(np.hypot(*(windy[:2, 0, 1] - (5.0, -7.0))), 12.0, atol=0.1)
    later = np.hypot(*np.diff(windy[:2, :, :13]))
    ground = ground_speeds_m_s(windy[2, :, :12], 10.0, Wind(2.0, 0.0))
    np.testing.assert_allclose(later, ground, rtol=0.02)
