"""Who watches from the wanted side, and who waits on the other one.

One aircraft loses the side whenever the target reverses. With another one opposite a reversal only swaps their roles,
because the two sides change places. Rules
-----
1. The wanted side is held by the aircraft to which it is worth most: whose expected cost there, less that on the
   other side, is least.
2. It is handed over when that has been better for another by ``gain_s`` for ``patience_s``, or at once when the
   holder is out. So it is never left empty for a change: whoever takes over is nearer to it by then.
3. The others are spread over the opposite and the wanted side in turn, those that it is worth least to first.
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

    @property
    def regret_s(self) -> float:
        """What the wanted side costs more than the opposite one."""
        return self.wanted_s - self.opposite_s if math.isfinite(self.wanted_s) else math.inf


@dataclass(slots=True)
class RoleAssignment:
    """Decides the roles, each time from all aircraft's costs; deterministic.

    gain_s: how much better another has to be, in seconds off the side: a circle's phase alone is worth some of them.
    patience_s: for how long.
    """

    gain_s: float = 15.0
    patience_s: float = 2.0
    holder: str | None = None
    _better_since_s: dict[str, float] = field(default_factory=dict)

    def assign(self, time_s: float, costs: Mapping[str, RoleCosts]) -> dict[str, Role]:
        """Return every aircraft's role at ``time_s``; costs are by aircraft, those that take part only."""
        if not costs:
            self.holder = None
            return {}
        self._hand_over(time_s, costs)
        others = sorted((name for name in costs if name != self.holder), key=lambda name: -costs[name].regret_s)
        opposite = len(costs) // 2
        roles = {name: Role.OPPOSITE if k < opposite else Role.WANTED for k, name in enumerate(others)}
        if self.holder is not None:
            roles[self.holder] = Role.WANTED
        return roles

    def _hand_over(self, time_s: float, costs: Mapping[str, RoleCosts]) -> None:
        best = min(costs, key=lambda name: (costs[name].regret_s, name))
        held_s = costs[self.holder].regret_s if self.holder is not None and self.holder in costs else math.inf
        if not math.isfinite(held_s):
            self.holder, self._better_since_s = best, {}
            return
        self._better_since_s = {
            name: self._better_since_s.get(name, time_s)
            for name, cost in costs.items()
            if cost.regret_s < held_s - self.gain_s
        }
        since_s = self._better_since_s.get(best)
        if since_s is not None and time_s - since_s >= self.patience_s:
            self.holder, self._better_since_s = best, {}
