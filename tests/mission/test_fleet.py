"""Roles of several aircraft on one target, and what each decides next to the others."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.planners.value_cache import value_table
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.fleet import FleetAdvice, Neighbour, NeighbourPlanned, Role
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind
from sidelong.mission.fleet import team_kernel as kernel
from sidelong.mission.fleet.coordinator import WatchedCourse
from sidelong.mission.fleet.roles import Candidate, RoleAssignment, RoleCosts, course_is_known, is_on_station
from sidelong.mission.fleet.team_planner import IN_TEAM, TeamPlanner, team_of
from sidelong.mission.geometry.separation import flown_places
from sidelong.mission.predictive.planner import PredictivePlanner, table_configuration

REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 5.0, course_horizon_s=0.0)


def costs(a: float, b: float, **of_b: bool) -> dict[str, Candidate]:
    return {"a": Candidate(RoleCosts(a, 1.0)), "b": Candidate(RoleCosts(b, 1.0), **of_b)}


def test_the_cheapest_holds_the_required_side_and_the_other_waits_opposite():
    assert RoleAssignment().assign(0.0, costs(5.0, 2.0)) == {"b": Role.WANTED, "a": Role.OPPOSITE}


def test_the_side_is_handed_over_only_after_some_seconds_of_clear_gain():
    roles = RoleAssignment(gain_s=1.0, patience_s=2.0)
    roles.assign(0.0, costs(2.0, 5.0))
    held = [roles.assign(float(t), costs(5.0, 2.0))["a"] for t in range(1, 5)]
    assert held == [Role.WANTED, Role.WANTED, Role.OPPOSITE, Role.OPPOSITE]


def test_a_gain_that_does_not_last_changes_nothing():
    roles = RoleAssignment(gain_s=1.0, patience_s=2.0)
    for t in range(20):
        better = t % 2 == 0
        assert roles.assign(float(t), costs(2.0, 0.5 if better and t else 5.0))["a"] is Role.WANTED


def test_no_one_takes_the_side_who_does_not_watch_from_there_or_of_a_target_whose_course_no_one_knows():
    roles = RoleAssignment()
    roles.assign(0.0, costs(2.0, 5.0))
    for t in range(1, 30):
        assert roles.assign(float(t), costs(50.0, 2.0, on_station=False))["a"] is Role.WANTED
        assert roles.assign(float(t), costs(50.0, 2.0), course_known=False)["a"] is Role.WANTED
    for t in range(30, 33):
        roles.assign(float(t), costs(50.0, 2.0))
    assert roles.holder == "b"
    blind = RoleAssignment()
    blind.assign(0.0, costs(2.0, 5.0))
    neither = {name: replace(one, on_station=False) for name, one in costs(50.0, 2.0).items()}
    for t in range(1, 4):
        blind.assign(float(t), neither)
    assert blind.holder == "b"  # no one watches: who comes first holds it


def test_the_next_hand_over_waits_until_plans_for_the_last_one_are_on_board():
    roles = RoleAssignment(gain_s=1.0, patience_s=2.0, settling_s=10.0, under_way_max_s=60.0)
    roles.assign(0.0, costs(2.0, 50.0))
    holders = []
    for t in range(1, 120):
        better_b = t // 5 % 2 == 0  # as the two pass each other
        roles.assign(float(t), costs(50.0, 2.0) if better_b else costs(2.0, 50.0, under_way=20 < t < 50))
        holders.append(roles.holder)
    handed_s = [t for t, (one, other) in enumerate(itertools.pairwise(holders), 2) if one != other]
    assert min(later - one for one, later in itertools.pairwise(handed_s)) >= 10
    stuck = RoleAssignment(gain_s=1.0, patience_s=2.0, settling_s=10.0, under_way_max_s=60.0)
    stuck.assign(0.0, costs(2.0, 50.0))
    for t in range(1, 63):
        stuck.assign(float(t), costs(50.0, 2.0) if t < 5 else costs(2.0, 50.0, under_way=True))
        assert stuck.holder == ("a" if t < 3 else "b")
    stuck.assign(63.0, costs(2.0, 50.0, under_way=True))
    assert stuck.holder == "a"  # they are not waited for without end


def test_what_a_hand_over_hangs_on():
    north = going(0.0)
    requirement = replace(REQUIREMENT, side=Side.LEFT)
    state, _ = on_circle(-200.0, 0.0, clockwise=True)
    assert is_on_station(state, north, requirement, 0.0)
    assert not is_on_station(state, north, requirement, math.pi)
    assert not is_on_station(replace(state, east_m=-90.0, north_m=0.0), north, requirement, 0.0)
    assert is_on_station(state, north, requirement, None)  # a target that has not moved has no sides
    assert course_is_known(north)
    assert not course_is_known(replace(north, covariance=9.0 * np.eye(4)))


@pytest.mark.parametrize("left", [{"b": Candidate(RoleCosts(9.0, 1.0))}, costs(math.inf, 9.0)], ids=["gone", "blind"])
def test_a_holder_that_is_out_is_replaced_at_once(left):
    roles = RoleAssignment()
    roles.assign(0.0, costs(2.0, 5.0))
    assert roles.assign(1.0, left)["b"] is Role.WANTED


def test_someone_always_holds_the_required_side():
    roles = RoleAssignment()
    for t in range(200):
        present = [(k, name) for k, name in enumerate("abc", 1) if t // 7 % 4 != k]
        given = {name: Candidate(RoleCosts(3.0 + math.sin(t * k), 1.0)) for k, name in present}
        assert list(roles.assign(float(t), given).values()).count(Role.WANTED) >= 1


def test_the_course_whose_sides_count():
    course, (state, _) = WatchedCourse(REQUIREMENT), on_circle(250.0, 0.0, clockwise=False)
    standing = replace(going(0.0), velocity_north_m_s=0.0)
    course.update(standing, None)
    assert course.course_rad is None
    course.update(replace(standing, time_s=101.0), state)
    east_of_it = math.atan2(state.east_m, state.north_m)
    assert course.course_rad == pytest.approx(east_of_it + math.pi / 2)  # so that it is on the left
    for k in range(30):
        course.update(replace(going(0.0), time_s=102.0 + k, north_m=4.0 * k), state)
        assert course.course_rad == pytest.approx(0.0)  # also before it has made its way
    for k in range(60):
        course.update(replace(standing, time_s=132.0 + k, north_m=120.0), state)
    assert course.course_rad == pytest.approx(0.0)  # held, whatever the estimate turns about


# -- one aircraft's decisions next to another's ---------------------------------------------------------------------

AIRCRAFT = Aircraft(10.0, 50.0)
TABLE = value_table(table_configuration(AIRCRAFT, REQUIREMENT, 0.0, IN_TEAM))


def planner(check=lambda plan: plan, requirement=REQUIREMENT) -> TeamPlanner:
    return TeamPlanner(PredictivePlanner(AIRCRAFT, requirement, TABLE, IN_TEAM, check=check))


def on_circle(east_m: float, north_m: float, clockwise: bool) -> tuple[AircraftState, Plan]:
    circle = Circle(east_m, north_m, 50.0, clockwise)
    state = AircraftState(100.0, *circle.position_at_course(0.3), 0.3, 10.0, circle.curvature_per_m)
    return state, Plan(circle)


def going(course_deg: float) -> TargetEstimate:
    """A target at the origin that goes at 4 m/s."""
    east, north = 4.0 * math.sin(math.radians(course_deg)), 4.0 * math.cos(math.radians(course_deg))
    return TargetEstimate(100.0, 0.0, 0.0, east, north, 0.04 * np.eye(4), TrackQuality.GOOD, 100.0)


def advised(team: TeamPlanner, other: tuple[AircraftState, Plan] | None, role: Role, side: Side) -> TeamPlanner:
    neighbours = ()
    if other is not None:
        team.advise(NeighbourPlanned(100.0, "b", other[1], None))
        neighbours = (Neighbour("b", other[0], 160.0, ours=True, target="t"),)
    team.advise(FleetAdvice(100.0, "t", role, side, None, 100.0, neighbours))
    return team


def test_without_others_it_decides_as_the_planner_of_one_does_at_the_fleets_prices():
    state, plan = on_circle(-280.0, 40.0, True)
    one = PredictivePlanner(AIRCRAFT, REQUIREMENT, TABLE, IN_TEAM)
    one.price_share = team_of(TABLE, Side.LEFT).price
    lone = one.decide(state, going(0.0), plan, Wind(), 0.5)
    on_its_own, given = planner(), planner()
    for team in (on_its_own, advised(given, None, Role.WANTED, Side.LEFT)):
        mine = team.decide(state, going(0.0), plan, Wind(), 0.5)
        assert (mine.reason, mine.values) == (lone.reason, lone.values)


def test_moves_cost_less_and_gaps_more_where_a_target_crosses_much_of_the_band_in_a_lap():
    slow, fast = (
        team_of(
            replace(
                TABLE,
                configuration=table_configuration(
                    Aircraft(30.0, 105.0), replace(REQUIREMENT, target_speed_max_m_s=speed_max_m_s), 0.0, IN_TEAM
                ),
            ),
            Side.LEFT,
        )
        for speed_max_m_s in (7.0, 14.0)
    )
    assert (slow.price, slow.opposite) == (0.6, 0.6)
    assert fast.price == pytest.approx(0.30, abs=0.01)  # 308 of 360 m in 22 s
    assert fast.opposite == pytest.approx(1.19, abs=0.02)


def test_the_required_side_costs_most_where_it_is_farthest():
    team = planner()
    left = team.role_costs(*_looked(on_circle(-300.0, 0.0, True), going(0.0)))
    right = team.role_costs(*_looked(on_circle(300.0, 0.0, False), going(0.0)))
    assert left.regret_s < -10.0
    assert right.regret_s > 10.0


def _looked(flown, target):
    return flown[0], target, flown[1], Wind(), 0.5


def flown_lap(team: TeamPlanner, other_east_m: float, role: Role, side: Side) -> list[Decision]:
    """What is decided each second of a lap east of a target that goes north, up to the first plan."""
    found: list[Decision] = []
    for k in range(32):
        circle = Circle(300.0, 4.0 * k, 50.0, True)
        state = AircraftState(100.0 + k, *circle.position_at_course(0.2 * k), 0.2 * k, 10.0, circle.curvature_per_m)
        other = Circle(other_east_m, 4.0 * k, 50.0, True)
        on_station = replace(state, east_m=state.east_m + other_east_m - 300.0)
        target = replace(going(0.0), time_s=state.time_s, north_m=4.0 * k, last_sighting_s=state.time_s)
        team.advise(NeighbourPlanned(state.time_s, "b", Plan(other), None))
        neighbour = Neighbour("b", on_station, 160.0, ours=True, target="t")
        team.advise(FleetAdvice(state.time_s, "t", role, side, target, 100.0, (neighbour,)))
        found.append(team.decide(state, target, Plan(circle), Wind(), 0.5))
        if found[-1].plan is not None:
            break
    return found


def test_whoever_is_off_the_required_side_hurries_only_when_no_one_else_sees_it():
    alone = flown_lap(planner(), 360.0, Role.WANTED, Side.LEFT)
    assert alone[-1].plan is not None
    seen = flown_lap(planner(), -300.0, Role.OPPOSITE, Side.RIGHT)
    assert max(one.values["stay_cost_s"] for one in seen) < min(one.values["stay_cost_s"] for one in alone)


def test_who_was_left_behind_comes_back_while_another_watches():
    state, plan = on_circle(900.0, -1000.0, True)
    team, end_s = planner(), 220.0
    while state.time_s < end_s:
        north_m = 4.0 * (state.time_s - 100.0)
        target = replace(going(0.0), time_s=state.time_s, north_m=north_m, last_sighting_s=state.time_s)
        there, other = on_circle(-300.0, north_m, True)
        team.advise(NeighbourPlanned(state.time_s, "b", other, None))
        neighbour = Neighbour("b", replace(there, time_s=state.time_s), 160.0, ours=True, target="t")
        team.advise(FleetAdvice(state.time_s, "t", Role.OPPOSITE, Side.RIGHT, target, 100.0, (neighbour,)))
        moved = team.decide(state, target, plan, Wind(), 0.0).plan
        if moved is not None:
            plan, course_rad = moved, moved.transition.course_rad[-1]
            flown_s = moved.transition_m / 10.0
        else:
            flown_s, course_rad = 1.0, state.course_rad + (0.2 if plan.circle.clockwise else -0.2)
        east_m, north_m = plan.circle.position_at_course(course_rad)
        per_m = plan.circle.curvature_per_m
        state = AircraftState(state.time_s + flown_s, east_m, north_m, course_rad, 10.0, per_m)
    assert math.hypot(state.east_m, state.north_m - 4.0 * (state.time_s - 100.0)) < 1000.0


def test_a_move_that_is_refused_gives_way_to_the_next():
    refused = []

    def check(found: Plan) -> Plan | str:
        refused.append(found)
        return "it would come near b" if len(refused) < 3 else found

    decisions = flown_lap(planner(check), 360.0, Role.WANTED, Side.LEFT)
    assert decisions[-1].plan is refused[-1]
    assert len(refused) >= 3
    never = flown_lap(planner(lambda _plan: "a fence"), 360.0, Role.WANTED, Side.LEFT)
    assert any(one.reason == "staying: a fence" for one in never)


def test_where_uploads_take_long_no_plan_ends_in_a_circle_that_leads_too_near_before_the_next_one():
    latency_s, rng, nearest_m = 6.0, np.random.default_rng(5), []
    for _ in range(60):
        target, bearing_rad = going(float(rng.uniform(0.0, 360.0))), rng.uniform(0.0, 2.0 * math.pi)
        range_m, clockwise = rng.uniform(190.0, 330.0), bool(rng.integers(2))
        circle = Circle(range_m * math.sin(bearing_rad), range_m * math.cos(bearing_rad), 50.0, clockwise)
        course_rad, role = rng.uniform(-3.0, 3.0), (Role.OPPOSITE, Role.WANTED)[rng.integers(2)]
        place = circle.position_at_course(course_rad)
        state = AircraftState(100.0, *place, course_rad, 10.0, circle.curvature_per_m)
        there, opposite = on_circle(-circle.east_m, -circle.north_m, not clockwise)
        deciding = planner()
        deciding.advise(NeighbourPlanned(100.0, "b", opposite, None))
        held = Side.LEFT if role is Role.WANTED else Side.RIGHT
        neighbour = Neighbour("b", there, 160.0, ours=True, target="t")
        deciding.advise(FleetAdvice(100.0, "t", role, held, target, 100.0, (neighbour,)))
        plan = deciding.decide(state, target, Plan(circle), Wind(), latency_s).plan
        if plan is not None:
            until_s = latency_s + plan.transition_m / 10.0 + latency_s
            flown = flown_places(state, Plan(circle), plan, Wind(), 10.0, 0.5, round(2.0 * until_s))
            went_s = 0.5 * np.arange(flown.shape[1])
            off_m = np.hypot(
                flown[0] - target.velocity_east_m_s * went_s, flown[1] - target.velocity_north_m_s * went_s
            )
            nearest_m.append(off_m[round(2.0 * latency_s) :].min())
    assert len(nearest_m) > 10
    assert min(nearest_m) > REQUIREMENT.range_min_m


@pytest.mark.parametrize(
    ("bearings_deg", "share"), [((0, 180), 0.0), ((0, 90), 0.25), ((0, 120, 240), 0.0), ((10, 20, 30), 160 / 360)]
)
def test_the_courses_that_no_one_covers_are_the_gap_beyond_half_a_turn(bearings_deg, share):
    first, *others = np.radians(bearings_deg)
    assert kernel.uncovered(float(first), np.array(others)) == pytest.approx(share, abs=1e-9)


def test_a_requirement_without_sides_is_refused():
    with pytest.raises(ValueError, match="left or right"):
        TeamPlanner(PredictivePlanner(AIRCRAFT, replace(REQUIREMENT, either_side=True), TABLE))


def test_who_comes_while_the_target_stands_counts_by_the_course_that_the_fleet_knows():
    standing = replace(going(0.0), velocity_north_m_s=0.0)
    state, plan = on_circle(250.0, 0.0, clockwise=False)
    alone, given = planner(), planner()
    assert alone.role_costs(state, standing, plan, Wind(), 0.5).regret_s < -15.0  # it presumes that it is on the left
    given.advise(FleetAdvice(100.0, "t", Role.OPPOSITE, Side.RIGHT, standing, 100.0, (), course_rad=0.0))
    assert given.role_costs(state, standing, plan, Wind(), 0.5).regret_s > 15.0
