"""Who watches from the wanted side, and who waits on the other one.

One aircraft loses the side whenever the target reverses. With another one opposite a reversal only swaps their roles,
because the two sides change places. Rules
-----
1. The wanted side is held by the aircraft that is expected to be off it for the shortest time from now on.
2. It is handed over when another's expected cost has been lower by ``gain_s`` for ``patience_s``, or at once when the
   holder's own sensors or link are out. So it is never left empty for a change: whoever takes over is there before.
3. The others are spread over the opposite and the wanted side in turn, the cheapest first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from mission.core.fleet import Role


@dataclass(frozen=True, slots=True)
class RoleCosts:
    """What one aircraft is expected to cost in each role, in seconds off that side; infinite: it cannot take it."""

    wanted_s: float
    opposite_s: float


@dataclass(slots=True)
class RoleAssignment:
    """Decides the roles, each time from all aircraft's costs; deterministic.

    gain_s: how much cheaper another has to be, in seconds off the side; patience_s: for how long.
    """

    gain_s: float = 1.0
    patience_s: float = 2.0
    holder: str | None = None
    _better_since_s: dict[str, float] = field(default_factory=dict)

    def assign(self, time_s: float, costs: Mapping[str, RoleCosts]) -> dict[str, Role]:
        """Return every aircraft's role at ``time_s``; costs are by aircraft, those that take part only."""
        if not costs:
            self.holder = None
            return {}
        self._hand_over(time_s, costs)
        others = sorted((name for name in costs if name != self.holder), key=lambda name: costs[name].opposite_s)
        roles = {name: Role.OPPOSITE if k % 2 == 0 else Role.WANTED for k, name in enumerate(others)}
        if self.holder is not None:
            roles[self.holder] = Role.WANTED
        return roles

    def _hand_over(self, time_s: float, costs: Mapping[str, RoleCosts]) -> None:
        cheapest = min(costs, key=lambda name: (costs[name].wanted_s, name))
        held_s = costs[self.holder].wanted_s if self.holder is not None and self.holder in costs else math.inf
        if not math.isfinite(held_s):
            self.holder, self._better_since_s = cheapest, {}
            return
        self._better_since_s = {
            name: self._better_since_s.get(name, time_s)
            for name, cost in costs.items()
            if cost.wanted_s < held_s - self.gain_s
        }
        since_s = self._better_since_s.get(cheapest)
        if since_s is not None and time_s - since_s >= self.patience_s:
            self.holder, self._better_since_s = cheapest, {}
