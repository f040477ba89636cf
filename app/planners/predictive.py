"""The default: decides every second by looking ahead."""

from __future__ import annotations

from collections.abc import Sequence

from app.planners.planner_kind import PlannerNeeds
from estimators.compiled import is_kept
from mission.core.plan import PlannerFactory
from mission.core.requirement import Aircraft, Requirement
from mission.paper.feasibility import Change, unflyable


class Predictive:
    """``PlannerKind`` for :class:`mission.predictive.planner.PredictivePlanner`."""

    name = "predictive"
    about = "decides every second by looking ahead"

    def unflyable(self, aircraft: Aircraft, requirement: Requirement) -> Sequence[Change]:
        return unflyable(aircraft, requirement)

    def is_compiled(self) -> bool:
        from mission.predictive._decision_kernel import look_ahead  # noqa: PLC0415  # see PlannerKind

        return is_kept(look_ahead)

    def factory(self, needs: PlannerNeeds) -> PlannerFactory:
        from app.value_cache import value_table  # noqa: PLC0415  # see PlannerKind
        from mission.predictive import planner  # noqa: PLC0415

        # A change of side needs no other table.
        aircraft, requirement = needs.aircraft, needs.requirement
        calm, *windy = (
            value_table(planner.table_configuration(aircraft, requirement, wind_m_s), needs.progress)
            for wind_m_s in (0.0, *needs.winds_m_s)
        )
        settings = planner.PredictiveSettings(lost_after_s=needs.lost_after_s)
        return lambda wanted: planner.PredictivePlanner(
            aircraft, wanted, calm, settings, windy, needs.check, needs.sight
        )
