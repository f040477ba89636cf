"""The fleet's coordinator: who watches which target, from which side, and who takes over from whom.

Each vehicle keeps its own whole core (door, tracker, planner, exchange) and yields by itself. The coordinator sits
above and commands no vehicle: it tells each core where the target is by all payloads together, which side to hold,
and where the others are (``FleetAdvice``, ``NeighbourPlanned``), as events of that core, which then decides its own
plans. A core that hears nothing for some seconds goes on by its own track, and keeps its last side.

How it is used
--------------
::

    coordinator = FleetCoordinator(members, targets, make_judge)
    # after each step of a vehicle's core, in the order in which the steps were made:
    for news in reporters[name].after(core.controller, event, outputs, mission_time_s):  # mission.fleet.reports
        for command in coordinator.step(news):
            if isinstance(command, Tell):
                put(command.name, command.event)  # into that vehicle's queue, and so into its journal
    # and at least once a second: coordinator.step(Tick(mission_time_s))

Events are :data:`mission.fleet.events.FleetEvent`; a ``ClockReported`` has to come first for each vehicle. All places
are in one local plane and all heights above one home: the shell gives all vehicles the same. Pure: the same events
in the same order lead to the same commands, so that a journal of them replays.

Rules
-----
1. Only what was reported lately counts: an aircraft silent for ``silent_after_s`` has lost its role to the others.
2. Roles are given out each second by expected cost; see :mod:`mission.fleet.roles`.
3. Relief: an aircraft whose battery is below ``relieve_below``, which has watched for its ``endurance_s``, or whose
   relief is asked for gives the wanted side away, but holds it with the other one until that one is there; a reserve
   is asked for. Below ``leave_below`` it leaves whatever happens. A reserve is asked for too when nobody is left.
4. Several targets: aircraft are given out by the time to get there, those that are free or with a target that is lost
   at once, others only where all together gain ``reassign_gain_s``.
5. Each aircraft keeps the height layer that it was set up with, so layers are never swapped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy.optimize import linear_sum_assignment

from estimators.estimate import TargetEstimate, TrackQuality
from estimators.joint_track import JointTrack
from estimators.settings import TrackerSettings
from mission.core.fleet import FleetAdvice, Neighbour, NeighbourPlanned, Role
from mission.core.plan import AircraftState, Plan
from mission.core.requirement import Aircraft, Requirement, Wind
from mission.fleet.clocks import VehicleTime, shifted_estimate, shifted_plan, shifted_state
from mission.fleet.events import (
    BatteryReported,
    ClockReported,
    FleetAnnounce,
    FleetCommand,
    FleetEvent,
    ForeignAircraftReported,
    LaunchRequested,
    PlansReported,
    ReliefRequested,
    SightingReported,
    Tell,
    Tick,
    VehicleLost,
    VehicleReported,
)
from mission.fleet.roles import RoleAssignment, RoleCosts

_FOREIGN_FORGOTTEN_S = 30.0
_STANDING_M_S = 0.3  # a slower target has no course
# An aircraft that is to be relieved pays so much more for the wanted side.
_RELIEVED_S = 1000.0


@dataclass(frozen=True, slots=True)
class FleetMember:
    """One aircraft as the fleet file has it.

    height_m: of its layer, above the common home. target: to begin with. reserve: it waits until it is asked for.
    endurance_s: it is relieved after watching for so long.
    """

    name: str
    aircraft: Aircraft
    tracker: TrackerSettings
    height_m: float
    target: str = ""
    reserve: bool = False
    endurance_s: float = math.inf


@dataclass(frozen=True, slots=True)
class FleetTarget:
    """One target, and how it is to be watched: its side is the wanted one."""

    name: str
    requirement: Requirement


@dataclass(frozen=True, slots=True)
class FleetSettings:
    """See the rules of this module. relieve_below, leave_below: shares of the battery's charge."""

    period_s: float = 1.0
    silent_after_s: float = 5.0
    relieve_below: float = 0.3
    leave_below: float = 0.15
    reassign_gain_s: float = 30.0


class RoleJudge(Protocol):
    """Tells what the roles cost an aircraft; see :meth:`mission.fleet.team_planner.TeamPlanner.role_costs`."""

    def role_costs(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> RoleCosts:
        """Return what this aircraft would pay in each role."""
        ...


@dataclass(slots=True, eq=False)
class _Vehicle:
    """What is known of one aircraft; ``report`` is on mission time, ``plans`` as the aircraft has them."""

    member: FleetMember
    clock: VehicleTime = field(default_factory=VehicleTime)
    report: VehicleReported | None = None
    plans: PlansReported | None = None
    lost: str = ""
    remaining: float = 1.0
    relief_asked: bool = False
    since_s: float = math.inf  # it watches
    leaving: bool = False
    target: str = ""
    role: Role = Role.WANTED
    told: tuple[Role, str] | None = None
    launch_asked: bool = False


class FleetCoordinator:
    """See the module. make_judge builds what tells one aircraft's costs for a requirement, from what is at hand.

    Raises ValueError where names repeat, there is no aircraft or no target, or a requirement has no sides.
    """

    def __init__(
        self,
        members: Sequence[FleetMember],
        targets: Sequence[FleetTarget],
        make_judge: Callable[[str, Requirement], RoleJudge],
        settings: FleetSettings | None = None,
    ) -> None:
        names = [one.name for one in members]
        if len(set(names)) < len(names) or len({one.name for one in targets}) < len(targets):
            raise ValueError("every aircraft and every target needs a name of its own")
        if not targets or not members:
            raise ValueError("a fleet needs an aircraft and a target")
        self.settings = settings or FleetSettings()
        self._vehicles = {one.name: _Vehicle(one, target=one.target or targets[0].name) for one in members}
        self._targets = {one.name: one for one in targets}
        payloads = {one.name: one.tracker for one in members}
        self._tracks = {one.name: JointTrack(payloads) for one in targets}
        for one in targets:
            if one.requirement.either_side or one.requirement.sector is not None:
                raise ValueError("several aircraft share the sides of a target: side has to be left or right")
        self._judges = {(name, one.name): make_judge(name, one.requirement) for name in names for one in targets}
        self._assignments = {one.name: RoleAssignment() for one in targets}
        self._foreign: dict[str, ForeignAircraftReported] = {}
        self._refused: dict[str, Mapping[str, str]] = {}
        self._asked: set[str] = set()
        self._now_s, self._next_s = -math.inf, -math.inf
        self._out: list[FleetCommand] = []

    # -- what a display wants -------------------------------------------------------------------------------

    def estimate(self, target: str) -> TargetEstimate | None:
        """Return the joint estimate of a target at the mission's present time."""
        return self._tracks[target].estimate(self._now_s)

    @property
    def roles(self) -> Mapping[str, tuple[str, Role]]:
        """Each aircraft's target and role."""
        return {name: (one.target, one.role) for name, one in self._vehicles.items()}

    # -- the step ---------------------------------------------------------------------------------------------

    def step(self, event: FleetEvent) -> tuple[FleetCommand, ...]:
        """Take one event; return what it led to, in order. KeyError: no aircraft of the fleet has that name."""
        self._out = []
        match event:
            case Tick():
                self._now_s = max(self._now_s, event.mission_time_s)
            case ClockReported():
                self._vehicles[event.name].clock.note(event.time_s, event.mission_time_s, event.sigma_s)
            case VehicleReported():
                self._reported(self._vehicles[event.name], event)
            case PlansReported():
                self._planned(self._vehicles[event.name], event)
            case SightingReported():
                self._sighted(self._vehicles[event.name], event)
            case BatteryReported():
                self._vehicles[event.name].remaining = event.remaining
            case VehicleLost():
                self._lost(self._vehicles[event.name], event.reason)
            case ForeignAircraftReported():
                self._foreign[event.identity] = event
            case ReliefRequested():
                self._vehicles[event.name].relief_asked = True
        if self._now_s >= self._next_s:
            self._next_s = self._now_s + self.settings.period_s
            self._coordinate()
        return tuple(self._out)

    def _reported(self, vehicle: _Vehicle, event: VehicleReported) -> None:
        if not vehicle.clock.known:
            return
        before, by_s = vehicle.report, vehicle.clock.offset_s
        vehicle.report = replace(
            event,
            time_s=event.time_s + by_s,
            state=shifted_state(event.state, by_s),
        )
        self._now_s = max(self._now_s, vehicle.report.time_s)
        if event.watching:
            vehicle.since_s = min(vehicle.since_s, vehicle.report.time_s)
        if vehicle.lost and event.watching:
            vehicle.lost = ""
            self._asked.discard(f"{event.name} is out")
            self._say(event.name, "is back")
        if before is None:
            for other in self._vehicles.values():
                if other is not vehicle:
                    self._tell_plans(vehicle, other)
                    self._tell_plans(other, vehicle)

    def _planned(self, vehicle: _Vehicle, event: PlansReported) -> None:
        vehicle.plans = event
        for other in self._vehicles.values():
            if other is not vehicle:
                self._tell_plans(other, vehicle)

    def _tell_plans(self, listener: _Vehicle, other: _Vehicle) -> None:
        if listener.report is None or other.report is None or other.plans is None:
            return
        told, by_s = other.plans, other.clock.offset_s - listener.clock.offset_s
        self._out.append(
            Tell(
                listener.member.name,
                NeighbourPlanned(
                    self._now_s - listener.clock.offset_s,
                    told.name,
                    shifted_plan(told.present, by_s),
                    shifted_plan(told.coming, by_s),
                ),
            )
        )

    def _sighted(self, vehicle: _Vehicle, event: SightingReported) -> None:
        if not vehicle.clock.known:
            return
        sighting = event.sighting
        sigma_s = vehicle.clock.sigma_at(sighting.time_s)
        on_mission = replace(sighting, time_s=vehicle.clock.mission_s(sighting.time_s))
        self._tracks[vehicle.target].add(event.name, on_mission, sigma_s)

    def _lost(self, vehicle: _Vehicle, reason: str) -> None:
        if not vehicle.lost:
            vehicle.lost = reason
            self._say(vehicle.member.name, f"is out: {reason}")
            self._next_s = -math.inf  # the others close the gap at once
            if not any(self._takes_part(one) for one in self._vehicles.values() if one.target == vehicle.target):
                self._launch_reserve(f"{vehicle.member.name} is out", vehicle.target)

    def _say(self, name: str, text: str) -> None:
        self._out.append(FleetAnnounce(self._now_s, name, text))

    # -- each second ------------------------------------------------------------------------------------------

    def _coordinate(self) -> None:
        for vehicle in self._vehicles.values():
            report = vehicle.report
            if report is not None and self._now_s - report.time_s > self.settings.silent_after_s:
                self._lost(vehicle, f"nothing was heard of it for {self._now_s - report.time_s:.0f} s")
        self._next_s = self._now_s + self.settings.period_s
        estimates = {name: track.estimate(self._now_s) for name, track in self._tracks.items()}
        self._tell_refusals()
        self._assign_targets(estimates)
        for name in self._targets:
            self._assign_roles(name, estimates[name])
        self._relieve(estimates)
        self._foreign = {
            key: one for key, one in self._foreign.items() if self._now_s - one.mission_time_s < _FOREIGN_FORGOTTEN_S
        }
        for vehicle in self._vehicles.values():
            if vehicle.report is not None:
                self._advise(vehicle, estimates[vehicle.target])

    def _tell_refusals(self) -> None:
        for name, track in self._tracks.items():
            before = self._refused.get(name, {})
            for payload, reason in track.refused.items():
                if payload not in before:
                    self._say(payload, f"its sightings are left out: {reason}")
            self._refused[name] = dict(track.refused)

    def _takes_part(self, vehicle: _Vehicle) -> bool:
        return vehicle.report is not None and vehicle.report.watching and not vehicle.lost and not vehicle.leaving

    def _assign_targets(self, estimates: Mapping[str, TargetEstimate | None]) -> None:
        """Give the aircraft out to the targets that are seen, as evenly as can be."""
        known = {
            name: one for name, one in estimates.items() if one is not None and one.quality is not TrackQuality.LOST
        }
        free = [one for one in self._vehicles.values() if self._takes_part(one) and estimates[one.target] is not None]
        if len(self._targets) < 2 or not known or not free:
            return
        names = list(known)
        slots = [names[k % len(names)] for k in range(len(free))]
        to_s = np.array([[_way_s(one, known[name]) for name in slots] for one in free])
        rows, columns = linear_sum_assignment(to_s)
        at = [slots.index(one.target) if one.target in known else -1 for one in free]
        bound = all(k >= 0 for k in at) and sorted(one.target for one in free) == sorted(slots)
        present_s = sum(to_s[row, k] for row, k in enumerate(at))
        if bound and present_s - float(to_s[rows, columns].sum()) < self.settings.reassign_gain_s:
            return
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            if free[row].target != slots[column]:
                free[row].target = slots[column]
                self._say(free[row].member.name, f"goes to {slots[column]}")

    def _assign_roles(self, target: str, estimate: TargetEstimate | None) -> None:
        if estimate is None or estimate.quality is TrackQuality.LOST:
            return
        costs: dict[str, RoleCosts] = {}
        for name, vehicle in self._vehicles.items():
            report, plans = vehicle.report, vehicle.plans
            if vehicle.target != target or report is None or plans is None or not self._takes_part(vehicle):
                continue
            present = shifted_plan(plans.present, vehicle.clock.offset_s)
            if present is None:
                continue
            judge = self._judges[name, target]
            found = judge.role_costs(report.state, estimate, present, report.wind, report.latency_s)
            more_s = _RELIEVED_S if self._is_to_be_relieved(vehicle) else 0.0
            costs[name] = RoleCosts(found.wanted_s + more_s, found.opposite_s)
        for name, role in self._assignments[target].assign(self._now_s, costs).items():
            self._vehicles[name].role = role

    def _is_to_be_relieved(self, vehicle: _Vehicle) -> bool:
        watched_s = self._now_s - vehicle.since_s
        low = vehicle.remaining < self.settings.relieve_below or watched_s > vehicle.member.endurance_s
        return low or vehicle.relief_asked

    def _relieve(self, estimates: Mapping[str, TargetEstimate | None]) -> None:
        for vehicle in self._vehicles.values():
            if not self._takes_part(vehicle) or not self._is_to_be_relieved(vehicle):
                continue
            others = [
                one
                for one in self._vehicles.values()
                if one is not vehicle and one.target == vehicle.target and self._takes_part(one)
            ]
            vehicle.role = Role.WANTED  # with who takes over, until that one is there
            estimate = estimates[vehicle.target]
            if any(one.role is Role.WANTED and self._is_beside(one, estimate) for one in others):
                self._leave(vehicle, "another aircraft has taken over")
            elif vehicle.remaining < self.settings.leave_below:
                self._leave(vehicle, f"{100.0 * vehicle.remaining:.0f} % of the battery is left")
            else:
                self._launch_reserve(f"{vehicle.member.name} has to be relieved", vehicle.target)

    def _is_beside(self, vehicle: _Vehicle, estimate: TargetEstimate | None) -> bool:
        """Tell whether an aircraft is on the wanted side and in the band."""
        requirement, report = self._targets[vehicle.target].requirement, vehicle.report
        if report is None or estimate is None:
            return False
        east_m, north_m = report.state.east_m - estimate.east_m, report.state.north_m - estimate.north_m
        normal_rad = estimate.course_rad + requirement.side.normal_turn_rad
        beside = east_m * math.sin(normal_rad) + north_m * math.cos(normal_rad) >= 0.0
        in_band = requirement.range_min_m <= math.hypot(east_m, north_m) <= requirement.range_max_m
        return in_band and (beside or estimate.speed_m_s < _STANDING_M_S)

    def _leave(self, vehicle: _Vehicle, reason: str) -> None:
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

    def _advise(self, vehicle: _Vehicle, estimate: TargetEstimate | None) -> None:
        by_s, name = -vehicle.clock.offset_s, vehicle.member.name
        wanted = self._targets[vehicle.target].requirement.side
        side = wanted if vehicle.role is not Role.OPPOSITE else wanted.opposite
        told = (vehicle.role, vehicle.target)
        reason = "" if told == vehicle.told else _reason(vehicle)
        vehicle.told = told
        advice = FleetAdvice(
            self._now_s + by_s,
            vehicle.target,
            vehicle.role,
            side,
            shifted_estimate(estimate, by_s),
            vehicle.member.height_m,
            self._neighbours(vehicle, by_s),
            reason,
        )
        self._out.append(Tell(name, advice))

    def _neighbours(self, vehicle: _Vehicle, by_s: float) -> tuple[Neighbour, ...]:
        ours = [
            Neighbour(name, shifted_state(one.report.state, by_s), one.report.height_m, True, one.target, one.role)
            for name, one in self._vehicles.items()
            if one is not vehicle and one.report is not None
        ]
        foreign = [_neighbour(one, by_s) for one in self._foreign.values()]
        return (*ours, *foreign)


def _way_s(vehicle: _Vehicle, target: TargetEstimate) -> float:
    """Return about how long an aircraft needs to a target."""
    assert vehicle.report is not None
    state = vehicle.report.state
    way_m = math.hypot(state.east_m - target.east_m, state.north_m - target.north_m)
    return way_m / vehicle.member.aircraft.airspeed_m_s


def _reason(vehicle: _Vehicle) -> str:
    match vehicle.role:
        case Role.LEAVE:
            return "another aircraft has taken over, or the battery is low"
        case Role.OPPOSITE:
            return "another aircraft holds the wanted side"
        case _:
            return "this aircraft is to hold the wanted side"


def _neighbour(one: ForeignAircraftReported, by_s: float) -> Neighbour:
    state = AircraftState(one.mission_time_s + by_s, one.east_m, one.north_m, one.course_rad, one.speed_m_s, 0.0)
    return Neighbour(one.identity, state, one.height_m, ours=False)
