"""One aircraft of a fleet, as the coordinator knows it. Source: docs/how-to/several-aircraft.md."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.settings import TrackerSettings
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.fleet import Role
from sidelong.mission.core.requirement import Aircraft
from sidelong.mission.fleet.clocks import VehicleTime
from sidelong.mission.fleet.events import PlansReported, VehicleReported


@dataclass(frozen=True, slots=True)
class FleetMember:
    """One aircraft as the fleet file has it.

    height_m: of its layer, above the common home. target: to begin with, '' for the first. reserve: it waits until
    it is asked for.
    endurance_s: watching time after which it is relieved.
    """

    name: str
    aircraft: Aircraft
    tracker: TrackerSettings
    height_m: float
    target: str = ""
    reserve: bool = False
    endurance_s: float = math.inf


@dataclass(slots=True, eq=False)
class FleetVehicle:
    """What is known of one aircraft; ``report`` is on mission time, ``plans`` as the aircraft has them.

    target: which it is to watch. watches: which its payload looks at, until that has been turned to ``target``.
    """

    member: FleetMember
    clock: VehicleTime = field(default_factory=VehicleTime)
    report: VehicleReported | None = None
    silent_s: float = 0.0  # time since the latest report, independent of its own clock
    plans: PlansReported | None = None
    lost: str = ""
    yielded: bool = False  # its plans are not known any more
    remaining: float = 1.0
    relief_asked: bool = False
    since_s: float = math.inf  # it watches
    leaving: bool = False
    target: str = ""
    watches: str = ""
    corrections: int = 0  # of its payload, as it was last reported
    nearer: tuple[str, int] = ("", 0)  # another target, and how many sightings in a row have lain nearer to that one
    role: Role = Role.WANTED
    announced: tuple[Role, str] | None = None
    launch_asked: bool = False
    route: RouteGiven | None = None  # that it has been sent

    @property
    def takes_part(self) -> bool:
        """Whether it watches, or could."""
        return self.report is not None and self.report.watching and not self.lost and not self.leaving

    def range_m(self, target: TargetEstimate) -> float:
        """Return how far from a target it is."""
        assert self.report is not None
        return math.hypot(self.report.state.east_m - target.east_m, self.report.state.north_m - target.north_m)
