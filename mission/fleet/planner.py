"""The joint decision: each aircraft is looked at in both roles; once the roles are given out, its plan follows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from estimators.estimate import TargetEstimate
from mission.core.fleet import Role
from mission.core.plan import AircraftState, Decision, Plan, Planner
from mission.core.requirement import Requirement, Side, Wind
from mission.fleet.roles import RoleAssignment, RoleCosts


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """What the joint decision is told of one aircraft: its state, the plan that it flies, how long an upload takes.

    busy: a plan is on its way to its autopilot, so that nothing new can be decided for it now.
    """

    aircraft: AircraftState
    present: Plan
    latency_s: float
    busy: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FleetDecision:
    """One aircraft's role and what was decided for it; None while a plan is under way to it."""

    role: Role
    decision: Decision | None


def opposite(requirement: Requirement) -> Requirement:
    """Return the requirement to watch from the other side."""
    return replace(requirement, side=Side.RIGHT if requirement.side is Side.LEFT else Side.LEFT)


class FleetPlanner:
    """Plans for all aircraft on one target. make_planner builds one aircraft's planner for a requirement.

    Raises ValueError for a requirement without sides, either side or a sector, which one aircraft keeps alone.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        requirement: Requirement,
        make_planner: Callable[[str, Requirement], Planner],
        assignment: RoleAssignment | None = None,
    ) -> None:
        if requirement.either_side or requirement.sector is not None:
            raise ValueError("several aircraft share the sides of a target: side has to be left or right")
        wanted = {Role.WANTED: requirement, Role.OPPOSITE: opposite(requirement)}
        self._planners = {(name, role): make_planner(name, wanted[role]) for name in names for role in wanted}
        self.assignment = assignment or RoleAssignment()

    def decide(self, members: Mapping[str, Member], target: TargetEstimate, wind: Wind) -> dict[str, FleetDecision]:
        """Decide for the aircraft that take part now; those left out lose their role to the others."""
        decisions: dict[tuple[str, Role], Decision] = {}
        for name, member in members.items():
            for role in (Role.WANTED, Role.OPPOSITE):
                decisions[name, role] = self._planners[name, role].decide(
                    member.aircraft, target, member.present, wind, member.latency_s
                )
        costs = {
            name: RoleCosts(_cost_s(decisions[name, Role.WANTED]), _cost_s(decisions[name, Role.OPPOSITE]))
            for name in members
        }
        time_s = max((member.aircraft.time_s for member in members.values()), default=-math.inf)
        roles = self.assignment.assign(time_s, costs)
        return {
            name: FleetDecision(role, None if members[name].busy else decisions[name, role])
            for name, role in roles.items()
        }


def _cost_s(decision: Decision) -> float:
    """Return what a decision expects to cost: the cheaper of staying and moving; infinite where it cannot tell."""
    values = decision.values
    return min(values.get("stay_cost_s", math.inf), values.get("move_cost_s", math.inf))
