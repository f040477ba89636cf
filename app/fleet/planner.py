"""Planners of the aircraft of a fleet: the predictive planner in its cooperative form, the others unchanged."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sidelong.app.config import Config
from sidelong.app.planners.planner_kind import PlannerKind, Predictive
from sidelong.app.planners.registry import planner_by_name
from sidelong.estimators.compiled import is_cached
from sidelong.mission.core.plan import Planner

if TYPE_CHECKING:
    from sidelong.mission.predictive.planner import PredictivePlanner, PredictiveSettings


class TeamPredictive(Predictive):
    """``PlannerKind`` for :class:`sidelong.mission.fleet.team_planner.TeamPlanner`."""

    about = "decides every second by looking ahead, together with the rest of the fleet"

    def is_compiled(self) -> bool:
        from sidelong.mission.fleet.team_kernel import team_decide  # noqa: PLC0415  # see PlannerKind

        return super().is_compiled() and is_cached(team_decide)

    def settings(self) -> PredictiveSettings:
        from sidelong.mission.fleet.team_planner import IN_TEAM  # noqa: PLC0415  # see PlannerKind

        return IN_TEAM

    def finished(self, planner: PredictivePlanner) -> Planner:
        """Return the cooperative planner; a requirement without sides to share has the planner of one aircraft."""
        from sidelong.mission.fleet.team_planner import TeamPlanner  # noqa: PLC0415  # see PlannerKind

        has_sides = planner.requirement.sector is None and not planner.requirement.either_side
        return TeamPlanner(planner) if has_sides else planner


def planner_in_fleet(settings: Config) -> PlannerKind:
    """Return the kind of planner of an aircraft of a fleet; one that watches alone has that of a single aircraft."""
    together = settings.requirement.fleet_size > 1 and settings.planner.name == TeamPredictive.name
    return TeamPredictive() if together else planner_by_name(settings.planner.name)
