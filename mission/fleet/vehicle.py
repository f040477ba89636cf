"""One aircraft of a fleet, as the coordinator knows it, and one mission time for several, each with its own clock.

Source: docs/how-to/several-aircraft.md; scalar Kalman filter, Bar-Shalom, Li, Kirubarajan, *Estimation with
Applications to Tracking and Navigation*, 2001, section 5.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.settings import TrackerSettings
from sidelong.mission.core.events import RouteGiven
from sidelong.mission.core.fleet import Role
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft
from sidelong.mission.fleet.events import PlansReported, VehicleReported

# Two crystals drift apart by some tens of microseconds a second.
_DRIFT_S_PER_S = 5e-5
_RESTARTED_S = 1.0  # a vehicle's clock that goes back by more than this belongs to an autopilot that has rebooted
_LASTS_S = 15.0


@dataclass(slots=True)
class VehicleTime:
    """Adds ``offset_s`` to a vehicle's time, which makes it mission time.

    The clock of a running autopilot does not step: its offset from mission time only drifts. A report that does not
    fit is a step of the source (UTC), which is kept aside until ``take_step`` is called.

    offset_s is NaN before the first report; sigma_s: one standard deviation of it at ``at_s``, the time of the latest
    report on the vehicle's clock. step_s: size of the step kept aside; 0 where the latest report agreed.
    """

    offset_s: float = math.nan
    sigma_s: float = math.inf
    at_s: float = -math.inf
    step_s: float = 0.0
    _stepped_s: float = math.inf
    _step_sigma_s: float = math.inf

    def note(self, time_s: float, mission_time_s: float, sigma_s: float, *, discard: bool = False) -> None:
        """Process a report by a scalar Kalman filter, or keep it aside as a step; discard: forget earlier reports."""
        offset_s, sigma_s = mission_time_s - time_s, max(sigma_s, 1e-6)
        known_s, restarted = self.sigma_at(time_s), time_s < self.at_s - _RESTARTED_S
        self.at_s = time_s
        off_s = offset_s - self.offset_s
        if discard or restarted or not self.known:
            self._set(offset_s, sigma_s)
        elif abs(off_s) <= 5.0 * math.hypot(known_s, sigma_s):
            gain = known_s**2 / (known_s**2 + sigma_s**2)
            self._set(self.offset_s + gain * off_s, math.sqrt(1.0 - gain) * known_s)
        else:
            if self.step_s == 0.0 or abs(off_s - self.step_s) > 5.0 * math.hypot(self._step_sigma_s, sigma_s):
                self._stepped_s = time_s
            self.step_s, self._step_sigma_s = off_s, sigma_s

    def _set(self, offset_s: float, sigma_s: float) -> None:
        self.offset_s, self.sigma_s = offset_s, sigma_s
        self.step_s, self._stepped_s = 0.0, math.inf

    @property
    def step_lasts(self) -> bool:
        """Whether the same step has been reported for 15 s."""
        return self.at_s - self._stepped_s >= _LASTS_S

    def take_step(self) -> None:
        """Accept the step kept aside."""
        self._set(self.offset_s + self.step_s, self._step_sigma_s)

    @property
    def known(self) -> bool:
        """Whether there was a report."""
        return math.isfinite(self.offset_s)

    def sigma_at(self, time_s: float) -> float:
        """Return one standard deviation of the offset at a time of the vehicle's clock, s."""
        return self.sigma_s if not self.known else self.sigma_s + _DRIFT_S_PER_S * max(time_s - self.at_s, 0.0)

    def mission_s(self, time_s: float) -> float:
        """Return the mission time at a time of the vehicle's clock, s."""
        return time_s + self.offset_s


def shifted_state(state: AircraftState, by_s: float) -> AircraftState:
    """Return the state with ``by_s`` added to its time."""
    return replace(state, time_s=state.time_s + by_s)


def shifted_plan(plan: Plan | None, by_s: float) -> Plan | None:
    """Return the plan with ``by_s`` added to its departure."""
    return plan if plan is None else replace(plan, departure_s=plan.departure_s + by_s)


def shifted_estimate(estimate: TargetEstimate | None, by_s: float) -> TargetEstimate | None:
    """Return the estimate with ``by_s`` added to its times."""
    if estimate is None:
        return None
    time_s, sighted_s, as_seen = estimate.time_s, estimate.last_sighting_s, shifted_estimate(estimate.as_seen, by_s)
    return replace(estimate, time_s=time_s + by_s, last_sighting_s=sighted_s + by_s, as_seen=as_seen)


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
        """Whether the aircraft watches, or could."""
        return self.report is not None and self.report.watching and not self.lost and not self.leaving

    def range_m(self, target: TargetEstimate) -> float:
        """Return how far from a target it is."""
        assert self.report is not None
        return math.hypot(self.report.state.east_m - target.east_m, self.report.state.north_m - target.north_m)
