"""Roles of several aircraft on one target."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from mission.core.circle import Circle
from mission.core.plan import AircraftState, Decision, Plan
from mission.core.requirement import Requirement, Side, Wind
from mission.fleet.planner import FleetPlanner, Member, opposite
from mission.fleet.roles import Role, RoleAssignment, RoleCosts

REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 5.0)


def costs(a: float, b: float) -> dict[str, RoleCosts]:
    return {"a": RoleCosts(a, 1.0), "b": RoleCosts(b, 1.0)}


def test_the_cheapest_holds_the_wanted_side_and_the_other_waits_opposite():
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


@pytest.mark.parametrize("left", [{"b": RoleCosts(9.0, 1.0)}, costs(math.inf, 9.0)], ids=["gone", "blind"])
def test_a_holder_that_is_out_is_replaced_at_once(left):
    roles = RoleAssignment()
    roles.assign(0.0, costs(2.0, 5.0))
    assert roles.assign(1.0, left)["b"] is Role.WANTED


def test_somebody_always_holds_the_wanted_side():
    roles = RoleAssignment()
    for t in range(200):
        told = {name: RoleCosts(3.0 + math.sin(t * k), 1.0) for k, name in enumerate("abc", 1) if (t // 7) % 4 != k}
        assert list(roles.assign(float(t), told).values()).count(Role.WANTED) >= 1


class Costing:
    """A planner whose cost is how far the aircraft is from its side of a target that goes north."""

    def __init__(self, requirement: Requirement) -> None:
        self.side = requirement.side

    def decide(self, aircraft, target, present, wind, latency_s):
        off_m = aircraft.east_m + 300.0 if self.side is Side.LEFT else 300.0 - aircraft.east_m
        return Decision(aircraft.time_s, None, "", {"stay_cost_s": abs(off_m), "move_cost_s": abs(off_m) + 1.0})


def member(east_m: float, busy: bool = False) -> Member:
    state = AircraftState(0.0, east_m, 0.0, 0.0, 15.0, 0.02)
    return Member(state, Plan(Circle(east_m, 0.0, 50.0, True)), 0.5, busy)


def test_each_is_planned_for_in_its_role_and_left_alone_while_a_plan_is_under_way():
    fleet = FleetPlanner(("west", "east"), REQUIREMENT, lambda _name, requirement: Costing(requirement))
    decided = fleet.decide({"west": member(-280.0), "east": member(310.0, busy=True)}, None, Wind())
    assert decided["west"].role is Role.WANTED
    assert decided["east"].role is Role.OPPOSITE
    assert decided["west"].decision is not None
    assert decided["east"].decision is None


def test_the_opposite_of_the_opposite_is_what_was_asked_for():
    assert opposite(opposite(REQUIREMENT)) == REQUIREMENT


def test_a_requirement_without_sides_is_refused():
    with pytest.raises(ValueError, match="left or right"):
        FleetPlanner(("a",), replace(REQUIREMENT, either_side=True), lambda _name, requirement: Costing(requirement))
