"""Assignment of the primary, on the required side, and of the standby aircraft, on the other one.

One aircraft loses the side whenever the target reverses. With another one opposite a reversal only swaps their roles,
because the two sides change places. Rules
-----
1. The required side is held by the aircraft to which it is worth most: whose expected cost there, less that on the
   other side, is least. A holder that is out, or to be relieved, is replaced at once.
2. Else it is handed over when that has been better for another by ``gain_s`` for ``patience_s``, and that other one
   watches from the required side then, or neither does: so the side is never left empty for a change. The target's
   course has to be known for that: which side is which hangs on it.
3. After a hand-over the next one waits ``settling_s``, in which both make their plans, and until these have reached
   the autopilots, ``under_way_max_s`` at most. It does not wait for whole lines to be flown: where a target turned
   in the meantime, that cost more time off side than it saved in hand-overs.
4. The others are spread over the opposite and the required side in turn, those that it is worth least to first.

Source: docs/explanation/planners.md#several-aircraft.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.fleet import Role
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Requirement

_STANDING_M_S = 0.3  # a slower target has no course
_COURSE_SIGMA_RAD = math.radians(30.0)  # one standard deviation of a course that is barely known


@dataclass(frozen=True, slots=True)
class RoleCosts:
    """What one aircraft is expected to cost in each role, in seconds off that side; infinite: it cannot take it."""

    wanted_s: float
    opposite_s: float

    @property
    def regret_s(self) -> float:
        """What the required side costs more than the opposite one."""
        return self.wanted_s - self.opposite_s if math.isfinite(self.wanted_s) else math.inf


@dataclass(frozen=True, slots=True)
class Candidate:
    """One aircraft that takes part: whether it watches from the required side now, and has a plan under way to it."""

    costs: RoleCosts
    on_station: bool = True
    under_way: bool = False


@dataclass(slots=True)
class RoleAssignment:
    """Decides the roles, each time from all aircraft's costs; deterministic.

    gain_s: how much better another has to be, in seconds off the side: a circle's phase alone is worth some of them.
    patience_s: for how long. settling_s, under_way_max_s: see the rules.
    """

    gain_s: float = 15.0
    patience_s: float = 2.0
    settling_s: float = 10.0
    under_way_max_s: float = 30.0
    holder: str | None = None
    _better_since_s: dict[str, float] = field(default_factory=dict)
    _handed_s: float = -math.inf
    _waited_for: frozenset[str] = frozenset()  # these have to take up their new roles first

    def assign(
        self, time_s: float, candidates: Mapping[str, Candidate], *, course_known: bool = True
    ) -> dict[str, Role]:
        """Return every aircraft's role at ``time_s``; candidates: by name, those that take part only."""
        if not candidates:
            self.holder = None
            return {}
        regret_s = {name: one.costs.regret_s for name, one in candidates.items()}
        self._hand_over(time_s, regret_s, candidates, course_known)
        others = sorted((name for name in regret_s if name != self.holder), key=lambda name: -regret_s[name])
        opposite = len(candidates) // 2
        roles = {name: Role.OPPOSITE if k < opposite else Role.WANTED for k, name in enumerate(others)}
        if self.holder is not None:
            roles[self.holder] = Role.WANTED
        return roles

    def _hand_over(
        self, time_s: float, regret_s: dict[str, float], candidates: Mapping[str, Candidate], course_known: bool
    ) -> None:
        best = min(regret_s, key=lambda name: (regret_s[name], name))
        held = candidates.get(self.holder) if self.holder is not None else None
        if held is None or not math.isfinite(held.costs.regret_s):
            self._hand_to(best, time_s)
            return
        since_s = time_s - self._handed_s
        if since_s >= self.settling_s:
            under_way = (name for name in self._waited_for if name in candidates and candidates[name].under_way)
            self._waited_for = frozenset(under_way if since_s < self.under_way_max_s else ())
        self._better_since_s = {
            name: self._better_since_s.get(name, time_s)
            for name, one in candidates.items()
            if regret_s[name] < held.costs.regret_s - self.gain_s
            and course_known
            and (one.on_station or not held.on_station)
        }
        better_s = time_s - self._better_since_s.get(best, math.inf)
        if better_s >= self.patience_s and not self._waited_for:
            self._hand_to(best, time_s)

    def _hand_to(self, name: str, time_s: float) -> None:
        before = self.holder
        self.holder, self._better_since_s = name, {}
        if before is not None and before != name:
            self._handed_s, self._waited_for = time_s, frozenset((before, name))


def course_is_known(target: TargetEstimate) -> bool:
    """Return whether a target's course is known well enough to say which side of it is which, or it stands."""
    if target.speed_m_s < _STANDING_M_S:
        return True
    across = (math.cos(target.course_rad), -math.sin(target.course_rad))
    (a, b), (_, d) = target.covariance[2:, 2:].tolist()
    sigma_m_s = math.sqrt(max(a * across[0] ** 2 + 2.0 * b * across[0] * across[1] + d * across[1] ** 2, 0.0))
    return sigma_m_s < math.tan(_COURSE_SIGMA_RAD) * target.speed_m_s


def is_on_station(
    aircraft: AircraftState, target: TargetEstimate, requirement: Requirement, course_rad: float | None
) -> bool:
    """Return whether an aircraft is in the band and on the required side of a target's course, if it has one."""
    east_m, north_m = aircraft.east_m - target.east_m, aircraft.north_m - target.north_m
    in_band = requirement.range_min_m <= math.hypot(east_m, north_m) <= requirement.range_max_m
    if course_rad is None:
        return in_band
    normal_rad = course_rad + requirement.side.normal_turn_rad
    return in_band and east_m * math.sin(normal_rad) + north_m * math.cos(normal_rad) >= 0.0
