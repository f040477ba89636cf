"""What the application asks of a kind of planner, to configure it, to judge it and to make it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from sidelong.estimators.compiled import is_cached
from sidelong.mission.core.feasibility import Change, unflyable
from sidelong.mission.core.plan import CheckedPlannerFactory, PlanCheck, Planner
from sidelong.mission.core.requirement import Aircraft, Requirement
from sidelong.mission.paper.scope import infeasible, largest_psi_c_rad

if TYPE_CHECKING:
    from sidelong.mission.predictive.planner import PredictivePlanner, PredictiveSettings
    from sidelong.mission.predictive.value_table import TableConfiguration, ValueTable


@dataclass(frozen=True, slots=True)
class PlannerNeeds:
    """What a planner is made from; winds_m_s: to prepare for, beyond zero; progress: receives a share 0..1."""

    aircraft: Aircraft
    requirement: Requirement
    winds_m_s: Sequence[float]
    lost_after_s: float
    progress: Callable[[float], None]


class PlannerKind(Protocol):
    """One kind of planner. Nothing heavy is imported before ``factory`` and ``is_compiled`` are called."""

    name: str  # what ``planner.name`` calls it
    about: str  # what it does, in a few words

    def unflyable(self, aircraft: Aircraft, requirement: Requirement) -> Sequence[Change]:
        """Return why it cannot keep the requirement with this aircraft, each with the way out."""
        return unflyable(aircraft, requirement)

    def is_compiled(self) -> bool:
        """Return whether the planner can be made without compilation."""
        return True

    def factory(self, needs: PlannerNeeds) -> CheckedPlannerFactory:
        """Compute the tables for ``needs``, which takes long, and return a factory of planners.

        The factory is quick for aircraft and requirement of ``needs``, for another side, and after ``make_ready``.
        """

    async def make_ready(self, aircraft: Aircraft, requirement: Requirement, winds_m_s: Sequence[float]) -> None:
        """Compute the tables for a changed aircraft or requirement in another process. Raises OSError."""
        return  # by default nothing takes long


@runtime_checkable
class CompilesInParts(Protocol):
    """A ``PlannerKind`` whose decisions one process compiles while another computes its tables."""

    def without_values(self, aircraft: Aircraft, requirement: Requirement) -> PredictivePlanner:
        """Return a planner with made-up tables, whose decisions compile everything."""

    def finished(self, planner: PredictivePlanner) -> Planner:
        """Return the planner that decides: the given one, or one made of it."""


class Paper(PlannerKind):
    """``PlannerKind`` for :class:`sidelong.mission.paper.planner.PaperPlanner`."""

    name = "paper"
    about = "the published method, once a lap"

    def unflyable(self, aircraft: Aircraft, requirement: Requirement) -> Sequence[Change]:
        return infeasible(aircraft, requirement, largest_psi_c_rad(aircraft, requirement))

    def factory(self, needs: PlannerNeeds) -> CheckedPlannerFactory:
        from sidelong.mission.paper.planner import PaperPlanner  # noqa: PLC0415  # see PlannerKind

        return lambda aircraft, wanted, _check: PaperPlanner(aircraft, wanted, largest_psi_c_rad(aircraft, wanted))


class PlainKind(PlannerKind):
    """``PlannerKind`` for a class with ``decide`` of another distribution, which computes nothing ahead."""

    def __init__(self, name: str, make: Callable[[Aircraft, Requirement], Planner]) -> None:
        self.name, self.make = name, make
        self.about = (make.__doc__ or "of another distribution").strip().splitlines()[0]

    def factory(self, needs: PlannerNeeds) -> CheckedPlannerFactory:
        self.make(needs.aircraft, needs.requirement)  # refused here, not in flight
        return lambda aircraft, wanted, _check: self.make(aircraft, wanted)


def kind_of(name: str, loaded: Any) -> Any:
    """Return the kind of an entry point: a class with ``decide``, a ``PlannerKind``, or a class of one."""
    if not isinstance(loaded, type):
        return loaded
    return PlainKind(name, loaded) if hasattr(loaded, "decide") else loaded()


class Predictive(PlannerKind):
    """``PlannerKind`` for :class:`sidelong.mission.predictive.planner.PredictivePlanner`."""

    name = "predictive"
    about = "decides every second by looking ahead"

    def is_compiled(self) -> bool:
        from sidelong.mission.predictive.decision_kernel import foresee, look_two_moves_ahead  # noqa: PLC0415

        return is_cached(look_two_moves_ahead) and is_cached(foresee)

    def without_values(self, aircraft: Aircraft, requirement: Requirement) -> PredictivePlanner:
        """Return a planner with made-up tables, whose decisions compile everything."""
        import numpy as np  # noqa: PLC0415  # see PlannerKind, as all of these

        from sidelong.mission.predictive.planner import PredictivePlanner, table_configuration  # noqa: PLC0415
        from sidelong.mission.predictive.value_table import completed  # noqa: PLC0415

        configuration = table_configuration(aircraft, requirement, 0.0, self.settings())
        shape = configuration.shape  # values that grow along one axis let it move
        slope = np.broadcast_to(np.linspace(0.0, 1e3, shape[-1], dtype=np.float32), shape)
        table = completed(configuration, slope.copy())
        return PredictivePlanner(aircraft, requirement, table, self.settings())

    def settings(self) -> PredictiveSettings:
        """Return the planner's settings; ``lost_after_s`` comes from the flight."""
        from sidelong.mission.predictive.planner import USUAL  # noqa: PLC0415  # see PlannerKind

        return USUAL

    def finished(self, planner: PredictivePlanner) -> Planner:
        """Return the planner that decides: the given one, or one made of it."""
        return planner

    def factory(self, needs: PlannerNeeds) -> CheckedPlannerFactory:
        from sidelong.app.planners.value_cache import value_table  # noqa: PLC0415  # see PlannerKind
        from sidelong.mission.predictive.planner import PredictivePlanner  # noqa: PLC0415

        settings = replace(self.settings(), lost_after_s=needs.lost_after_s)
        tables: dict[TableConfiguration, ValueTable] = {}  # a change of side needs no other one

        def tables_for(aircraft: Aircraft, wanted: Requirement, winds_m_s: Sequence[float]) -> list[ValueTable]:
            configurations = self._configurations(aircraft, wanted, winds_m_s)
            for one in configurations:
                tables[one] = tables.get(one) or value_table(one, needs.progress)
            return [tables[one] for one in configurations]

        def make(aircraft: Aircraft, wanted: Requirement, plans: PlanCheck) -> Planner:
            def table_at(wind_m_s: float) -> ValueTable:
                return tables_for(aircraft.configured or aircraft, wanted, [wind_m_s])[-1]

            # A wider circle, as learned in flight, cannot wait for tables of its own.
            calm, *windy = tables_for(aircraft.configured or aircraft, wanted, needs.winds_m_s)
            return self.finished(
                PredictivePlanner(aircraft, wanted, calm, settings, windy, plans.cleared, plans.sight, table_at)
            )

        tables_for(needs.aircraft, needs.requirement, needs.winds_m_s)
        return make

    async def make_ready(self, aircraft: Aircraft, requirement: Requirement, winds_m_s: Sequence[float]) -> None:
        from sidelong.app.planners.value_cache import have_at_hand  # noqa: PLC0415  # see PlannerKind

        await have_at_hand(self._configurations(aircraft, requirement, winds_m_s))

    def _configurations(
        self, aircraft: Aircraft, requirement: Requirement, winds_m_s: Sequence[float]
    ) -> list[TableConfiguration]:
        from sidelong.mission.predictive.planner import table_configuration  # noqa: PLC0415  # see PlannerKind

        settings = self.settings()
        return [table_configuration(aircraft, requirement, wind_m_s, settings) for wind_m_s in (0.0, *winds_m_s)]
