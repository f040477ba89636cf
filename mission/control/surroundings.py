"""Fences, ground and other aircraft: whether a plan can be flown among them, and at which heights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from sidelong.mission.core.heights import Heights
from sidelong.mission.core.plan import Plan
from sidelong.mission.core.sight import NOTHING_HIDDEN, Sight, SightAt
from sidelong.mission.geometry.separation import Separation

FenceCheck = Callable[[Plan], str | None]


def _no_fence(_plan: Plan) -> str | None:
    return None


def _all_in_sight(*_target: float) -> Sight:
    return NOTHING_HIDDEN


@dataclass(slots=True)
class Surroundings:
    """Checks of plans against fences and terrain.

    Attributes:
        check: Returns the name of the fence that a plan would break, or None.
        heights: Assigns heights to plans; None: the configured height for all.
        sight: Returns what terrain hides around a target of given position and velocity.

    """

    check: FenceCheck = _no_fence
    heights: Heights | None = None
    sight: SightAt = _all_in_sight
    separation: Separation = field(default_factory=Separation)

    def cleared(
        self,
        plan: Plan,
        flown_m: float | None,
        target_m: tuple[float, float] | None,
        heights: Heights | None = None,
    ) -> Plan | str:
        """Return the plan with its heights, or in words which fence it breaks or what ground is in its way.

        flown_m: the aircraft's height, None where it does not matter; target_m: the target's place; heights: others
        than those that are used.
        """
        heights = heights or self.heights
        levelled = plan if heights is None else heights.levelled(plan, flown_m, target_m)
        return levelled if isinstance(levelled, str) else self.check(levelled) or levelled
