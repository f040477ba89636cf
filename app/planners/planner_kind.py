"""What the application asks of a kind of planner, to configure it, to judge it and to make it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.feasibility import Change
from sidelong.mission.core.plan import AircraftState, CheckedPlannerFactory, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind

DecisionInputs = tuple[AircraftState, TargetEstimate, Plan, Wind, float]
"""What ``Planner.decide`` takes."""


@dataclass(frozen=True, slots=True)
class PlannerNeeds:
    """The inputs from which a planner is made.

    winds_m_s: wind speeds to prepare for, in addition to zero. progress: called with the share 0..1 of a computation
    that takes seconds.
    """

    aircraft: Aircraft
    requirement: Requirement
    winds_m_s: Sequence[float]
    lost_after_s: float
    progress: Callable[[float], None]


class PlannerKind(Protocol):
    """One kind of planner. Nothing heavy is imported before ``factory`` and ``is_compiled`` are called."""

    name: str
    """What ``planner.name`` calls it."""
    about: str
    """What it does, in a few words."""

    def unflyable(self, aircraft: Aircraft, requirement: Requirement) -> Sequence[Change]:
        """Return why it cannot keep the requirement with this aircraft, each with the way out."""

    def is_compiled(self) -> bool:
        """Return whether the planner can be made without compilation."""

    def factory(self, needs: PlannerNeeds) -> CheckedPlannerFactory:
        """Compute what takes long for ``needs``, and return what makes a planner.

        That takes an aircraft, a requirement and the check of plans. It makes one at once for those of ``needs``,
        another side, and whatever ``make_ready`` was called for.
        """

    async def make_ready(self, aircraft: Aircraft, requirement: Requirement, winds_m_s: Sequence[float]) -> None:
        """Compute what takes long for others than those of the beginning, in another process.

        Raises OSError when that fails.
        """


@runtime_checkable
class CompilesInParts(Protocol):
    """A ``PlannerKind`` that a second process can help to compile."""

    def compile_part(self, aircraft: Aircraft, requirement: Requirement, known: DecisionInputs) -> None:
        """Compile about half of it, while another process begins with the other half. known: to decide by."""
