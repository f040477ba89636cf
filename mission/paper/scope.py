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

from sidelong.mission.core.feasibility import Change, unflyable
from sidelong.mission.core.requirement import GRAVITY_M_S2, Aircraft, Requirement
from sidelong.mission.paper.planner import stand_off_m
from sidelong.mission.paper.transition import min_move_m, root, transition_length_m

_THRESHOLD_MAX = 1.0  # beyond, the aircraft would leave the band by design


def infeasible(aircraft: Aircraft, requirement: Requirement, psi_c_rad: float = math.pi / 2) -> tuple[Change, ...]:
    """Return the changes that would help where the circle cannot be flown, fitted (19) or moved in time (46-47).

    Each cures its own cause alone; where two causes are named, one change of each is needed.
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
    range_max_m = requirement.range_max_m
    yield Change("range_max_m", range_max_m, of.min_threshold * range_max_m / requirement.threshold, because)
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
        return replace(aircraft, **{field: value}), requirement  # type: ignore[arg-type]  # likewise
    return aircraft, replace(requirement, **{field: value})  # type: ignore[arg-type]  # a field that is a number


@dataclass(frozen=True, slots=True)
class Scope:
    """The distances and times of one requirement.

    x_tr_m: length of AB along the move. shortest_move_m: d_min, negative when the circle would have to move before
    the target has; longest_move_m: d_max, one lap of the target more. shortest_time_s: t_y,min between two moves, inf
    for a standing target. straight_left_m: what the shortest move leaves beyond both bends, negative when they do not
    fit; min_threshold: the least C for which they always fit.
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
    limit_m, target_m_s = requirement.threshold * requirement.range_max_m, requirement.target_speed_max_m_s
    min_m = min_move_m(aircraft.radius_m, psi_c_rad)

    shortest_m = math.sqrt(max(limit_m**2 - cross_track_m**2, 0.0)) - ahead_m - lap_travel_m
    return Scope(
        x_tr_m=transition_length_m(aircraft.radius_m, psi_c_rad),
        shortest_move_m=shortest_m,
        longest_move_m=shortest_m + lap_travel_m,
        shortest_time_s=shortest_m / target_m_s if target_m_s > 0.0 else math.inf,
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
