"""The published method."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from sidelong.app.planners.planner_kind import PlannerNeeds
from sidelong.mission.core.feasibility import Change
from sidelong.mission.core.plan import CheckedPlannerFactory
from sidelong.mission.core.requirement import Aircraft, Requirement
from sidelong.mission.paper.feasibility import infeasible
from sidelong.mission.paper.scope import largest_psi_c_rad


class Paper:
    """``PlannerKind`` for :class:`sidelong.mission.paper.planner.PaperPlanner`."""

    name = "paper"
    about = "the published method, once a lap"

    def unflyable(self, aircraft: Aircraft, requirement: Requirement) -> Sequence[Change]:
        return infeasible(aircraft, requirement, largest_psi_c_rad(aircraft, requirement))

    def is_compiled(self) -> bool:
        return True

    def factory(self, needs: PlannerNeeds) -> CheckedPlannerFactory:
        import_module("scipy.special")  # where it is not installed, refuse before the flight

        from sidelong.mission.paper.planner import PaperPlanner  # noqa: PLC0415  # see PlannerKind

        return lambda aircraft, wanted, _check: PaperPlanner(aircraft, wanted, largest_psi_c_rad(aircraft, wanted))

    async def make_ready(self, aircraft: Aircraft, requirement: Requirement, winds_m_s: Sequence[float]) -> None:
        pass  # it computes as it goes
