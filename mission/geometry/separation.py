"""Whether a plan keeps apart from the other aircraft, checked along the whole of it and of what they fly.

Height layers keep aircraft apart wherever they fly; then nothing else is asked. Where two heights are closer than the
least distance, three things are: on the way, moment by moment, the distance less what the speeds may be wrong by; and
on the circles that both end in, where the phase is unknown, that the circles themselves are far enough apart. A
foreign aircraft is predicted to go on as it flies, for a limited time, and no plan may bring it nearer than it comes
anyway.

Source: docs/how-to/several-aircraft.md; ASTM F3442/F3442M for the distances from manned and other unmanned aircraft.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.fleet import Neighbour, NeighbourPlanned, Role
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import RATE_RESERVE, AircraftState, Flown, Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry import line_kernel as kernel
from sidelong.mission.geometry.progress import line_of

MIN_SEPARATION_M = 50.0
# Horizontally and vertically: 2000 and 250 ft are well clear of a manned aircraft; 500 and 100 ft are a near mid-air
# collision, and what is kept from other unmanned aircraft.
WELL_CLEAR_M, NEAR_COLLISION_M = (609.6, 76.2), (152.4, 30.5)
PREDICTED_S = 75.0
_REPORT_MAX_AGE_S = 20.0
_STEP_S = 1.0
_FOREIGN_S = 30.0  # a foreign aircraft's straight-line prediction is valid for this time
_SPEED_ERROR = 0.05  # share of the airspeed by which each aircraft may be ahead of its line's time, or behind it
_LINE_ERROR_M = 10.0  # flown lines differ from planned ones
_LONGEST_S = 180.0


@dataclass(frozen=True, slots=True)
class Encounter:
    """The predicted closest approach of a foreign aircraft, in in_s: its height above home then, and the distances.

    share: the larger one of both distances, each as a share of what is to be kept; below 1 neither is.
    """

    other: Neighbour
    in_s: float
    horizontal_m: float
    height_m: float
    vertical_m: float
    share: float

    def __str__(self) -> str:
        near = self.horizontal_m < NEAR_COLLISION_M[0] and self.vertical_m < NEAR_COLLISION_M[1]
        level = "near collision" if near else "not well clear"
        distances = f"{self.horizontal_m:.0f} m horizontally and {self.vertical_m:.0f} m vertically"
        return f"{level}: {self.other.name} comes within {distances} in {self.in_s:.0f} s"


@dataclass(slots=True)
class Separation:
    """What is known of the others, all on the own clock. min_m: in three dimensions."""

    min_m: float = MIN_SEPARATION_M
    _others: dict[str, Neighbour] = field(default_factory=dict)
    _plans: dict[str, NeighbourPlanned] = field(default_factory=dict)

    def note(self, neighbours: tuple[Neighbour, ...]) -> None:
        """Replace the list of the other aircraft."""
        self._others = {one.name: one for one in neighbours}

    def planned(self, neighbour: NeighbourPlanned) -> None:
        """Store the plans of another aircraft of the fleet."""
        self._plans[neighbour.name] = neighbour

    def breach(self, plan: Plan, flown: Flown) -> str | None:
        """Return in words which aircraft a plan that follows what is flown comes too near to, or None."""
        height_m = flown.height_m
        if not self._others or flown.aircraft is None or height_m is None:
            return None
        flown = flown if flown.present is not None else flown._replace(present=plan)
        heights = {height_m, *_heights_of(plan)}
        own: FloatArray | None = None
        before, after = (closest_of(self.encounters(flown, coming)) for coming in (None, plan))
        if after is not None and after.share < min(1.0, 1.0 if before is None else before.share):
            return str(after)
        for name, other in self._others.items():
            if other.clear_m != (0.0, 0.0):
                continue
            neighbour = self._plans.get(name) if other.ours else None
            theirs = () if neighbour is None else (neighbour.present, neighbour.coming)
            vertical_m = _gap_m(heights, {other.height_m, *_heights_of(*theirs)})
            if vertical_m >= self.min_m:
                continue
            flat_m = math.sqrt(self.min_m**2 - vertical_m**2)
            if own is None:
                # A plan is followed for its transition and a lap.
                duration_s = (plan.transition_m + 2.0 * math.pi * plan.circle.radius_m) / flown.airspeed_m_s
                own = _own_places(flown, plan, min(duration_s, _LONGEST_S))
            apart_m = self._least_m(own, flown, other, neighbour, vertical_m)
            if apart_m < self.min_m:
                return f"it would come within {apart_m:.0f} m of {name}"
            if neighbour is not None and neighbour.present is not None:
                ending = neighbour.coming or neighbour.present
                if circles_apart_m(plan.circle, ending.circle) - 2.0 * _LINE_ERROR_M < flat_m:
                    return f"its circle is too near to that of {name}, at almost the same height"
        return None

    @property
    def has_fleet(self) -> bool:
        """Whether aircraft of the own fleet are near: their layers keep them apart."""
        return any(other.ours for other in self._others.values())

    @property
    def traffic(self) -> tuple[Neighbour, ...]:
        """The foreign aircraft."""
        return tuple(other for other in self._others.values() if not other.ours)

    def encounters(self, flown: Flown, coming: Plan | None) -> list[Encounter]:
        """Return the closest approach of each foreign aircraft to keep clear of; nothing of ``flown`` is None."""
        assert flown.aircraft is not None
        now_s = flown.aircraft.time_s
        others = [
            one
            for one in self._others.values()
            if one.clear_m != (0.0, 0.0) and now_s - one.state.time_s < _REPORT_MAX_AGE_S
        ]
        if not others:
            return []
        own = _own_places(flown, coming, PREDICTED_S)
        heights_m = _heights_m(flown, coming, own.shape[1])
        return [_closest(own, heights_m, now_s, one) for one in others]

    def crossed(self, present: Plan, height_m: float) -> str | None:
        """Return in words which lower aircraft of the fleet flies a circle that crosses the own one, or None.

        The higher aircraft gives way: an aircraft has sunk out of its layer or climbed into the own one.
        """
        for name, other in self._others.items():
            neighbour, vertical_m = self._plans.get(name), height_m - other.height_m
            if not other.ours or other.role is Role.LEAVE or not 0.0 <= vertical_m < self.min_m:
                continue
            if neighbour is None or neighbour.present is None:
                continue
            ending = neighbour.coming or neighbour.present
            if math.hypot(circles_apart_m(present.circle, ending.circle), vertical_m) < self.min_m:
                return f"{name} is only {vertical_m:.0f} m below, and the circles cross"
        return None

    def _least_m(
        self, own: FloatArray, flown: Flown, other: Neighbour, neighbour: NeighbourPlanned | None, vertical_m: float
    ) -> float:
        assert flown.aircraft is not None
        state = other.state
        lag_s = flown.aircraft.time_s - state.time_s
        n = own.shape[1]
        if neighbour is None or neighbour.present is None:
            n = min(n, 1 + int(_FOREIGN_S / _STEP_S))
            gone_m = state.ground_speed_m_s * (lag_s + _STEP_S * np.arange(n))
            sin_c, cos_c = math.sin(state.course_rad), math.cos(state.course_rad)
            theirs = np.stack((state.east_m + gone_m * sin_c, state.north_m + gone_m * cos_c))
        else:
            speed_m_s = airspeed_of(state, flown.wind)
            late = max(0, round(lag_s / _STEP_S))  # their places are counted from their own report
            plans = neighbour.present, neighbour.coming
            theirs = flown_places(state, *plans, flown.wind, speed_m_s, _STEP_S, n + late)[:, late:]
        growth_m_s = _SPEED_ERROR * (flown.airspeed_m_s + state.ground_speed_m_s)
        ours, theirs = np.ascontiguousarray(own[:, :n]), np.ascontiguousarray(theirs)
        return kernel.min_distance_m(ours, theirs, _STEP_S, vertical_m, growth_m_s) - _LINE_ERROR_M


def closest_of(encounters: list[Encounter]) -> Encounter | None:
    """Return the encounter that comes closest to what has to be kept; None without any."""
    return min(encounters, key=lambda one: one.share, default=None)


def _closest(own: FloatArray, heights_m: FloatArray, now_s: float, other: Neighbour) -> Encounter:
    """Return the closest approach of one aircraft to own places, which are _STEP_S apart from ``now_s`` on.

    heights_m: least and greatest own heights at these places.
    """
    state = other.state
    ahead_s = now_s - state.time_s + _STEP_S * np.arange(own.shape[1])
    turned_rad = state.curvature_per_m * state.ground_speed_m_s * ahead_s
    # The chord of an arc, and its direction.
    gone_m = state.ground_speed_m_s * ahead_s * np.sinc(0.5 * turned_rad / math.pi)
    along_rad = state.course_rad + 0.5 * turned_rad
    east_m, north_m = state.east_m + gone_m * np.sin(along_rad), state.north_m + gone_m * np.cos(along_rad)
    flat_m, their_m = np.hypot(own[0] - east_m, own[1] - north_m), other.height_m + other.climb_m_s * ahead_s
    vertical_m = np.maximum(np.maximum(heights_m[0] - their_m, their_m - heights_m[1]), 0.0)
    shares = np.maximum(flat_m / other.clear_m[0], vertical_m / other.clear_m[1])
    k = int(shares.argmin())
    return Encounter(other, _STEP_S * k, *(float(row[k]) for row in (flat_m, their_m, vertical_m, shares)))


def _own_places(flown: Flown, coming: Plan | None, duration_s: float) -> FloatArray:
    """Return own places (east, north, course) (3, n) every _STEP_S from now on."""
    assert flown.aircraft is not None
    assert flown.present is not None
    count = 1 + round(duration_s / _STEP_S)
    return flown_places(flown.aircraft, flown.present, coming, flown.wind, flown.airspeed_m_s, _STEP_S, count)


def _heights_m(flown: Flown, coming: Plan | None, count: int) -> FloatArray:
    """Return the least and greatest own heights above home every _STEP_S, towards that of the plan flown by then.

    An autopilot may change its height as fast as it can, or as slowly as the plan.
    """
    rows = []
    assert flown.aircraft is not None
    assert flown.height_m is not None
    for share in (1.0, 1.0 / RATE_RESERVE):
        at_m, row = flown.height_m, []
        for k in range(count):
            row.append(at_m)
            departed = coming is not None and flown.aircraft.time_s + _STEP_S * k >= coming.departure_s
            plan = coming if departed else flown.present
            if plan is not None and plan.heights is not None:
                step_m = share * plan.heights.slope * flown.airspeed_m_s * _STEP_S
                at_m += min(max(plan.heights.to_m - at_m, -step_m), step_m)
        rows.append(row)
    return np.sort(np.array(rows), axis=0)


def flown_places(
    state: AircraftState,
    present: Plan,
    coming: Plan | None,
    wind: Wind,
    airspeed_m_s: float,
    step_s: float,
    count: int,
) -> FloatArray:
    """Return (east, north, course) (3, count) every step_s from a state on: along its plans, at an airspeed."""
    found = np.empty((3, count))
    kernel.flown_places(
        (state.time_s, state.east_m, state.north_m, state.course_rad),
        *line_of(present),
        *line_of(coming or present),
        math.inf if coming is None else coming.departure_s,
        kernel.Air(max(airspeed_m_s, 1.01 * wind.speed_m_s), wind.east_m_s, wind.north_m_s),
        step_s,
        found,
    )
    return found


def airspeed_of(state: AircraftState, wind: Wind) -> float:
    """Return the airspeed of an aircraft with this ground speed in this wind."""
    east_m_s = state.ground_speed_m_s * math.sin(state.course_rad) - wind.east_m_s
    north_m_s = state.ground_speed_m_s * math.cos(state.course_rad) - wind.north_m_s
    return math.hypot(east_m_s, north_m_s)


def _heights_of(*plans: Plan | None) -> set[float]:
    profiles = [plan.heights for plan in plans if plan is not None and plan.heights is not None]
    return {height_m for profile in profiles for height_m in (profile.from_m, profile.to_m)}


def _gap_m(a: set[float], b: set[float]) -> float:
    """Return the least distance between two ranges of heights; 0 where they overlap."""
    return max(min(a) - max(b), min(b) - max(a), 0.0)


def circles_apart_m(a: Circle, b: Circle) -> float:
    """Return the least distance between points of two circles, m; 0 where they cross."""
    centres_m = math.hypot(a.east_m - b.east_m, a.north_m - b.north_m)
    return max(centres_m - a.radius_m - b.radius_m, abs(a.radius_m - b.radius_m) - centres_m, 0.0)
