"""Which aircraft goes to which target."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment


def spread_over(
    targets: Sequence[str], way_s: Sequence[Sequence[float]], at: Sequence[str], gain_s: float
) -> list[str]:
    """Return the target of each aircraft: as evenly as can be, and with the least time on the way for all together.

    way_s: of each aircraft to each target; at: where each is, '' or another name for none of these. While that is
    even already, it is changed only where all together gain ``gain_s``.
    """
    slots = [k % len(targets) for k in range(len(way_s))]
    to_s = np.array([[own[k] for k in slots] for own in way_s])
    rows, columns = linear_sum_assignment(to_s)
    if sorted(at) == sorted(targets[k] for k in slots):
        present_s = sum(own[targets.index(name)] for own, name in zip(way_s, at, strict=True))
        if present_s - float(to_s[rows, columns].sum()) < gain_s:
            return list(at)
    return [targets[slots[column]] for column in columns.tolist()]
