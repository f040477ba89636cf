"""The fleet's coordinator: assignment of aircraft to targets, of roles and of reliefs.

Each vehicle keeps its own whole core (input checks, tracker, planner, exchange) and yields separately. The
coordinator commands no vehicle. It sends each core the joint estimate of its target, the side to hold, the positions
of the others (``FleetAdvice``, ``NeighbourPlanned``) and the target's route (``RouteGiven``), as events of that core,
which then decides its own plans. A core that receives no advice for some seconds continues with its own track and its
last side.

How it is used
--------------
After each step of a vehicle's core, in the order of the steps, its
:class:`sidelong.mission.fleet.reports.FleetReporter` returns events. ``step`` takes each of them, and a ``Tick`` at
least once a second. A ``VehicleEvent`` among the commands that it returns is put into the named vehicle's queue and
journal.

Events are :data:`sidelong.mission.fleet.events.FleetEvent`; a ``ClockReported`` has to come first for each vehicle.
All positions are in one local plane and all heights above one home: the shell gives all vehicles the same. Pure: the
same events in the same order lead to the same commands, so that a journal of them replays.

Rules
-----
1. Only what was reported lately counts: an aircraft silent for 5 s has lost its role to the others.
   Mission time goes by the aircraft's clocks: a jump of one aircraft's UTC never moves it; see
   :class:`sidelong.mission.fleet.vehicle.VehicleTime`.
2. Roles are given out each second by expected cost; see :mod:`sidelong.mission.fleet.roles`. The sides are those of
   one course for all, known since the target was first seen (:class:`WatchedCourse`).
3. Relief: an aircraft whose battery is below 30 %, which has watched for its ``endurance_s``, or whose
   relief is asked for gives the required side away, but holds it until the other one is there; a reserve
   is asked for. Below 15 % it leaves in any case. A reserve is also asked for when no aircraft is left.
4. Several targets: aircraft are assigned evenly, by what their roles would cost them at each, the flight there
   included. Those of a lost target go at once, others where all together have gained more than 15 s
   for each that changes, for some seconds. What a payload has seen counts for the target that it looks at:
   another one than before once three sightings in a row lie there.
5. Each aircraft keeps the height layer that it was set up with: layers are never swapped, so nothing has to be
   confirmed before one is free.
6. Aircraft too near to each other raise an alarm; see :mod:`sidelong.mission.fleet.coordinator`.
7. An operator changes the required side (``SideRequested``), for all aircraft and targets at once; a band or radius
   that one core took up (``RequirementReported``) holds for the roles too.

Source: docs/how-to/several-aircraft.md; docs/decisions/0012-fleet-as-a-layer.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.sensing.sighting import AnySighting
from sidelong.estimators.tracking.joint_track import JointTrack
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.fleet import FleetAdvice, Neighbour, NeighbourPlanned, Role
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Aircraft, Requirement
from sidelong.mission.fleet.events import (
    ChargeReported,
    ClockReported,
    FleetAnnounce,
    FleetCommand,
    FleetEvent,
    ForeignAircraftReported,
    LaunchRequested,
    PayloadReported,
    PlansReported,
    ReliefRequested,
    RequirementChanged,
    RequirementReported,
    SideRequested,
    SightingReported,
    TargetRouteGiven,
    Tick,
    VehicleEvent,
    VehicleLost,
    VehicleReported,
)
from sidelong.mission.fleet.roles import Candidate, RoleAssignment, RoleCosts, course_is_known, is_on_station
from sidelong.mission.fleet.vehicle import FleetMember, FleetVehicle, shifted_estimate, shifted_plan, shifted_state
from sidelong.mission.geometry.separation import MIN_SEPARATION_M, circles_apart_m
from sidelong.mission.route.route import RouteFollower, follower_of
from sidelong.mission.viewpoint.watch_course import CourseHold, SidePolicy

if TYPE_CHECKING:
    from sidelong.mission.fleet.team_planner import TeamPlanner

AFTER_S, CLEAR_AFTER_S = 3.0, 5.0
_AIRBORNE_M = 10.0  # above home; lower, aircraft may stand side by side
_REPORT_MAX_AGE_S = 3.0  # positions are extrapolated along the reported velocity for this long


@dataclass(frozen=True, slots=True)
class _Flying:
    name: str
    state: AircraftState
    height_m: float
    ours: bool = False  # commanded by this program
    member: bool = True  # of the fleet
    circle: Circle | None = None


@dataclass(slots=True)
class _Pair:
    """upper: the aircraft that the alarm belongs to; text: '' until it is raised."""

    upper: str
    begun_s: float
    seen_s: float = -math.inf
    text: str = ""


class Proximity:
    """Watches all pairs of aircraft."""

    def __init__(self) -> None:
        self._pairs: dict[frozenset[str], _Pair] = {}

    def watch(
        self, now_s: float, fleet: Iterable[FleetVehicle], foreign: Iterable[ForeignAircraftReported]
    ) -> dict[str, str]:
        """Return the alarms of mission time ``now_s`` in words, by the name of the aircraft that each belongs to."""
        flying = [craft for craft in _all_of(fleet, foreign) if craft.height_m >= _AIRBORNE_M]
        flying.sort(key=lambda craft: (not craft.ours, -craft.height_m, craft.name))
        for upper, lower in combinations(flying, 2):
            if upper.ours:
                self._compare(now_s, upper, lower)
        self._pairs = {key: pair for key, pair in self._pairs.items() if now_s - pair.seen_s < CLEAR_AFTER_S}
        raised: dict[str, list[str]] = {}
        for pair in self._pairs.values():
            if pair.text:
                raised.setdefault(pair.upper, []).append(pair.text)
        return {name: "; ".join(texts) for name, texts in raised.items()}

    def _compare(self, now_s: float, upper: _Flying, lower: _Flying) -> None:
        apart_m, gap_m, crosses = _apart_m(now_s, upper, lower), abs(upper.height_m - lower.height_m), False
        near, level = apart_m < MIN_SEPARATION_M, gap_m < MIN_SEPARATION_M
        if level and upper.circle is not None and lower.circle is not None:
            crosses = math.hypot(circles_apart_m(upper.circle, lower.circle), gap_m) < MIN_SEPARATION_M
        if not (near or crosses or (level and not lower.ours and lower.member)):
            return
        pair = self._pairs.setdefault(frozenset((upper.name, lower.name)), _Pair(upper.name, now_s))
        pair.seen_s = now_s
        other = lower.name if pair.upper == upper.name else upper.name
        if near:
            pair.text = f"only {apart_m:.0f} m from {other}; {MIN_SEPARATION_M:.0f} m are required"
        elif pair.text or now_s - pair.begun_s >= AFTER_S:
            why = "and their circles cross" if crosses else "which was yielded and may come here"
            pair.text = f"the height differs by only {gap_m:.0f} m from that of {other}, {why}"


def _all_of(fleet: Iterable[FleetVehicle], foreign: Iterable[ForeignAircraftReported]) -> Iterator[_Flying]:
    for vehicle in fleet:
        if vehicle.report is not None and not vehicle.yielded:
            plan = vehicle.plans.present if vehicle.plans is not None and vehicle.role is not Role.LEAVE else None
            circle, report = None if plan is None else plan.circle, vehicle.report
            yield _Flying(vehicle.member.name, report.state, report.height_m, ours=True, circle=circle)
    for other in foreign:
        yield _Flying(other.identity, other.state, other.height_m, member=other.member)


def _apart_m(now_s: float, first: _Flying, other: _Flying) -> float:
    """Return the distance at ``now_s`` by the latest reports, m; infinite where a report is too old."""
    places = []
    for state in (first.state, other.state):
        age_s, course_rad = now_s - state.time_s, state.course_rad
        if age_s > _REPORT_MAX_AGE_S:
            return math.inf
        gone_m = state.ground_speed_m_s * age_s
        places.append((state.east_m + gone_m * math.sin(course_rad), state.north_m + gone_m * math.cos(course_rad)))
    return math.hypot(math.dist(*places), first.height_m - other.height_m)


_REASONS = {
    Role.LEAVE: "another aircraft has taken over, or the battery is low",
    Role.OPPOSITE: "another aircraft holds the required side",
    Role.WANTED: "this aircraft is to hold the required side",
}


_SHARE_S = 1e6  # more than anything costs: that a target has less than its even share
_ELSEWHERE_S = 1e9


def assign_evenly(
    targets: Sequence[str], costs: Sequence[Sequence[RoleCosts]], at: Sequence[str], change_s: float
) -> tuple[list[str], float]:
    """Return the assignment of the aircraft to the targets that costs least among the even ones.

    Each target has a position on its required side, then one opposite, and so on in turn. Also returns the gain over
    the present assignment in seconds off the required side, which are the unit of costs and change_s, the price of
    each change; infinite if the aircraft are spread unevenly now, or one has no target.

    Args:
        costs: Costs of each aircraft (rows) at each target (columns), finite.
        at: The present target of each aircraft; any other name if it has none.
    """
    each, odd = divmod(len(costs), len(targets))
    places = [(k, row) for k in range(len(targets)) for row in range(each + (odd > 0))]
    # Every target gets its even share first; the remaining aircraft go where they cost least.
    share_s = np.where([row < each for _, row in places], _SHARE_S, 0.0)
    elsewhere = np.array([[targets[k] != name for k, _ in places] for name in at])
    alongside_s = [[own[k].opposite_s if row % 2 else own[k].wanted_s for k, row in places] for own in costs]
    to_s = alongside_s - share_s + change_s * elsewhere
    best, best_s = _cheapest(to_s)
    _, stay_s = _cheapest(to_s + _ELSEWHERE_S * elsewhere)
    gained_s = stay_s - best_s
    return [targets[places[column][0]] for column in best], math.inf if gained_s > 0.5 * _SHARE_S else gained_s


def _cheapest(to_s: FloatArray) -> tuple[list[int], float]:
    """Return the column of each row's aircraft in the cheapest assignment, and its total cost."""
    rows, columns = linear_sum_assignment(to_s)
    return columns.tolist(), float(to_s[rows, columns].sum())


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
        """Process an estimate, in the order of time. first: the aircraft that began to watch first, if any."""
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

    def set_requirement(self, target: str, wanted: Requirement, fleet: Iterable[FleetVehicle]) -> None:
        """Compute the costs of all aircraft at a target by this requirement from now on."""
        self._wanted[target] = wanted
        self._courses.setdefault(target, WatchedCourse(wanted))
        for member in (vehicle.member for vehicle in fleet):
            self._judges[member.name, target] = self._make_judge(member.name, member.aircraft, wanted)
        self._expect_on_route(target)

    def set_route(self, target: str, given: RouteGiven) -> None:
        """Expect a target on a route from now on; ignored if its points are not a route."""
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
        """Update the targets' courses and route progress by their estimates, in the order of time."""
        for name, estimate in estimates.items():
            if estimate is not None and estimate.quality is not TrackQuality.LOST:
                watching = [vehicle for vehicle in fleet if vehicle.takes_part and vehicle.target == name]
                first = min(watching, key=lambda vehicle: vehicle.since_s).report if watching else None
                self._courses[name].update(estimate, None if first is None else first.state)
                if name in self._followers:
                    self._followers[name].update(estimate)

    def course_rad(self, target: str) -> float | None:
        """Return the course that defines a target's sides, rad; None before there is an aircraft."""
        return self._courses[target].course_rad

    def costs(self, vehicle: FleetVehicle, target: str, estimate: TargetEstimate) -> RoleCosts | None:
        """Return an aircraft's expected costs in each role from its next departure; None: its plan is not known."""
        report = vehicle.report
        present = None if vehicle.plans is None else shifted_plan(vehicle.plans.present, vehicle.clock.offset_s)
        if report is None or present is None:
            return None
        judge, course_rad = self._judges[vehicle.member.name, target], self.course_rad(target)
        if course_rad is not None:
            judge.presume(course_rad)
        return judge.role_costs(report.state, estimate, present, report.wind, report.latency_s)

    def flight_time_s(self, vehicle: FleetVehicle, target: str, estimate: TargetEstimate) -> float:
        """Return the flight time of an aircraft to a target, s; 0 within its range band."""
        range_m = vehicle.range_m(estimate)
        at_it = range_m <= self._wanted[target].range_max_m
        return 0.0 if at_it else range_m / vehicle.member.aircraft.airspeed_m_s

    def costs_with_flight(self, vehicle: FleetVehicle, target: str, estimate: TargetEstimate) -> RoleCosts:
        """Return an aircraft's expected costs in each role at a target, with the flight there, s off the side."""
        costs = self.costs(vehicle, target, estimate) or RoleCosts(0.0, 0.0)
        flight_time_s = self.flight_time_s(vehicle, target, estimate)
        return RoleCosts(costs.wanted_s + flight_time_s, costs.opposite_s + flight_time_s)


_PERIOD_S = 1.0
_SILENT_AFTER_S = 5.0
_RELIEVE_BELOW, _LEAVE_BELOW = 0.3, 0.15  # shares of the battery's charge
_REASSIGN_COST_S = 15.0
_TURNED_AFTER = 3  # sightings
_FOREIGN_FORGOTTEN_S = 30.0
_NEAR_M, _NEARER = 60.0, 0.5  # a sighting of another target is so near to it, and by this share nearer than its own
_USED_AGAIN_AFTER_S = 10.0  # two payloads that contradict each other are both used for moments
_REASSIGN_AFTER_S = 5.0  # how long the gain has to last
_STEP_MAX_S = 2.0  # a smaller step of a clock hardly moves mission time; clocks that agree differ by less
_NO_ROUTE = RouteGiven(0.0, (), (), lap=False, tolerance_m=1.0, speed_m_s=None, direction="either")
_PASSED_MAX_S = 2.0  # mission time that jumps ahead is not a silence


@dataclass(frozen=True, slots=True)
class FleetTarget:
    """One target, and how it is to be watched: its side is the wanted one."""

    name: str
    requirement: Requirement


class FleetCoordinator:
    """See the module.

    make_judge returns the object that computes the costs of a named aircraft; it is called again when the operator
    changes the requirement. Raises ValueError where names repeat, there is no aircraft or no target, or a requirement
    has no sides.
    """

    def __init__(self, members: Sequence[FleetMember], targets: Sequence[FleetTarget], make_judge: MakeJudge) -> None:
        names = [member.name for member in members]
        if len(set(names)) < len(names) or len({target.name for target in targets}) < len(targets):
            raise ValueError("every aircraft and every target needs a name of its own")
        if not targets or not members:
            raise ValueError("a fleet needs an aircraft and a target")
        self._vehicles = {
            member.name: FleetVehicle(member, target=own, watches=own)
            for member in members
            for own in (member.target or targets[0].name,)
        }
        self._targets = {target.name: target for target in targets}
        payloads = {member.name: member.tracker for member in members}
        self._tracks = {target.name: JointTrack(payloads) for target in targets}
        for target in targets:
            if target.requirement.either_side or target.requirement.sector is not None:
                raise ValueError("several aircraft share the sides of a target: side has to be left or right")
        self._judges = RoleJudges(make_judge)
        for target in targets:
            self._ask(target.name, target.requirement)
        self._assignments = {target.name: RoleAssignment() for target in targets}
        self._estimates: Mapping[str, TargetEstimate | None] = {}  # as of the last second
        self._foreign: dict[str, ForeignAircraftReported] = {}
        self._proximity = Proximity()
        self._refused_s: dict[str, float] = {}  # when the sightings of a payload were left out last
        self._routes: dict[str, RouteGiven] = {}
        self._asked: set[str] = set()
        self._gains_since_s = math.inf  # another assignment to the targets
        self._now_s = self._next_s = self._coordinated_s = -math.inf
        self._out: list[FleetCommand] = []

    # -- what a display wants -------------------------------------------------------------------------------

    def requirement(self, target: str) -> Requirement:
        """Return how a target is to be watched now."""
        return self._targets[target].requirement

    def offset_s(self, name: str) -> float | None:
        """Return what is added to an aircraft's time to make it mission time, s; None before it is known."""
        clock = self._vehicles[name].clock
        return clock.offset_s if clock.known else None

    def estimate(self, target: str) -> TargetEstimate | None:
        """Return the joint estimate of a target at the mission's present time."""
        return self._tracks[target].estimate(self._now_s)

    def primary(self, target: str) -> str | None:
        """Return the aircraft that holds the required side of a target; None before there is one."""
        return self._assignments[target].holder

    @property
    def roles(self) -> Mapping[str, tuple[str, Role]]:
        """Each aircraft's target and role."""
        return {name: (vehicle.target, vehicle.role) for name, vehicle in self._vehicles.items()}

    # -- the step ---------------------------------------------------------------------------------------------

    def step(self, event: FleetEvent) -> tuple[FleetCommand, ...]:
        """Process one event and return the commands that it leads to, in order.

        Raises:
            KeyError: No aircraft of the fleet has that name.
        """
        self._out = []
        match event:
            case Tick():
                self._now_s = max(self._now_s, event.mission_time_s)
            case ClockReported():
                self._clock_reported(self._vehicles[event.name], event)
            case VehicleReported():
                self._reported(self._vehicles[event.name], event)
            case PlansReported():
                self._planned(self._vehicles[event.name], event)
            case SightingReported():
                self._sighted(self._vehicles[event.name], event)
            case PayloadReported():
                self._payload_reported(self._vehicles[event.name], event)
            case ChargeReported():
                self._vehicles[event.name].remaining = event.remaining
            case VehicleLost():
                self._lost(self._vehicles[event.name], event.reason, event.yielded)
            case ForeignAircraftReported():
                self._foreign[event.identity] = event
            case ReliefRequested() | SideRequested() | RequirementReported() | TargetRouteGiven():
                self._asked_for(event)
        if self._now_s >= self._next_s:
            self._next_s = self._now_s + _PERIOD_S
            self._coordinate()
        return tuple(self._out)

    def _clock_reported(self, vehicle: FleetVehicle, event: ClockReported) -> None:
        clock = vehicle.clock
        stepped = clock.step_s != 0.0
        clock.note(event.time_s, event.mission_time_s, event.sigma_s, discard=event.anew)
        if clock.step_lasts and self._agrees_with_others(vehicle):
            clock.take_step()
        if clock.step_s and not stepped:
            self._say(event.name, f"its UTC jumped by {clock.step_s:.1f} s: it is not used while it is off")
        elif stepped and not clock.step_s:
            self._say(event.name, "its UTC is used again")

    def _agrees_with_others(self, vehicle: FleetVehicle) -> bool:
        """Return whether the step of a vehicle's UTC is small, or brings it to the mission time of another one."""
        clock = vehicle.clock
        if abs(clock.step_s) < _STEP_MAX_S:
            return True
        now_s = clock.mission_s(clock.at_s) + clock.step_s
        others = (other.clock for other in self._vehicles.values() if other is not vehicle and not other.lost)
        return any(abs(other.mission_s(other.at_s) - now_s) < _STEP_MAX_S for other in others if not other.step_s)

    def _reported(self, vehicle: FleetVehicle, event: VehicleReported) -> None:
        if not vehicle.clock.known:
            return
        before, by_s = vehicle.report, vehicle.clock.offset_s
        vehicle.report = replace(event, time_s=event.time_s + by_s, state=shifted_state(event.state, by_s))
        vehicle.silent_s = 0.0
        self._now_s = max(self._now_s, vehicle.report.time_s)
        if event.watching:
            vehicle.since_s = min(vehicle.since_s, vehicle.report.time_s)
        if vehicle.lost and event.watching:
            vehicle.lost, vehicle.yielded = "", False
            self._asked.discard(f"{event.name} is out")
            self._say(event.name, "is back")
        if before is None:
            for other in self._vehicles.values():
                self._announce_plans(vehicle, other)
                self._announce_plans(other, vehicle)

    def _planned(self, vehicle: FleetVehicle, event: PlansReported) -> None:
        vehicle.plans = event
        for other in self._vehicles.values():
            self._announce_plans(other, vehicle)

    def _announce_plans(self, listener: FleetVehicle, other: FleetVehicle) -> None:
        if listener is other or listener.report is None or other.report is None or other.plans is None:
            return
        plans, by_s = other.plans, other.clock.offset_s - listener.clock.offset_s
        present, coming = shifted_plan(plans.present, by_s), shifted_plan(plans.coming, by_s)
        announced = NeighbourPlanned(self._now_s - listener.clock.offset_s, plans.name, present, coming)
        self._out.append(VehicleEvent(listener.member.name, announced))

    def _sighted(self, vehicle: FleetVehicle, event: SightingReported) -> None:
        if not vehicle.clock.known:
            return
        sighting = event.sighting
        sigma_s = vehicle.clock.sigma_at(sighting.time_s)
        on_mission = replace(sighting, time_s=vehicle.clock.mission_s(sighting.time_s))
        self._look(vehicle, on_mission)
        self._tracks[vehicle.watches].add(event.name, on_mission, sigma_s)

    def _payload_reported(self, vehicle: FleetVehicle, event: PayloadReported) -> None:
        sigmas = event.yaw_sigma_rad, event.range_sigma_m
        corrected = sigmas if event.corrections != vehicle.corrections else None
        vehicle.corrections = event.corrections
        for track in self._tracks.values():
            track.judge(event.name, event.fault, jumped=event.jumped, confirmed=event.confirmed, corrected=corrected)

    def _look(self, vehicle: FleetVehicle, sighting: AnySighting) -> None:
        """Find out which of the targets a payload looks at."""
        off_m = {
            name: math.dist((sighting.east_m, sighting.north_m), estimate.position_m(sighting.time_s))
            for name, estimate in self._estimates.items()
            if estimate is not None
        }
        nearest = min(off_m, key=lambda name: off_m[name], default=vehicle.watches)
        own_m = off_m.get(vehicle.watches, math.inf if nearest == vehicle.target else 0.0)
        if nearest == vehicle.watches or off_m[nearest] > min(_NEARER * own_m, _NEAR_M):
            vehicle.nearer = ("", 0)
            return
        before, count = vehicle.nearer
        vehicle.nearer = (nearest, count + 1 if before == nearest else 1)
        if vehicle.nearer[1] >= _TURNED_AFTER:
            vehicle.watches, vehicle.nearer = nearest, ("", 0)
            self._say(vehicle.member.name, f"its payload sees {nearest}")

    def _lost(self, vehicle: FleetVehicle, reason: str, yielded: bool = False) -> None:
        if not vehicle.lost:
            vehicle.lost, vehicle.yielded = reason, yielded
            self._say(vehicle.member.name, f"is out: {reason}")
            self._next_s = -math.inf  # the others close the gap at once
            if not any(other.takes_part for other in self._vehicles.values() if other.target == vehicle.target):
                self._launch_reserve(f"{vehicle.member.name} is out", vehicle.target)

    def _asked_for(self, event: ReliefRequested | SideRequested | RequirementReported | TargetRouteGiven) -> None:
        match event:
            case ReliefRequested():
                self._vehicles[event.name].relief_asked = True
            case SideRequested():
                self._side_requested(event)
            case RequirementReported():
                self._requirement_reported(event)
            case TargetRouteGiven():
                self._routes[event.target] = event.route
                self._judges.set_route(event.target, event.route)

    def _side_requested(self, event: SideRequested) -> None:
        for name, target in self._targets.items():
            if target.requirement.side is not event.side:
                self._change(name, replace(target.requirement, side=event.side))
                self._assignments[name] = RoleAssignment()  # the nearest aircraft holds it at once
        self._say("", f"the required side is the {event.side} one now")
        self._next_s = -math.inf

    def _requirement_reported(self, event: RequirementReported) -> None:
        """Assign the roles by the present settings of that aircraft, and keep the required side."""
        vehicle = self._vehicles[event.name]
        vehicle.member = replace(vehicle.member, aircraft=event.aircraft)
        for name, target in self._targets.items():
            self._change(name, replace(event.requirement, side=target.requirement.side))

    def _change(self, target: str, wanted: Requirement) -> None:
        if wanted != self._targets[target].requirement:
            self._out.append(RequirementChanged(self._now_s, target, wanted))
        self._ask(target, wanted)

    def _ask(self, target: str, wanted: Requirement) -> None:
        self._targets[target] = FleetTarget(target, wanted)
        self._judges.set_requirement(target, wanted, self._vehicles.values())

    def _say(self, name: str, text: str) -> None:
        self._out.append(FleetAnnounce(self._now_s, name, text))

    # -- each second ------------------------------------------------------------------------------------------

    def _coordinate(self) -> None:
        passed_s = min(self._now_s - self._coordinated_s, _PASSED_MAX_S)
        self._coordinated_s = self._now_s
        for vehicle in self._vehicles.values():
            if vehicle.report is None:
                continue
            vehicle.silent_s += passed_s
            if vehicle.silent_s > _SILENT_AFTER_S:
                self._lost(vehicle, f"no message received for {vehicle.silent_s:.0f} s")
        self._next_s = self._now_s + _PERIOD_S
        estimates = self._estimates = {name: self.estimate(name) for name in self._tracks}
        self._announce_refusals()
        self._judges.follow(estimates, self._vehicles.values())
        self._assign_targets(estimates)
        for name in self._targets:
            self._assign_roles(name, estimates[name])
        self._relieve(estimates)
        too_near = self._proximity.watch(self._now_s, self._vehicles.values(), self._foreign.values())
        now_s, foreign = self._now_s, self._foreign.items()
        self._foreign = {key: craft for key, craft in foreign if now_s - craft.mission_time_s < _FOREIGN_FORGOTTEN_S}
        for vehicle in self._vehicles.values():
            if vehicle.report is not None:
                advice = self._advice_to(vehicle, estimates[vehicle.target], too_near.get(vehicle.member.name, ""))
                self._out.append(VehicleEvent(vehicle.member.name, advice))
                self._give_route(vehicle)

    def _advice_to(self, vehicle: FleetVehicle, estimate: TargetEstimate | None, separation: str) -> FleetAdvice:
        """Return an aircraft's advice. separation: which other aircraft is too near, in words."""
        target, by_s = vehicle.target, -vehicle.clock.offset_s
        wanted, announced = self._targets[target].requirement.side, (vehicle.role, target)
        reason = "" if announced == vehicle.announced else _REASONS[vehicle.role]
        if vehicle.announced is not None and target != vehicle.announced[1]:
            reason = f"it is to watch {target} now"
        vehicle.announced = announced
        # While the payloads contradict one another, each aircraft watches by its own track.
        if vehicle.watches == target and vehicle.member.name in self._tracks[target].refused:
            estimate = estimate if self._tracks[target].is_led else None
        neighbours: list[Neighbour] = []
        for other in self._vehicles.values():
            if other is not vehicle and other.report is not None and not other.yielded:
                flown = shifted_state(other.report.state, by_s), other.report.height_m
                neighbours.append(Neighbour(other.member.name, *flown, True, other.target, other.role))
        for craft in self._foreign.values():
            flown, kept = (shifted_state(craft.state, by_s), craft.height_m), (craft.climb_m_s, craft.clear_m)
            neighbours.append(Neighbour(craft.identity, *flown, False, "", Role.WANTED, *kept))
        return FleetAdvice(
            self._now_s + by_s,
            target,
            vehicle.role,
            wanted.opposite if vehicle.role is Role.OPPOSITE else wanted,
            shifted_estimate(estimate, by_s),
            vehicle.member.height_m,
            tuple(neighbours),
            reason,
            vehicle.watches != target,
            self._judges.course_rad(target),
            separation,
        )

    def _give_route(self, vehicle: FleetVehicle) -> None:
        route = self._routes.get(vehicle.target)
        if route is not vehicle.route:
            vehicle.route = route
            own = replace(route or _NO_ROUTE, time_s=self._now_s - vehicle.clock.offset_s)
            self._out.append(VehicleEvent(vehicle.member.name, own))

    def _announce_refusals(self) -> None:
        for track in self._tracks.values():
            for payload, reason in track.refused.items():
                if payload not in self._refused_s:
                    self._say(payload, f"its sightings are left out: {reason}")
                self._refused_s[payload] = self._now_s
        for payload, refused_s in list(self._refused_s.items()):
            if self._now_s - refused_s >= _USED_AGAIN_AFTER_S:
                del self._refused_s[payload]
                self._say(payload, "its sightings are used again")

    def _assign_targets(self, estimates: Mapping[str, TargetEstimate | None]) -> None:
        """Give the aircraft out to the targets that are seen, as evenly as can be."""
        known = {
            name: estimate
            for name, estimate in estimates.items()
            if estimate is not None and estimate.quality is not TrackQuality.LOST
        }
        taking_part = (vehicle for vehicle in self._vehicles.values() if vehicle.takes_part)
        free = [vehicle for vehicle in taking_part if estimates[vehicle.target] is not None]
        if len(self._targets) < 2 or not known or not free:
            return
        costs = [
            [self._judges.costs_with_flight(vehicle, name, estimate) for name, estimate in known.items()]
            for vehicle in free
        ]
        at = [vehicle.target for vehicle in free]
        given, gained_s = assign_evenly(list(known), costs, at, _REASSIGN_COST_S)
        self._gains_since_s = min(self._gains_since_s, self._now_s) if gained_s > 0.0 else math.inf
        if math.isfinite(gained_s) and self._now_s - self._gains_since_s < _REASSIGN_AFTER_S:
            return
        for vehicle, target in zip(free, given, strict=True):
            if vehicle.target != target:
                vehicle.target = target
                self._say(vehicle.member.name, f"goes to {target}")

    def _assign_roles(self, target: str, estimate: TargetEstimate | None) -> None:
        if estimate is None or estimate.quality is TrackQuality.LOST:
            return
        candidates: dict[str, Candidate] = {}
        wanted = self._targets[target].requirement
        for name, vehicle in self._vehicles.items():
            report = vehicle.report
            if vehicle.target != target or report is None or not vehicle.takes_part:
                continue
            costs = self._judges.costs(vehicle, target, estimate)
            if costs is None:
                continue
            # An aircraft that has to get there first does not take the side of one already there.
            flight_time_s = (
                math.inf
                if self._is_to_be_relieved(vehicle)
                else self._judges.flight_time_s(vehicle, target, estimate)
            )
            costs = replace(costs, wanted_s=costs.wanted_s + flight_time_s)
            on_station = is_on_station(report.state, estimate, wanted, self._judges.course_rad(target))
            under_way = vehicle.plans is not None and vehicle.plans.coming is not None
            candidates[name] = Candidate(costs, on_station, under_way)
        roles = self._assignments[target].assign(self._now_s, candidates, course_known=course_is_known(estimate))
        for name, role in roles.items():
            self._vehicles[name].role = role

    def _is_to_be_relieved(self, vehicle: FleetVehicle) -> bool:
        watched_s = self._now_s - vehicle.since_s
        low = vehicle.remaining < _RELIEVE_BELOW or watched_s > vehicle.member.endurance_s
        return low or vehicle.relief_asked

    def _relieve(self, estimates: Mapping[str, TargetEstimate | None]) -> None:
        for vehicle in self._vehicles.values():
            if not vehicle.takes_part or not self._is_to_be_relieved(vehicle):
                continue
            others = [
                other
                for other in self._vehicles.values()
                if other is not vehicle and other.target == vehicle.target and other.takes_part
            ]
            vehicle.role = Role.WANTED  # with who takes over, until that one is there
            estimate, wanted = estimates[vehicle.target], self._targets[vehicle.target].requirement
            course_rad = self._judges.course_rad(vehicle.target)
            if estimate is not None and any(
                other.role is Role.WANTED
                and other.report is not None
                and is_on_station(other.report.state, estimate, wanted, course_rad)
                for other in others
            ):
                self._leave(vehicle, "another aircraft has taken over")
            elif vehicle.remaining < _LEAVE_BELOW:
                self._leave(vehicle, f"{100.0 * vehicle.remaining:.0f} % of the battery is left")
            else:
                self._launch_reserve(f"{vehicle.member.name} has to be relieved", vehicle.target)

    def _leave(self, vehicle: FleetVehicle, reason: str) -> None:
        vehicle.leaving, vehicle.role = True, Role.LEAVE
        self._say(vehicle.member.name, f"goes home: {reason}")

    def _launch_reserve(self, reason: str, target: str) -> None:
        """Ask for one reserve for each reason, if there is one left."""
        if reason in self._asked:
            return
        for name, reserve in self._vehicles.items():
            if reserve.member.reserve and reserve.report is None and not reserve.launch_asked:
                reserve.launch_asked, reserve.target = True, target
                self._asked.add(reason)
                self._out.append(LaunchRequested(name, self._now_s, reason))
                return
