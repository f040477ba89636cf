"""The expected route of the target: a line in the plane, with a tolerance. Source: docs/routes.md."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.path import FloatArray

POINT_EVERY_M = 4.0
REACH_M = 1e8  # no point of the Earth is farther from the origin
_POINTS_MAX = 20_000
_SAME_POINT_M = 0.05


class Direction(StrEnum):
    """In which direction the target follows the route."""

    FORWARD = "forward"
    BACKWARD = "backward"
    EITHER = "either"


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A route, resampled to evenly spaced points.

    Attributes:
        east_m: East of the points (n,), in the local plane.
        north_m: North of the points (n,), in the local plane.
        spacing_m: Distance between points along the route.
        lap: Whether the target continues at the first point after the last one.
        tolerance_m: One standard deviation of the target's lateral offset from the route.
        speed_m_s: Expected speed along the route; NaN: unknown.
        direction: Direction in which the target follows the points.
    """

    east_m: FloatArray
    north_m: FloatArray
    spacing_m: float
    lap: bool = False
    tolerance_m: float = 10.0
    speed_m_s: float = math.nan
    direction: Direction = Direction.EITHER

    @property
    def length_m(self) -> float:
        """Length of the route, of one lap if it is one."""
        return self.spacing_m * (self.east_m.size - (0 if self.lap else 1))

    def points_m(self, along_m: FloatArray) -> FloatArray:
        """Return the points (n, 2), east and north, at positions along the route (n,); clipped to its ends.

        Args:
            along_m: Positions along the route (n,), m.
        """
        count = self.east_m.size + (1 if self.lap else 0)
        at_m = np.mod(along_m, self.length_m) if self.lap else along_m
        arc_m = self.spacing_m * np.arange(count)
        rows = (np.append(row, row[0]) if self.lap else row for row in (self.east_m, self.north_m))
        return np.stack([np.interp(at_m, arc_m, row) for row in rows], axis=1)

    def outline_m(self, points_max: int) -> FloatArray:
        """Return points (n, 2) of the route for a drawing, n <= points_max; the first one is repeated for a lap."""
        drawn = self.points_m(np.linspace(0.0, self.length_m, min(points_max, self.east_m.size + 1)))
        return np.concatenate([drawn[:-1], drawn[:1]]) if self.lap else drawn


def route_of(
    east_m: FloatArray,
    north_m: FloatArray,
    *,
    lap: bool = False,
    tolerance_m: float = 10.0,
    speed_m_s: float = math.nan,
    direction: Direction = Direction.EITHER,
) -> Route:
    """Resample way points or a dense line to a route.

    Args:
        east_m: East of the way points (n,).
        north_m: North of the way points (n,).
        lap: Whether the last way point connects to the first one.

    Raises:
        ValueError: There are fewer than two different points, or a coordinate is out of range.
    """
    points_m = np.stack([np.asarray(east_m, np.float64), np.asarray(north_m, np.float64)])
    if not (np.abs(points_m) <= REACH_M).all():
        raise ValueError(f"a coordinate of the route is not a finite number up to {REACH_M:g} m")
    if lap and points_m.shape[1]:
        points_m = np.concatenate([points_m, points_m[:, :1]], axis=1)
    # Of points that lie close together, one is kept for each _SAME_POINT_M of the way.
    apart = np.floor(np.cumsum(np.hypot(*np.diff(points_m, prepend=points_m[:, :1]))) / _SAME_POINT_M)
    points_m = points_m[:, np.diff(apart, prepend=-1.0) > 0.0]
    if points_m.shape[1] < 2:
        raise ValueError("a route needs at least two different points")
    arc_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(points_m))))
    count = min(max(math.ceil(arc_m[-1] / POINT_EVERY_M), 1), _POINTS_MAX)
    at_m = np.linspace(0.0, arc_m[-1], count + 1)
    at_m = at_m[:-1] if lap else at_m
    east, north = (np.interp(at_m, arc_m, row) for row in points_m)
    return Route(east, north, float(arc_m[-1] / count), lap, tolerance_m, speed_m_s, direction)


def event_of(route: Route, time_s: float) -> RouteGiven:
    """Return a route as the event that :func:`route_from` reads.

    Args:
        time_s: Time of the event, vehicle's clock, s.
    """
    way = tuple(route.east_m.tolist()), tuple(route.north_m.tolist())
    speed_m_s = None if math.isnan(route.speed_m_s) else route.speed_m_s
    return RouteGiven(time_s, *way, route.lap, route.tolerance_m, speed_m_s, route.direction.value)


def route_from(given: RouteGiven) -> Route:
    """Return the route of an event.

    Raises:
        ValueError: The points are not a route; see :func:`route_of`.
    """
    return route_of(
        np.array(given.east_m),
        np.array(given.north_m),
        lap=given.lap,
        tolerance_m=given.tolerance_m,
        speed_m_s=math.nan if given.speed_m_s is None else given.speed_m_s,
        direction=Direction(given.direction),
    )
