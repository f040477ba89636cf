"""Fences, ground and other aircraft: where and how high a plan can be flown. Source: docs/explanation/safety.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sidelong.mission.core.plan import Flown, Heights, Plan
from sidelong.mission.core.sight import NOTHING_HIDDEN, Sight
from sidelong.mission.geometry.separation import Separation

if TYPE_CHECKING:
    from sidelong.estimators.terrain.ground import Ground

FenceCheck = Callable[[Plan], str | None]
Hidden = Callable[[Heights, float | None, tuple[float, float], tuple[float, float]], Sight]


@dataclass(frozen=True, slots=True)
class FlightBounds:
    """What the flown position and height are to stay within. Heights are above home."""

    height_m: float = math.nan  # of plans without heights of their own; NaN: not known
    floor_m: float = -math.inf
    ceiling_m: float = math.inf
    margin_m: float = 0.0  # kept by plans from every fence
    clearance_m: float = 0.0  # least height over the ground
    inside_m: Callable[[float, float], float] = lambda _east_m, _north_m: math.inf
    clear_m: Callable[[float, float, float], float] = lambda _east_m, _north_m, _height_m: math.inf


@dataclass(slots=True)
class Surroundings:
    """The one check of plans, for planner and control step alike. All but ``flown`` is known before both are made.

    Attributes:
        fences: Returns the name of the fence that a plan would break, or None.
        heights: Assigns heights to plans; None: the configured height for all.
        hidden: Returns what the ground hides of a target of given position and velocity.
        flown: What plans begin from. The control step updates it.
    """

    fences: FenceCheck = lambda _plan: None
    heights: Heights | None = None
    ground: Ground | None = None
    hidden: Hidden | None = None
    separation: Separation = field(default_factory=Separation)
    bounds: FlightBounds = FlightBounds()  # frozen
    _flown: Flown = field(default_factory=Flown)
    _cleared: Plan | None = None  # the plan that passed last: it is not checked again

    @property
    def flown(self) -> Flown:
        """What is flown."""
        return self._flown

    @flown.setter
    def flown(self, flown: Flown) -> None:
        self._flown, self._cleared = flown, None

    def cleared(self, plan: Plan) -> Plan | str:
        """Check a plan that is to follow what is flown against fences, ground and other aircraft.

        Returns the plan with its heights, or in words the fence that it breaks or the obstacle in its path.
        """
        if plan is self._cleared:
            return plan
        flown = self._flown
        cleared = self.levelled(plan, flown.height_m, flown.target_m)
        if isinstance(cleared, str):
            return cleared
        near = self.separation.breach(cleared, flown)
        if near:
            return near
        self._cleared = cleared
        return cleared

    def first_cleared(self, plans: Iterable[Plan]) -> Plan | None:
        """Return the first of several plans that passes the check, with its heights; None: none does."""
        return next((plan for plan in map(self.cleared, plans) if isinstance(plan, Plan)), None)

    def levelled(
        self,
        plan: Plan,
        flown_m: float | None = None,
        target_m: tuple[float, float] | None = None,
        heights: Heights | None = None,
    ) -> Plan | str:
        """Check a plan against fences and ground alone; see :meth:`cleared`.

        A present height does not matter for the first circle; ``heights`` are rules instead of the present ones.
        """
        heights = heights or self.heights
        levelled = plan if heights is None else heights.levelled(plan, flown_m, target_m)
        return levelled if isinstance(levelled, str) else self.fences(levelled) or levelled

    def sight(self, east_m: float, north_m: float, velocity_east_m_s: float, velocity_north_m_s: float) -> Sight:
        """Return what the ground hides of a target."""
        if self.hidden is None or self.heights is None:
            return NOTHING_HIDDEN
        velocity_m_s = velocity_east_m_s, velocity_north_m_s
        return self.hidden(self.heights, self._flown.height_m, (east_m, north_m), velocity_m_s)
