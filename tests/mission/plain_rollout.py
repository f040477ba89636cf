"""The roll-out as formulas of whole arrays: slow, and what the compiled one is held to.

Lines go without what they share, the table is blended before it is asked, and every cost stands in one expression.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sidelong.mission.core.requirement import Wind
from sidelong.mission.predictive.moves_kernel import HOLD_CURVATURES, HOLD_LENGTHS, STAY_LENGTHS
from sidelong.mission.predictive.value_table import HEADING_STEP_RAD, HEADINGS

_NODES, _WEIGHTS = 0.5 + np.array([-0.5, 0.5]) / math.sqrt(3.0), np.array([0.5, 0.5])
_TURN_STRIDE = 3


@dataclass
class Lines:
    """n trapezoids: curvature(s) = start + first ramp + last ramp."""

    start: float
    first_rate: np.ndarray
    first_end: np.ndarray
    last_rate: np.ndarray
    last_start: np.ndarray
    last_end: np.ndarray

    @staticmethod
    def between(start, hold, length, final, ramp):
        hold, length, final = np.broadcast_arrays(hold, length, final)
        first_end = np.abs(hold - start) / ramp
        last_start = first_end + length
        last_end = last_start + np.abs(final - hold) / ramp
        return Lines(
            start, np.sign(hold - start) * ramp, first_end, np.sign(final - hold) * ramp, last_start, last_end
        )

    def with_last_ramps(self, ramps):
        change = np.abs(self.last_rate) * (self.last_end - self.last_start)
        last_end = self.last_start + change / ramps
        return Lines(
            self.start, self.first_rate, self.first_end, np.sign(self.last_rate) * ramps, self.last_start, last_end
        )

    def turned(self, arc):
        first = np.minimum(arc, self.first_end[:, None])
        length = (self.last_end - self.last_start)[:, None]
        last = np.clip(arc - self.last_start[:, None], 0.0, length)
        after = np.maximum(arc - self.last_end[:, None], 0.0)
        return (
            self.start * arc
            + self.first_rate[:, None] * first * (arc - 0.5 * first)
            + self.last_rate[:, None] * (0.5 * last * last + length * after)
        )

    def arcs(self, step, beyond):
        ends = self.last_end + beyond
        return np.minimum(step * np.arange(math.ceil(ends.max() / step) + 2), ends[:, None])

    def displaced(self, arc, course):
        step = np.diff(arc, axis=1)
        east, north = np.zeros_like(arc), np.zeros_like(arc)
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            along = course + self.turned(arc[:, :-1] + node * step)
            east[:, 1:] += weight * step * np.sin(along)
            north[:, 1:] += weight * step * np.cos(along)
        return np.cumsum(east, axis=1), np.cumsum(north, axis=1)


def moves_from(start, radius, tightest, ramp, lengths=HOLD_LENGTHS):
    unit = np.where(np.arange(len(HOLD_CURVATURES)) == 0, tightest, radius)[:, None]
    hold, length = HOLD_CURVATURES[:, None] / unit * np.ones(len(lengths)), lengths * unit
    return Lines.between(start, np.append(hold.ravel(), start), np.append(length.ravel(), 0.0), 1.0 / radius, ramp)


def staying_on(curvature, radius, ramp):
    return Lines.between(curvature, curvature, STAY_LENGTHS * radius, 1.0 / radius, ramp)


@dataclass
class RollOut:
    """velocity and wind in the watch frame; doubt: sigmas of position, velocity and course."""

    table: object  # a ValueTable
    velocity: tuple[float, float]
    wind: Wind
    doubt: tuple[float, float, float]
    step_m: float
    beyond_m: float = 0.0

    def costs(self, lines, x, y, heading):
        arc = lines.arcs(self.step_m, self.beyond_m)
        east, north = lines.displaced(arc, heading)
        return self.costs_of(x + east, y + north, heading + lines.turned(arc), arc)

    def costs_of(self, x, y, heading, arc):
        c = self.table.configuration
        time = self._times(heading, arc)
        x, y = x - self.velocity[0] * time, y - self.velocity[1] * time
        hazard = 1.0 / c.habits.mean_leg_s
        weight = np.exp(-(c.discount_per_s + hazard) * time)
        step = np.zeros_like(time)
        half = 0.5 * np.diff(time, axis=1)
        step[:, 1:] += half
        step[:, :-1] += half
        sigma = np.hypot(self.doubt[0], self.doubt[1] * time)
        blur = 1.0 + np.hypot(sigma, self.doubt[2] * y)
        total = np.sum(cost_rate(c.cost, x, y, sigma, blur) * weight * step, axis=1)
        values, after_turn = self._blended()
        cell_m = 2.0 * c.half_width_m / (values.shape[-1] - 1)
        every = slice(0, None, _TURN_STRIDE)
        turned = looked_up(after_turn, cell_m, x[:, every], y[:, every], heading[:, every])
        held = np.diff(time[:, every], axis=1, append=time[:, -1:])
        total += hazard * np.sum(turned * weight[:, every] * held, axis=1)
        return total + weight[:, -1] * looked_up(values, cell_m, x[:, -1], y[:, -1], heading[:, -1])

    def _times(self, heading, arc):
        speed = self.table.configuration.airspeed_m_s
        along = self.wind.east_m_s * np.sin(heading) + self.wind.north_m_s * np.cos(heading)
        across = self.wind.east_m_s * np.cos(heading) - self.wind.north_m_s * np.sin(heading)
        slowness = 1.0 / (along + np.sqrt(speed**2 - across**2))
        time = np.zeros_like(arc)
        time[:, 1:] = np.cumsum(np.diff(arc, axis=1) * 0.5 * (slowness[:, 1:] + slowness[:, :-1]), axis=1)
        return time

    def _blended(self):
        table = self.table
        values, after_turn = np.zeros_like(table.values[0]), np.zeros_like(table.values[0])
        for which, weight in class_weights(table.configuration, self.velocity, self.wind):
            values += np.float32(weight) * table.values[which]
            after_turn += np.float32(weight) * table.after_turn[which]
        return values, after_turn


def cost_rate(cost, x, y, widened, blur):
    distance = np.hypot(x, y)
    off = np.clip(0.5 + 0.5 * (x + math.cos(cost.half_width_rad) * distance) / blur, 0.0, 1.0)
    widened = np.minimum(widened, 0.25 * (cost.far_m - cost.near_m))
    inside = np.minimum(distance - (cost.near_m + widened), (cost.far_m - widened) - distance)
    wall = 2.0 * np.clip(1.0 - inside / 20.0, 0.0, 1.0) ** 2
    return off + wall + np.where(inside < 0.0, 18.0 - 0.5 * inside, 0.0)


def class_weights(c, velocity, wind):
    share = min(math.hypot(*velocity) / c.target_speed_max_m_s, 1.0)
    ring = 0 if share < 0.5 else 1
    outer = 2.0 * share - ring
    rings = ((ring, 1.0 - outer), (ring + 1, outer))
    if not c.follows_course:
        around = _directions(velocity, 8)
        return [(1 + (r - 1) * 8 + d if r else 0, weight * part) for r, weight in rings for d, part in around]
    if c.wind_speed_m_s == 0.0:
        return list(rings)
    around = _directions((wind.east_m_s, wind.north_m_s), 4)
    return [(r * 4 + d, weight * part) for r, weight in rings for d, part in around]


def _directions(vector, count):
    direction = math.atan2(*vector) / (2.0 * math.pi) * count % count
    first, past = int(direction), direction - int(direction)
    return (first % count, 1.0 - past), ((first + 1) % count, past)


def deep_cost(table, futures, doubt, ahead, end, branches, horizon, prices, radius, tightest, ramp, levels, lengths):
    """What a line (x, y, heading, curvature) (4, k) at whole seconds costs in calm air, with the best second move."""
    c = table.configuration
    hazard = 1.0 / c.habits.mean_leg_s
    cell_m = 2.0 * c.half_width_m / (table.values.shape[-1] - 1)

    def asked(values, share, one, at, x, y, heading):
        x, y = x - futures.place[one, at, 0], y - futures.place[one, at, 1]
        sin_t, cos_t, angle = futures.course[one, at].T
        mixed = np.zeros(np.shape(x))
        for i in range(4):
            every = np.array([futures.classes[one, k, i] for k in np.atleast_1d(at)])
            found = [
                looked_up(values[v], cell_m, *place)
                for v, *place in zip(
                    every,
                    *map(np.atleast_1d, (x * cos_t - y * sin_t, x * sin_t + y * cos_t, heading - angle)),
                    strict=True,
                )
            ]
            mixed = mixed + share[one, at, i] * np.reshape(found, np.shape(x))
        return mixed

    def running(one, first, x, y, heading):
        """The cost up to each second, without the table's at the end."""
        at = first + np.arange(len(x))
        dx, dy = x - futures.place[one, at, 0], y - futures.place[one, at, 1]
        sin_f, cos_f, alongside = futures.facing[one, at].T
        across, along = dx * cos_f - dy * sin_f, dx * sin_f + dy * cos_f
        sigma = np.hypot(doubt[0], doubt[1] * at)
        weight = np.exp(-(c.discount_per_s + hazard) * at)
        rate = weight * cost_rate(c.cost, across, along, sigma, 1.0 + np.hypot(sigma, alongside * along))
        return np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])))), weight

    def turns(one, first, x, y, heading, weight, at):
        return (
            hazard
            * weight[at]
            * asked(table.after_turn, futures.turn_share, one, first + at, x[at], y[at], heading[at])
        )

    x, y, heading, curvature = ahead
    total = 0.0
    for one in range(len(futures.weight)):
        before, weight = running(one, 0, x, y, heading)
        for k in range(1, len(x)):
            before[k:] += turns(one, 0, x, y, heading, weight, min((k - 1) // 4 * 4 + 2, len(x) - 1))
        ends = [max(end, 15)] if end > 0 else [15, 22, 30]
        best = min(
            before[k] + weight[k] * asked(table.values, futures.share, one, k, x[k], y[k], heading[k]) for k in ends
        )
        for at in branches:
            level = levels[np.argmin(np.abs(levels - curvature[at] * radius))] / radius
            lines = moves_from(level, radius, tightest, ramp, lengths)
            for j, last in enumerate(np.maximum(np.ceil(lines.last_end / 10.0), horizon - at).astype(int)):
                arc = np.tile(10.0 * np.arange(last + 1.0), (len(lines.last_end), 1))
                east, north = (a[j] for a in lines.displaced(arc, heading[at]))
                px, py, ph = x[at] + east, y[at] + north, heading[at] + lines.turned(arc)[j]
                cost, w = running(one, at, px, py, ph)
                cost = cost[-1] + w[-1] * asked(table.values, futures.share, one, at + last, px[-1], py[-1], ph[-1])
                for k in range(0, last, 4):
                    held = min(4, last - k)
                    cost += held * turns(one, at, px, py, ph, w, k + held // 2)
                best = min(best, before[at] + weight[at] * prices[int(at < end)] + cost)
        total += futures.weight[one] * best
    return total


def looked_up(table, cell_m, x, y, heading):
    n = table.shape[-1]
    x = np.clip(np.asarray(x) / cell_m + (n - 1) / 2, 0.0, n - 1.001)
    y = np.clip(np.asarray(y) / cell_m + (n - 1) / 2, 0.0, n - 1.001)
    heading = np.asarray(heading) / HEADING_STEP_RAD % HEADINGS
    i, j, k = x.astype(int), y.astype(int), heading.astype(int)
    across, along, turn = x - i, y - j, heading - k
    total = np.zeros(np.broadcast_shapes(x.shape, y.shape, heading.shape))
    for plane, weight in ((k % HEADINGS, 1.0 - turn), ((k + 1) % HEADINGS, turn)):
        low = table[plane, i, j] * (1.0 - along) + table[plane, i, j + 1] * along
        high = table[plane, i + 1, j] * (1.0 - along) + table[plane, i + 1, j + 1] * along
        total += weight * (low * (1.0 - across) + high * across)
    return total
