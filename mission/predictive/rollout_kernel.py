"""Roll out candidate lines, which share their beginnings, against predicted futures of the target.

Lines are sampled every step_m and at their ends, in the frame of the departure: its origin is where the target is
then, x is to the right of the watch course, y along it. A future holds where the target is from then on, which course
to watch from, and which course and velocity the table is to be asked for: all may change on the way.

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

from sidelong.estimators.compiled import compiled, inlined
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.sight import Sight
from sidelong.mission.geometry.line_kernel import (
    Trapezoid,
    crab_rad,
    ground_speed_m_s,
    moved_m,
    trapezoid,
    turned_rad,
    with_last_ramp,
)
from sidelong.mission.predictive.cost_kernel import CostTerms, IntArray, Table, blind_rate, cost_rate, table_value

# The target turns at random, so what it does at a certain moment of the roll-out matters only in the mean: every
# third sample is enough.
TURN_STRIDE = 3
STEP_S = 1.0
_ENDLESS_M = 1e9


class Uncertainty(NamedTuple):
    """One standard deviation of the target's place and velocity on the worse axis, and of the watch course."""

    position_m: float
    velocity_m_s: float
    course_rad: float


class Scenarios(NamedTuple):
    """What the target may do: f futures, sampled k times every step_s from the departure on, k >= 1.

    weight (f,) sums to 1. place (f, k, 4): x, y, and the velocity that carries on from there to the next sample (from
    the last one indefinitely). facing (f, k, 3): sine and cosine of the watch course in the frame of the departure,
    and one standard deviation of it.
    course (f, k, 3): sine, cosine and angle of the course that the table's frame follows. classes (f, k, 4): the
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


class Air(NamedTuple):
    """Airspeed, and the wind in the frame of the lines."""

    airspeed_m_s: float
    wind_x_m_s: float
    wind_y_m_s: float


@compiled
def speed_m_s(course_rad: float, air: Air) -> float:
    """Return the speed over the ground on a course."""
    return ground_speed_m_s(course_rad, air.airspeed_m_s, air.wind_x_m_s, air.wind_y_m_s)


@compiled
def nose_rad(course_rad: float, air: Air) -> float:
    """Return where the nose points on a course over the ground."""
    return course_rad - crab_rad(course_rad, air.airspeed_m_s, air.wind_x_m_s, air.wind_y_m_s)


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


# -- lines -----------------------------------------------------------------------------------------------------------


class Shapes(NamedTuple):
    """Lines that ramp from one curvature to holds, hold them, and ramp on to a circle.

    Attributes:
        start_per_m: curvature at the start.
        holds_per_m: curvatures that are held, (holds,).
        hold: which of them each line holds, (lines,).
        lengths_m: for how far it holds it, (lines,).
        final_per_m: curvature of the circle.
        ramp_per_m2: sharpness of the first ramp.
        last_ramps_per_m2: sharpness of each last ramp, (lines,).
    """

    start_per_m: float
    holds_per_m: FloatArray
    hold: IntArray
    lengths_m: FloatArray
    final_per_m: float
    ramp_per_m2: float
    last_ramps_per_m2: FloatArray


class Sampling(NamedTuple):
    """How lines are sampled.

    Attributes:
        beyond_m: how far each line follows its circle.
        heading_rad: heading at the start, which matters in wind.
        air: airspeed and wind; samples are STEP_S of flight at the airspeed apart.
        rate_per_s: rate of the discount in ``Lines.weight``.
    """

    beyond_m: float
    heading_rad: float
    air: Air
    rate_per_s: float


@compiled
def spread(shapes: Shapes, sampling: Sampling) -> Lines:
    """Return the lines of some shapes."""
    start_per_m, holds_per_m, hold, lengths_m, final_per_m, ramp, last_ramps = shapes
    step_m, beyond_m = sampling.air.airspeed_m_s * STEP_S, sampling.beyond_m
    lines, trunks = len(hold), len(holds_per_m)
    on_trunk, end_m = np.empty(lines, np.int64), np.empty(lines)
    trunk_size = np.ones(trunks, np.int64)
    trunk_first, own_first = np.zeros(trunks + 1, np.int64), np.zeros(lines + 1, np.int64)
    for i in range(lines):
        shape = trapezoid(start_per_m, holds_per_m[hold[i]], lengths_m[i], final_per_m, ramp)
        shape = with_last_ramp(shape, last_ramps[i])
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
        shape = trapezoid(start_per_m, holds_per_m[h], _ENDLESS_M, final_per_m, ramp)
        x[s] = y[s] = turned[s] = time[s] = 0.0
        weight[s] = 1.0
        for k in range(1, trunk_size[h]):
            here = (x[s], y[s], turned[s], time[s])
            s += 1
            x[s], y[s], turned[s], time[s], weight[s] = _sample_after(
                shape, here, step_m * (k - 1), step_m * k, sampling
            )
    for i in range(lines):
        shape = trapezoid(start_per_m, holds_per_m[hold[i]], lengths_m[i], final_per_m, ramp)
        shape = with_last_ramp(shape, last_ramps[i])
        before, from_m = trunk_first[hold[i]] + on_trunk[i] - 1, step_m * (on_trunk[i] - 1)
        last = own_first[i + 1] - 1
        for s in range(own_first[i], last + 1):
            to_m = shape.end_m + beyond_m if s == last else from_m + step_m
            here = (x[before], y[before], turned[before], time[before])
            x[s], y[s], turned[s], time[s], weight[s] = _sample_after(shape, here, from_m, to_m, sampling)
            before, from_m = s, to_m
    return Lines(x, y, turned, time, weight, trunk_first, own_first, hold, on_trunk, end_m)


@inlined
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
    n = len(x_m)
    weight = np.empty(n)
    for s in range(n):
        weight[s] = math.exp(-rate_per_s * time_s[s])
    return Lines(
        x_m,
        y_m,
        heading_rad,
        time_s,
        weight,
        np.array([0, 1]),
        np.array([1, n]),
        np.zeros(1, np.int64),
        np.ones(1, np.int64),
        np.full(1, np.inf),
    )


# -- costs -----------------------------------------------------------------------------------------------------------


@inlined
def from_target(
    place: FloatArray, step_s: float, one: int, x_m: float, y_m: float, time_s: float
) -> tuple[int, float, float]:
    """Return which sample of a future holds at a time, and a place (x, y) relative to the target then."""
    k = min(int(time_s / step_s), place.shape[1] - 1)
    since_s = time_s - k * step_s
    return (
        k,
        x_m - (place[one, k, 0] + place[one, k, 2] * since_s),
        y_m - (place[one, k, 1] + place[one, k, 3] * since_s),
    )


@compiled
def _relate(
    x_m: FloatArray,
    y_m: FloatArray,
    time_s: FloatArray,
    one: int,
    step_s: float,
    place: FloatArray,
    turn: FloatArray,
    across: FloatArray,
    along: FloatArray,
) -> None:
    """Fill in places relative to the target of one future, in a frame that turns: turn (f, k, 2...) as Scenarios."""
    for i in range(len(x_m)):
        k, off_x, off_y = from_target(place, step_s, one, x_m[i], y_m[i], time_s[i])
        sin_t, cos_t = turn[one, k, 0], turn[one, k, 1]
        across[i], along[i] = off_x * cos_t - off_y * sin_t, off_x * sin_t + off_y * cos_t


@compiled
def _rates(
    across: FloatArray,
    along: FloatArray,
    time_s: FloatArray,
    weight: FloatArray,
    sigmas_rad: FloatArray,
    step_s: float,
    d: Uncertainty,
    c: CostTerms,
    found: FloatArray,
) -> None:
    """Fill in the discounted rate of the running cost at places of the watch frame, whose course has sigmas (k,)."""
    last = len(sigmas_rad) - 1
    place2, velocity2 = d.position_m * d.position_m, d.velocity_m_s * d.velocity_m_s
    for i in range(len(across)):
        sigma2 = place2 + velocity2 * time_s[i] * time_s[i]
        aside_m = sigmas_rad[min(int(time_s[i] / step_s), last)] * along[i]
        blur_m = 1.0 + math.sqrt(sigma2 + aside_m * aside_m)
        found[i] = cost_rate(across[i], along[i], math.sqrt(sigma2), blur_m, c) * weight[i]


@compiled
def placed(lines: Lines, start: Pose) -> tuple[FloatArray, FloatArray]:
    """Return the places x, y (samples,) of lines from a start."""
    n, own_x, own_y = len(lines.x_m), lines.x_m, lines.y_m
    sin_h, cos_h = math.sin(start.heading_rad), math.cos(start.heading_rad)
    x, y = np.empty(n), np.empty(n)
    for s in range(n):
        x[s] = start.x_m + own_x[s] * cos_h + own_y[s] * sin_h
    for s in range(n):
        y[s] = start.y_m - own_x[s] * sin_h + own_y[s] * cos_h
    return x, y


@compiled
def turn_samples(lines: Lines) -> IntArray:
    """Return the samples at which it is looked at what a turn of the target would cost."""
    trunk_first, own_first, on_trunk = lines.trunk_first, lines.own_first, lines.on_trunk
    found, n = np.empty(len(lines.x_m), np.int64), 0
    for h in range(len(trunk_first) - 1):
        for s in range(trunk_first[h], trunk_first[h + 1], TURN_STRIDE):
            found[n], n = s, n + 1
    for i in range(len(on_trunk)):
        for s in range(own_first[i] + -on_trunk[i] % TURN_STRIDE, own_first[i + 1] - 1, TURN_STRIDE):
            found[n], n = s, n + 1
    return found[:n]


@compiled
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
    """Fill in the expected cost (lines,) of flying each line from a start in the departure's frame."""
    turned, time_s, weight, own_first = lines.turned_rad, lines.time_s, lines.weight, lines.own_first
    classes, share, turn_share, course = f.classes, f.share, f.turn_share, f.course
    values, after_turn, cell_m, hazard_per_s = table.values, table.after_turn, table.cell_m, 1.0 / table.mean_leg_s
    n, last_k, heading_rad, step_s = len(time_s), f.place.shape[1] - 1, start.heading_rad, f.step_s
    x, y = placed(lines, start)
    across, along, rates, turn_rates = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    samples, ends = turn_samples(lines), np.empty(len(lines.trunk))
    costs[: len(ends)] = 0.0
    for one in range(len(f.weight)):
        _relate(x, y, time_s, one, step_s, f.place, f.facing, across, along)
        _rates(across, along, time_s, weight, f.facing[one, :, 2], step_s, d, c, rates)
        if c.blind > 0.0:
            place = f.place
            for s in range(n):
                _, off_x, off_y = from_target(place, step_s, one, x[s], y[s], time_s[s])
                rates[s] += weight[s] * blind_rate(off_x, off_y, nose_rad(heading_rad + turned[s], air), c)
        _relate(x, y, time_s, one, step_s, f.place, course, across, along)
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


# -- what the ground hides -------------------------------------------------------------------------------------------

_LAP_SAMPLES = 16


class WatchFrame(NamedTuple):
    """How the frame of the lines lies in the plane, and how the target moves in it."""

    course_rad: float
    mirror: float
    velocity_x_m_s: float
    velocity_y_m_s: float


@compiled
def hidden_rate(s: Sight, v: WatchFrame, x_m: float, y_m: float, time_s: float) -> float:
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
    s: Sight, v: WatchFrame, at: Pose, time_s: float, radius_m: float, lap_s: float, rate_per_s: float
) -> float:
    """Return the cost of the clockwise circle from a position on it, for a lap."""
    x_m, y_m, heading_rad = at
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
    return total


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
    """Add to the cost (lines,) of each line from a start what is hidden along it and on the circle after it."""
    if s.needed_m.shape[0] == 0:
        return
    x, y = placed(lines, start)
    rates, ends = np.empty(len(x)), np.empty(len(lines.trunk))
    for k in range(len(x)):
        rates[k] = hidden_rate(s, v, x[k], y[k], lines.time_s[k]) * lines.weight[k]
    for i in range(len(ends)):
        last = lines.own_first[i + 1] - 1
        at = Pose(x[last], y[last], start.heading_rad + lines.turned_rad[last])
        ends[i] = lines.weight[last] * _lap_cost(s, v, at, lines.time_s[last], radius_m, lap_s, rate_per_s)
    add_up(lines, rates, np.zeros(len(x)), ends, 1.0, costs)
