"""Alarms about aircraft that are too near to each other, or whose circles cross at almost the same height.

Rules
-----
1. Two aircraft in the air that are less than ``MIN_SEPARATION_M`` apart by their reports raise an alarm at once. One
   of them may be foreign.
2. Two aircraft of the fleet raise an alarm if their circles come within that distance of each other, heights
   included, for ``AFTER_S``. The control step of the higher one then leaves its circle; see
   :meth:`sidelong.mission.geometry.separation.Separation.crossed`.
3. An aircraft of the fleet that was yielded, to a pilot or to another program that commands the same fleet, raises an
   alarm if it flies within that distance of the height of another one for ``AFTER_S``: its plans are not known.
4. Each alarm belongs to one of the two, the higher one of the fleet's. It ends ``CLEAR_AFTER_S`` after its last
   reason. That aircraft receives it by its advice, and announces its beginning and its end; see
   :mod:`sidelong.mission.control.alarms`.

Source: docs/how-to/several-aircraft.md.
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
    """upper: the aircraft that the alarm belongs to; text: the alarm in words, '' until it is raised."""

    upper: str
    begun_s: float
    seen_s: float = -math.inf
    text: str = ""


class Proximity:
    """Watches all pairs of aircraft."""

    def __init__(self) -> None:
        self._pairs: dict[frozenset[str], _Pair] = {}

    def watch(
        self, now_s: float, fleet: Iterable[FleetVehicle], foreign: Iterable[ForeignAircraftReported]
    ) -> dict[str, str]:
        """Return the alarms of mission time ``now_s`` in words, by the name of the aircraft that each belongs to.

        Args:
            now_s: Mission time, s.
            fleet: All aircraft of the fleet.
            foreign: Aircraft that do not belong to the fleet.
        """
        flying = [one for one in _all_of(fleet, foreign) if one.height_m >= _AIRBORNE_M]
        flying.sort(key=lambda one: (one.vehicle is None, -one.height_m, one.name))
        for upper, lower in combinations(flying, 2):
            if upper.vehicle is not None:
                self._compare(now_s, upper, lower)
        self._pairs = {key: one for key, one in self._pairs.items() if now_s - one.seen_s < CLEAR_AFTER_S}
        raised: dict[str, str] = {}
        for one in self._pairs.values():
            if one.text:
                raised[one.upper] = f"{raised[one.upper]}; {one.text}" if one.upper in raised else one.text
        return raised

    def _compare(self, now_s: float, upper: _Flying, lower: _Flying) -> None:
        apart_m, crosses = _apart_m(now_s, upper, lower), self._crosses(upper, lower)
        gap_m = abs(upper.height_m - lower.height_m)
        shares = lower.vehicle is None and lower.member and gap_m < MIN_SEPARATION_M
        near = apart_m < MIN_SEPARATION_M
        if not (near or crosses or shares):
            return
        pair = self._pairs.setdefault(frozenset((upper.name, lower.name)), _Pair(upper.name, now_s))
        pair.seen_s = now_s
        other = lower.name if pair.upper == upper.name else upper.name
        if near:
            pair.text = f"only {apart_m:.0f} m from {other}; {MIN_SEPARATION_M:.0f} m are required"
        elif pair.text or now_s - pair.begun_s >= AFTER_S:
            why = "and their circles cross" if crosses else "which was yielded and may come here"
            pair.text = f"the height differs by only {gap_m:.0f} m from that of {other}, {why}"

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
            vertical_m < MIN_SEPARATION_M
            and len(circles) == 2
            and math.hypot(circles_apart_m(*circles), vertical_m) < MIN_SEPARATION_M
        )


def _all_of(fleet: Iterable[FleetVehicle], foreign: Iterable[ForeignAircraftReported]) -> Iterator[_Flying]:
    for one in fleet:
        if one.report is not None and not one.yielded:
            yield _Flying(one.member.name, one.report.state, one.report.height_m, one)
    for other in foreign:
        yield _Flying(other.identity, other.state, other.height_m, None, other.member)


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
