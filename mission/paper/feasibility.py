"""Feasibility of the published method. Source: Liao et al., Defence Technology 16(4), 2020, equations 19, 46-47."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from sidelong.mission.core.feasibility import Change, unflyable
from sidelong.mission.core.requirement import Aircraft, Requirement
from sidelong.mission.geometry.root import root
from sidelong.mission.paper.scope import scope

_THRESHOLD_MAX = 1.0  # beyond, the aircraft would leave the band by design


def infeasible(aircraft: Aircraft, requirement: Requirement, psi_c_rad: float = math.pi / 2) -> tuple[Change, ...]:
    """Check that the circle can be flown, fits the band (19), and can always be moved in time (46-47).

    Returns:
        The changes that would help, none if it is feasible. Each cures its own cause alone; where two causes are
        named, one change of each is needed.

    Args:
        aircraft: Limits of the aircraft.
        requirement: Required band and side.
        psi_c_rad: Turn of each transition end, psi_c, rad.
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
