"""Which aircraft goes to which target."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from sidelong.mission.core.path import FloatArray
from sidelong.mission.fleet.roles import RoleCosts

_SHARE_S = 1e6  # more than anything costs: that a target has less than its even share
_ELSEWHERE_S = 1e9


def spread_over(
    targets: Sequence[str], costs: Sequence[Sequence[RoleCosts]], at: Sequence[str], change_s: float
) -> tuple[list[str], float]:
    """Return the target of each aircraft, and by how much that is cheaper than as it is, in seconds off the sides.

    As evenly as can be, and with the least cost for all together: each target has a place on its wanted side, then
    one opposite, and so on in turn. costs: of each aircraft beside each target, finite; at: where each is, '' or
    another name for none of these. Each aircraft that changes costs ``change_s`` beside: so none does for less, also
    while others have to. The gain is infinite where the aircraft are spread unevenly, or one is nowhere.
    """
    each, odd = divmod(len(costs), len(targets))
    places = [(k, row) for k in range(len(targets)) for row in range(each + (odd > 0))]
    # Every target has its even share first; who is over goes where it costs least.
    share_s = np.where([row < each for _, row in places], _SHARE_S, 0.0)
    elsewhere = np.array([[targets[k] != name for k, _ in places] for name in at])
    beside_s = [[own[k].opposite_s if row % 2 else own[k].wanted_s for k, row in places] for own in costs]
    to_s = beside_s - share_s + change_s * elsewhere
    best, best_s = _cheapest(to_s)
    _, stay_s = _cheapest(to_s + _ELSEWHERE_S * elsewhere)
    gained_s = stay_s - best_s
    return [targets[places[column][0]] for column in best], math.inf if gained_s > 0.5 * _SHARE_S else gained_s


def _cheapest(to_s: FloatArray) -> tuple[list[int], float]:
    """Return the place of each aircraft, and what all cost together."""
    rows, columns = linear_sum_assignment(to_s)
    return columns.tolist(), float(to_s[rows, columns].sum())
