"""Keep-in and keep-out polygons in the plane, a floor and a ceiling. Source: docs/explanation/safety.md."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from shapely import LineString, Point, Polygon, contains, distance, get_parts, intersection_all, points, union_all

from sidelong.mission.core.plan import Plan

Outline = Sequence[tuple[float, float]]

_AREA_MIN_M2 = 1.0
_QUARTER_CIRCLE_SEGMENTS = 32  # keeps the polygon within 0.06 % of the radius


class FenceError(ValueError):
    """A fence that is no polygon."""


class Fences:
    """Fences in the local plane; outlines are corners (east, north) in order, without repeating the first.

    The aircraft stays inside the union of ``keep_in`` (anywhere, where there is none), outside each of
    ``keep_out``, and ``margin_m`` from every border: for what the flown line is off the planned one. Heights are
    above home. Raises FenceError naming a polygon with fewer than three corners or crossing sides.
    """

    def __init__(
        self,
        keep_in: Sequence[Outline] = (),
        keep_out: Sequence[Outline] = (),
        floor_m: float | None = None,
        ceiling_m: float | None = None,
        margin_m: float = 20.0,
    ) -> None:
        inside = _polygons(keep_in, "keep_in polygon")
        self._keep_in = union_all(list(inside.values())) if inside else None
        self._keep_out = _polygons(keep_out, "keep_out polygon")
        self._floor_m, self._ceiling_m, self._margin_m = floor_m, ceiling_m, margin_m

    def has_room(self, radius_m: float) -> bool:
        """Return whether a circle of this radius fits anywhere into the keep-in polygons."""
        if self._keep_in is None:
            return True
        without_holes = [Polygon(part.exterior) for part in get_parts(self._keep_in)]  # a circle may surround a hole
        return not union_all(without_holes).buffer(-radius_m - self._margin_m).is_empty

    def rejection(self, plan: Plan, height_m: float) -> str | None:
        """Return in words which part of a plan at a height above home breaks which fence; None if none is broken.

        The whole transition and the whole circle are checked; of a plan without a transition the circle alone, as the
        autopilot's path to it is unknown. A transition that begins outside may only lead back.
        """
        if self._floor_m is not None and height_m < self._floor_m:
            return f"the height of {height_m:.0f} m is below the floor of {self._floor_m:.0f} m"
        if self._ceiling_m is not None and height_m > self._ceiling_m:
            return f"the height of {height_m:.0f} m is above the ceiling of {self._ceiling_m:.0f} m"
        if self._keep_in is None and not self._keep_out:
            return None
        if plan.transition is not None:
            line = LineString(np.column_stack((plan.transition.east_m, plan.transition.north_m)))
            broken = self._broken_by("the transition", line)
            if broken is not None and not self._leads_back(plan):
                return broken
        circle = plan.circle
        disc = Point(circle.east_m, circle.north_m).buffer(circle.radius_m, quad_segs=_QUARTER_CIRCLE_SEGMENTS)
        return self._broken_by("the new circle", disc.exterior)

    def inside_m(self, east_m: Any, north_m: Any) -> Any:
        """Return how far positions are inside the fences, m; negative: outside. Scalars or arrays of one shape."""
        found = np.full(np.shape(east_m), np.inf)
        if self._keep_in is None and not self._keep_out:
            return found
        places = points(east_m, north_m)
        if self._keep_in is not None:
            sign = np.where(contains(self._keep_in, places), 1.0, -1.0)
            found = sign * distance(places, self._keep_in.boundary)
        for polygon in self._keep_out.values():
            sign = np.where(contains(polygon, places), -1.0, 1.0)
            found = np.minimum(found, sign * distance(places, polygon.boundary))
        return found

    def _leads_back(self, plan: Plan) -> bool:
        """Return whether a transition that begins too near to a border, or outside, leads away from it for good."""
        path = plan.transition
        assert path is not None
        inside_m = self.inside_m(path.east_m, path.north_m) - self._margin_m
        allowed = inside_m >= 0.0
        if allowed[0] or not allowed.any():
            return False
        back = int(np.argmax(allowed))
        turns_m = 2.0 * plan.circle.radius_m + self._margin_m
        return bool(allowed[back:].all() and inside_m[:back].min() >= inside_m[0] - turns_m)

    def check(self, height_m: float) -> Callable[[Plan], str | None]:
        """Return :meth:`rejection` as a function of the plan alone; height_m: of plans without heights."""

        def rejection(plan: Plan) -> str | None:
            return self.rejection(plan, plan.circle_height_m(height_m))

        return rejection

    def _broken_by(self, part: str, line: Any) -> str | None:
        if self._keep_in is not None:
            if not self._keep_in.contains(line):
                return f"{part} leaves the keep_in polygons"
            near_m = line.distance(self._keep_in.boundary)
            if near_m < self._margin_m:
                return f"{part} comes within {near_m:.0f} m of the keep_in border, less than {self._margin_m:.0f} m"
        for name, polygon in self._keep_out.items():
            near_m = line.distance(polygon)
            if near_m == 0.0:
                return f"{part} crosses {name}"
            if near_m < self._margin_m:
                return f"{part} comes within {near_m:.0f} m of {name}, less than {self._margin_m:.0f} m"
        return None


def intersection(
    keep_in: Sequence[Outline], inclusion: Sequence[Outline], every: bool
) -> tuple[list[Outline], list[Outline]]:
    """Return the area inside both the union of ``keep_in``, if any, and other fences, as outlines and their holes.

    Args:
        every: Whether all of the other fences, at least one, have to be stayed in, or one of them.

    Raises:
        FenceError: One is no polygon, or they have no area in common.
    """
    others = list(_polygons(inclusion, "inclusion fence").values())
    area = intersection_all(others) if every else union_all(others)
    if keep_in:
        area = area.intersection(union_all(list(_polygons(keep_in, "keep_in polygon").values())))
    parts = [part for part in get_parts(area) if part.geom_type == "Polygon" and part.area >= _AREA_MIN_M2]
    if not parts:
        raise FenceError("the inclusion fences and keep_in have no area in common")
    outlines, holes = [part.exterior for part in parts], [hole for part in parts for hole in part.interiors]
    return [list(ring.coords)[:-1] for ring in outlines], [list(ring.coords)[:-1] for ring in holes]


def _polygons(outlines: Sequence[Outline], kind: str) -> dict[str, Any]:
    found = {}
    for name, outline in ((f"{kind} {number}", outline) for number, outline in enumerate(outlines, 1)):
        if len(outline) < 3:
            raise FenceError(f"{name} has {len(outline)} corners; it needs at least three")
        polygon = found[name] = Polygon(outline)
        if polygon.convex_hull.area < _AREA_MIN_M2:
            raise FenceError(f"{name} has no area")
        if not polygon.is_valid:
            raise FenceError(f"{name} has sides that cross")
    return found
