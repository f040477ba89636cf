"""Puts the coordinator of a fleet together from its file."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from sidelong.app.assembly import planner_needs, tracker_settings
from sidelong.app.fleet.fleet_file import FleetFile, TeamPredictive
from sidelong.app.warm_up import MADE_UP_ROUTE
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.joint_track import JointTrack
from sidelong.mission.control.surroundings import Surroundings
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.fleet import FleetAdvice, Neighbour, NeighbourPlanned, Role
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind
from sidelong.mission.fleet.coordinator import FleetCoordinator, FleetTarget
from sidelong.mission.fleet.judges import WatchedCourse
from sidelong.mission.fleet.team_planner import TeamPlanner
from sidelong.mission.fleet.vehicle import FleetMember
from sidelong.mission.route.progress import RouteFollower


def coordinator_of(fleet: FleetFile, progress: Callable[[float], None] = lambda _share: None) -> FleetCoordinator:
    """Return the coordinator, compiled and ready to run; progress is called with the value tables' progress.

    It assigns the roles by the predictive planner's costs, whichever planner the aircraft use.
    """
    members, nothing = fleet.members, Surroundings()
    configs = {member.name: member.config for member in members}
    factories = {name: TeamPredictive().factory(planner_needs(config, progress)) for name, config in configs.items()}

    def judge(name: str, aircraft: Aircraft, wanted: Requirement) -> TeamPlanner:
        planner = factories[name](aircraft, wanted, nothing)
        assert isinstance(planner, TeamPlanner)  # a fleet's file has a side
        return planner

    for name, config in configs.items():
        _warm_up(judge(name, config.aircraft.aircraft(), config.requirement.requirement()))
    return FleetCoordinator(
        [
            FleetMember(
                member.name,
                member.config.aircraft.aircraft(),
                tracker_settings(member.config.sensors, member.config.planner.lost_after_s),
                member.config.aircraft.height_m,
                member.target,
                reserve=member.reserve,
                endurance_s=math.inf if member.relieve_after_min is None else 60.0 * member.relieve_after_min,
            )
            for member in members
        ],
        [FleetTarget(name, asked) for name, asked in fleet.asked.items()],
        judge,
    )


def _warm_up(planner: TeamPlanner) -> None:
    """Call the compiled functions of a fleet flight once and discard the results, so that they are loaded."""
    track = JointTrack({name: TrackerSettings() for name in ("west", "east")})
    for name, east_m, bearing_rad in (("west", -250.0, 0.5 * math.pi), ("east", 250.0, -0.5 * math.pi)):
        track.add(name, Sighting(0.0, 270.0, bearing_rad, 0.3, 1.0, 0.01, 0.01, east_m, 0.0, 80.0))
    estimate = track.estimate(0.0)
    assert estimate is not None
    WatchedCourse(Requirement(100.0, 500.0, Side.LEFT, 5.0)).update(estimate, None)
    west, east = (Circle(east_m, 0.0, 60.0, clockwise=True) for east_m in (-250.0, 250.0))
    state = AircraftState(0.0, *west.position_at_course(0.0), 0.0, 15.0, west.curvature_per_m)
    other = Neighbour("east", replace(state, east_m=250.0), 160.0, ours=True, target="target")
    planner.role_costs(state, estimate, Plan(west), Wind(), 0.5)
    planner.advise(NeighbourPlanned(0.0, "east", Plan(east), None))
    planner.advise(FleetAdvice(0.0, "target", Role.WANTED, Side.LEFT, estimate, 100.0, (other,)))
    planner.decide(state, estimate, Plan(west), Wind(), 0.5)
    follower = RouteFollower(MADE_UP_ROUTE)
    follower.update(estimate)
    planner.follow(MADE_UP_ROUTE, follower.progress)
