"""Where the target is on its route, for the control step and for displays.

Source: docs/routes.md#how-the-route-is-used; histogram filter, Thrun, Burgard, Fox, *Probabilistic Robotics*, 2005,
section 4.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import Planner
from sidelong.mission.route.progress_kernel import (
    Progress,
    RouteArrays,
    fresh_progress,
    update_progress,
)
from sidelong.mission.route.route import Direction, Route, route_from
from sidelong.mission.viewpoint.course_hold import known

_DIRECTIONS = {Direction.FORWARD: 1.0, Direction.BACKWARD: -1.0, Direction.EITHER: 0.0}
_UPDATE_S = 0.9  # the planner processes one estimate each second


@dataclass(frozen=True, slots=True)
class RouteProgress:
    """The target's progress along its route.

    Attributes:
        along_m: Position along the route, m; NaN where it is unknown.
        speed_m_s: Speed along the route, negative against its direction, m/s; NaN where it is unknown.
        probability: Probability that the target follows the route, 0..1.
        to_end_s: Time to the end of the route at this speed, s; NaN for a lap, and where it is unknown.
        of_use: Whether it is planned along: whether forecasts along it have been better than straight on.
    """

    route: Route
    on_route: bool
    along_m: float
    speed_m_s: float
    probability: float
    to_end_s: float
    of_use: bool = True

    def places_m(self, in_s: FloatArray) -> FloatArray:
        """Return where (n, 2) the target is expected after times (n,) at its present speed; NaN where unknown.

        Args:
            in_s: Times from now (n,), s.
        """
        return self.route.points_m(self.along_m + self.speed_m_s * in_s)


@runtime_checkable
class RoutePlanner(Planner, Protocol):
    """A planner that plans along a known route."""

    def follow(self, route: Route | None, progress: Progress) -> None:
        """Expect the target on this route from the next decision on.

        Args:
            route: The route; None: none is known.
            progress: State of the progress filter, of :func:`fresh_progress`; decisions update it.
        """


def way_of(route: Route) -> RouteArrays:
    """Return a route as the loops see it."""
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
    """Return what the filter knows: off route before the first update."""
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
