"""Advice to one aircraft about the others, on its own clock. Source: docs/decisions/0012-fleet-as-a-layer.md."""

from __future__ import annotations

from collections.abc import Iterable

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.fleet import FleetAdvice, Neighbour, NeighbourPlanned, Role
from sidelong.mission.core.requirement import Side
from sidelong.mission.fleet.clocks import shifted_estimate, shifted_plan, shifted_state
from sidelong.mission.fleet.events import ForeignAircraftReported
from sidelong.mission.fleet.vehicle import FleetVehicle

_REASONS = {
    Role.LEAVE: "another aircraft has taken over, or the battery is low",
    Role.OPPOSITE: "another aircraft holds the required side",
    Role.WANTED: "this aircraft is to hold the required side",
}


def advice_to(
    vehicle: FleetVehicle,
    now_s: float,
    wanted: Side,
    estimate: TargetEstimate | None,
    fleet: Iterable[FleetVehicle],
    foreign: Iterable[ForeignAircraftReported],
    course_rad: float | None = None,
    separation: str = "",
) -> FleetAdvice:
    """Return an aircraft's advice.

    Args:
        vehicle: The aircraft.
        now_s: Mission time, s.
        wanted: Required side of the target.
        estimate: Estimate of the target; None if there is none.
        fleet: All aircraft of the fleet.
        foreign: Aircraft that do not belong to the fleet.
        course_rad: Course of the target whose sides count, rad; None if unknown.
        separation: Which other aircraft is too near, in words.
    """
    by_s = -vehicle.clock.offset_s
    announced = (vehicle.role, vehicle.target)
    reason = "" if announced == vehicle.announced else _REASONS[vehicle.role]
    if vehicle.announced is not None and vehicle.target != vehicle.announced[1]:
        reason = f"it is to watch {vehicle.target} now"
    vehicle.announced = announced
    ours = [
        Neighbour(
            one.member.name, shifted_state(one.report.state, by_s), one.report.height_m, True, one.target, one.role
        )
        for one in fleet
        if one is not vehicle and one.report is not None and not one.yielded
    ]
    others = [Neighbour(one.identity, shifted_state(one.state, by_s), one.height_m, False) for one in foreign]
    return FleetAdvice(
        now_s + by_s,
        vehicle.target,
        vehicle.role,
        wanted.opposite if vehicle.role is Role.OPPOSITE else wanted,
        shifted_estimate(estimate, by_s),
        vehicle.member.height_m,
        (*ours, *others),
        reason,
        vehicle.watches != vehicle.target,
        course_rad,
        separation,
    )


def announced_plans(listener: FleetVehicle, other: FleetVehicle, now_s: float) -> NeighbourPlanned | None:
    """Return another aircraft's plans at mission time ``now_s`` for a listener, None before they are known.

    Args:
        listener: The aircraft that is informed.
        other: The aircraft whose plans are reported.
        now_s: Mission time, s.
    """
    if listener.report is None or other.report is None or other.plans is None:
        return None
    announced, by_s = other.plans, other.clock.offset_s - listener.clock.offset_s
    return NeighbourPlanned(
        now_s - listener.clock.offset_s,
        announced.name,
        shifted_plan(announced.present, by_s),
        shifted_plan(announced.coming, by_s),
    )
