"""The inner loops of :mod:`sidelong.mission.predictive.cost`, and looking up in a value table."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled, inlined
from sidelong.mission.core.path import FloatArray

Float32 = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]


# The border of where the gimbal can look is blurred over this difference of cosines: 10 degrees at 120 degrees. From
# the limit on, the further cost rises over the other difference: up to 143 degrees.
_BLIND_BLUR, _LOST_BLUR = 0.15, 0.3


class CostTerms(NamedTuple):
    """The numbers of :class:`sidelong.mission.predictive.cost.WatchCost`."""

    near_m: float
    far_m: float
    cos_half_width: float
    outside: float
    outside_per_m: float
    wall_width_m: float
    wall: float
    cos_pan_limit: float
    blind: float
    lost: float


class Table(NamedTuple):
    """A value table: arrays (classes, headings, n, n)."""

    values: Float32
    after_turn: Float32
    cell_m: float
    discount_per_s: float
    mean_leg_s: float


@compiled
def fading_per_s(table: Table) -> float:
    """Return the rate at which what is to be paid later fades: it is discounted, and the target may turn before."""
    return table.discount_per_s + 1.0 / table.mean_leg_s


@inlined
def cost_rate(x_m: float, y_m: float, widened_m: float, blur_m: float, c: CostTerms) -> float:
    """See :meth:`sidelong.mission.predictive.cost.WatchCost.rate`."""
    range_m = math.sqrt(x_m * x_m + y_m * y_m)
    off = 0.5 + 0.5 * (x_m + c.cos_half_width * range_m) / blur_m
    off = 0.0 if off < 0.0 else off
    off = 1.0 if off > 1.0 else off
    quarter_m = 0.25 * (c.far_m - c.near_m)
    widened_m = widened_m if widened_m < quarter_m else quarter_m
    above_m, below_m = range_m - (c.near_m + widened_m), (c.far_m - widened_m) - range_m
    inside_m = above_m if above_m < below_m else below_m
    near_wall = 1.0 - inside_m / c.wall_width_m
    near_wall = 0.0 if near_wall < 0.0 else near_wall
    near_wall = 1.0 if near_wall > 1.0 else near_wall
    beyond = c.outside - c.wall - c.outside_per_m * inside_m
    return off + c.wall * near_wall * near_wall + (beyond if inside_m < 0.0 else 0.0)


@inlined
def blind_rate(x_m: float, y_m: float, nose_rad: float, c: CostTerms) -> float:
    """Return the cost per second where the nose points so that the gimbal cannot look at the target."""
    range_m = math.sqrt(x_m * x_m + y_m * y_m)
    ahead_m = -(x_m * math.sin(nose_rad) + y_m * math.cos(nose_rad))
    beyond = (c.cos_pan_limit * range_m - ahead_m) / (range_m + 1.0)
    share, far = 0.5 + beyond / _BLIND_BLUR, beyond / _LOST_BLUR
    share = 0.0 if share < 0.0 else share
    far = 0.0 if far < 0.0 else far
    return c.blind * (1.0 if share > 1.0 else share) + c.lost * (1.0 if far > 1.0 else far)


@compiled
def blind_rates(axis_m: FloatArray, nose_rad: float, c: CostTerms, found: FloatArray) -> None:
    """Fill in the rate (n, n) at all places of a square, whose sides have the places axis_m (n,)."""
    for i in range(len(axis_m)):
        for j in range(len(axis_m)):
            found[i, j] = blind_rate(axis_m[i], axis_m[j], nose_rad, c)


@compiled
def cost_rates(
    x_m: FloatArray, y_m: FloatArray, widened_m: FloatArray, blur_m: FloatArray, c: CostTerms, found: FloatArray
) -> None:
    """Fill in the rate at places (n,)."""
    for i in range(len(x_m)):
        found[i] = cost_rate(x_m[i], y_m[i], widened_m[i], blur_m[i], c)


@inlined
def table_value(
    values: Float32,
    cell_m: float,
    x_m: float,
    y_m: float,
    heading_rad: float,
    classes: IntArray,
    share: FloatArray,
    one: int,
    k: int,
) -> float:
    """Return what the classes[one, k] (4,) say together at a place; beyond the grid as on its edge."""
    _, headings, n, _ = values.shape
    x = min(max(x_m / cell_m + 0.5 * (n - 1), 0.0), n - 1.001)
    y = min(max(y_m / cell_m + 0.5 * (n - 1), 0.0), n - 1.001)
    heading = heading_rad * (headings / math.tau)
    heading -= headings * math.floor(heading / headings)
    i, j, near = int(x), int(y), int(heading)
    across, along, turn = x - i, y - j, heading - near
    near = near if near < headings else near - headings
    far = near + 1 if near + 1 < headings else 0
    total = 0.0
    for c in range(4):
        weight = share[one, k, c]
        if weight > 0.0:
            v = classes[one, k, c]
            low = values[v, near, i, j] + along * (values[v, near, i, j + 1] - values[v, near, i, j])
            high = values[v, near, i + 1, j] + along * (values[v, near, i + 1, j + 1] - values[v, near, i + 1, j])
            here = low + across * (high - low)
            low = values[v, far, i, j] + along * (values[v, far, i, j + 1] - values[v, far, i, j])
            high = values[v, far, i + 1, j] + along * (values[v, far, i + 1, j + 1] - values[v, far, i + 1, j])
            total += weight * (here + turn * (low + across * (high - low) - here))
    return float(total)


@compiled
def least(costs: FloatArray) -> float:
    """Return the smallest of costs (n,), infinity of none. numba's own ``min`` has scipy loaded at each start."""
    smallest = np.inf
    for cost in costs:
        smallest = min(smallest, cost)
    return smallest
