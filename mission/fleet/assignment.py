"""Which aircraft goes to which target.

Source: linear assignment, Crouse, "On implementing 2D rectangular assignment algorithms", IEEE Transactions on
Aerospace and Electronic Systems 52(4), 2016; docs/how-to/several-aircraft.md.
"""

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
    """Return the assignment of the aircraft to the targets that costs least among the even ones.

    Each target has a position on its required side, then one opposite, and so on in turn.

    Args:
        targets: Names of the targets.
        costs: Costs of each aircraft (rows) at each target (columns), finite.
        at: The present target of each aircraft; any other name if it has none.
        change_s: Price of each change of target, in seconds off the required side.

    Returns:
        The target of each aircraft, and the gain over the present assignment in seconds off the required side. The
        gain is infinite if the aircraft are spread unevenly now, or one has no target.
    """
    each, odd = divmod(len(costs), len(targets))
    places = [(k, row) for k in range(len(targets)) for row in range(each + (odd > 0))]
    # Every target gets its even share first; the remaining aircraft go where they cost least.
    share_s = np.where([row < each for _, row in places], _SHARE_S, 0.0)
    elsewhere = np.array([[targets[k] != name for k, _ in places] for name in at])
    alongside_s = [[own[k].opposite_s if row % 2 else own[k].wanted_s for k, row in places] for own in costs]
    to_s = alongside_s - share_s + change_s * elsewhere
    best, best_s = _cheapest(to_s)
    _, stay_s = _cheapest(to_s + _ELSEWHERE_S * elsewhere)
    gained_s = stay_s - best_s
    return [targets[places[column][0]] for column in best], math.inf if gained_s > 0.5 * _SHARE_S else gained_s


def _cheapest(to_s: FloatArray) -> tuple[list[int], float]:
    """Return the place of each aircraft, and what all cost together."""
    rows, columns = linear_sum_assignment(to_s)
    return columns.tolist(), float(to_s[rows, columns].sum())
