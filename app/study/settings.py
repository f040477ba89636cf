"""What a run of a study is flown with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Literal

from sidelong.app.config import SensorsSection
from sidelong.app.study.recorded import RecordedTarget
from sidelong.mission.core.requirement import GRAVITY_M_S2, Aircraft, Requirement, Side, Wind
from sidelong.mission.viewpoint.side_policy import watching_from

if TYPE_CHECKING:
    from sidelong.estimators.terrain.ground import Ground


class PlannerName(StrEnum):
    """What can be compared: this project's planners, two laws of the literature, and a program of the user."""

    PREDICTIVE = "predictive"
    PAPER = "paper"
    LVFG = "lvfg"
    PARK = "park"
    CONTROLLER = "controller"


class Fidelity(StrEnum):
    """How much of the product a study flies; ``PARTS`` lists it."""

    KINEMATIC = "kinematic"
    CLOSED_LOOP = "closed-loop"


PARTS = {
    Fidelity.KINEMATIC: "filter and planner in a compiled loop; the aircraft flies each plan from its departure, "
    "without checks of the input, control step, exchange or autopilot",
    Fidelity.CLOSED_LOOP: "MAVLink decoding, plausibility checks, filter, planner, control step and exchange with "
    "the autopilot; a kinematic vehicle flies the mission items that were uploaded",
}
"""What a study consists of."""


OWN_PLANNERS = tuple(one for one in PlannerName if one is not PlannerName.CONTROLLER)
"""Everything that can be compared without a program of the user."""

MISSION_PLANNERS = (PlannerName.PREDICTIVE, PlannerName.PAPER)
"""The planners that a closed loop flies; guidance laws have no plans to upload."""


@dataclass(frozen=True, slots=True)
class AutopilotAnswer:
    """latency_s: what a flight counts with from a decision to the earliest departure. lag_s: of the bank."""

    latency_s: float
    lag_s: float


# The lag is fitted to the bank that flights in SITL asked for and flew, a quarter of an hour each (to 0.045 and
# 0.011 rad RMS); the latency is that of uploads to the simulated vehicles, and what a flight begins with.
AUTOPILOTS = {"arduplane": AutopilotAnswer(1.0, 0.45), "px4": AutopilotAnswer(1.0, 0.43)}

# The study's laser has an unknown offset.
STUDIED_SENSORS = SensorsSection(range_bias_sigma_m=0.5)  # type: ignore[call-arg]  # every field has a default


@dataclass(frozen=True, slots=True, eq=False)
class Hills:
    """The ground of a study about home, and a digest of it."""

    ground: Ground
    digest: str


@dataclass(frozen=True, slots=True)
class StudySettings:
    """The paper's requirement. In wind the circle grows, so that its bank at the greatest ground speed stays.

    runs: targets; each is flown noise_draws times by each planner. latency_s: from a decision to the earliest
    departure. lag_s: time constant with which the bank follows its command, within the roll rate; 0: the roll rate
    alone. tracks: recorded targets in place of random ones, as many as runs, each flown to its end or for
    duration_s; skipped: (file, reason) of others. only: numbers of the runs to be flown, not all. fleet: aircraft on
    each target, each layer_m above the one before.

    fidelity: what is flown; autopilot: whose vehicle, in a closed loop. controller: the command of the planner
    "controller", see :mod:`sidelong.app.study.controller`.

    hills: what targets and aircraft move over, None: flat ground. terrain: whether planner and filter know it.
    clearance_m, climb_m_s and descent_m_s are as a mission's.
    """

    planners: tuple[PlannerName, ...] = OWN_PLANNERS
    runs: int = 20
    seed: int = 1
    target_speed_max_m_s: float = 5.0
    wind_speed_m_s: float = 0.0
    legs_s: tuple[float, float] = (40.0, 200.0)
    perfect_sensors: bool = False
    duration_s: float = 1200.0
    airspeed_m_s: float = 10.0
    still_air_radius_m: float = 50.0
    range_min_m: float = 100.0
    range_max_m: float = 500.0
    latency_s: float = 0.2
    tracks: tuple[RecordedTarget, ...] = ()
    skipped: tuple[tuple[str, str], ...] = ()
    noise_draws: int = 1
    only: tuple[int, ...] = ()
    lag_s: float = 0.0
    wind_from_deg: float = 270.0
    side: str = "left"
    threshold: float = 1.0  # the paper's C that keeps the band longest
    course_horizon_s: float = 20.0
    bank_max_deg: float = 45.0
    roll_rate_max_deg_s: float = 30.0
    height_m: float = 100.0
    lost_after_s: float = 60.0
    fleet: int = 1
    layer_m: float = 60.0
    hills: Hills | None = None
    terrain: Literal["known", "ignored"] = "known"
    clearance_m: float = 50.0
    climb_m_s: float = 3.0
    descent_m_s: float = 2.0
    sensors: SensorsSection = STUDIED_SENSORS
    fidelity: Fidelity = Fidelity.KINEMATIC
    autopilot: str = "arduplane"
    controller: str = ""

    @property
    def numbers(self) -> Sequence[int]:
        """The runs of each planner: every target once, then again with other noise."""
        return self.only or range(self.runs * self.noise_draws)

    @property
    def radius_m(self) -> float:
        """Radius of the circle flown to one side of the target."""
        return self.still_air_radius_m * (1.0 + self.wind_speed_m_s / self.airspeed_m_s) ** 2

    @property
    def circle_bank_rad(self) -> float:
        """Bank in the circle in still air."""
        return math.atan(self.airspeed_m_s**2 / (GRAVITY_M_S2 * self.still_air_radius_m))

    @property
    def wind(self) -> Wind:
        """From the west: a random target's course is random, so that one direction stands for all."""
        if self.wind_from_deg == 270.0:
            return Wind(self.wind_speed_m_s, 0.0)
        from_rad = math.radians(self.wind_from_deg)
        return Wind(-self.wind_speed_m_s * math.sin(from_rad), -self.wind_speed_m_s * math.cos(from_rad))

    def aircraft(self) -> Aircraft:
        """Return the planner's view of the aircraft."""
        return Aircraft(
            self.airspeed_m_s,
            self.radius_m,
            math.radians(self.bank_max_deg),
            math.radians(self.roll_rate_max_deg_s),
        )

    def requirement(self) -> Requirement:
        """Return the requirement."""
        plain = Requirement(self.range_min_m, self.range_max_m, Side.LEFT, self.target_speed_max_m_s, self.threshold)
        watched = watching_from(plain, self.side)
        return replace(watched, course_horizon_s=self.course_horizon_s, fleet_size=self.fleet)
