"""The cost of each role for every aircraft and target. Source: docs/explanation/planners.md#several-aircraft."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Aircraft, Requirement
from sidelong.mission.fleet.clocks import shifted_plan
from sidelong.mission.fleet.roles import RoleCosts
from sidelong.mission.fleet.vehicle import FleetVehicle
from sidelong.mission.route.progress import RouteFollower, follower_of
from sidelong.mission.viewpoint.course_hold import CourseHold
from sidelong.mission.viewpoint.side_policy import SidePolicy

if TYPE_CHECKING:
    from sidelong.mission.fleet.team_planner import TeamPlanner

MakeJudge = Callable[[str, Aircraft, Requirement], "TeamPlanner"]


class WatchedCourse:
    """The course that defines the sides for a whole fleet, of one target from its first sighting on.

    course_rad: the one made good over the requirement's horizon. While the way is still short, the present one, held
    while the target stands; before it has moved, one by which the first aircraft is on the required side; None until
    there is an aircraft.
    """

    def __init__(self, requirement: Requirement) -> None:
        self._normal_turn_rad = requirement.side.normal_turn_rad
        self._policy = SidePolicy(requirement, 0.0, requirement.course_horizon_s)
        self._hold = CourseHold()
        self._presumed_rad: float | None = None
        self.course_rad: float | None = None

    def update(self, target: TargetEstimate, first: AircraftState | None) -> None:
        """Take an estimate, in the order of time. first: the aircraft that began to watch first, None before.

        Args:
            first: State of the first aircraft that watched; None before.
        """
        self._policy.viewpoint(target.east_m, target.north_m, target)
        if first is not None and self._presumed_rad is None:
            away_rad = math.atan2(first.east_m - target.east_m, first.north_m - target.north_m)
            self._presumed_rad = away_rad - self._normal_turn_rad
        held_rad, made_good_rad = self._hold.update(target), float(self._policy.memory[0].made_good_rad)
        if not math.isnan(made_good_rad):
            self.course_rad = made_good_rad
        else:
            self.course_rad = self._presumed_rad if held_rad is None else held_rad


class RoleJudges:
    """One judge for each aircraft and target, all by the target's one course."""

    def __init__(self, make_judge: MakeJudge) -> None:
        self._make_judge = make_judge
        self._judges: dict[tuple[str, str], TeamPlanner] = {}
        self._wanted: dict[str, Requirement] = {}
        self._courses: dict[str, WatchedCourse] = {}
        self._followers: dict[str, RouteFollower] = {}

    def ask(self, target: str, wanted: Requirement, fleet: Iterable[FleetVehicle]) -> None:
        """Judge by this requirement of a target from now on."""
        self._wanted[target] = wanted
        self._courses.setdefault(target, WatchedCourse(wanted))
        for one in fleet:
            self._judges[one.member.name, target] = self._make_judge(one.member.name, one.member.aircraft, wanted)
        self._expect_on_route(target)

    def expect(self, target: str, given: RouteGiven) -> None:
        """Expect a target on a route from now on.

        Args:
            given: The route; not used if its points are no route.
        """
        follower = follower_of(given)
        if follower is not None:
            self._followers[target] = follower
            self._expect_on_route(target)

    def _expect_on_route(self, target: str) -> None:
        follower = self._followers.get(target)
        if follower is not None:
            for (_, watched), judge in self._judges.items():
                if watched == target:
                    judge.follow(follower.route, follower.progress)

    def follow(self, estimates: Mapping[str, TargetEstimate | None], fleet: Iterable[FleetVehicle]) -> None:
        """Take the targets' estimates, in the order of time."""
        for name, estimate in estimates.items():
            if estimate is not None and estimate.quality is not TrackQuality.LOST:
                watching = [one for one in fleet if one.takes_part and one.target == name]
                first = min(watching, key=lambda one: one.since_s).report if watching else None
                self._courses[name].update(estimate, None if first is None else first.state)
                if name in self._followers:
                    self._followers[name].update(estimate)

    def course_rad(self, target: str) -> float | None:
        """Return the course of a target whose sides count."""
        return self._courses[target].course_rad

    def costs(self, vehicle: FleetVehicle, target: str, estimate: TargetEstimate) -> RoleCosts | None:
        """Return what an aircraft would pay from its next departure on; None before its plan is known."""
        report = vehicle.report
        present = None if vehicle.plans is None else shifted_plan(vehicle.plans.present, vehicle.clock.offset_s)
        if report is None or present is None:
            return None
        judge, course_rad = self._judges[vehicle.member.name, target], self.course_rad(target)
        if course_rad is not None:
            judge.presume(course_rad)
        return judge.role_costs(report.state, estimate, present, report.wind, report.latency_s)

    def way_s(self, vehicle: FleetVehicle, target: str, estimate: TargetEstimate) -> float:
        """Return how long an aircraft needs to a target, 0 where it is at it."""
        range_m = vehicle.range_m(estimate)
        at_it = range_m <= self._wanted[target].range_max_m
        return 0.0 if at_it else range_m / vehicle.member.aircraft.airspeed_m_s

    def costs_from_afar(self, vehicle: FleetVehicle, target: str, estimate: TargetEstimate) -> RoleCosts:
        """Return what an aircraft would pay in each role at a target, the flight there included."""
        costs = self.costs(vehicle, target, estimate) or RoleCosts(0.0, 0.0)
        way_s = self.way_s(vehicle, target, estimate)
        return RoleCosts(costs.wanted_s + way_s, costs.opposite_s + way_s)
