"""Where the target is on its route, for the control step and for displays."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import Planner
from sidelong.mission.route.progress_kernel import (
    ALONG_M,
    DIRECTION,
    LAST_S,
    OFF_CHANCE,
    ON_ROUTE,
    SPEED_M_S,
    hypotheses,
    likeliest,
)
from sidelong.mission.route.route import Route


@dataclass(frozen=True, slots=True)
class RouteProgress:
    """The target's progress along its route.

    Attributes:
        on_route: Whether the target follows the route.
        along_m: Position along the route, m; NaN where it is unknown.
        length_m: Length of the route, m.
        speed_m_s: Speed along the route, negative against its direction, m/s; NaN where it is unknown.
        probability: Probability that the target follows the route, 0..1.
        to_end_s: Time to the end of the route at this speed, s; NaN for a lap, and where it is unknown.

    """

    on_route: bool
    along_m: float
    length_m: float
    speed_m_s: float
    probability: float
    to_end_s: float


@runtime_checkable
class RoutePlanner(Planner, Protocol):
    """A planner that plans along a known route."""

    def follow(self, route: Route) -> None:
        """Expect the target on this route from the next decision on.

        Args:
            route: The route.

        """
        ...

    @property
    def route_progress(self) -> RouteProgress | None:
        """The target's progress; None without a route, and before the first estimate."""
        ...


def progress_of(route: Route, memory: FloatArray) -> RouteProgress | None:
    """Return what the filter's memory says; None before its first update.

    Args:
        route: The route.
        memory: Memory of the filter.

    Returns:
        The progress; None before the filter's first update.

    """
    if math.isnan(memory[LAST_S]):
        return None
    best, on_route = likeliest(memory), bool(memory[ON_ROUTE] > 0.0)
    along_m = speed_m_s = to_end_s = math.nan
    if best >= 0 and on_route:
        one = hypotheses(memory)[best]
        along_m, speed_m_s = float(one[ALONG_M]), float(one[SPEED_M_S])
        if not route.lap and abs(speed_m_s) > 0.1:
            to_end_s = (route.length_m - along_m if one[DIRECTION] > 0.0 else along_m) / abs(speed_m_s)
    return RouteProgress(on_route, along_m, route.length_m, speed_m_s, 1.0 - float(memory[OFF_CHANCE]), to_end_s)


def describe(progress: RouteProgress) -> str:
    """Return the progress in a few words.

    Args:
        progress: The target's progress along the route.

    """
    if not progress.on_route:
        return "off route"
    return f"{progress.along_m:.0f} of {progress.length_m:.0f} m along the route"
