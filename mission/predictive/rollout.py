"""What would come of flying a line: its cost against the target as it is known, and the worth of where it ends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mission.core.path import FloatArray
from mission.core.requirement import Wind
from mission.geometry.trapezoid import Trapezoids
from mission.geometry.wind import ground_speeds_m_s
from mission.predictive.cost import WatchCost
from mission.predictive.value_table import MotionTable

# The target turns at random, so what it does at a certain moment of the roll-out matters only in the mean: every
# third sample is enough.
_TURN_STRIDE = 3


@dataclass(frozen=True, slots=True)
class WatchFrame:
    """The frame of the cost at a moment: origin, course, and -1 where left and right are swapped."""

    east_m: float
    north_m: float
    course_rad: float
    mirror: float

    def heading_rad(self, course_rad: float) -> float:
        """Return a course of the plane as a heading of this frame."""
        return self.mirror * (course_rad - self.course_rad)

    def vector(self, east: float, north: float) -> tuple[float, float]:
        """Return a vector of the plane as (x, y)."""
        sin_c, cos_c = math.sin(self.course_rad), math.cos(self.course_rad)
        return self.mirror * (east * cos_c - north * sin_c), east * sin_c + north * cos_c

    def place(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return a place of the plane as (x, y)."""
        return self.vector(east_m - self.east_m, north_m - self.north_m)

    def places(self, east_m: FloatArray, north_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return many places, arrays of any one shape."""
        sin_c, cos_c = math.sin(self.course_rad), math.cos(self.course_rad)
        east_m, north_m = east_m - self.east_m, north_m - self.north_m
        return self.mirror * (east_m * cos_c - north_m * sin_c), east_m * sin_c + north_m * cos_c


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """All in the watch frame at the departure: the target's and the air's motion, and how far both are known.

    sigma_position_m and sigma_velocity_m_s are one standard deviation along the worst direction; the course's is
    zero for a sector, which does not turn with the target.
    """

    velocity_m_s: tuple[float, float]
    wind: Wind  # east_m_s and north_m_s stand for x and y
    airspeed_m_s: float
    sigma_position_m: float
    sigma_velocity_m_s: float
    sigma_course_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """Places relative to the target, headings and times since departure along n lines: arrays (n, k)."""

    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    time_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where lines begin in the watch frame."""

    x_m: float
    y_m: float
    heading_rad: float


def outlook(
    x_m: FloatArray, y_m: FloatArray, heading_rad: FloatArray, arc_m: FloatArray, situation: Situation
) -> Outlook:
    """Return the outlook of lines over the ground (n, k), given in the frame at departure.

    The aircraft holds its line; the wind only makes it faster or slower along it. Rows may end in repeated samples.
    """
    if situation.wind.speed_m_s == 0.0:
        time = arc_m / situation.airspeed_m_s
    else:
        slowness = 1.0 / ground_speeds_m_s(heading_rad, situation.airspeed_m_s, situation.wind)
        time = np.zeros_like(arc_m)
        np.cumsum(np.diff(arc_m, axis=1) * 0.5 * (slowness[:, 1:] + slowness[:, :-1]), axis=1, out=time[:, 1:])
    velocity_x, velocity_y = situation.velocity_m_s
    return Outlook(x_m - velocity_x * time, y_m - velocity_y * time, heading_rad, time)


@dataclass(frozen=True, slots=True, eq=False)
class RollOut:
    """Rolls lines forward in one situation. All costs are expected, discounted, and include the end's worth.

    step_m: between samples. beyond_m: how far each line follows its circle before the table is believed.
    """

    situation: Situation
    cost: WatchCost
    table: MotionTable
    step_m: float
    beyond_m: float = 0.0

    def outlook(self, lines: Trapezoids, start: Start) -> Outlook:
        """Return the outlook of trapezoids."""
        arc = lines.coarse_arcs_m(self.step_m, self.beyond_m)
        east, north = lines.displaced_m(arc, start.heading_rad)
        heading = start.heading_rad + lines.turned_rad(arc)
        return outlook(start.x_m + east, start.y_m + north, heading, arc, self.situation)

    def costs(self, lines: Trapezoids, start: Start) -> FloatArray:
        """Return the cost (n,) of flying each trapezoid."""
        return self.costs_of(self.outlook(lines, start))

    def costs_of(self, seen: Outlook) -> FloatArray:
        """Return the cost (n,) of flying each line of an outlook."""
        running, end_weight = self._running_costs(seen)
        end = self.table.value(seen.x_m[:, -1], seen.y_m[:, -1], seen.heading_rad[:, -1])
        total: FloatArray = running + end_weight * end
        return total

    def _running_costs(self, seen: Outlook) -> tuple[FloatArray, FloatArray]:
        """Return the cost (n,) along each line, and what a cost at its end counts."""
        hazard_per_s = 1.0 / self.table.mean_leg_s
        weight = np.exp(-(self.table.discount_per_s + hazard_per_s) * seen.time_s)
        step = np.zeros_like(seen.time_s)
        half = 0.5 * np.diff(seen.time_s, axis=1)
        step[:, 1:] += half
        step[:, :-1] += half
        situation = self.situation
        sigma = np.hypot(situation.sigma_position_m, situation.sigma_velocity_m_s * seen.time_s)
        blur = 1.0 + np.hypot(sigma, situation.sigma_course_rad * seen.y_m)
        total: FloatArray = np.sum(self.cost.rate(seen.x_m, seen.y_m, sigma, blur) * weight * step, axis=1)
        every = slice(0, None, _TURN_STRIDE)
        turned = self.table.expected_after_turn(seen.x_m[:, every], seen.y_m[:, every], seen.heading_rad[:, every])
        held = np.diff(seen.time_s[:, every], axis=1, append=seen.time_s[:, -1:])
        total += hazard_per_s * np.sum(turned * weight[:, every] * held, axis=1)
        return total, weight[:, -1]
