"""Heights of plans, and the way from one height to another. Source: docs/how-to/hills.md."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from sidelong.mission.core.plan import HeightProfile, Plan

# The share of the rates that is counted on: in a tailwind the ground comes sooner.
_RATE_RESERVE = 0.7


class Heights(Protocol):
    """Gives plans their heights, m above home."""

    def levelled(self, plan: Plan, flown_m: float | None, target_m: tuple[float, float] | None = None) -> Plan | str:
        """Return a plan with its heights.

        Args:
            plan: The plan.
            flown_m: Present height above home, m; None before the first circle.
            target_m: Target's position (east, north), m.

        Returns:
            The plan with heights above home, or in words why there are none.
        """

    def at(self, height_m: float) -> Heights:
        """Return the same rules for another height.

        Args:
            height_m: The height, above the reference of the configured one, m.
        """


@dataclass(frozen=True, slots=True)
class ClimbRates:
    """What the aircraft reaches: airspeed, climb and descent, m/s."""

    airspeed_m_s: float
    climb_m_s: float = 3.0
    descent_m_s: float = 2.0

    def slope(self, *, climbs: bool) -> float:
        """Return the usable change of height per metre flown.

        Args:
            climbs: Whether the aircraft climbs; else it descends.
        """
        return _RATE_RESERVE * (self.climb_m_s if climbs else self.descent_m_s) / self.airspeed_m_s

    def profile(self, from_m: float, to_m: float) -> HeightProfile:
        """Return the heights on the way from one height to another.

        Args:
            from_m: Height at the start, m.
            to_m: Height at the end, m.
        """
        return HeightProfile(from_m, to_m, self.slope(climbs=to_m >= from_m))


@dataclass(frozen=True, slots=True)
class OneHeight:
    """``Heights`` over flat ground. height_m None: the configured one, which plans do not carry."""

    rates: ClimbRates
    height_m: float | None = None

    def levelled(self, plan: Plan, flown_m: float | None, _target_m: tuple[float, float] | None = None) -> Plan:
        """See :class:`Heights`."""
        if self.height_m is None:
            return plan
        return replace(plan, heights=self.rates.profile(self.height_m if flown_m is None else flown_m, self.height_m))

    def at(self, height_m: float) -> OneHeight:
        """See :class:`Heights`."""
        return OneHeight(self.rates, height_m)
