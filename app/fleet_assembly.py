"""Puts the coordinator of a fleet together from its file."""

from __future__ import annotations

from collections.abc import Callable

from app.assembly import planner_needs, tracker_settings
from app.fleet_file import FleetFile
from app.planners.predictive import Predictive
from mission.core.plan import Planner
from mission.core.requirement import Requirement
from mission.fleet.coordinator import FleetCoordinator, FleetMember, FleetTarget
from mission.predictive._sight_kernel import NOTHING_HIDDEN, Sight


def coordinator_of(fleet: FleetFile, progress: Callable[[float], None] = lambda _share: None) -> FleetCoordinator:
    """Return the coordinator, ready to run without a pause; progress hears of the value tables' computation.

    It gives out the roles by the predictive planner's costs, whatever planner the aircraft fly by.
    """
    members = fleet.members
    configs = {member.name: member.config for member in members}
    factories = {
        name: Predictive().factory(planner_needs(config, progress, lambda _plan: None, _all_in_sight))
        for name, config in configs.items()
    }

    def planner(name: str, wanted: Requirement) -> Planner:
        return factories[name](configs[name].aircraft.aircraft(), wanted)

    return FleetCoordinator(
        [
            FleetMember(
                member.name,
                member.config.aircraft.aircraft(),
                tracker_settings(member.config.sensors, member.config.planner.lost_after_s),
                member.config.aircraft.height_m,
                reserve=member.reserve,
            )
            for member in members
        ],
        [FleetTarget(target.name, fleet.requirement.requirement()) for target in fleet.target],
        planner,
    )


def _all_in_sight(*_target: float) -> Sight:
    return NOTHING_HIDDEN
