from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sidelong.app.assembly import prepared
from sidelong.app.config import load_config
from sidelong.app.errors import InputError
from sidelong.app.flight.preflight import _ground_check
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, ClimbRates, HeightProfile, Plan, settled_height_m
from sidelong.mission.geometry.approach import turn_straight_turn
from sidelong.mission.terrain.heights import FlightHeights, HeightRules
from sidelong.mission.upload.items import plan_items

CLEARANCE_M, AIRSPEED_M_S = 50.0, 15.0
RULES = HeightRules(100.0, "ground", CLEARANCE_M, ClimbRates(AIRSPEED_M_S))
HOME_DEG = (36.59, -84.24)


def flat_with(*hills: tuple[float, float, float]) -> Ground:
    """4 km of flat ground, posts every 50 m, with single posts (east, north, height) raised."""
    heights = np.zeros((81, 81), np.float32)
    for east_m, north_m, height_m in hills:
        heights[round(north_m / 50.0) + 40, round(east_m / 50.0) + 40] = height_m
    return Ground(heights, -2000.0, -2000.0, 50.0, 50.0, 4.0)


def random_plan(rng: np.random.Generator, with_transition: bool = True) -> Plan:
    east_m, north_m = rng.uniform(-12_000.0, 12_000.0, 2)
    bearing_rad, off_m = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(150.0, 400.0)
    circle = Circle(east_m + off_m * math.sin(bearing_rad), north_m + off_m * math.cos(bearing_rad), 50.0, True)
    if not with_transition:
        return Plan(circle)
    start = AircraftState(0.0, east_m, north_m, rng.uniform(-math.pi, math.pi), AIRSPEED_M_S, 0.02)
    return Plan(circle, turn_straight_turn(start, circle, 50.0))


def flown(plan: Plan, begin_late_s: float = 0.0) -> np.ndarray:
    """(n, 3) east, north, height along transition and three laps, every 2 m; the climb begins late, if it does."""
    circle, line, heights = plan.circle, plan.transition, plan.heights
    assert heights is not None
    length_m = 0.0 if line is None else line.length_m
    on_m = np.arange(0.0, 6.0 * math.pi * circle.radius_m, 2.0)
    begin_rad = 0.0
    if line is not None:
        begin_rad = math.atan2(line.east_m[-1] - circle.east_m, line.north_m[-1] - circle.north_m)
    angle_rad = begin_rad + circle.curvature_per_m * on_m
    east_m = circle.east_m + circle.radius_m * np.sin(angle_rad)
    north_m = circle.north_m + circle.radius_m * np.cos(angle_rad)
    arc_m = length_m + on_m
    if line is not None:
        way_m = np.arange(0.0, length_m, 2.0)
        east_m = np.concatenate((np.interp(way_m, line.arc_m, line.east_m), east_m))
        north_m = np.concatenate((np.interp(way_m, line.arc_m, line.north_m), north_m))
        arc_m = np.concatenate((way_m, arc_m))
    late_m = begin_late_s * AIRSPEED_M_S
    return np.column_stack((east_m, north_m, [heights.at_m(max(arc - late_m, 0.0)) for arc in arc_m]))


def test_over_real_hills_no_plan_comes_below_the_clearance(ground: Ground) -> None:
    """Circles and transitions from a height that was clear where they begin; whatever time a descent begins at."""
    rng = np.random.default_rng(11)
    heights = FlightHeights(ground, RULES)
    flyable = 0
    for _ in range(600):
        plan = random_plan(rng)
        begin = Circle(float(plan.transition.east_m[0]), float(plan.transition.north_m[0]), 50.0, True)
        first = heights.levelled(Plan(begin), None)
        if isinstance(first, str) or math.isnan(ground.height_m(plan.circle.east_m, plan.circle.north_m)):
            continue
        from_m = first.heights.to_m
        levelled = heights.levelled(plan, from_m, (plan.circle.east_m, plan.circle.north_m))
        if isinstance(levelled, str):
            assert "ground" in levelled
            continue
        flyable += 1
        descends = levelled.heights.to_m < from_m
        for late_s in (0.0, 5.0, 20.0) if descends else (0.0,):
            way = flown(levelled, late_s)
            assert (way[:, 2] - ground.heights_at_m(way[:, 0], way[:, 1])).min() >= CLEARANCE_M - 0.01
        assert abs(levelled.heights.slope) * AIRSPEED_M_S <= (
            RULES.rates.descent_m_s if descends else RULES.rates.climb_m_s
        )
    assert flyable > 400


def test_at_one_height_a_plan_is_rejected_if_and_only_if_ground_near_it_is_too_high(ground: Ground) -> None:
    rng = np.random.default_rng(12)
    at_200_m = FlightHeights(ground, replace(RULES, above="home", height_m=200.0))
    kept = refused = 0
    for _ in range(600):
        plan = random_plan(rng, with_transition=False)
        way = flown(replace(plan, heights=HeightProfile(200.0, 200.0, 0.0)))
        clear_m = float((200.0 - ground.heights_at_m(way[:, 0], way[:, 1])).min())
        if math.isnan(clear_m):
            continue
        around = [
            200.0 - ground.heights_at_m(way[:, 0] + east_m, way[:, 1] + north_m).max()
            for east_m in np.arange(-140.0, 141.0, 20.0)
            for north_m in np.arange(-140.0, 141.0, 20.0)
        ]
        found = at_200_m.levelled(plan, None)
        if isinstance(found, str):
            refused += 1
            assert not min(around) >= CLEARANCE_M
        else:
            kept += 1
            assert clear_m >= CLEARANCE_M
    assert kept > 50
    assert refused > 50


@pytest.mark.parametrize(
    ("ground", "words"),
    [
        (flat_with((350.0, -150.0, 80.0)), "the new circle comes within 20 m of the ground, less than 50 m"),
        (flat_with((350.0, -150.0, 130.0)), "the new circle runs into the ground"),
        (flat_with((200.0, 0.0, 70.0)), "the transition comes within 30 m of the ground, less than 50 m"),
        (flat_with((300.0, 0.0, math.nan)), "the new circle lies over ground of unknown height"),
        (flat_with((200.0, 0.0, math.nan)), "the transition leads over ground of unknown height"),
    ],
)
def test_what_is_in_the_way_is_reported_in_the_words_of_fences(ground: Ground, words: str) -> None:
    start = AircraftState(0.0, 0.0, 0.0, math.pi / 2, AIRSPEED_M_S, 0.0)
    circle = Circle(350.0, -50.0, 50.0, True)
    plan = Plan(circle, turn_straight_turn(start, circle, 50.0))
    assert FlightHeights(ground, replace(RULES, above="home")).levelled(plan, 100.0) == words


def test_too_steep_a_climb_is_rejected_and_a_gentle_one_is_begun_in_time() -> None:
    start = AircraftState(0.0, 0.0, 0.0, math.pi / 2, AIRSPEED_M_S, 0.0)
    circle = Circle(1500.0, -50.0, 50.0, True)
    plan = Plan(circle, turn_straight_turn(start, circle, 50.0))
    steep = FlightHeights(flat_with((150.0, 0.0, 120.0)), RULES).levelled(plan, 100.0, (1500.0, 300.0))
    assert steep == "the transition runs into the ground, climbing as fast as it can"
    gentle = FlightHeights(flat_with((1300.0, 0.0, 120.0)), RULES).levelled(plan, 100.0, (1500.0, 300.0))
    assert not isinstance(gentle, str)
    assert gentle.heights.from_m == 100.0
    assert gentle.heights.to_m == 170.0


def test_a_height_that_will_do_is_kept() -> None:
    heights = FlightHeights(flat_with(), RULES)
    plan = Plan(Circle(0.0, 0.0, 50.0, True))
    for flown_m, kept_m in ((100.0, 100.0), (110.0, 110.0), (150.0, 120.0), (30.0, 80.0)):
        levelled = heights.levelled(plan, flown_m, (300.0, 0.0))
        assert not isinstance(levelled, str)
        assert levelled.heights.to_m == pytest.approx(kept_m)


def test_above_the_ceiling_nothing_is_flown() -> None:
    heights = FlightHeights(flat_with((0.0, 50.0, 90.0)), replace(RULES, ceiling_m=120.0))
    words = heights.levelled(Plan(Circle(0.0, 0.0, 50.0, True)), None)
    assert words == "clear of the ground the new circle is 140 m above home, above the ceiling of 120 m"


def test_items_carry_the_heights_of_the_plan() -> None:
    start = AircraftState(0.0, 0.0, 0.0, math.pi / 2, AIRSPEED_M_S, 0.0)
    circle = Circle(600.0, -50.0, 50.0, True)
    plan = Plan(circle, turn_straight_turn(start, circle, 50.0), heights=HeightProfile(100.0, 160.0, 0.14))
    items = plan_items(plan, LocalPlane(*HOME_DEG), 999.0, 30.0)
    given = [item.z for item in items]
    assert given[-1] == 160.0
    assert all(100.0 <= height_m <= 160.0 for height_m in given)
    assert given == sorted(given)
    assert len(set(given)) > 1


def test_an_aircraft_about_at_its_height_is_at_it() -> None:
    plan = Plan(Circle(0.0, 0.0, 50.0, True), heights=HeightProfile(100.0, 160.0, 0.1))
    assert settled_height_m(155.0, plan) == 160.0
    assert settled_height_m(130.0, plan) == 130.0
    assert settled_height_m(155.0, None) == 155.0


def test_the_controller_asks_ground_and_fences(hills_folder, plane: LocalPlane, ground: Ground) -> None:
    terrain = {"folder": str(hills_folder)}
    config = load_config(
        None, {"planner": {"name": "paper"}, "terrain": terrain, "aircraft": {"height_above": "ground"}}
    )
    controller = prepared(config).controller(plane, HOME_DEG)
    circle = Circle(4000.0, 1000.0, 50.0, True)
    cleared = controller.surroundings.levelled(Plan(circle))
    assert not isinstance(cleared, str)
    assert cleared.heights.to_m - ground.height_m(4000.0, 1000.0) == pytest.approx(100.0, abs=60.0)
    beyond = Plan(Circle(0.0, 24_000.0, 50.0, True))
    assert controller.surroundings.levelled(beyond) == "the new circle lies over ground of unknown height"
    fenced = load_config(None, {"planner": {"name": "paper"}, "terrain": terrain, "fences": {"floor_m": 300.0}})
    controller = prepared(fenced).controller(plane, HOME_DEG)
    assert "below the floor of 300 m" in str(controller.surroundings.levelled(Plan(Circle(0.0, 0.0, 20.0, True))))


def test_height_above_ground_needs_a_ground() -> None:
    with pytest.raises(InputError, match=r"terrain\.folder"):
        load_config(None, {"aircraft": {"height_above": "ground"}})


@pytest.mark.parametrize(
    ("altitude_m", "ready", "words"),
    [(0.0, False, "see which of the two is wrong"), (None, True, ""), (-1.0, True, "taken as flat")],
)
def test_before_the_flight_home_is_compared_with_the_data(
    hills_folder, altitude_m: float | None, ready: bool, words: str
) -> None:
    flat = altitude_m is not None and altitude_m < 0.0
    config = load_config(None, {} if flat else {"terrain": {"folder": str(hills_folder)}})
    home = SimpleNamespace(latitude_deg=HOME_DEG[0], longitude_deg=HOME_DEG[1], altitude_m=altitude_m)
    if altitude_m is None:
        home.altitude_m = 450.0
    check = _ground_check(config, home)
    assert check.ready is ready
    assert words in str(check)
