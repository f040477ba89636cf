"""Which aircraft goes to which target."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

_SHARE_S = 1e6  # more than any way


def spread_over(
    targets: Sequence[str], way_s: Sequence[Sequence[float]], at: Sequence[str], gain_s: float
) -> list[str]:
    """Return the target of each aircraft: as evenly as can be, and with the least time on the way for all together.

    way_s: of each aircraft to each target; at: where each is, '' or another name for none of these. While that is
    even already, it is changed only where all together gain ``gain_s``.
    """
    each, odd = divmod(len(way_s), len(targets))
    slots = [k for k in range(len(targets)) for _ in range(each + (odd > 0))]
    to_s = np.array([[own[k] for k in slots] for own in way_s], float)
    # Every target has its even share first; who is over goes where the way is shortest.
    to_s -= np.tile([_SHARE_S] * each + [0.0] * (odd > 0), len(targets))
    _, columns = linear_sum_assignment(to_s)
    best = [targets[slots[column]] for column in columns.tolist()]
    counts = [at.count(name) for name in targets]
    if sum(counts) == len(at) and min(counts) >= each and max(counts) <= each + (odd > 0):
        gained_s = sum(
            own[targets.index(name)] - own[targets.index(other)]
            for own, name, other in zip(way_s, at, best, strict=True)
        )
        if gained_s < gain_s:
            return list(at)
    return best
