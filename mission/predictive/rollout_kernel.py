"""Roll out candidate lines, which share their beginnings, against predicted futures of the target.

Lines are sampled every step_m and at their ends, in the frame of the departure: its origin is where the target is
then, x is to the right of the watch course, y along it.

What lines share is computed once: all moves that hold one curvature follow one trunk until their last ramps begin.
In still air a set of lines depends on the curvature at its start only, of which a flight has few: sets are cached.

About each position that the target will have stands a raster of heights: from there and higher it is in sight. A
hidden position costs as much as some seconds off side; the circle at a line's end counts for a lap, because the
value table knows nothing of the ground.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled, inlined, inner, inner_inlined
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.sight import Sight
from sidelong.mission.geometry.line_kernel import (
    Air,
    Trapezoid,
    moved_m,
    nose_rad,
    speed_m_s,
    trapezoid,
    turned_rad,
    with_last_ramp,
)

Float32 = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]

# The target turns at random, so what it does at a certain moment of the roll-out matters only in the mean: every
# third sample is enough.
TURN_STRIDE = 3
STEP_S = 1.0
_ENDLESS_M = 1e9
# The border of where the gimbal can look is blurred over this difference of cosines: 10 degrees at 120 degrees. From
# the limit on, the further cost rises over the other difference: up to 143 degrees.
_BLIND_BLUR, _LOST_BLUR = 0.15, 0.3


class CostTerms(NamedTuple):
    """The numbers of :class:`sidelong.mission.predictive.value_table.WatchCost`."""

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


@inner
def fading_per_s(table: Table) -> float:
    """Return the rate at which what is to be paid later fades: it is discounted, and the target may turn before."""
    return table.discount_per_s + 1.0 / table.mean_leg_s


@inner_inlined
def cost_rate(x_m: float, y_m: float, widened_m: float, blur_m: float, c: CostTerms) -> float:
    """Return the cost per second at a place of the watch frame: see ``WatchCost.rate`` of the value table."""
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
    """Return the cost per second of a nose direction from which the gimbal cannot look at the target.

    x_m, y_m: the aircraft's place relative to the target, in the frame of nose_rad.
    """
    range_m = math.sqrt(x_m * x_m + y_m * y_m)
    ahead_m = -(x_m * math.sin(nose_rad) + y_m * math.cos(nose_rad))
    beyond = (c.cos_pan_limit * range_m - ahead_m) / (range_m + 1.0)
    share, far = 0.5 + beyond / _BLIND_BLUR, beyond / _LOST_BLUR
    share = 0.0 if share < 0.0 else share
    far = 0.0 if far < 0.0 else far
    return c.blind * (1.0 if share > 1.0 else share) + c.lost * (1.0 if far > 1.0 else far)


@compiled
def blind_rates(axis_m: FloatArray, nose_rad: float, c: CostTerms, found: FloatArray) -> None:
    """Fill in :func:`blind_rate` (n, n) on a square grid around the target, axis_m (n,) along both sides."""
    for i in range(len(axis_m)):
        for j in range(len(axis_m)):
            found[i, j] = blind_rate(axis_m[i], axis_m[j], nose_rad, c)


@compiled
def cost_rates(
    x_m: FloatArray, y_m: FloatArray, widened_m: FloatArray, blur_m: FloatArray, c: CostTerms, found: FloatArray
) -> None:
    """Fill in :func:`cost_rate` at places (n,)."""
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
    """Return the table's value, s, at a place and heading, the classes[one, k] (4,) mixed by their shares.

    Beyond the grid it is that of the edge.
    """
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


@inner
def least(costs: FloatArray) -> float:
    """Return the smallest of costs (n,), infinity of none. numba's own ``min`` has scipy loaded at each start."""
    smallest = np.inf
    for cost in costs:
        smallest = min(smallest, cost)
    return smallest


class Uncertainty(NamedTuple):
    """One standard deviation of the target's place and velocity on the worse axis, and of the watch course."""

    position_m: float
    velocity_m_s: float
    course_rad: float


class Scenarios(NamedTuple):
    """What the target may do: f futures, sampled k times every step_s from the departure on, k >= 1.

    weight (f,) sums to 1. place (f, k, 4): x, y, and the velocity until the next sample (from the last one on).
    facing (f, k, 3): sine and cosine of the watch course in the frame of the departure, and one standard deviation of
    it. course (f, k, 3): sine, cosine and angle of the course that the table's frame follows. classes (f, k, 4): the
    table's classes for the velocities there; share, turn_share (f, k, 4): what each counts in V, and after a turn.
    """

    weight: FloatArray
    step_s: float
    place: FloatArray
    facing: FloatArray
    course: FloatArray
    classes: IntArray
    share: FloatArray
    turn_share: FloatArray


class Pose(NamedTuple):
    """A place of the departure's frame and the heading there."""

    x_m: float
    y_m: float
    heading_rad: float


class Lines(NamedTuple):
    """Lines from one start: samples of all trunks, then the lines' own, arrays (samples,), from the origin along y.

    trunk_first (trunks + 1,), own_first (lines + 1,): where each begins. trunk, on_trunk (lines,): which trunk each
    line follows, and for how many samples. end_m (lines,): where the circle begins.
    """

    x_m: FloatArray
    y_m: FloatArray
    turned_rad: FloatArray
    time_s: FloatArray
    weight: FloatArray
    trunk_first: IntArray
    own_first: IntArray
    trunk: IntArray
    on_trunk: IntArray
    end_m: FloatArray


class Shapes(NamedTuple):
    """Lines that ramp from one curvature to one of holds_per_m (holds,), hold it, and ramp on to a circle.

    hold, lengths_m, last_ramps_per_m2 (lines,): which curvature each line holds, for how far, and the sharpness of
    its last ramp; ramp_per_m2 is that of the first.
    """

    start_per_m: float
    holds_per_m: FloatArray
    hold: IntArray
    lengths_m: FloatArray
    final_per_m: float
    ramp_per_m2: float
    last_ramps_per_m2: FloatArray


class Sampling(NamedTuple):
    """How lines are sampled: STEP_S of flight at the airspeed apart, beyond_m along their circles, from a heading.

    rate_per_s: of the discount in ``Lines.weight``.
    """

    beyond_m: float
    heading_rad: float
    air: Air
    rate_per_s: float


@inner
def _shape(s: Shapes, i: int) -> Trapezoid:
    shape = trapezoid(s.start_per_m, s.holds_per_m[s.hold[i]], s.lengths_m[i], s.final_per_m, s.ramp_per_m2)
    return with_last_ramp(shape, s.last_ramps_per_m2[i])


@inner
def spread(shapes: Shapes, sampling: Sampling) -> Lines:
    """Return lines as samples along the given shapes."""
    hold, holds_per_m = shapes.hold, shapes.holds_per_m
    step_m, beyond_m = sampling.air.airspeed_m_s * STEP_S, sampling.beyond_m
    lines, trunks = len(hold), len(holds_per_m)
    on_trunk, end_m = np.empty(lines, np.int64), np.empty(lines)
    trunk_size = np.ones(trunks, np.int64)
    trunk_first, own_first = np.zeros(trunks + 1, np.int64), np.zeros(lines + 1, np.int64)
    for i in range(lines):
        shape = _shape(shapes, i)
        on_trunk[i] = int(shape.last_start_m / step_m) + 1
        end_m[i] = shape.end_m
        trunk_size[hold[i]] = max(trunk_size[hold[i]], on_trunk[i])
        own = 1
        while step_m * (on_trunk[i] + own - 1) < shape.end_m + beyond_m:
            own += 1
        own_first[i + 1] = own_first[i] + own
    for h in range(trunks):
        trunk_first[h + 1] = trunk_first[h] + trunk_size[h]
    own_first += trunk_first[trunks]
    samples = own_first[lines]
    x, y, turned = np.empty(samples), np.empty(samples), np.empty(samples)
    time, weight = np.empty(samples), np.empty(samples)
    for h in range(trunks):
        s = trunk_first[h]
        shape = trapezoid(shapes.start_per_m, holds_per_m[h], _ENDLESS_M, shapes.final_per_m, shapes.ramp_per_m2)
        x[s] = y[s] = turned[s] = time[s] = 0.0
        weight[s] = 1.0
        for k in range(1, trunk_size[h]):
            here = (x[s], y[s], turned[s], time[s])
            s += 1
            x[s], y[s], turned[s], time[s], weight[s] = _sample_after(
                shape, here, step_m * (k - 1), step_m * k, sampling
            )
    for i in range(lines):
        shape = _shape(shapes, i)
        before, from_m = trunk_first[hold[i]] + on_trunk[i] - 1, step_m * (on_trunk[i] - 1)
        last = own_first[i + 1] - 1
        for s in range(own_first[i], last + 1):
            to_m = shape.end_m + beyond_m if s == last else from_m + step_m
            here = (x[before], y[before], turned[before], time[before])
            x[s], y[s], turned[s], time[s], weight[s] = _sample_after(shape, here, from_m, to_m, sampling)
            before, from_m = s, to_m
    return Lines(x, y, turned, time, weight, trunk_first, own_first, hold, on_trunk, end_m)


@inner_inlined
def _sample_after(
    shape: Trapezoid, here: tuple[float, float, float, float], from_m: float, to_m: float, sampling: Sampling
) -> tuple[float, float, float, float, float]:
    """Return x, y, turned, time and weight at an arc, from x, y, turned and time at another."""
    x_m, y_m, here_rad, time_s = here
    across_m, along_m = moved_m(shape, 0.0, from_m, to_m)
    there_rad, heading_rad, air = turned_rad(shape, to_m), sampling.heading_rad, sampling.air
    if air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0:
        time_s = to_m / air.airspeed_m_s
    else:
        slow, slower = 1.0 / speed_m_s(heading_rad + here_rad, air), 1.0 / speed_m_s(heading_rad + there_rad, air)
        time_s += (to_m - from_m) * 0.5 * (slow + slower)
    return x_m + across_m, y_m + along_m, there_rad, time_s, math.exp(-sampling.rate_per_s * time_s)


@compiled
def single_line(
    x_m: FloatArray, y_m: FloatArray, heading_rad: FloatArray, time_s: FloatArray, rate_per_s: float
) -> Lines:
    """Return one line (k,) that is known by its places, k >= 2, in the frame of the origin."""
    samples = x_m, y_m, heading_rad, time_s, np.exp(-rate_per_s * time_s)
    firsts = np.array([0, 1]), np.array([1, len(x_m)])
    return Lines(*samples, *firsts, np.zeros(1, np.int64), np.ones(1, np.int64), np.full(1, np.inf))


@inner_inlined
def from_target(
    place: FloatArray, step_s: float, one: int, x_m: float, y_m: float, time_s: float
) -> tuple[int, float, float]:
    """Return which sample of a future holds at a time, and the place (x, y) relative to the target then.

    place (f, k, 4): the target's places and velocities every step_s; one: the future.
    """
    k = min(int(time_s / step_s), place.shape[1] - 1)
    since_s = time_s - k * step_s
    at_x, at_y = place[one, k, 0] + place[one, k, 2] * since_s, place[one, k, 1] + place[one, k, 3] * since_s
    return k, x_m - at_x, y_m - at_y


@inner
def _relate(
    x_m: FloatArray, y_m: FloatArray, time_s: FloatArray, f: Scenarios, one: int, turn: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return places (across, along) relative to the target of one future; turn (f, k, 2...): of the frame."""
    across, along, place, step_s = np.empty(len(x_m)), np.empty(len(x_m)), f.place, f.step_s
    for i in range(len(x_m)):
        k, off_x, off_y = from_target(place, step_s, one, x_m[i], y_m[i], time_s[i])
        sin_t, cos_t = turn[one, k, 0], turn[one, k, 1]
        across[i], along[i] = off_x * cos_t - off_y * sin_t, off_x * sin_t + off_y * cos_t
    return across, along


@inner
def _rates(
    across: FloatArray, along: FloatArray, lines: Lines, f: Scenarios, one: int, d: Uncertainty, c: CostTerms
) -> FloatArray:
    """Return the discounted rate of the running cost at the samples of lines, which are placed in the watch frame."""
    time_s, weight, step_s, sigmas_rad = lines.time_s, lines.weight, f.step_s, f.facing[one, :, 2]
    last, found = len(sigmas_rad) - 1, np.empty(len(across))
    place2, velocity2 = d.position_m * d.position_m, d.velocity_m_s * d.velocity_m_s
    for i in range(len(across)):
        sigma2 = place2 + velocity2 * time_s[i] * time_s[i]
        aside_m = sigmas_rad[min(int(time_s[i] / step_s), last)] * along[i]
        blur_m = 1.0 + math.sqrt(sigma2 + aside_m * aside_m)
        found[i] = cost_rate(across[i], along[i], math.sqrt(sigma2), blur_m, c) * weight[i]
    return found


@inner
def placed(lines: Lines, start: Pose) -> tuple[FloatArray, FloatArray]:
    """Return the places x, y (samples,) of lines from a start."""
    sin_h, cos_h = math.sin(start.heading_rad), math.cos(start.heading_rad)
    x = start.x_m + lines.x_m * cos_h + lines.y_m * sin_h
    return x, start.y_m - lines.x_m * sin_h + lines.y_m * cos_h


@inner
def turn_samples(lines: Lines) -> IntArray:
    """Return the indices of the samples at which the cost of a turn of the target is evaluated."""
    trunk_first, own_first, on_trunk = lines.trunk_first, lines.own_first, lines.on_trunk
    found, n = np.empty(len(lines.x_m), np.int64), 0
    for h in range(len(trunk_first) - 1):
        for s in range(trunk_first[h], trunk_first[h + 1], TURN_STRIDE):
            found[n], n = s, n + 1
    for i in range(len(on_trunk)):
        for s in range(own_first[i] + -on_trunk[i] % TURN_STRIDE, own_first[i + 1] - 1, TURN_STRIDE):
            found[n], n = s, n + 1
    return found[:n]


@inner
def add_up(
    lines: Lines, rates: FloatArray, turn_rates: FloatArray, ends: FloatArray, share: float, costs: FloatArray
) -> None:
    """Add to the cost (lines,) of each line a share of what is paid along it and, by ends (lines,), from its end on.

    rates (samples,): of the running cost; turn_rates: of the target's turning, at the turn_samples.
    """
    # Parts of tuples are taken out once: in a loop each access would count its references.
    time_s, trunk_first, own_first = lines.time_s, lines.trunk_first, lines.own_first
    trunk, on_trunk = lines.trunk, lines.on_trunk
    sums, turns = np.zeros(len(time_s)), np.zeros(len(time_s))
    for h in range(len(trunk_first) - 1):
        first = trunk_first[h]
        for s in range(first + 1, trunk_first[h + 1]):
            sums[s] = sums[s - 1] + 0.5 * (rates[s - 1] + rates[s]) * (time_s[s] - time_s[s - 1])
        for s in range(first + TURN_STRIDE, trunk_first[h + 1], TURN_STRIDE):
            before = s - TURN_STRIDE
            turns[s] = turns[before] + turn_rates[before] * (time_s[s] - time_s[before])
    for i in range(len(trunk)):
        first = trunk_first[trunk[i]]
        before = first + on_trunk[i] - 1
        leaving = first + (on_trunk[i] - 1) // TURN_STRIDE * TURN_STRIDE
        total = sums[before] + turns[leaving]
        turn_rate, turn_s = turn_rates[leaving], time_s[leaving]
        last = own_first[i + 1] - 1
        for s in range(own_first[i], last + 1):
            total += 0.5 * (rates[before] + rates[s]) * (time_s[s] - time_s[before])
            before = s
            if (on_trunk[i] + s - own_first[i]) % TURN_STRIDE == 0 and s < last:
                total += turn_rate * (time_s[s] - turn_s)
                turn_rate, turn_s = turn_rates[s], time_s[s]
        total += turn_rate * (time_s[last] - turn_s)
        costs[i] += share * (total + ends[i])


@compiled
def lines_costs(
    lines: Lines, start: Pose, f: Scenarios, d: Uncertainty, c: CostTerms, table: Table, air: Air, costs: FloatArray
) -> None:
    """Fill in the expected cost (lines,), s, of flying each line from a start in the departure's frame."""
    turned, time_s, weight, own_first = lines.turned_rad, lines.time_s, lines.weight, lines.own_first
    classes, share, turn_share, course = f.classes, f.share, f.turn_share, f.course
    values, after_turn, cell_m, hazard_per_s = table.values, table.after_turn, table.cell_m, 1.0 / table.mean_leg_s
    n, last_k, heading_rad, step_s = len(time_s), f.place.shape[1] - 1, start.heading_rad, f.step_s
    x, y = placed(lines, start)
    samples, turn_rates, ends = turn_samples(lines), np.empty(n), np.empty(len(lines.trunk))
    costs[: len(ends)] = 0.0
    for one in range(len(f.weight)):
        across, along = _relate(x, y, time_s, f, one, f.facing)
        rates = _rates(across, along, lines, f, one, d, c)
        if c.blind > 0.0:
            place = f.place
            for s in range(n):
                _, off_x, off_y = from_target(place, step_s, one, x[s], y[s], time_s[s])
                rates[s] += weight[s] * blind_rate(off_x, off_y, nose_rad(heading_rad + turned[s], air), c)
        across, along = _relate(x, y, time_s, f, one, course)
        for s in samples:
            k = min(int(time_s[s] / step_s), last_k)
            heading = heading_rad + turned[s] - course[one, k, 2]
            after = table_value(after_turn, cell_m, across[s], along[s], heading, classes, turn_share, one, k)
            turn_rates[s] = hazard_per_s * weight[s] * after
        for i in range(len(ends)):
            s = own_first[i + 1] - 1
            k = min(int(time_s[s] / step_s), last_k)
            heading = heading_rad + turned[s] - course[one, k, 2]
            end = table_value(values, cell_m, across[s], along[s], heading, classes, share, one, k)
            ends[i] = weight[s] * end
        add_up(lines, rates, turn_rates, ends, f.weight[one], costs)


@compiled
def times_s(heading_rad: FloatArray, arc_m: FloatArray, air: Air) -> FloatArray:
    """Return the times (k,) since the start of a line over the ground, flown at the airspeed in the wind."""
    time = np.zeros(len(arc_m))
    for s in range(1, len(arc_m)):
        if air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0:
            time[s] = (arc_m[s] - arc_m[0]) / air.airspeed_m_s
        else:
            slow, slower = 1.0 / speed_m_s(heading_rad[s - 1], air), 1.0 / speed_m_s(heading_rad[s], air)
            time[s] = time[s - 1] + (arc_m[s] - arc_m[s - 1]) * 0.5 * (slow + slower)
    return time


_LAP_SAMPLES = 16


class WatchFrame(NamedTuple):
    """How the frame of the lines lies in the plane, and how the target moves in it."""

    course_rad: float
    mirror: float
    velocity_x_m_s: float
    velocity_y_m_s: float


@compiled
def hidden_rate(s: Sight, v: WatchFrame, x_m: float, y_m: float, time_s: float) -> float:
    """Return the cost per second of ground that hides the target, at a place of the lines' frame."""
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
def add_sight(
    lines: Lines,
    start: Pose,
    s: Sight,
    v: WatchFrame,
    radius_m: float,
    lap_s: float,
    rate_per_s: float,
    costs: FloatArray,
) -> None:
    """Add to the cost (lines,), s, of each line the time hidden by ground along it and on its circle, for a lap."""
    if s.needed_m.shape[0] == 0:
        return
    x, y = placed(lines, start)
    rates, ends, step_s = np.empty(len(x)), np.zeros(len(lines.trunk)), lap_s / _LAP_SAMPLES
    for k in range(len(x)):
        rates[k] = hidden_rate(s, v, x[k], y[k], lines.time_s[k]) * lines.weight[k]
    for i in range(len(ends)):
        last = lines.own_first[i + 1] - 1
        heading_rad = start.heading_rad + lines.turned_rad[last]
        middle_x, middle_y = x[last] + radius_m * math.cos(heading_rad), y[last] - radius_m * math.sin(heading_rad)
        for k in range(_LAP_SAMPLES):
            since_s = (k + 0.5) * step_s
            on_rad = heading_rad + math.tau * since_s / lap_s
            on_x, on_y = middle_x - radius_m * math.cos(on_rad), middle_y + radius_m * math.sin(on_rad)
            rate = hidden_rate(s, v, on_x, on_y, lines.time_s[last] + since_s)
            ends[i] += rate * math.exp(-rate_per_s * since_s) * step_s
        ends[i] *= lines.weight[last]
    add_up(lines, rates, np.zeros(len(x)), ends, 1.0, costs)
