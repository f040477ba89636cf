"""How high a plan is flown over the ground, and whether it can be.

Two ways (``above``):

home    one height for everything; what comes too near to the ground is rejected
ground  each circle has its own height: ``height_m`` above the ground under the target, more where clearance asks for
        it, and the present height where that will do, so that the aircraft climbs and descends little

A descent is never to a height at which the transition would not be clear, so nothing depends on when the autopilot
begins it. A climb has to be steep enough for what lies under the transition.

Source: docs/how-to/hills.md.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.terrain.ground_kernel import (
    Raster,
    climbing_clearance_m,
    height_and_slope,
    heights_at,
    highest_along,
    highest_at,
)
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import ClimbRates, Plan

# A height within this share of the required one is as good.
_HEIGHT_SLACK = 0.2
_ARC_STEP_M = 8.0


@dataclass(frozen=True, slots=True)
class HeightRules:
    """Rules for the height of a plan.

    Attributes:
        height_m: Height above the reference, m.
        above: The reference: home, or the ground below.
        margin_m: The ground within this distance of a path counts as being below it, m.
    """

    height_m: float
    above: Literal["home", "ground"]
    clearance_m: float
    rates: ClimbRates
    margin_m: float = 30.0
    ceiling_m: float = math.inf


class FlightHeights:
    """Gives plans their heights over one ground. Heights are above home."""

    def __init__(self, ground: Ground, rules: HeightRules) -> None:
        self._grid, self._rules = ground.grid, rules
        self._carried = False  # whether plans carry the one height for all: it is not the configured one
        self._highest = _highest_about(ground, rules.margin_m)

    def at(self, height_m: float) -> FlightHeights:
        """See :class:`sidelong.mission.core.plan.Heights`."""
        other = copy(self)
        other._rules, other._carried = replace(self._rules, height_m=height_m), True
        return other

    def levelled(self, plan: Plan, flown_m: float | None, target_m: tuple[float, float] | None = None) -> Plan | str:
        """See :class:`sidelong.mission.core.plan.Heights`.

        Where the ground under the target is unknown, that below the circle serves.
        """
        rules = self._rules
        ring = _ring(plan.circle)
        floor_m = self._highest_along(*ring) + rules.clearance_m
        if math.isinf(floor_m):
            return "the new circle lies over ground of unknown height"
        line = plan.transition
        # The transition's own heights count where no aircraft climbs to the circle's on it.
        line_floor_m = (
            -math.inf if line is None else self._highest_along(line.east_m, line.north_m) + rules.clearance_m
        )
        if math.isinf(line_floor_m) and line_floor_m > 0.0:
            return "the transition leads over ground of unknown height"
        if rules.above == "home":
            return self._fixed(plan, floor_m, line_floor_m, flown_m)
        watched_m = math.nan if target_m is None else height_and_slope(self._grid, *target_m)[0]
        wanted_m = rules.height_m + (
            float(heights_at(self._grid, *ring).mean()) if math.isnan(watched_m) else watched_m
        )
        low_m = max(floor_m, wanted_m - _HEIGHT_SLACK * rules.height_m)
        high_m = max(low_m, wanted_m + _HEIGHT_SLACK * rules.height_m)
        if flown_m is None:
            return self._at(plan, max(floor_m, wanted_m), max(floor_m, wanted_m))
        to_m = min(max(flown_m, low_m), high_m)
        if line is None:
            return self._at(plan, flown_m, to_m)
        if line_floor_m <= min(flown_m, to_m):
            return self._at(plan, flown_m, to_m)
        # Something on the way is higher than one of the two heights.
        if line_floor_m <= flown_m:
            return self._at(plan, flown_m, line_floor_m)
        to_m = max(to_m, line_floor_m)
        clear_m = self._climbing_clearance_m(plan, flown_m, to_m)
        if clear_m < rules.clearance_m:
            return _too_low("the transition", clear_m, rules.clearance_m, ", climbing as fast as it can")
        return self._at(plan, flown_m, to_m)

    def expected_m(self, flown_m: float | None, target_m: tuple[float, float]) -> float:
        """Return the height at which the next circle around a target will be flown, apart from clearance, m.

        Args:
            flown_m: Present height above home, m; None before the first circle.
            target_m: Target's position (east, north), m.
        """
        rules = self._rules
        if rules.above == "home":
            return rules.height_m
        watched_m = height_and_slope(self._grid, *target_m)[0]
        wanted_m = watched_m + (1.0 - _HEIGHT_SLACK) * rules.height_m
        return wanted_m if flown_m is None else flown_m if math.isnan(watched_m) else max(flown_m, wanted_m)

    def clearance_m(self, east_m: float, north_m: float, height_m: float) -> float:
        """Return how far a height is above the ground around a position, m.

        Args:
            height_m: Height above home, m.
        """
        return height_m - highest_at(self._highest, self._grid, east_m, north_m)

    def _fixed(self, plan: Plan, floor_m: float, line_floor_m: float, flown_m: float | None) -> Plan | str:
        rules = self._rules
        if line_floor_m > rules.height_m:
            return _too_low("the transition", rules.height_m - line_floor_m + rules.clearance_m, rules.clearance_m)
        if floor_m > rules.height_m:
            return _too_low("the new circle", rules.height_m - floor_m + rules.clearance_m, rules.clearance_m)
        if not self._carried:
            return plan
        from_m = rules.height_m if flown_m is None else flown_m
        if plan.transition is not None and line_floor_m > from_m:
            clear_m = self._climbing_clearance_m(plan, from_m, rules.height_m)
            if clear_m < rules.clearance_m:
                return _too_low("the transition", clear_m, rules.clearance_m, ", climbing as fast as it can")
        return self._at(plan, from_m, rules.height_m)

    def _at(self, plan: Plan, from_m: float, to_m: float) -> Plan | str:
        rules = self._rules
        if to_m > rules.ceiling_m:
            return (
                f"clear of the ground the new circle is {to_m:.0f} m above home, "
                f"above the ceiling of {rules.ceiling_m:.0f} m"
            )
        return replace(plan, heights=self._rules.rates.profile(from_m, to_m))

    def _climbing_clearance_m(self, plan: Plan, from_m: float, to_m: float) -> float:
        """Return the least clearance from the departure until the aircraft has climbed, at last on the circle."""
        line = plan.transition
        assert line is not None
        slope = self._rules.rates.slope(climbs=True)
        arc_m = np.arange(0.0, line.length_m, _ARC_STEP_M)
        east_m, north_m = np.interp(arc_m, line.arc_m, line.east_m), np.interp(arc_m, line.arc_m, line.north_m)
        left_m = (to_m - from_m) / slope - line.length_m
        if left_m > 0.0:
            circle = plan.circle
            on_m = np.arange(0.0, left_m + _ARC_STEP_M, _ARC_STEP_M)
            begin_rad = math.atan2(line.east_m[-1] - circle.east_m, line.north_m[-1] - circle.north_m)
            angle_rad = begin_rad + circle.curvature_per_m * on_m
            arc_m = np.concatenate((arc_m, line.length_m + on_m))
            east_m = np.concatenate((east_m, circle.east_m + circle.radius_m * np.sin(angle_rad)))
            north_m = np.concatenate((north_m, circle.north_m + circle.radius_m * np.cos(angle_rad)))
        return climbing_clearance_m(self._highest, self._grid, east_m, north_m, arc_m, from_m, to_m, slope)

    def _highest_along(self, east_m: FloatArray, north_m: FloatArray) -> float:
        return highest_along(self._highest, self._grid, east_m, north_m)


def _too_low(part: str, clearance_m: float, wanted_m: float, how: str = "") -> str:
    if clearance_m <= 0.0:
        return f"{part} runs into the ground{how}"
    return f"{part} comes within {clearance_m:.0f} m of the ground{how}, less than {wanted_m:.0f} m"


def _ring(circle: Circle) -> tuple[FloatArray, FloatArray]:
    count = max(32, math.ceil(2.0 * math.pi * circle.radius_m / _ARC_STEP_M))
    angle_rad = np.linspace(0.0, 2.0 * math.pi, count)
    return circle.east_m + circle.radius_m * np.sin(angle_rad), circle.north_m + circle.radius_m * np.cos(angle_rad)


def _highest_about(ground: Ground, margin_m: float) -> Raster:
    """Return for each cell between posts the highest ground within ``margin_m`` of any of its points.

    Bilinear ground is nowhere higher than the posts around it, so no top is missed. Infinite near voids.
    """
    posts = np.where(np.isnan(ground.heights_m), np.float32(np.inf), ground.heights_m)
    cells = np.maximum(posts[:-1, :-1], posts[:-1, 1:])
    np.maximum(cells, posts[1:, :-1], out=cells)
    np.maximum(cells, posts[1:, 1:], out=cells)
    for axis, step_m in ((0, ground.step_north_m), (1, ground.step_east_m)):
        reach = math.ceil(margin_m / step_m)
        beyond = [(reach, reach) if one == axis else (0, 0) for one in (0, 1)]
        padded = np.pad(cells, beyond, constant_values=np.inf)
        cells = sliding_window_view(padded, 2 * reach + 1, axis=axis).max(axis=-1)
    return cells
