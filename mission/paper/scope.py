"""How far the circle has to move when the target drives straight on.

All of it is for a target that moves straight at its top speed, still air, and an aircraft that decides once a lap::

      A---.                 A is flown with the target v_t t behind x = 0 ... d_max ahead of it; the lap after which
      O1   |  D             the range would pass C Dmax is not flown, so the move d lies in [d_min, d_max].
      -----+-----> target

Source: Liao et al., Defence Technology 16(4), 2020, equations 43-55.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.feasibility import Change, fits_band, unflyable
from sidelong.mission.core.path import Path
from sidelong.mission.core.requirement import GRAVITY_M_S2, Aircraft, Requirement
from sidelong.mission.paper.planner import stand_off_m
from sidelong.mission.paper.transition import abcd, min_move_m, root, transition_length_m

_THRESHOLD_MAX = 1.0  # beyond, the aircraft would leave the band by design


def infeasible(aircraft: Aircraft, requirement: Requirement, psi_c_rad: float = math.pi / 2) -> tuple[Change, ...]:
    """Check that the circle can be flown, fits the band (19), and can always be moved in time (46-47).

    Returns:
        The changes that would help, none if it is feasible. Each cures its own cause alone; where two causes are
        named, one change of each is needed.
    """
    return (*unflyable(aircraft, requirement), *_moves_too_short(aircraft, requirement, psi_c_rad))


def _moves_too_short(aircraft: Aircraft, requirement: Requirement, psi_c_rad: float) -> Iterator[Change]:
    of = scope(aircraft, requirement, psi_c_rad)
    if of.straight_left_m >= 0.0:
        return
    needed = f"the transition needs {of.shortest_move_m - of.straight_left_m:.0f} m"
    because = (
        f"a move of {of.shortest_move_m:.0f} m would be wanted, but {needed}"
        if of.shortest_move_m > 0.0
        else f"the band leaves no room for a move, and {needed}"
    )

    def straight_left_m(tried: float, field: str) -> float:
        return scope(*_changed(aircraft, requirement, field, tried), psi_c_rad).straight_left_m

    if of.min_threshold <= _THRESHOLD_MAX:
        yield Change("threshold", requirement.threshold, of.min_threshold, because)
    yield Change(
        "range_max_m",
        requirement.range_max_m,
        of.min_threshold * requirement.range_max_m / requirement.threshold,
        because,
    )
    for field, value, ends in (
        ("target_speed_max_m_s", requirement.target_speed_max_m_s, (0.0, requirement.target_speed_max_m_s)),
        ("range_min_m", requirement.range_min_m, (0.0, requirement.range_min_m)),
        ("airspeed_m_s", aircraft.airspeed_m_s, (aircraft.airspeed_m_s, 10.0 * aircraft.airspeed_m_s)),
        ("radius_m", aircraft.radius_m, (min(aircraft.min_radius_m, aircraft.radius_m), aircraft.radius_m)),
    ):
        if straight_left_m(ends[0], field) * straight_left_m(ends[1], field) > 0.0:
            continue
        nearest = root(partial(straight_left_m, field=field), *ends)
        flown, _ = _changed(aircraft, requirement, field, nearest)
        if nearest > 0.0 and flown.radius_m >= flown.min_radius_m * (1.0 - 1e-9):
            yield Change(field, value, nearest, because)


def _changed(aircraft: Aircraft, requirement: Requirement, field: str, value: float) -> tuple[Aircraft, Requirement]:
    if hasattr(aircraft, field):
        return replace(aircraft, **{field: value}), requirement
    return aircraft, replace(requirement, **{field: value})  # type: ignore[arg-type]  # a field that is a number


@dataclass(frozen=True, slots=True)
class Scope:
    """The distances and times of one requirement.

    x_tr_m            length of AB along the move.
    shortest_move_m   d_min; negative when the circle would have to move before the target has.
    longest_move_m    d_max, one lap of the target more.
    shortest_time_s   t_y,min, the least time between two moves; inf for a standing target.
    straight_left_m   what the shortest move leaves beyond both bends; negative when they do not fit.
    min_threshold     the least C for which they always fit.
    """

    x_tr_m: float
    shortest_move_m: float
    longest_move_m: float
    shortest_time_s: float
    straight_left_m: float
    min_threshold: float


def scope(aircraft: Aircraft, requirement: Requirement, psi_c_rad: float = math.pi / 2) -> Scope:
    """Return the scope of the once-a-lap method.

    The range at A is taken from A itself, D + R cos psi_c across the target's line; the paper's psi_c = pi/2 makes
    the second term zero. A threshold below D counts as D: the circle would have to move at once.
    """
    lap_travel_m = requirement.target_speed_max_m_s * aircraft.lap_s
    ahead_m = aircraft.radius_m * math.sin(psi_c_rad)  # A lags the centre by this much
    cross_track_m = stand_off_m(aircraft, requirement) + aircraft.radius_m * math.cos(psi_c_rad)
    limit_m = requirement.threshold * requirement.range_max_m
    min_m = min_move_m(aircraft.radius_m, psi_c_rad)

    shortest_m = math.sqrt(max(limit_m**2 - cross_track_m**2, 0.0)) - ahead_m - lap_travel_m
    return Scope(
        x_tr_m=transition_length_m(aircraft.radius_m, psi_c_rad),
        shortest_move_m=shortest_m,
        longest_move_m=shortest_m + lap_travel_m,
        shortest_time_s=(
            shortest_m / requirement.target_speed_max_m_s if requirement.target_speed_max_m_s > 0.0 else math.inf
        ),
        straight_left_m=shortest_m - min_m,
        min_threshold=math.hypot(min_m + ahead_m + lap_travel_m, cross_track_m) / requirement.range_max_m,
    )


def min_psi_c_rad(aircraft: Aircraft) -> float:
    """Return the least psi_c, at most pi/2: the roll begins at v^3 / (g R^2 psi_c), and the aircraft's is limited."""
    rolling_m_s3 = GRAVITY_M_S2 * aircraft.radius_m**2 * aircraft.roll_rate_max_rad_s
    return min(aircraft.airspeed_m_s**3 / rolling_m_s3, math.pi / 2)


def largest_psi_c_rad(aircraft: Aircraft, requirement: Requirement) -> float:
    """Return the paper's psi_c = pi/2 where the requirement is feasible with it, else the largest that is.

    A smaller one shortens the transition. Where none is feasible, the least one comes nearest.
    """

    def straight_left_m(psi_c_rad: float) -> float:
        return scope(aircraft, requirement, psi_c_rad).straight_left_m

    min_rad = min_psi_c_rad(aircraft)
    if straight_left_m(math.pi / 2) >= 0.0:
        return math.pi / 2
    if straight_left_m(min_rad) <= 0.0:
        return min_rad
    return root(straight_left_m, min_rad, math.pi / 2)


_THRESHOLD_END = 2.0
_AIRSPEED_STEPS = 60
_LAP_STEPS = 90


@dataclass(frozen=True, slots=True)
class ThresholdBounds:
    """Every C in [least, greatest] keeps its promises; best leaves ``room_m`` at both ends.

    max_range_m is the proven bound at the best C.
    """

    least: float
    greatest: float
    best: float
    room_m: float
    max_range_m: float


@dataclass(frozen=True, slots=True)
class Optimum:
    """The aircraft, at the airspeed and on the circle at which the best threshold leaves the most room.

    target_speed_max_m_s is the fastest straight target for which a threshold exists there.
    """

    aircraft: Aircraft
    bounds: ThresholdBounds
    target_speed_max_m_s: float


def _longest_move(aircraft: Aircraft, requirement: Requirement) -> tuple[float, Path]:
    """Return d_max and the way there; a move too short for ABCD counts as the shortest that exists."""
    radius_m, psi_c_rad = aircraft.radius_m, math.pi / 2
    move_m = max(scope(aircraft, requirement, psi_c_rad).longest_move_m, min_move_m(radius_m, psi_c_rad))
    return move_m, abcd(Circle(0.0, 0.0, radius_m, True), Circle(move_m, 0.0, radius_m, True), psi_c_rad)


def max_range_m(aircraft: Aircraft, requirement: Requirement) -> float:
    """Return the greatest range around the longest move d_max: in the lap before it and on the way."""
    speed_m_s, target_m_s, radius_m = aircraft.airspeed_m_s, requirement.target_speed_max_m_s, aircraft.radius_m
    cross_track_m = stand_off_m(aircraft, requirement)
    move_m, path = _longest_move(aircraft, requirement)
    on_path = np.hypot(path.east_m - move_m - target_m_s * path.arc_m / speed_m_s, path.north_m + cross_track_m)
    before_rad = np.linspace(0.0, 2.0 * math.pi, _LAP_STEPS)  # turn still to go until A
    course_rad = path.course_rad[0] - before_rad
    behind_m = target_m_s * before_rad * radius_m / speed_m_s
    on_lap = np.hypot(
        -radius_m * np.cos(course_rad) - (move_m - behind_m), radius_m * np.sin(course_rad) + cross_track_m
    )
    return float(max(on_path.max(), on_lap.max()))


def threshold_bounds(aircraft: Aircraft, requirement: Requirement) -> ThresholdBounds | None:
    """Return which thresholds C work for this aircraft, and the best; None where none does."""
    if not fits_band(aircraft, requirement) or requirement.target_speed_max_m_s >= aircraft.airspeed_m_s:
        return None

    def headroom_m(threshold: float) -> float:
        return requirement.range_max_m - max_range_m(aircraft, replace(requirement, threshold=threshold))

    def spare_m(threshold: float) -> float:
        return scope(aircraft, replace(requirement, threshold=threshold)).straight_left_m

    least = max(scope(aircraft, requirement).min_threshold, _in_time(aircraft, requirement))
    if least >= _THRESHOLD_END or headroom_m(least) < 0.0:
        return None
    greatest = root(headroom_m, least, _THRESHOLD_END)
    best = least
    if spare_m(least) < headroom_m(least):
        best = root(lambda threshold: spare_m(threshold) - headroom_m(threshold), least, greatest)
    room_m = min(spare_m(best), headroom_m(best))
    return ThresholdBounds(least, greatest, best, room_m, requirement.range_max_m - headroom_m(best))


def optimise(aircraft: Aircraft, requirement: Requirement, airspeed_range_m_s: tuple[float, float]) -> Optimum | None:
    """Return the best airspeed in a range, flying the aircraft's circle or the tightest its bank allows there.

    Faster means shorter laps, until the bank limit widens the circle: the best speed is where the circle takes all
    of the bank, sqrt(R g tan bank), or the end of the range. None where no speed has a threshold.
    """
    best: Optimum | None = None
    limit_m_s = math.sqrt(aircraft.radius_m * GRAVITY_M_S2 * math.tan(aircraft.bank_max_rad))
    speeds_m_s = np.append(np.linspace(*airspeed_range_m_s, _AIRSPEED_STEPS), np.clip(limit_m_s, *airspeed_range_m_s))
    for airspeed_m_s in np.sort(speeds_m_s):
        flown = replace(aircraft, airspeed_m_s=float(airspeed_m_s))
        flown = replace(flown, radius_m=max(aircraft.radius_m, flown.min_radius_m))
        bounds = threshold_bounds(flown, requirement)
        if bounds is not None and (best is None or bounds.room_m > best.bounds.room_m):
            best = Optimum(flown, bounds, math.nan)
    if best is None:
        return None
    return replace(best, target_speed_max_m_s=fastest_target_m_s(best.aircraft, requirement))


def fastest_target_m_s(aircraft: Aircraft, requirement: Requirement) -> float:
    """Return the top speed of a straight target up to which a threshold exists, by bisection; 0 if none does."""
    low_m_s, high_m_s = 0.0, aircraft.airspeed_m_s
    while high_m_s - low_m_s > 1e-3:
        middle_m_s = (low_m_s + high_m_s) / 2.0
        if threshold_bounds(aircraft, replace(requirement, target_speed_max_m_s=middle_m_s)) is None:
            high_m_s = middle_m_s
        else:
            low_m_s = middle_m_s
    return low_m_s


def _in_time(aircraft: Aircraft, requirement: Requirement) -> float:
    """Return the least C with which the aircraft is at A again before the target is d_max ahead once more."""

    def early_m(threshold: float) -> float:
        move_m, path = _longest_move(aircraft, replace(requirement, threshold=threshold))
        flown_m = path.length_m + math.pi * aircraft.radius_m  # from D to A, psi_c = pi/2 each way short of a lap
        return move_m - requirement.target_speed_max_m_s * flown_m / aircraft.airspeed_m_s

    if early_m(0.0) >= 0.0:
        return 0.0
    if early_m(_THRESHOLD_END) <= 0.0:
        return math.inf
    return root(early_m, 0.0, _THRESHOLD_END)
