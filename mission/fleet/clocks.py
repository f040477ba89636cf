"""One mission time for several vehicles, each with a clock of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState, Plan

# Two crystals drift apart by some tens of microseconds a second.
_DRIFT_S_PER_S = 5e-5


@dataclass(slots=True)
class VehicleTime:
    """Adds ``offset_s`` to a vehicle's time; NaN before the first report. Each report is weighed by its sigma."""

    offset_s: float = math.nan
    sigma_s: float = math.inf
    at_s: float = -math.inf

    def note(self, time_s: float, mission_time_s: float, sigma_s: float) -> None:
        """Take a report: a scalar Kalman filter; a report far off what is known (a clock set anew) replaces it."""
        offset_s, sigma_s = mission_time_s - time_s, max(sigma_s, 1e-6)
        known_s = self.sigma_at(time_s)
        off_s = offset_s - self.offset_s
        self.at_s = time_s
        if not abs(off_s) <= 5.0 * math.hypot(known_s, sigma_s):
            self.offset_s, self.sigma_s = offset_s, sigma_s
            return
        gain = known_s**2 / (known_s**2 + sigma_s**2)
        self.offset_s += gain * off_s
        self.sigma_s = math.sqrt(1.0 - gain) * known_s

    @property
    def known(self) -> bool:
        """Whether there was a report."""
        return math.isfinite(self.offset_s)

    def sigma_at(self, time_s: float) -> float:
        """Return one standard deviation of the offset at the vehicle's time."""
        return self.sigma_s if not self.known else self.sigma_s + _DRIFT_S_PER_S * max(time_s - self.at_s, 0.0)

    def mission_s(self, time_s: float) -> float:
        """Return the mission time of a vehicle's."""
        return time_s + self.offset_s

    def vehicle_s(self, mission_time_s: float) -> float:
        """Return the vehicle's time of a mission time."""
        return mission_time_s - self.offset_s


def shifted_state(state: AircraftState, by_s: float) -> AircraftState:
    """Return the state on another clock."""
    return replace(state, time_s=state.time_s + by_s)


def shifted_plan(plan: Plan | None, by_s: float) -> Plan | None:
    """Return the plan on another clock."""
    return plan if plan is None else replace(plan, departure_s=plan.departure_s + by_s)


def shifted_estimate(estimate: TargetEstimate | None, by_s: float) -> TargetEstimate | None:
    """Return the estimate on another clock."""
    if estimate is None:
        return None
    return replace(estimate, time_s=estimate.time_s + by_s, last_sighting_s=estimate.last_sighting_s + by_s)
