"""Alarms about aircraft that are too near to each other, or whose circles cross at almost the same height.

Rules
-----
1. Two aircraft in the air that are less than ``min_m`` apart by their reports raise an alarm at once. One of them may
   be foreign.
2. Two aircraft of the fleet raise an alarm if their circles come within ``min_m`` of each other, heights included,
   for ``AFTER_S``. The control step of the higher one then leaves its circle; see
   :meth:`sidelong.mission.geometry.separation.Separation.crossed`.
3. An aircraft of the fleet that was yielded, to a pilot or to another program that commands the same fleet, raises an
   alarm if it flies within ``min_m`` of the height of another one for ``AFTER_S``: its plans are not known.
4. Each alarm is one sentence, announced once; so is its end, ``CLEAR_AFTER_S`` after the last report of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations

from sidelong.mission.core.fleet import Role
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.fleet.events import ForeignAircraftReported
from sidelong.mission.fleet.vehicle import FleetVehicle
from sidelong.mission.geometry.separation import MIN_SEPARATION_M, circles_apart_m

AFTER_S, CLEAR_AFTER_S = 3.0, 5.0
_AIRBORNE_M = 10.0  # above home; lower, aircraft may stand side by side
_REPORT_MAX_AGE_S = 3.0  # positions are extrapolated along the reported velocity for this long


@dataclass(frozen=True, slots=True)
class _Flying:
    name: str
    state: AircraftState
    height_m: float
    vehicle: FleetVehicle | None  # None: not commanded by this program
    member: bool = True  # of the fleet


@dataclass(slots=True)
class _Pair:
    upper: str
    lower: str
    begun_s: float
    seen_s: float = -math.inf
    announced: str = ""  # "near" or "height", the most severe announced


class Proximity:
    """Watches all pairs of aircraft. min_m: required separation in three dimensions, m."""

    def __init__(self, min_m: float = MIN_SEPARATION_M) -> None:
        self._min_m = min_m
        self._pairs: dict[frozenset[str], _Pair] = {}

    def watch(
        self, now_s: float, fleet: Iterable[FleetVehicle], foreign: Iterable[ForeignAircraftReported]
    ) -> Iterator[tuple[str, str]]:
        """Yield (name of the aircraft, sentence) for each alarm that begins or ends at mission time ``now_s``."""
        flying = [one for one in _all_of(fleet, foreign) if one.height_m >= _AIRBORNE_M]
        flying.sort(key=lambda one: (one.vehicle is None, -one.height_m, one.name))
        for upper, lower in combinations(flying, 2):
            if upper.vehicle is not None:
                yield from self._compare(now_s, upper, lower)
        for key, pair in list(self._pairs.items()):
            if now_s - pair.seen_s >= CLEAR_AFTER_S:
                del self._pairs[key]
                if pair.announced:
                    yield pair.upper, f"separated from {pair.lower} again"

    def _compare(self, now_s: float, upper: _Flying, lower: _Flying) -> Iterator[tuple[str, str]]:
        apart_m, crosses = _apart_m(now_s, upper, lower), self._crosses(upper, lower)
        shares = lower.vehicle is None and lower.member and abs(upper.height_m - lower.height_m) < self._min_m
        if apart_m >= self._min_m and not crosses and not shares:
            return
        key = frozenset((upper.name, lower.name))
        pair = self._pairs.setdefault(key, _Pair(upper.name, lower.name, now_s))
        pair.seen_s = now_s
        if apart_m < self._min_m and pair.announced != "near":
            pair.announced = "near"
            text = f"ALARM: only {apart_m:.0f} m from {pair.lower}; {self._min_m:.0f} m are required"
            yield pair.upper, text
        elif not pair.announced and now_s - pair.begun_s >= AFTER_S:
            pair.announced = "height"
            gap_m = abs(upper.height_m - lower.height_m)
            if shares:
                text = f"ALARM: in the height layer of {pair.lower} ({gap_m:.0f} m), which was yielded"
            else:
                text = f"ALARM: only {gap_m:.0f} m above {pair.lower}, and their circles cross"
            yield pair.upper, text

    def _crosses(self, upper: _Flying, lower: _Flying) -> bool:
        vertical_m = abs(upper.height_m - lower.height_m)
        circles = [
            one.vehicle.plans.present.circle
            for one in (upper, lower)
            if one.vehicle is not None
            and one.vehicle.role is not Role.LEAVE
            and one.vehicle.plans is not None
            and one.vehicle.plans.present is not None
        ]
        return (
            vertical_m < self._min_m
            and len(circles) == 2
            and math.hypot(circles_apart_m(*circles), vertical_m) < self._min_m
        )


def _all_of(fleet: Iterable[FleetVehicle], foreign: Iterable[ForeignAircraftReported]) -> Iterator[_Flying]:
    for one in fleet:
        if one.report is not None and not one.yielded:
            yield _Flying(one.member.name, one.report.state, one.report.height_m, one)
    for other in foreign:
        state = AircraftState(
            other.mission_time_s, other.east_m, other.north_m, other.course_rad, other.speed_m_s, 0.0
        )
        yield _Flying(other.identity, state, other.height_m, None, other.member)


def _apart_m(now_s: float, one: _Flying, other: _Flying) -> float:
    """Return the distance at ``now_s`` by the latest reports, m; infinite where a report is too old."""
    places = []
    for state in (one.state, other.state):
        age_s = now_s - state.time_s
        if age_s > _REPORT_MAX_AGE_S:
            return math.inf
        gone_m = state.ground_speed_m_s * age_s
        places.append(
            (state.east_m + gone_m * math.sin(state.course_rad), state.north_m + gone_m * math.cos(state.course_rad))
        )
    return math.hypot(math.dist(*places), one.height_m - other.height_m)
