"""Several aircraft on one circle about a moving target at equal phases, by two laws of the literature.

phased field         the Lyapunov vector field; an aircraft behind its phase flies faster, one ahead of it slower
circular formation   constant speed; an aircraft behind its phase flies a smaller circle, one ahead of it a larger one

For comparison: both watch from all sides in turn, and know no wanted one.

Source: Frew, Lawrence, Morris, "Coordinated standoff tracking of moving targets using Lyapunov guidance vector
fields", Journal of Guidance, Control, and Dynamics 31(2), 2008; Garcia de Marina, Sun, Bronz, Hattenberger, "Circular
formation control of fixed-wing UAVs with constant speeds", IROS 2017, which Paparazzi flies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.laws.course_field import VectorField

# The radius and gain of the laws of one aircraft; the gains of the phase settle it within about a lap.
_RADIUS_M, _GAIN_PER_S = 350.0, 0.25
_SPEED_GAIN_PER_S, _SPEED_SHARE = 0.05, 0.2
_RADIUS_GAIN, _RADIUS_SHARE = 0.3, 0.3


def phased(
    aircraft: Sequence[AircraftState],
    target: TargetEstimate,
    *,
    clockwise: bool,
    airspeed_m_s: float,
    constant_speed: bool,
) -> list[tuple[float, float]]:
    """Return the curvature, 1/m, and the airspeed, m/s, that each aircraft is to fly.

    Args:
        aircraft: State of each.
        target: Estimate of the target.
        clockwise: Sense of flight.
        airspeed_m_s: The middle one; it is changed by a fifth at most.
        constant_speed: The circular formation in place of the phased field.
    """
    found = []
    for state, behind_rad in zip(aircraft, behind(aircraft, target, clockwise), strict=True):
        radius_m, speed_m_s = _RADIUS_M, airspeed_m_s
        if constant_speed:
            radius_m *= 1.0 - min(max(_RADIUS_GAIN * behind_rad, -_RADIUS_SHARE), _RADIUS_SHARE)
        else:
            share = _SPEED_GAIN_PER_S * behind_rad * radius_m / airspeed_m_s
            speed_m_s *= 1.0 + min(max(share, -_SPEED_SHARE), _SPEED_SHARE)
        found.append((VectorField(radius_m, clockwise, _GAIN_PER_S).curvature_per_m(state, target), speed_m_s))
    return found


def behind(aircraft: Sequence[AircraftState], target: TargetEstimate, clockwise: bool) -> list[float]:
    """Return by how much each is behind its place between those before and after it, rad; they keep their order.

    Alone, no aircraft is behind.

    Args:
        aircraft: States of the aircraft.
        target: Estimate of the target.
        clockwise: Sense of flight, as seen from above.
    """
    n, sense = len(aircraft), 1.0 if clockwise else -1.0
    phase_rad = [sense * math.atan2(one.east_m - target.east_m, one.north_m - target.north_m) for one in aircraft]
    order = sorted(range(n), key=lambda k: phase_rad[k] % math.tau)
    found = [0.0] * n
    for place, k in enumerate(order):
        before, after = order[place - 1], order[(place + 1) % n]
        if before != k:
            gap_back_rad = (phase_rad[k] - phase_rad[before]) % math.tau
            gap_ahead_rad = (phase_rad[after] - phase_rad[k]) % math.tau
            found[k] = 0.5 * (gap_ahead_rad - gap_back_rad)
    return found
