"""What the ground hides along the lines of the roll-out.

About each place where the target will be stands a raster of heights: from there and higher it is seen. A place hidden
costs as much as some seconds off side; the circle at a line's end counts for a lap, because the value table knows
nothing of the ground.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sidelong.estimators.compiled import compiled
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.sight import Sight
from sidelong.mission.predictive.rollout_kernel import Lines, Pose, add_up, placed

_LAP_SAMPLES = 16


class View(NamedTuple):
    """How the frame of the lines lies in the plane, and how the target moves in it."""

    course_rad: float
    mirror: float
    velocity_x_m_s: float
    velocity_y_m_s: float


@compiled
def hidden_rate(s: Sight, v: View, x_m: float, y_m: float, time_s: float) -> float:
    """Return the cost per second at a place of the frame."""
    targets, azimuths, rings = s.needed_m.shape
    off_x_m, off_y_m = x_m - v.velocity_x_m_s * time_s, y_m - v.velocity_y_m_s * time_s
    target = min(int(time_s / s.step_s + 0.5), targets - 1)
    azimuth = (math.atan2(v.mirror * off_x_m, off_y_m) + v.course_rad) * (azimuths / math.tau) + 0.5
    azimuth -= azimuths * math.floor(azimuth / azimuths)
    ring = math.sqrt(off_x_m * off_x_m + off_y_m * off_y_m) / s.ring_m - 0.5
    ring = min(max(ring, 0.0), rings - 1.0)
    above_m = s.height_m - s.needed_m[target, min(int(azimuth), azimuths - 1), int(ring)]
    share = 0.5 - 0.5 * above_m / s.soft_m
    return float(s.weight * min(max(share, 0.0), 1.0))


@compiled
def _lap_cost(
    s: Sight,
    v: View,
    x_m: float,
    y_m: float,
    heading_rad: float,
    time_s: float,
    weight: float,
    radius_m: float,
    lap_s: float,
    rate_per_s: float,
) -> float:
    """Return the cost of the clockwise circle from a place on it, for a lap."""
    centre_x_m, centre_y_m = x_m + radius_m * math.cos(heading_rad), y_m - radius_m * math.sin(heading_rad)
    step_s = lap_s / _LAP_SAMPLES
    total = 0.0
    for k in range(_LAP_SAMPLES):
        since_s = (k + 0.5) * step_s
        turned_rad = heading_rad + math.tau * since_s / lap_s
        on_x_m = centre_x_m - radius_m * math.cos(turned_rad)
        on_y_m = centre_y_m + radius_m * math.sin(turned_rad)
        discount = math.exp(-rate_per_s * since_s)
        total += hidden_rate(s, v, on_x_m, on_y_m, time_s + since_s) * discount * step_s
    return weight * total


@compiled
def add_sight(
    lines: Lines,
    start: Pose,
    s: Sight,
    v: View,
    radius_m: float,
    lap_s: float,
    rate_per_s: float,
    costs: FloatArray,
) -> None:
    """Add to the cost (lines,) of each line from a start what is hidden along it and on the circle after it."""
    if s.needed_m.shape[0] == 0:
        return
    x, y = placed(lines, start)
    rates, ends = np.empty(len(x)), np.empty(len(lines.trunk))
    for k in range(len(x)):
        rates[k] = hidden_rate(s, v, x[k], y[k], lines.time_s[k]) * lines.weight[k]
    for i in range(len(ends)):
        last = lines.own_first[i + 1] - 1
        ends[i] = _lap_cost(
            s,
            v,
            x[last],
            y[last],
            start.heading_rad + lines.turned_rad[last],
            lines.time_s[last],
            lines.weight[last],
            radius_m,
            lap_s,
            rate_per_s,
        )
    add_up(lines, rates, np.zeros(len(x)), ends, 1.0, costs)
