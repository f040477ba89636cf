"""Fences, ground and other aircraft: where and how high a plan can be flown. Source: docs/explanation/safety.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from sidelong.mission.core.heights import Heights
from sidelong.mission.core.plan import Plan
from sidelong.mission.core.sight import NOTHING_HIDDEN, SightAt
from sidelong.mission.geometry.separation import Separation

FenceCheck = Callable[[Plan], str | None]


@dataclass(slots=True)
class Surroundings:
    """Checks of plans against fences and terrain.

    Attributes:
        check: Returns the name of the fence that a plan would break, or None.
        heights: Assigns heights to plans; None: the configured height for all.
        sight: Returns what terrain hides around a target of given position and velocity.
    """

    check: FenceCheck = lambda _plan: None
    heights: Heights | None = None
    sight: SightAt = lambda *_target: NOTHING_HIDDEN
    separation: Separation = field(default_factory=Separation)

    def cleared(
        self,
        plan: Plan,
        flown_m: float | None = None,
        target_m: tuple[float, float] | None = None,
        heights: Heights | None = None,
    ) -> Plan | str:
        """Check a plan against fences, ground and other aircraft.

        Args:
            plan: The plan.
            flown_m: Present height above home, m; None if it does not matter, as for the first circle.
            target_m: Target's position (east, north), m; None if unknown.
            heights: Rules for the heights instead of the present ones.

        Returns:
            The plan with its heights, or in words the fence that it breaks or the ground in its path.
        """
        heights = heights or self.heights
        levelled = plan if heights is None else heights.levelled(plan, flown_m, target_m)
        return levelled if isinstance(levelled, str) else self.check(levelled) or levelled
