"""Fleet data for one aircraft, as events of its control step, so that its journal replays alone.

All positions are in the local plane that the whole fleet shares, all heights above the same home, and all times on
the clock of the receiving vehicle.

Source: docs/decisions/0012-fleet-as-a-layer.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState, Plan, Planner
from sidelong.mission.core.requirement import Side


class Role(StrEnum):
    """What an aircraft is to do: watch from one of the sides, or go home because another has taken over."""

    WANTED = "wanted"
    OPPOSITE = "opposite"
    LEAVE = "leave"


@dataclass(frozen=True, slots=True)
class Neighbour:
    """Another aircraft: ours follows the plans of ``NeighbourPlanned``; a foreign one goes on as it flies.

    target: name of the one it watches; '' for a foreign aircraft. clear_m: distance to keep from it horizontally or
    vertically; (0, 0): the least distance in all directions.
    """

    name: str
    state: AircraftState
    height_m: float
    ours: bool
    target: str = ""
    role: Role = Role.WANTED
    climb_m_s: float = 0.0
    clear_m: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class FleetAdvice:
    """About once a second: which target to watch, from which side, and where the others are.

    estimate: joint one of that target; None before it was seen. height_m: of the layer to fly in, above home. reason:
    why this differs from the previous advice; '' where it does not. turn_payload: the payload looks at another target
    and has to turn. course_rad: of the target, by which the fleet assigns the sides; None before the first aircraft
    watches. separation: which aircraft is too near, in words; '' if none is.
    """

    time_s: float
    target: str
    role: Role
    side: Side
    estimate: TargetEstimate | None
    height_m: float
    neighbours: tuple[Neighbour, ...]
    reason: str = ""
    turn_payload: bool = False
    course_rad: float | None = None
    separation: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class NeighbourPlanned:
    """What another aircraft of the fleet flies, and the plan on its way to it; sent whenever either changes.

    present is None where it is not known, or the aircraft has left the fleet.
    """

    time_s: float
    name: str
    present: Plan | None
    coming: Plan | None


@runtime_checkable
class CooperativePlanner(Planner, Protocol):
    """A planner that counts on the others."""

    def advise(self, news: FleetAdvice | NeighbourPlanned) -> None:
        """Process fleet data; the next decision uses it."""
