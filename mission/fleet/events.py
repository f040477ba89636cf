"""What goes into the fleet's coordinator and what comes out of it: frozen values, as in :mod:`mission.core.events`.

``time_s`` is on the named vehicle's own clock, ``mission_time_s`` on the one that the whole fleet shares.
Source: docs/decisions/0012-fleet-as-a-layer.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from sidelong.estimators.sensing.sighting import AnySighting
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.fleet import FleetAdvice, NeighbourPlanned
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind


@dataclass(frozen=True, slots=True)
class ClockReported:
    """At ``time_s`` of the vehicle's clock it was ``mission_time_s``, to one standard deviation of ``sigma_s``.

    From SYSTEM_TIME (UTC and boot time in one message) or TIMESYNC. Nothing of a vehicle is used before its first.
    The flag is set if the source of its reports has changed: earlier ones are discarded.
    """

    name: str
    time_s: float
    mission_time_s: float
    sigma_s: float
    anew: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class VehicleReported:
    """How one aircraft flies: about once a second.

    watching: it is ours, in the air and not held or yielded. detail: why not, in words.
    """

    name: str
    time_s: float
    state: AircraftState
    height_m: float
    watching: bool
    latency_s: float = 0.5
    wind: Wind = field(default_factory=Wind)
    detail: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class PlansReported:
    """What one aircraft flies, and what is on its way to it: whenever a plan is sent, taken up or given up."""

    name: str
    present: Plan | None
    coming: Plan | None = None


@dataclass(frozen=True, slots=True)
class SightingReported:
    """What the vehicle's payload has seen, without the errors found, before any filter of its own has judged it."""

    name: str
    sighting: AnySighting


@dataclass(frozen=True, slots=True)
class PayloadReported:
    """What the vehicle's own check knows of its payload: whenever that changes.

    fault: why its sightings are not to be trusted, in words; '' while they are. jumped: the position at which it sees
    the target has jumped lately. confirmed: its errors and delays are known from this flight. corrections: how often
    it turned out to err; earlier sightings show another place. The sigmas are of the errors that remain.
    """

    name: str
    fault: str = ""
    jumped: bool = False
    confirmed: bool = False
    corrections: int = 0
    yaw_sigma_rad: float = 0.0
    range_sigma_m: float = 0.0


@dataclass(frozen=True, slots=True)
class ChargeReported:
    """Remaining share of the charge, 0..1; left_s: remaining flight time, None where unknown."""

    name: str
    time_s: float
    remaining: float
    left_s: float | None = None


@dataclass(frozen=True, slots=True)
class VehicleLost:
    """The link, the autopilot or the pilot's hands: nothing more can be expected of this aircraft for now.

    A later ``VehicleReported`` brings it back. yielded: this program commands it no more.
    """

    name: str
    mission_time_s: float
    reason: str
    yielded: bool = False


@dataclass(frozen=True, slots=True)
class ForeignAircraftReported:
    """An aircraft that is not ours (ADSB_VEHICLE, GLOBAL_POSITION_INT of another system). height_m is above home.

    member: it belongs to the fleet, but this program has yielded it; ``identity`` is its name.
    """

    identity: str
    mission_time_s: float
    east_m: float
    north_m: float
    height_m: float
    course_rad: float
    speed_m_s: float
    member: bool = False
    curvature_per_m: float = 0.0
    climb_m_s: float = 0.0
    clear_m: tuple[float, float] = (0.0, 0.0)

    @property
    def state(self) -> AircraftState:
        """How it flies, on mission time."""
        flown = self.course_rad, self.speed_m_s, self.curvature_per_m
        return AircraftState(self.mission_time_s, self.east_m, self.north_m, *flown)


@dataclass(frozen=True, slots=True)
class ReliefRequested:
    """A person's wish: another is to take this aircraft's place. who: as the page knows the person."""

    name: str
    mission_time_s: float
    who: str = ""


@dataclass(frozen=True, slots=True)
class SideRequested:
    """A person's wish: which side is the wanted one from now on. who: as the page knows the person."""

    mission_time_s: float
    side: Side
    who: str = ""


@dataclass(frozen=True, slots=True)
class RequirementReported:
    """What one core flies by since a person changed it; its side is the one that the fleet gave it."""

    name: str
    mission_time_s: float
    aircraft: Aircraft
    requirement: Requirement


@dataclass(frozen=True, slots=True)
class TargetRouteGiven:
    """The route that a target is expected to follow. Its aircraft receive it at their own time."""

    target: str
    route: RouteGiven


@dataclass(frozen=True, slots=True)
class Tick:
    """Mission time goes on: sent at least once a second, so that silence is noticed too."""

    mission_time_s: float


FleetEvent = (
    ClockReported
    | VehicleReported
    | PlansReported
    | SightingReported
    | PayloadReported
    | ChargeReported
    | VehicleLost
    | ForeignAircraftReported
    | ReliefRequested
    | SideRequested
    | RequirementReported
    | TargetRouteGiven
    | Tick
)


@dataclass(frozen=True, slots=True, eq=False)
class VehicleEvent:
    """Feed ``event`` into the named vehicle's control step, as an event of its own."""

    name: str
    event: FleetAdvice | NeighbourPlanned | RouteGiven


@dataclass(frozen=True, slots=True)
class LaunchRequested:
    """A reserve is wanted in the air."""

    name: str
    mission_time_s: float
    reason: str


@dataclass(frozen=True, slots=True)
class FleetAnnounce:
    """Display a text to the operator. name: the aircraft that it concerns, '' for all."""

    mission_time_s: float
    name: str
    text: str


@dataclass(frozen=True, slots=True)
class RequirementChanged:
    """From now on the target is to be watched like this; its side is the wanted one."""

    mission_time_s: float
    target: str
    requirement: Requirement


FleetCommand = VehicleEvent | LaunchRequested | FleetAnnounce | RequirementChanged
