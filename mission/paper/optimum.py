"""The best threshold and the best airspeed: the paper's future work, from its closed forms.

For a target that drives straight on at up to its top speed, still air, and decisions once a lap:

- a threshold C of at least C_least leaves room for every move that is wanted (46-47);
- a threshold of at most C_greatest keeps the range within Dmax, from the last lap before the longest move d_max to
  its end. The paper bounds the range at A only; from there on the aircraft still flies away from the target.

Between the two, the best C leaves as many metres at one end as at the other. A target slower than its top speed
asks for longer moves, with less travel on the way: the bounds hold for it too.

Source: Liao et al., Defence Technology 16(4), 2020, equations 43-55.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.feasibility import fits_band
from sidelong.mission.core.requirement import GRAVITY_M_S2, Aircraft, Requirement
from sidelong.mission.geometry.root import root
from sidelong.mission.geometry.transition import abcd, min_move_m
from sidelong.mission.paper.placement import stand_off_m
from sidelong.mission.paper.scope import scope

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
    """The airspeed, with the circle it flies, at which the best threshold leaves the most room.

    target_speed_max_m_s is the fastest straight target for which a threshold exists there.
    """

    airspeed_m_s: float
    radius_m: float
    bounds: ThresholdBounds
    target_speed_max_m_s: float


def max_range_m(aircraft: Aircraft, requirement: Requirement, psi_c_rad: float = math.pi / 2) -> float:
    """Return the greatest range around the longest move d_max: in the lap before it and on the way.

    A move too short for ABCD counts as the shortest that exists.

    Args:
        aircraft: Limits of the aircraft.
        requirement: Required band and side.
        psi_c_rad: Turn of each transition end, psi_c, rad.
    """
    speed_m_s, target_m_s, radius_m = aircraft.airspeed_m_s, requirement.target_speed_max_m_s, aircraft.radius_m
    move_m = max(scope(aircraft, requirement, psi_c_rad).longest_move_m, min_move_m(radius_m, psi_c_rad))
    cross_track_m = stand_off_m(aircraft, requirement)
    circle = Circle(0.0, 0.0, radius_m, True)
    path = abcd(circle, Circle(move_m, 0.0, radius_m, True), psi_c_rad)

    on_path = np.hypot(path.east_m - move_m - target_m_s * path.arc_m / speed_m_s, path.north_m + cross_track_m)
    before_rad = np.linspace(0.0, 2.0 * math.pi, _LAP_STEPS)  # turn still to go until A
    course_rad = path.course_rad[0] - before_rad
    behind_m = target_m_s * before_rad * radius_m / speed_m_s
    on_lap = np.hypot(
        -radius_m * np.cos(course_rad) - (move_m - behind_m), radius_m * np.sin(course_rad) + cross_track_m
    )
    return float(max(on_path.max(), on_lap.max()))


def threshold_bounds(
    aircraft: Aircraft, requirement: Requirement, psi_c_rad: float = math.pi / 2
) -> ThresholdBounds | None:
    """Return which thresholds C work for this aircraft, and the best; None where none does.

    Args:
        aircraft: Limits of the aircraft.
        requirement: Required band and side.
        psi_c_rad: Turn of each transition end, psi_c, rad.
    """
    if not fits_band(aircraft, requirement) or requirement.target_speed_max_m_s >= aircraft.airspeed_m_s:
        return None

    def headroom_m(threshold: float) -> float:
        tried = replace(requirement, threshold=threshold)
        return requirement.range_max_m - max_range_m(aircraft, tried, psi_c_rad)

    def spare_m(threshold: float) -> float:
        return scope(aircraft, replace(requirement, threshold=threshold), psi_c_rad).straight_left_m

    least = max(scope(aircraft, requirement, psi_c_rad).min_threshold, _in_time(aircraft, requirement, psi_c_rad))
    if least >= _THRESHOLD_END or headroom_m(least) < 0.0:
        return None
    greatest = root(headroom_m, least, _THRESHOLD_END)
    best = least
    if spare_m(least) < headroom_m(least):
        best = root(lambda threshold: spare_m(threshold) - headroom_m(threshold), least, greatest)
    room_m = min(spare_m(best), headroom_m(best))
    return ThresholdBounds(least, greatest, best, room_m, requirement.range_max_m - headroom_m(best))


def optimise(
    aircraft: Aircraft,
    requirement: Requirement,
    airspeed_range_m_s: tuple[float, float],
    psi_c_rad: float = math.pi / 2,
) -> Optimum | None:
    """Return the best airspeed in a range, flying the aircraft's circle or the tightest its bank allows there.

    Faster means shorter laps, until the bank limit widens the circle: the best speed is where the circle takes all
    of the bank, sqrt(R g tan bank), or the end of the range. None where no speed has a threshold.

    Args:
        aircraft: Limits of the aircraft.
        requirement: Required band and side.
        airspeed_range_m_s: Least and greatest airspeed, m/s.
        psi_c_rad: Turn of each transition end, psi_c, rad.
    """
    best: Optimum | None = None
    limit_m_s = math.sqrt(aircraft.radius_m * GRAVITY_M_S2 * math.tan(aircraft.bank_max_rad))
    speeds_m_s = np.append(np.linspace(*airspeed_range_m_s, _AIRSPEED_STEPS), np.clip(limit_m_s, *airspeed_range_m_s))
    for airspeed_m_s in np.sort(speeds_m_s):
        flown = replace(aircraft, airspeed_m_s=float(airspeed_m_s))
        flown = replace(flown, radius_m=max(aircraft.radius_m, flown.min_radius_m))
        bounds = threshold_bounds(flown, requirement, psi_c_rad)
        if bounds is not None and (best is None or bounds.room_m > best.bounds.room_m):
            best = Optimum(flown.airspeed_m_s, flown.radius_m, bounds, math.nan)
    if best is None:
        return None
    flown = replace(aircraft, airspeed_m_s=best.airspeed_m_s, radius_m=best.radius_m)
    return replace(best, target_speed_max_m_s=fastest_target_m_s(flown, requirement, psi_c_rad))


def fastest_target_m_s(aircraft: Aircraft, requirement: Requirement, psi_c_rad: float = math.pi / 2) -> float:
    """Return the top speed of a straight target up to which a threshold exists, by bisection; 0 if none does.

    Args:
        aircraft: Limits of the aircraft.
        requirement: Required band and side.
        psi_c_rad: Turn of each transition end, psi_c, rad.
    """
    low_m_s, high_m_s = 0.0, aircraft.airspeed_m_s
    while high_m_s - low_m_s > 1e-3:
        middle_m_s = (low_m_s + high_m_s) / 2.0
        tried = replace(requirement, target_speed_max_m_s=middle_m_s)
        if threshold_bounds(aircraft, tried, psi_c_rad) is None:
            high_m_s = middle_m_s
        else:
            low_m_s = middle_m_s
    return low_m_s


def _in_time(aircraft: Aircraft, requirement: Requirement, psi_c_rad: float) -> float:
    """Return the least C with which the aircraft is at A again before the target is d_max ahead once more."""

    def early_m(threshold: float) -> float:
        tried = replace(requirement, threshold=threshold)
        move_m = max(scope(aircraft, tried, psi_c_rad).longest_move_m, min_move_m(aircraft.radius_m, psi_c_rad))
        radius_m = aircraft.radius_m
        path = abcd(Circle(0.0, 0.0, radius_m, True), Circle(move_m, 0.0, radius_m, True), psi_c_rad)
        flown_m = path.length_m + 2.0 * (math.pi - psi_c_rad) * radius_m
        return move_m - requirement.target_speed_max_m_s * flown_m / aircraft.airspeed_m_s

    if early_m(0.0) >= 0.0:
        return 0.0
    if early_m(_THRESHOLD_END) <= 0.0:
        return math.inf
    return root(early_m, 0.0, _THRESHOLD_END)
