"""The expected route of the target, a line in the plane with a tolerance, and where the target is on it.

Source: docs/routes.md; histogram filter, Thrun, Burgard, Fox, *Probabilistic Robotics*, 2005, section 4.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import Planner
from sidelong.mission.route.progress_kernel import Progress, RouteArrays, fresh_progress, update_progress
from sidelong.mission.viewpoint.watch_course import known

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
    """A route, resampled to points (n,) of the local plane, spacing_m apart; see :class:`RouteGiven`.

    speed_m_s: NaN where it is unknown.
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
        """Return the points (n, 2), east and north, at positions along the route (n,); clipped to its ends."""
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
    """Resample way points (n,) or a dense line to a route.

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
    """Return a route as the event that :func:`route_from` reads."""
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


_DIRECTIONS = {Direction.FORWARD: 1.0, Direction.BACKWARD: -1.0, Direction.EITHER: 0.0}
_UPDATE_S = 0.9  # the planner processes one estimate each second


@dataclass(frozen=True, slots=True)
class RouteProgress:
    """The target's progress along its route; positions, speeds and times are NaN where they are unknown.

    speed_m_s: negative against the route's direction. probability: that the target follows the route, 0..1. to_end_s:
    at this speed, NaN for a lap. of_use: whether forecasts along it have been better than straight on.
    """

    route: Route
    on_route: bool
    along_m: float
    speed_m_s: float
    probability: float
    to_end_s: float
    of_use: bool = True

    def places_m(self, in_s: FloatArray) -> FloatArray:
        """Return where (n, 2) the target is expected after times (n,) at its present speed; NaN where unknown."""
        return self.route.points_m(self.along_m + self.speed_m_s * in_s)


@runtime_checkable
class RoutePlanner(Planner, Protocol):
    """A planner that plans along a known route."""

    def follow(self, route: Route | None, progress: Progress) -> None:
        """Expect the target on this route, if any, from the next decision on; decisions update the progress."""


def way_of(route: Route) -> RouteArrays:
    """Return a route as the compiled functions take it."""
    points = np.ascontiguousarray(np.stack([route.east_m, route.north_m], axis=1))
    direction = _DIRECTIONS[route.direction]
    return RouteArrays(points, route.spacing_m, route.lap, route.tolerance_m, route.speed_m_s, direction)


class RouteFollower:
    """Estimates a target's progress along a route from its estimates; ``progress`` is the state of the filter."""

    def __init__(self, route: Route) -> None:
        self.route, self.progress = route, fresh_progress(route.east_m.size)
        self._way, self._at_s = way_of(route), -math.inf

    def update(self, target: TargetEstimate) -> RouteProgress | None:
        """Process an estimate, in order of time; None if less than a second has passed since the last one."""
        if target.time_s < self._at_s + _UPDATE_S:
            return None
        self._at_s = target.time_s
        update_progress(self._way, known(target), self.progress)
        return progress_of(self.route, self.progress)


def follower_of(given: RouteGiven) -> RouteFollower | None:
    """Return the follower of a flight's route; None where the flight could not use it."""
    try:
        return RouteFollower(route_from(given))
    except ValueError:
        return None


def progress_of(route: Route, progress: Progress) -> RouteProgress:
    """Return the target's progress by the state of the filter; off route before the first update."""
    state = progress.state[0]
    on_route = bool(state.on_route)
    along_m = speed_m_s = to_end_s = math.nan
    if on_route:
        along_m, speed_m_s = float(state.along_m), float(state.speed_m_s)
        if not route.lap and abs(speed_m_s) > 0.1:
            to_end_s = (route.length_m - along_m if state.direction > 0.0 else along_m) / abs(speed_m_s)
    probability, of_use = 1.0 - float(state.off_chance), bool(state.of_use)
    return RouteProgress(route, on_route, along_m, speed_m_s, probability, to_end_s, of_use)


def describe(progress: RouteProgress) -> str:
    """Return the progress in a few words."""
    if not progress.on_route:
        return "off route"
    to_end = f", {progress.to_end_s:.0f} s to its end" if math.isfinite(progress.to_end_s) else ""
    not_used = "" if progress.of_use else ", not used: straight on predicts the target better"
    return f"{progress.along_m:.0f} of {progress.route.length_m:.0f} m along the route{to_end}{not_used}"
