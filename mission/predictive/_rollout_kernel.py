"""The inner loops of the roll-out: many lines that share their beginnings, against futures of the target.

Lines are sampled every step_m and at their ends, in the frame of the departure: its origin is where the target is
then, x is to the right of the watch course, y along it. A future tells where the target is from then on, which course
to watch from, and which course and velocity the table is to be asked for: all may change on the way.

What lines share is computed once: all moves that hold one curvature follow one trunk until their last ramps begin.
In still air a set of lines depends on the curvature at its start only, of which a flight has few: sets are kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.compiled import compiled
from mission.core.path import FloatArray
from mission.geometry._line_kernel import ground_speed_m_s, moved_m, trapezoid, turned_rad, with_last_ramp
from mission.predictive._cost_kernel import CostTerms, Float32, IntArray, Table, cost_rate, table_value

# The target turns at random, so what it does at a certain moment of the roll-out matters only in the mean: every
# third sample is enough.
TURN_STRIDE = 3
_ENDLESS_M = 1e9


class Doubt(NamedTuple):
    """One standard deviation of the target's place and velocity on the worse axis, and of the watch course."""

    position_m: float
    velocity_m_s: float
    course_rad: float


class Futures(NamedTuple):
    """What the target may do: f futures, sampled k times every step_s from the departure on, k >= 1.

    weight (f,) sums to 1. place (f, k, 4): x, y, and the velocity that carries on from there to the next sample (from
    the last one for ever). facing (f, k, 2): sine and cosine of the watch course in the frame of the departure.
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


@compiled
def _value_there(
    values: Float32,
    cell_m: float,
    x_m: float,
    y_m: float,
    heading_rad: float,
    time_s: float,
    one: int,
    f: Futures,
    after_turn: bool,
) -> float:
    """Return the table's word on a place of the departure's frame at a time, in one future."""
    k = _sample(f, time_s)
    east_m, north_m = _off_target(f, one, k, x_m, y_m, time_s)
    sin_c, cos_c = f.course[one, k, 0], f.course[one, k, 1]
    share = f.turn_share[one, k] if after_turn else f.share[one, k]
    return table_value(
        values,
        cell_m,
        east_m * cos_c - north_m * sin_c,
        east_m * sin_c + north_m * cos_c,
        heading_rad - f.course[one, k, 2],
        f.classes[one, k],
        share,
    )


@compiled
def _sample(f: Futures, time_s: float) -> int:
    return int(min(time_s / f.step_s, f.place.shape[1] - 1.0))


@compiled
def _off_target(f: Futures, one: int, k: int, x_m: float, y_m: float, time_s: float) -> tuple[float, float]:
    since_s = time_s - k * f.step_s
    place = f.place[one, k]
    return x_m - (place[0] + place[2] * since_s), y_m - (place[1] + place[3] * since_s)


# -- lines -----------------------------------------------------------------------------------------------------------


@compiled
def spread(
    start_per_m: float,
    holds_per_m: FloatArray,
    hold: IntArray,
    lengths_m: FloatArray,
    final_per_m: float,
    sharpness_per_m2: float,
    last_ramps_per_m2: FloatArray,
    step_m: float,
    beyond_m: float,
    heading_rad: float,
    air: Air,
    rate_per_s: float,
) -> Lines:
    """Return the lines that ramp from a curvature to one of the holds (h,), hold it, and ramp on to a circle.

    Line i holds holds_per_m[hold[i]] for lengths_m[i] and ramps on at last_ramps_per_m2[i]. beyond_m: how far each
    follows its circle. heading_rad: of the start, which matters in wind. rate_per_s: of the discount in ``weight``.
    """
    lines, trunks = len(hold), len(holds_per_m)
    on_trunk, end_m = np.empty(lines, np.int64), np.empty(lines)
    trunk_size = np.ones(trunks, np.int64)
    trunk_first, own_first = np.zeros(trunks + 1, np.int64), np.zeros(lines + 1, np.int64)
    for i in range(lines):
        one = with_last_ramp(
            trapezoid(start_per_m, holds_per_m[hold[i]], lengths_m[i], final_per_m, sharpness_per_m2),
            last_ramps_per_m2[i],
        )
        on_trunk[i] = int(one[4] / step_m) + 1
        end_m[i] = one[5]
        trunk_size[hold[i]] = max(trunk_size[hold[i]], on_trunk[i])
        own = 1
        while step_m * (on_trunk[i] + own - 1) < one[5] + beyond_m:
            own += 1
        own_first[i + 1] = own_first[i] + own
    for h in range(trunks):
        trunk_first[h + 1] = trunk_first[h] + trunk_size[h]
    own_first += trunk_first[trunks]
    samples = own_first[lines]
    x, y, turned = np.empty(samples), np.empty(samples), np.empty(samples)
    time, weight = np.empty(samples), np.empty(samples)
    for h in range(trunks):
        first = trunk_first[h]
        one = trapezoid(start_per_m, holds_per_m[h], _ENDLESS_M, final_per_m, sharpness_per_m2)
        x[first] = y[first] = turned[first] = time[first] = 0.0
        weight[first] = 1.0
        for k in range(1, trunk_size[h]):
            _extend(
                one,
                first + k,
                first + k - 1,
                step_m * (k - 1),
                step_m * k,
                x,
                y,
                turned,
                time,
                weight,
                heading_rad,
                air,
                rate_per_s,
            )
    for i in range(lines):
        one = with_last_ramp(
            trapezoid(start_per_m, holds_per_m[hold[i]], lengths_m[i], final_per_m, sharpness_per_m2),
            last_ramps_per_m2[i],
        )
        before, from_m = trunk_first[hold[i]] + on_trunk[i] - 1, step_m * (on_trunk[i] - 1)
        last = own_first[i + 1] - 1
        for s in range(own_first[i], last + 1):
            to_m = one[5] + beyond_m if s == last else from_m + step_m
            _extend(one, s, before, from_m, to_m, x, y, turned, time, weight, heading_rad, air, rate_per_s)
            before, from_m = s, to_m
    return Lines(x, y, turned, time, weight, trunk_first, own_first, hold, on_trunk, end_m)


@compiled
def _extend(
    one: tuple[float, float, float, float, float, float],
    s: int,
    before: int,
    from_m: float,
    to_m: float,
    x: FloatArray,
    y: FloatArray,
    turned: FloatArray,
    time: FloatArray,
    weight: FloatArray,
    heading_rad: float,
    air: Air,
    rate_per_s: float,
) -> None:
    """Fill in sample s, which follows ``before``."""
    across_m, along_m = moved_m(one, 0.0, from_m, to_m)
    x[s], y[s], turned[s] = x[before] + across_m, y[before] + along_m, turned_rad(one, to_m)
    if air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0:
        time[s] = to_m / air.airspeed_m_s
    else:
        slow = 1.0 / ground_speed_m_s(heading_rad + turned[before], air.airspeed_m_s, air.wind_x_m_s, air.wind_y_m_s)
        slower = 1.0 / ground_speed_m_s(heading_rad + turned[s], air.airspeed_m_s, air.wind_x_m_s, air.wind_y_m_s)
        time[s] = time[before] + (to_m - from_m) * 0.5 * (slow + slower)
    weight[s] = math.exp(-rate_per_s * time[s])


# -- costs -----------------------------------------------------------------------------------------------------------


@compiled
def _rates(
    x_m: FloatArray,
    y_m: FloatArray,
    time_s: FloatArray,
    weight: FloatArray,
    one: int,
    f: Futures,
    d: Doubt,
    c: CostTerms,
    found: FloatArray,
) -> None:
    """Fill in the discounted rate of the running cost at samples of the departure's frame, in one future."""
    n = len(x_m)
    across, along = np.empty(n), np.empty(n)
    if f.place.shape[1] == 1:
        sin_w, cos_w = f.facing[one, 0, 0], f.facing[one, 0, 1]
        x0, y0, vx, vy = f.place[one, 0, 0], f.place[one, 0, 1], f.place[one, 0, 2], f.place[one, 0, 3]
        for i in range(n):
            off_x, off_y = x_m[i] - x0 - vx * time_s[i], y_m[i] - y0 - vy * time_s[i]
            across[i] = off_x * cos_w - off_y * sin_w
        for i in range(n):
            off_x, off_y = x_m[i] - x0 - vx * time_s[i], y_m[i] - y0 - vy * time_s[i]
            along[i] = off_x * sin_w + off_y * cos_w
    else:
        for i in range(n):
            k = _sample(f, time_s[i])
            off_x, off_y = _off_target(f, one, k, x_m[i], y_m[i], time_s[i])
            sin_w, cos_w = f.facing[one, k, 0], f.facing[one, k, 1]
            across[i], along[i] = off_x * cos_w - off_y * sin_w, off_x * sin_w + off_y * cos_w
    place2, velocity2, course2 = (
        d.position_m * d.position_m,
        d.velocity_m_s * d.velocity_m_s,
        d.course_rad * d.course_rad,
    )
    for i in range(n):
        sigma2 = place2 + velocity2 * time_s[i] * time_s[i]
        blur_m = 1.0 + math.sqrt(sigma2 + course2 * along[i] * along[i])
        found[i] = cost_rate(across[i], along[i], math.sqrt(sigma2), blur_m, c) * weight[i]


@compiled
def lines_costs(
    lines: Lines,
    x_m: float,
    y_m: float,
    heading_rad: float,
    f: Futures,
    d: Doubt,
    c: CostTerms,
    table: Table,
    costs: FloatArray,
) -> None:
    """Fill in the expected cost (lines,) of flying each line from a place and heading of the departure's frame."""
    n = len(lines.x_m)
    sin_h, cos_h = math.sin(heading_rad), math.cos(heading_rad)
    x, y, rates = np.empty(n), np.empty(n), np.empty(n)
    for s in range(n):
        x[s] = x_m + lines.x_m[s] * cos_h + lines.y_m[s] * sin_h
    for s in range(n):
        y[s] = y_m - lines.x_m[s] * sin_h + lines.y_m[s] * cos_h
    sums, turns, turn_rates = np.empty(n), np.empty(n), np.empty(n)
    costs[: len(lines.trunk)] = 0.0
    for one in range(len(f.weight)):
        _rates(x, y, lines.time_s, lines.weight, one, f, d, c, rates)
        for h in range(len(lines.trunk_first) - 1):
            first = lines.trunk_first[h]
            for s in range(first, lines.trunk_first[h + 1]):
                sums[s] = turns[s] = 0.0
                if s > first:
                    step_s = lines.time_s[s] - lines.time_s[s - 1]
                    sums[s] = sums[s - 1] + 0.5 * (rates[s - 1] + rates[s]) * step_s
                if (s - first) % TURN_STRIDE == 0:
                    turn_rates[s] = _turn_rate(lines, s, x[s], y[s], heading_rad, one, f, table)
                    if s > first:
                        held_s = lines.time_s[s] - lines.time_s[s - TURN_STRIDE]
                        turns[s] = turns[s - TURN_STRIDE] + turn_rates[s - TURN_STRIDE] * held_s
        for i in range(len(lines.trunk)):
            first, on_trunk = lines.trunk_first[lines.trunk[i]], lines.on_trunk[i]
            before = first + on_trunk - 1
            turned = first + (on_trunk - 1) // TURN_STRIDE * TURN_STRIDE
            total = sums[before] + turns[turned]
            turn_rate, turn_s = turn_rates[turned], lines.time_s[turned]
            last = lines.own_first[i + 1] - 1
            for s in range(lines.own_first[i], last + 1):
                total += 0.5 * (rates[before] + rates[s]) * (lines.time_s[s] - lines.time_s[before])
                before = s
                if (on_trunk + s - lines.own_first[i]) % TURN_STRIDE == 0 and s < last:
                    total += turn_rate * (lines.time_s[s] - turn_s)
                    turn_rate, turn_s = _turn_rate(lines, s, x[s], y[s], heading_rad, one, f, table), lines.time_s[s]
            end_s = lines.time_s[last]
            total += turn_rate * (end_s - turn_s)
            total += lines.weight[last] * _value_there(
                table.values,
                table.cell_m,
                x[last],
                y[last],
                heading_rad + lines.turned_rad[last],
                end_s,
                one,
                f,
                False,
            )
            costs[i] += f.weight[one] * total


@compiled
def _turn_rate(
    lines: Lines, s: int, x_m: float, y_m: float, heading_rad: float, one: int, f: Futures, table: Table
) -> float:
    """Return what a turn of the target at sample s costs, for each second in which it may happen."""
    heading_rad = heading_rad + lines.turned_rad[s]
    after = _value_there(table.after_turn, table.cell_m, x_m, y_m, heading_rad, lines.time_s[s], one, f, True)
    return float(lines.weight[s] / table.mean_leg_s * after)


@compiled
def line_cost(
    x_m: FloatArray,
    y_m: FloatArray,
    heading_rad: FloatArray,
    time_s: FloatArray,
    f: Futures,
    d: Doubt,
    c: CostTerms,
    table: Table,
) -> float:
    """Return the expected cost of one line (k,) in the departure's frame, as :func:`lines_costs` has it."""
    n = len(x_m)
    hazard_per_s = 1.0 / table.mean_leg_s
    weight, rates = np.empty(n), np.empty(n)
    for s in range(n):
        weight[s] = math.exp(-(table.discount_per_s + hazard_per_s) * time_s[s])
    total = 0.0
    for one in range(len(f.weight)):
        _rates(x_m, y_m, time_s, weight, one, f, d, c, rates)
        cost = 0.0
        for s in range(1, n):
            cost += 0.5 * (rates[s - 1] + rates[s]) * (time_s[s] - time_s[s - 1])
        for s in range(0, n - 1, TURN_STRIDE):
            held_s = time_s[min(s + TURN_STRIDE, n - 1)] - time_s[s]
            after = _value_there(
                table.after_turn, table.cell_m, x_m[s], y_m[s], heading_rad[s], time_s[s], one, f, True
            )
            cost += hazard_per_s * weight[s] * after * held_s
        cost += weight[n - 1] * _value_there(
            table.values, table.cell_m, x_m[n - 1], y_m[n - 1], heading_rad[n - 1], time_s[n - 1], one, f, False
        )
        total += f.weight[one] * cost
    return total


@compiled
def times_s(heading_rad: FloatArray, arc_m: FloatArray, air: Air) -> FloatArray:
    """Return the times (k,) since the start of a line over the ground, flown at the airspeed in the wind."""
    time = np.zeros(len(arc_m))
    for s in range(1, len(arc_m)):
        if air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0:
            time[s] = (arc_m[s] - arc_m[0]) / air.airspeed_m_s
        else:
            slow = 1.0 / ground_speed_m_s(heading_rad[s - 1], air.airspeed_m_s, air.wind_x_m_s, air.wind_y_m_s)
            slower = 1.0 / ground_speed_m_s(heading_rad[s], air.airspeed_m_s, air.wind_x_m_s, air.wind_y_m_s)
            time[s] = time[s - 1] + (arc_m[s] - arc_m[s - 1]) * 0.5 * (slow + slower)
    return time
