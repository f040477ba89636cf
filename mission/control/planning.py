"""The planner in use, and the data that it needs. Source: docs/explanation/planners.md."""

from __future__ import annotations

import math

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.fleet import CooperativePlanner, FleetAdvice, NeighbourPlanned
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import AircraftState, Decision, Plan, Planner, PlannerFactory, WindPlanner
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind
from sidelong.mission.geometry.approach import approach
from sidelong.mission.geometry.progress import dead_reckoned
from sidelong.mission.route.progress import RoutePlanner, RouteProgress, describe, progress_of
from sidelong.mission.route.progress_kernel import fresh_progress
from sidelong.mission.route.route import Route, route_from

# Fleet advice expires after this time.
_ADVICE_S = 5.0
# Minimum duration of an approach, while its circle is still within the target's range.
_APPROACH_S = 10.0


class Planning:
    """Holds the planner and rebuilds it when the aircraft or the requirement changes.

    ``make_planner`` builds it within one control step, from data in memory. ``prepared_winds_m_s`` are the wind
    speeds prepared in flight.
    """

    def __init__(self, make_planner: PlannerFactory, aircraft: Aircraft, requirement: Requirement) -> None:
        self.make_planner = make_planner
        self.prepared_winds_m_s: list[float] = []
        self._aircraft, self._requirement = aircraft, requirement
        self._advice: FleetAdvice | None = None
        self._neighbours: dict[str, NeighbourPlanned] = {}
        self._route: Route | None = None
        self._progress = fresh_progress(0)  # along the route: a new planner continues with it
        self._route_reported = (False, False)  # on the route; and of use
        self.planner: Planner = make_planner(aircraft, requirement)

    def renew(self, aircraft: Aircraft, requirement: Requirement) -> None:
        """Rebuild the planner for a new aircraft or requirement."""
        self._aircraft, self._requirement = aircraft, requirement
        self.planner = self.make_planner(aircraft, requirement)
        if isinstance(self.planner, WindPlanner):
            for speed_m_s in self.prepared_winds_m_s:
                self.planner.prepare(speed_m_s)
        if self._route is not None and isinstance(self.planner, RoutePlanner):
            self.planner.follow(self._route, self._progress)
        if isinstance(self.planner, CooperativePlanner):
            for news in (*self._neighbours.values(), *(() if self._advice is None else (self._advice,))):
                self.planner.advise(news)

    def prepare_wind(self, speed_m_s: float) -> bool:
        """Prepare the planner for winds of a speed from tables in memory; return whether that is new."""
        if speed_m_s in self.prepared_winds_m_s or not isinstance(self.planner, WindPlanner):
            return False
        self.prepared_winds_m_s.append(speed_m_s)
        self.planner.prepare(speed_m_s)
        return True

    # -- the route -----------------------------------------------------------------------------------------

    def follow(self, given: RouteGiven) -> str:
        """Expect the target on a route; return in words what that means for planning."""
        if not isinstance(self.planner, RoutePlanner):
            return "this planner does not use a route"
        try:
            self._route = route_from(given) if given.east_m else None
        except ValueError as error:
            return f"the route is not used: {error}"
        self._route_reported, self._progress = (False, False), self._fresh_progress()
        self.planner.follow(self._route, self._progress)
        if self._route is None:
            return "no route of the target is known"
        return f"the target is expected on a route of {self._route.length_m:.0f} m"

    def _fresh_progress(self) -> FloatArray:
        return fresh_progress(0 if self._route is None else self._route.east_m.size)

    @property
    def route_progress(self) -> RouteProgress | None:
        """The target's progress along its route; None without a route."""
        return None if self._route is None else progress_of(self._route, self._progress)

    def route_news(self) -> str:
        """Return in words whether the target has joined or left its route, or its use has changed; '' if neither."""
        progress = self.route_progress
        if progress is None:
            return ""
        now = progress.on_route, progress.on_route and progress.of_use
        if now == self._route_reported:
            return ""
        self._route_reported = now
        if progress.on_route:
            return f"on route: the target is {describe(progress)}"
        return "off route: the target has left its route, and sidelong plans without it"

    # -- the fleet -----------------------------------------------------------------------------------------

    def advise(self, news: FleetAdvice | NeighbourPlanned) -> None:
        """Pass fleet advice, or a neighbour's plan, to the planner."""
        before = self.target
        if isinstance(news, NeighbourPlanned):
            self._neighbours[news.name] = news
        else:
            self._advice = news
            if before not in ("", news.target):  # the planner's memory belongs to another target
                self._progress[:] = self._fresh_progress()
                self.renew(self._aircraft, self._requirement)
        if isinstance(self.planner, CooperativePlanner):
            self.planner.advise(news)

    @property
    def target(self) -> str:
        """Name of the target that the fleet assigns; '' without a fleet and before its first advice."""
        return "" if self._advice is None else self._advice.target

    @property
    def turn_payload(self) -> bool:
        """Whether the payload looks at another target than that."""
        return self._advice is not None and self._advice.turn_payload

    @property
    def layer_m(self) -> float:
        """Height above home of the layer that the fleet gives the aircraft, m; -inf without a fleet."""
        return -math.inf if self._advice is None else self._advice.height_m

    def too_near(self, time_s: float) -> str:
        """Return which other aircraft is too near.

        Returns:
            In words; '' if none is, and without fresh advice.
        """
        advice = self._advice
        return "" if advice is None or time_s - advice.time_s > _ADVICE_S else advice.separation

    def watch_from(self, requirement: Requirement) -> None:
        """Plan for the side that the fleet assigns; a cooperative planner receives the side with the advice."""
        if isinstance(self.planner, CooperativePlanner):
            self._requirement = requirement
        else:
            self.renew(self._aircraft, requirement)

    def joint_estimate(self, time_s: float) -> TargetEstimate | None:
        """Return the fleet's estimate of the target.

        Returns:
            The estimate; None if it is old or lost.
        """
        advice = self._advice
        if advice is None or advice.estimate is None or time_s - advice.time_s > _ADVICE_S:
            return None
        return None if advice.estimate.quality is TrackQuality.LOST else advice.estimate

    # -- deciding ------------------------------------------------------------------------------------------

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        """See :class:`sidelong.mission.core.plan.Planner`. Out of the band, approach a circle next to the target."""
        range_m = math.hypot(aircraft.east_m - target.east_m, aircraft.north_m - target.north_m)
        if range_m <= self._requirement.range_max_m:
            return self.planner.decide(aircraft, target, present, wind, latency_s)
        start = dead_reckoned(aircraft, latency_s)
        plan = approach(start, target, self._aircraft, self._requirement)
        circle = present.circle
        off_m = math.hypot(plan.circle.east_m - circle.east_m, plan.circle.north_m - circle.north_m)
        ahead_m = math.hypot(circle.east_m - target.east_m, circle.north_m - target.north_m) + circle.radius_m
        begun = present.transition is not None and aircraft.time_s - present.departure_s < _APPROACH_S
        if off_m < 0.5 * self._aircraft.radius_m or (begun and ahead_m < self._requirement.range_max_m):
            return Decision(aircraft.time_s, None, f"on the way to the target, {range_m:.0f} m to go")
        return Decision(aircraft.time_s, plan, f"approaching: the target is {range_m:.0f} m away")
