"""Why the aircraft moves or stays, in plain words. Source: docs/explanation/planners.md#the-predictive-planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import Requirement, Side

_OFF_SIDE_MIN_S = 2.0  # shorter visits to the other side are not worth a word


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """Places to the right of the watch course, ranges, and times since departure along a line: arrays (k,)."""

    x_m: FloatArray
    range_m: FloatArray
    time_s: FloatArray


def describe_breach(seen: Outlook, side: Side, requirement: Requirement, lead_s: float) -> str | None:
    """Return the first breach of the requirement on the line of ``seen``; None when there is none.

    Args:
        seen: What is met along the flown line.
        side: Required side.
        requirement: Required band and side.
        lead_s: Time from now to the outlook's start, s.
    """
    x_m, range_m, time_s = seen.x_m, seen.range_m, seen.time_s
    out = np.flatnonzero((range_m < requirement.range_min_m) | (range_m > requirement.range_max_m))
    off = np.flatnonzero(x_m > 0.0) if requirement.sector is None else np.empty(0, np.intp)
    if off.size and float(time_s[off[-1]] - time_s[off[0]]) < _OFF_SIDE_MIN_S:
        off = off[:0]
    if out.size and (not off.size or out[0] <= off[0]):
        first = out[0]
        extreme_m = range_m.max() if range_m[first] > requirement.range_max_m else range_m.min()
        when_s = float(time_s[np.flatnonzero(range_m == extreme_m)[0]]) + lead_s
        return f"in {when_s:.0f} s the target would be {extreme_m:.0f} m away"
    if off.size:
        when_s = float(time_s[off[0]]) + lead_s
        if when_s < 1.0:
            return f"the aircraft is on the target's {side.opposite}"
        return f"in {when_s:.0f} s the aircraft would be on the target's {side.opposite}"
    return None


def describe_range(seen: Outlook) -> str:
    """Return the ranges met along the line of ``seen``.

    Args:
        seen: What is met along the flown line.
    """
    nearest_m, farthest_m = seen.range_m.min(), seen.range_m.max()
    return f"the target stays {nearest_m:.0f} to {farthest_m:.0f} m away for {seen.time_s[-1]:.0f} s"
